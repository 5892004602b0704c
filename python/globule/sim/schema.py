"""Tables of a scene as dataclasses: the keys there are, and a check of each key's value.

A check takes a value as TOML has it and returns it as the simulation needs it, or raises a
ValueError that says what it expected.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeVar

from .._base.colormaps import hex_color, to_linear
from .toml_lines import Path

T = TypeVar("T", bound="Table")
Check = Callable[[Any], Any] | type  # a type: that of a table


class SceneError(ValueError):
    """A mistake in a scene. The message names the file and the line where there is a file, the
    key, what was expected and what came."""


class Problem(ValueError):
    """A mistake at a key; the tables around it prepend their own keys to `path`."""

    def __init__(self, path: Path, message: str):
        super().__init__(f"{spell(path)}: {message}" if path else message)
        self.path, self.message = path, message


def key(check: Check, default: Any = dataclasses.MISSING) -> Any:
    """A key of a table; without a default it is required. A class as default makes a new one for
    each table."""
    if isinstance(default, list):
        default = list
    if isinstance(default, type):
        return dataclasses.field(default_factory=default, metadata={"check": check})
    return dataclasses.field(default=default, metadata={"check": check})


class Table:
    """Base of the tables: what a key takes is checked when a table is made, from TOML, a dict or
    in Python alike. A subclass with a `__post_init__` of its own calls this one first.

    Raises:
        Problem: a value that the check of its key refuses.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]  # every subclass is a dataclass

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.metadata and value is not field.default:
                checked = _checked(field.metadata["check"], value, (field.name,))
                object.__setattr__(self, field.name, checked)  # a shape is frozen


def read_table(kind: type[T], value: Any, path: Path = ()) -> T:
    """A table as the dataclass `kind`: a dict as TOML has it, or a table of that kind already.

    Raises:
        Problem: an unknown or missing key, or a value that the key's check refuses.
    """
    if isinstance(value, kind):
        return value
    if not isinstance(value, dict):
        raise Problem(path, f"expected a table of names with values, got {shown(value)}")
    fields = {f.name: f for f in dataclasses.fields(kind) if f.metadata}
    for name in value:
        if name not in fields:
            known = ", ".join(fields)
            raise Problem((*path, name), f"expected one of {known}, got an unknown key")
    for name, field in fields.items():
        if name not in value and field.default is field.default_factory is dataclasses.MISSING:
            raise Problem(path, f"expected the key {name}, got none")
    try:
        return kind(**value)
    except Problem as problem:
        raise Problem((*path, *problem.path), problem.message) from None
    except ValueError as error:
        raise Problem(path, str(error)) from None


def _checked(check: Any, value: Any, path: Path) -> Any:
    """What `check` makes of a value; NumPy's numbers and arrays count as numbers and lists."""
    if isinstance(check, type) and issubclass(check, Table):
        return read_table(check, value, path)
    value = value.tolist() if hasattr(value, "tolist") else value
    try:
        return check(value)
    except Problem as problem:
        raise Problem((*path, *problem.path), problem.message) from None
    except ValueError as error:
        raise Problem(path, str(error)) from None


def spell(path: Path) -> str:
    """A path in words: `fluids[0].box.lo`."""
    words = ""
    for part in path:
        words += f"[{part}]" if isinstance(part, int) else f"{'.' if words else ''}{part[:60]}"
    return words


def shown(value: Any) -> str:
    """A value for a message: at most 60 characters, as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    words = repr(value)
    return words if len(words) <= 60 else words[:57] + "..."


# Checks


def number(least: float = -math.inf, most: float = math.inf, above: float = -math.inf) -> Check:
    """A finite number in [least, most] and more than `above`."""
    if above > -math.inf:
        expected = f"a number above {above:g}" + (f", at most {most:g}" if most < math.inf else "")
    elif most < math.inf:
        expected = f"a number from {least:g} to {most:g}"
    else:
        expected = "a number" + (f" of at least {least:g}" if least > -math.inf else "")

    def check(value: Any) -> float:
        real = isinstance(value, (int, float)) and not isinstance(value, bool)
        finite = real and abs(value) <= sys.float_info.max  # a whole number may be beyond any float
        if not (finite and least <= value <= most and value > above):
            raise ValueError(f"expected {expected}, got {shown(value)}")
        return float(value)

    return check


positive = number(above=0.0, most=1e30)


def whole(least: int, most: int) -> Check:
    """A whole number in [least, most]."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise ValueError(f"expected a whole number from {least} to {most}, got {shown(value)}")
        return value

    return check


def vector(n: int = 3, least: float = -math.inf, most: float = math.inf) -> Check:
    """A list of n finite numbers."""
    single = number(least=least, most=most)
    names = {2: "two", 3: "three", 4: "four"}

    def check(value: Any) -> tuple[float, ...]:
        if not isinstance(value, (list, tuple)) or len(value) != n:
            raise ValueError(f"expected {names[n]} numbers, got {shown(value)}")
        return tuple(each(single)(value))

    return check


# Quantities in SI units. The limits are some orders of magnitude beyond what occurs: they show
# slips and keep values within single precision.
place = vector(least=-1e6, most=1e6)
velocity = vector(least=-1e5, most=1e5)
density = number(1e-3, 1e6)


def direction(value: Any) -> tuple[float, ...]:
    """Three numbers, normalized to a unit vector."""
    v = vector()(value)
    length = math.sqrt(sum(x * x for x in v))
    if length == 0:
        raise ValueError(f"expected a direction, got {shown(value)}")
    return tuple(x / length for x in v)


def color(value: Any) -> tuple[float, ...]:
    """Linear RGB in [0, 1], or #rrggbb, sRGB."""
    if isinstance(value, str):
        digits = value[1:]
        if (
            len(value) == 7
            and value[0] == "#"
            and all(c in "0123456789abcdefABCDEF" for c in digits)
        ):
            return tuple(float(v) for v in to_linear(hex_color(digits)))
    elif isinstance(value, (list, tuple)) and len(value) == 3:
        return tuple(each(number(0.0, 1.0))(value))
    raise ValueError(f'expected [r, g, b] in 0 to 1, linear, or "#rrggbb", got {shown(value)}')


def switch(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise ValueError(f"expected true or false, got {shown(value)}")
    return value


def text(value: Any) -> str:
    """A string that is not empty."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"expected a text, got {shown(value)}")
    return value


def choice(*names: str) -> Check:
    """One of these strings."""

    def check(value: Any) -> str:
        if value not in names:
            raise ValueError(f"expected {' or '.join(names)}, got {shown(value)}")
        return value

    return check


def each(check: Any, least: int = 0) -> Check:
    """A list of what `check` takes."""

    def check_all(value: Any) -> list[Any]:
        if not isinstance(value, (list, tuple)) or len(value) < least:
            expected = f"a list of at least {least}" if least > 1 else "a list"
            raise ValueError(f"expected {expected}, got {shown(value)}")
        return [_checked(check, item, (i,)) for i, item in enumerate(value)]

    return check_all


def distinct(check: Any) -> Check:
    """A list of what `check` takes, no two the same."""

    def check_all(value: Any) -> list[Any]:
        found = each(check)(value)
        for i, item in enumerate(found):
            if item in found[:i]:
                raise Problem((i,), f"expected each once, got {shown(item)} again")
        return found

    return check_all


def exactly_one(table: Any, names: Sequence[str]) -> str:
    """The one of these keys that is given; none or several are a ValueError."""
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) != 1:
        raise ValueError(f"expected one of {', '.join(names)}, got {' and '.join(given) or 'none'}")
    return given[0]
