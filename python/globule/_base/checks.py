"""Checks of single arguments; each message names the argument, the expected and the given value."""

from __future__ import annotations

import functools
import importlib
import inspect
import math
import operator
import os
import reprlib
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

MAX_PIXELS = 2**28  # of an image

_Called = TypeVar("_Called", bound=Callable[..., Any])

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 100


def shown(value: Any) -> str:
    """A value for an error message: one short line, whatever it is."""
    try:
        return textwrap.shorten(_SHORT.repr(value), 160, placeholder=" ...")
    except ValueError:  # a whole number of thousands of digits
        return f"a very large {type(value).__name__}"


def near(word: str, known: Iterable[str]) -> str:
    """For an error message: what may have been meant; "" where nothing is near."""
    import difflib

    found = difflib.get_close_matches(word, known, 1)
    return f", did you mean {found[0]}?" if found else ""


def named(called: _Called) -> _Called:
    """Decorate a public class or function: a call with arguments that it does not have, or without
    those that it needs, says which there are."""
    function = called.__init__ if isinstance(called, type) else called  # type: ignore[misc]

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except TypeError as error:
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise  # of what it does
            signature = inspect.signature(function)
            try:
                signature.bind(*args, **kwargs)
            except TypeError as problem:
                known = [name for name in signature.parameters if name != "self"]
                wrong = next((name for name in kwargs if name not in known), "")
                said = f"{called.__name__}({', '.join(known)}): {problem}{near(wrong, known)}"
            else:
                raise
            raise TypeError(said) from None

    if not isinstance(called, type):
        return call  # type: ignore[return-value]  # `wraps` keeps the signature
    called.__init__ = call  # type: ignore[misc]
    return called


def listed(names: Sequence[str]) -> str:
    """ "a or b", "one of a, b, c"."""
    return " or ".join(names) if len(names) < 3 else f"one of {', '.join(names)}"


def choice(name: str, value: Any, known: Sequence[Any]) -> Any:
    """One of the known words or numbers."""
    if not isinstance(value, type(known[0])) or value not in known:
        expected = listed(list(map(str, known)))
        raise ValueError(f"{name}: expected {expected}, got {shown(value)}{near(str(value), map(str, known))}")
    return value


def three(name: str, value: Any, least: float = -math.inf) -> list[float]:
    """Three finite numbers; one number stands for all three."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):  # ragged
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{name}: expected three numbers, got {shown(value)}")
    with np.errstate(over="ignore"):  # too large becomes infinite
        array = array.astype(np.float32)
    if array.shape == ():
        array = np.repeat(array, 3)
    values = array.tolist()
    if array.shape != (3,) or not all(math.isfinite(v) and v >= least for v in values):
        expected = "three finite numbers" + (f" >= {least:g}" if least > -math.inf else "")
        raise ValueError(f"{name}: expected {expected}, got {shown(value)}")
    return values


def array_of_numbers(value: Any, dtype: Any = np.float64) -> np.ndarray:
    """An array of numbers; of what is none, an empty one, which has no expected shape."""
    try:
        return np.asarray(value, dtype)
    except (TypeError, ValueError, OverflowError):
        return np.empty(0, dtype)


def numeric(name: str, value: Any, expected: str = "numbers") -> np.ndarray:
    """An array of float64, of any shape; anything else is a TypeError."""
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{name}: expected {expected}, got {shown(value)}") from None


def unit(name: str, value: Any) -> list[float]:
    """A direction, made of unit length."""
    v = np.asarray(three(name, value), np.float64)
    length = np.linalg.norm(v)
    if length == 0:
        raise ValueError(f"{name}: expected a direction, got {shown(value)}")
    return [float(x) for x in v / length]


def as_float(value: Any) -> float:
    """A number as float, also an infinite one or NaN; what is none is a TypeError or ValueError."""
    if isinstance(value, (str, bytes, bool, np.bool_)):
        raise TypeError
    try:
        return float(value)
    except OverflowError:  # a whole number beyond all floats
        return math.inf


def number(name: str, value: Any, least: float = -math.inf, most: float = math.inf) -> float:
    """A finite number in [least, most]."""
    try:
        v = as_float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected a number, got {shown(value)}") from None
    if not (math.isfinite(v) and least <= v <= most):
        raise ValueError(f"{name}: expected {_range(least, most)}, got {shown(value)}")
    return v


def whole(name: str, value: Any, least: int, most: int) -> int:
    """A whole number in [least, most]."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}: expected a whole number, got {shown(value)}")
    if not least <= value <= most:
        raise ValueError(f"{name}: expected {least} to {most}, got {shown(value)}")
    return int(value)


def a_path(value: Any) -> str:
    """A file's or folder's path as text."""
    if not isinstance(value, (str, os.PathLike)):
        raise TypeError(f"path: expected a path, got {shown(value)}")
    path = os.fsdecode(value)
    if "\0" in path:
        raise ValueError(f"path: expected a path without a null byte, got {shown(path)}")
    return path


def image_size(value: Any) -> tuple[int, int]:
    """(width, height) of an image in pixels."""
    try:
        width, height = (operator.index(v) for v in value)
    except (TypeError, ValueError):
        raise TypeError(f"size: expected (width, height), got {shown(value)}") from None
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"size: expected 1 to {MAX_PIXELS:,} pixels, got {width}x{height}")
    return width, height


def corners(name: str, value: Any, dtype: Any = np.float64) -> np.ndarray:
    """Two finite corners (2, 3) of a box, the first one lower or equal along every axis."""
    box = array_of_numbers(value, dtype)
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise ValueError(f"{name}: expected two finite corners ((x, y, z), (x, y, z)), got {shown(value)}")
    return box


def as_image(value: Any) -> np.ndarray:
    """An image of 8 bits, perhaps with alpha."""
    image = np.asarray(value)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4):
        raise ValueError(f"image: expected (H, W, 3) or (H, W, 4) uint8, got {image.dtype} {image.shape}")
    return image


def positive(name: str, value: Any) -> float:
    """A finite number above 0."""
    try:
        v = number(name, value)
    except ValueError:
        v = 0.0
    if v <= 0:
        raise ValueError(f"{name}: expected a positive number, got {shown(value)}")
    return v


def flag(name: str, value: Any) -> bool:
    """True or False, also as NumPy has them."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}: expected True or False, got {shown(value)}")
    return bool(value)


def thread_count(value: Any) -> int:
    """How many CPU threads are asked for; 0 takes all."""
    return whole("threads", value, 0, 4096)


def _range(least: float, most: float) -> str:
    if least == -math.inf and most == math.inf:
        return "a finite number"
    if most == math.inf:
        return f"a number >= {least:g}"
    return f"{least:g} to {most:g}"


def how_to_install(extra: str) -> str:
    """The command that adds an extra where this Python looks for it: not every `pip` is its own."""
    python = sys.executable
    if python.startswith(os.getcwd() + os.sep):
        python = os.path.relpath(python)
    return f'{shlex.quote(python)} -m pip install "globule[{extra}]"'


class MissingPackageError(ImportError):
    """An optional package is not installed; the message gives the pip command that adds it."""


def optional(module: str, extra: str, package: str = "") -> Any:
    """A module of an optional package. Raises MissingPackageError; arguments as of `missing`, the
    package's name being the module's unless it is given."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise missing(package or module, extra) from None


def missing(package: str, extra: str) -> MissingPackageError:
    """The error to raise where an optional package cannot be imported.

    Args:
        package: its name, as users know it ("PyAV").
        extra: the extra of globule that installs it ("video").
    """
    return MissingPackageError(f"{package} is not installed. Install it with: {how_to_install(extra)}", name=package)
