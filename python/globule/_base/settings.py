"""Settings: dataclass fields that say what they take, in which unit, and what for.

One field is a checked attribute, a flag of a command (cli/flags.py), a widget of the viewer
(viewer/page/widgets.py), a key of a scene or state file, a row of the reference (docs/site) and a
property of a JSON Schema.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import math
import re
import textwrap
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from .checks import as_float, listed, shown
from .colormaps import hex_color, to_linear

Path = tuple[Any, ...]  # ("fluids", 0, "box", "lo")
T = TypeVar("T", bound="Table")
C = TypeVar("C", bound=type)


class Problem(ValueError):
    """A mistake at a key; the tables around it prepend their own keys to `path`."""

    def __init__(self, path: Path, message: str):
        super().__init__(f"{spell(path)}: {message}" if path else message)
        self.path, self.message = path, message


class WrongType(Problem, TypeError):
    """A value of another type."""


def spell(path: Path) -> str:
    """A path in words: `fluids[0].box.lo`."""
    words = ""
    for part in path:
        words += f"[{part}]" if isinstance(part, int) else f"{'.' if words else ''}{part[:60]}"
    return words


def sentence(words: str) -> str:
    """With a capital."""
    return words[:1].upper() + words[1:]


def unlinked(words: str) -> str:
    """Markdown without links."""
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", words)


# Kinds of values


class Kind:
    """What a setting takes: a check of a value, a parser of a word, and a JSON Schema."""

    expected = "a value"
    word = ""  # expected of a word of a command, where that is another
    metavar = "V"
    choices: tuple[str, ...] | None = None
    limits = ""  # "0 to 1"

    def __call__(self, value: Any) -> Any:
        """The value as the program needs it. Raises Problem."""
        return self._take(value)

    def _take(self, value: Any) -> Any:
        raise NotImplementedError

    def wrong(self, value: Any, kind: type[Problem] = Problem) -> Problem:
        """The error about a value."""
        return kind((), f"expected {self.expected}, got {shown(value)}")

    def parse(self, text: str) -> Any:
        """The value of a word of a command. Raises argparse.ArgumentTypeError."""
        try:
            return self(self._read(text))
        except (TypeError, ValueError):
            from argparse import ArgumentTypeError

            raise ArgumentTypeError(f"expected {self.word or self.expected}, got {text!r}") from None

    def _read(self, text: str) -> Any:
        return text

    def schema(self) -> dict[str, Any]:
        """As JSON Schema."""
        return {"type": "string"}


class Number(Kind):
    """A finite number in [least, most] and more than `above`."""

    noun = "a number"

    def __init__(self, least: float = -math.inf, most: float = math.inf, above: float = -math.inf):
        self.least, self.most, self.above = least, most, above
        self.expected = self.noun
        if above > -math.inf:
            self.expected += f" above {above:g}" + (f", at most {most:g}" if most < 1e38 else "")
        elif most < 1e38:
            self.limits = self.word = f"{self._shown(least)} to {self._shown(most)}"
            self.expected += f" from {self.limits}"
        elif least > -math.inf:
            self.expected += f" of at least {least:g}"

    def _shown(self, end: float) -> str:
        return f"{end:g}"

    def _take(self, value: Any) -> Any:
        try:
            v = as_float(value)
        except (TypeError, ValueError):
            raise self.wrong(value, WrongType) from None
        if not (math.isfinite(v) and self.least <= v <= self.most and v > self.above):
            raise self.wrong(value)
        return v

    def _read(self, text: str) -> Any:
        return float(text)

    def schema(self) -> dict[str, Any]:
        ends = {"minimum": self.least, "maximum": self.most, "exclusiveMinimum": self.above}
        return {"type": "number"} | {k: v for k, v in ends.items() if math.isfinite(v)}


class Whole(Number):
    """A whole number in [least, most]."""

    noun = "a whole number"
    metavar = "N"

    def __init__(self, least: int, most: int):
        super().__init__(least, most)
        self.word = ""

    def _shown(self, end: float) -> str:
        return str(end)

    def _take(self, value: Any) -> Any:
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
            raise self.wrong(value, WrongType)
        if not self.least <= value <= self.most:
            raise self.wrong(value)
        return int(value)

    def _read(self, text: str) -> Any:
        return int(text[:20]) if text.isdecimal() else text

    def schema(self) -> dict[str, Any]:
        return super().schema() | {"type": "integer"}


class Switch(Kind):
    """True or false."""

    expected = "true or false"

    def _take(self, value: Any) -> Any:
        if not isinstance(value, (bool, np.bool_)):
            raise self.wrong(value, WrongType)
        return bool(value)

    def schema(self) -> dict[str, Any]:
        return {"type": "boolean"}


class Text(Kind):
    """A text that is not empty, or may be."""

    expected = "a text"
    metavar = "TEXT"

    def __init__(self, empty: bool = False, longest: int = 100_000):
        self.empty, self.longest = empty, longest

    def _take(self, value: Any) -> Any:
        if not isinstance(value, str):
            raise self.wrong(value, WrongType)
        if not (value or self.empty) or len(value) > self.longest:
            raise self.wrong(value)
        return value


class Choice(Kind):
    """One of some names."""

    metavar = "NAME"

    def __init__(self, *names: str):
        self.choices, self.expected = names, listed(names)

    def _take(self, value: Any) -> Any:
        if not isinstance(value, str) or value not in self.choices:  # type: ignore[operator]
            raise self.wrong(value)
        return value

    def schema(self) -> dict[str, Any]:
        return {"enum": list(self.choices or ())}


class Each(Kind):
    """A list of what a kind takes; distinct: no two the same."""

    def __init__(self, kind: Any, least: int = 0, most: int | None = None, distinct: bool = False):
        self.kind, self.least, self.most, self.distinct = kind, least, most, distinct
        n = f" of at least {least}" if least > 1 else f" of at most {most}" if most else ""
        self.expected = f"a list{n}"

    def _take(self, value: Any) -> Any:
        if not isinstance(value, (list, tuple)):
            raise self.wrong(value, WrongType)
        if len(value) < self.least or (self.most is not None and len(value) > self.most):
            raise Problem((), f"expected {self.expected}, got {len(value)}")
        found = [checked(self.kind, item, (i,)) for i, item in enumerate(value)]
        for i, item in enumerate(found):
            if self.distinct and item in found[:i]:
                raise Problem((i,), f"expected each once, got {shown(item)} again")
        return found

    def schema(self) -> dict[str, Any]:
        found = {"type": "array", "items": schema_of(self.kind), "minItems": self.least}
        return found | {"uniqueItems": True} if self.distinct else found


class Vector(Kind):
    """Some numbers, each in [least, most]."""

    def __init__(self, n: int = 3, least: float = -math.inf, most: float = math.inf, whole: bool = False):
        self.n = n
        self.each = Whole(int(least), int(most)) if whole else Number(least, most)
        self.expected = f"{['', 'one', 'two', 'three', 'four'][n]} numbers"
        self.word = self.metavar = ",".join("XYZW"[:n])

    def _take(self, value: Any) -> Any:
        if not isinstance(value, (list, tuple)) or len(value) != self.n:
            raise self.wrong(value, WrongType if isinstance(value, str) else Problem)
        return tuple(checked(self.each, item, (i,)) for i, item in enumerate(value))

    def _read(self, text: str) -> Any:
        return [float(word) for word in text.split(",")]

    def schema(self) -> dict[str, Any]:
        items = self.each.schema()
        return {"type": "array", "items": items, "minItems": self.n, "maxItems": self.n}


class Direction(Vector):
    """Three numbers, made of unit length."""

    def _take(self, value: Any) -> Any:
        v = super()._take(value)
        length = math.hypot(*v)
        if length == 0:
            raise Problem((), f"expected a direction, got {shown(value)}")
        return tuple(x / length for x in v)


class Color(Vector):
    """Linear RGB, or "#rrggbb", sRGB; gray: one number stands for all three."""

    def __init__(self, most: float = 1.0, gray: bool = False):
        super().__init__(3, 0.0, most)
        self.gray = gray
        limits = f" in {self.each.limits}" if self.each.limits else " of at least 0"
        self.expected = f'[r, g, b]{limits}, linear, or "#rrggbb"'
        self.metavar, self.word = "COLOR", "R,G,B or V or #rrggbb"

    def _take(self, value: Any) -> Any:
        if isinstance(value, str):
            if not re.fullmatch("#[0-9a-fA-F]{6}", value):
                raise self.wrong(value, WrongType)
            return tuple(float(v) for v in to_linear(hex_color(value[1:])))
        three = [value] * 3 if self.gray and isinstance(value, (int, float)) else value
        if not isinstance(three, (list, tuple)) or len(three) != 3:
            raise self.wrong(value)
        try:
            return super()._take(three)
        except Problem:
            if self.gray:
                raise self.wrong(value) from None
            raise

    def _read(self, text: str) -> Any:
        if text.startswith("#"):
            return text
        values = super()._read(text)
        return values * 3 if len(values) == 1 else values

    def schema(self) -> dict[str, Any]:
        name = {"type": "string", "pattern": "^#[0-9a-fA-F]{6}$"}
        return {"anyOf": [super().schema(), name]}


class Made(Kind):
    """An object of one of some classes."""

    def __init__(self, *kinds: type):
        self.kinds, self.expected = kinds, listed([kind.__name__ for kind in kinds])

    def _take(self, value: Any) -> Any:
        if not isinstance(value, self.kinds):
            raise self.wrong(value, WrongType)
        return value


SHARE = Number(0.0, 1.0)
RADIANCE = Color(most=3e38, gray=True)  # of light: a float32

# Fields


@dataclass(frozen=True)
class Setting:
    """What a field is, beside its name and its default.

    Attributes:
        kind: a `Kind`, or the class of a `Table`.
        help: what it is for, in Markdown, without a capital and without unit, limits and default.
        unit: of the value.
        usual: the default in words, where its value does not say it.
        default: the value; "..." where there is none, or each object makes its own.
        label: of the widget; without one, the name's words.
        slider: ends of the widget's slider; without them, the limits.
        step: of the widget.
    """

    kind: Any
    help: str = ""
    unit: str = ""
    usual: str = ""
    label: str = ""
    slider: tuple[float, float] | None = None
    step: float | None = None
    name: str = ""
    default: Any = ...
    required: bool = True

    @property
    def words(self) -> str:
        """Help, unit, and limits that are no mere protection from slips."""
        limits = "" if isinstance(self.kind, type) else self.kind.limits
        near = limits and max(abs(self.kind.least), abs(self.kind.most)) < 1e5
        first, dot, more = self.help.partition(". ")
        parts = (first, self.unit, limits if near else "")
        return ", ".join(part for part in parts if part) + dot + more

    @property
    def plain(self) -> str:
        """`words` without Markdown."""
        return unlinked(self.words).replace("`", "")

    @property
    def brief(self) -> str:
        """`plain` with the first sentence of the help."""
        return replace(self, help=self.help.split(". ")[0]).plain

    def check(self, value: Any, path: Path = ()) -> Any:
        """The value as the kind has it; the default is right as it is. Raises as a kind does."""
        return value if value is self.default else checked(self.kind, value, path or (self.name,))


def setting(kind: Any, default: Any = MISSING, help: str = "", unit: str = "", **more: Any) -> Any:
    """A field of a dataclass; without a default it is required. A class as default makes a new one
    for each object, and so does an empty list. more: other attributes of `Setting`."""
    metadata = {"setting": Setting(kind, help, unit, **more)}
    make = list if isinstance(default, list) else default
    if isinstance(make, type):
        return dataclasses.field(default_factory=make, metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def same(table: type, name: str, **changes: Any) -> Any:
    """A field that is a setting of another dataclass, with changes of `Setting`."""
    one = replace(settings_of(table)[name], **{k: v for k, v in changes.items()})
    more = {k: getattr(one, k) for k in ("usual", "label", "slider", "step")}
    default = MISSING if one.default is ... else one.default
    return setting(one.kind, default, one.help, one.unit, **more)


_KNOWN: dict[Any, dict[str, Setting]] = {}


def settings_of(table: Any) -> dict[str, Setting]:
    """The settings of a dataclass by their names; none of anything else."""
    if table in _KNOWN:
        return _KNOWN[table]
    if not dataclasses.is_dataclass(table):
        return {}
    found = _KNOWN[table] = {}
    for field in dataclasses.fields(table):
        if "setting" in field.metadata:
            one, name, usual = field.metadata["setting"], field.name, field.default
            required = usual is field.default_factory is MISSING
            usual = ... if usual is MISSING else usual
            found[name] = replace(one, name=name, default=usual, required=required)
    return found


@contextlib.contextmanager
def at(*path: str | int) -> Iterator[None]:
    """Errors in this block begin with the path."""
    try:
        yield
    except Problem as problem:
        raise type(problem)((*path, *problem.path), problem.message) from None
    except ValueError as error:
        raise Problem(path, str(error)) from None


def checked(kind: Any, value: Any, path: Path = ()) -> Any:
    """What a kind makes of a value; NumPy's numbers and arrays count as numbers and lists. Its
    errors begin with the path."""
    if isinstance(kind, type):
        return read_table(kind, value, path)
    value = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    with at(*path):
        return kind(value)


def check_all(table: Any) -> dict[str, Any]:
    """All settings of an object as their kinds have them."""
    return {k: one.check(getattr(table, k)) for k, one in settings_of(type(table)).items()}


# Tables


class Table:
    """Base of the tables: what a key takes is checked when a table is made, from TOML, a dict or
    in Python alike. A subclass with a `__post_init__` of its own calls this one first.

    Raises:
        Problem: a value that the kind of its key refuses.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]  # every subclass is a dataclass

    def __post_init__(self) -> None:
        for name, value in check_all(self).items():
            object.__setattr__(self, name, value)  # a shape is frozen


def read_table(kind: type[T], value: Any, path: Path = ()) -> T:
    """A table as the dataclass `kind`: a dict as TOML has it, or a table of that kind already.

    Raises:
        Problem: an unknown or missing key, or a value that the key's kind refuses.
    """
    if isinstance(value, kind):
        return value
    if not isinstance(value, dict):
        raise Problem(path, f"expected a table of names with values, got {shown(value)}")
    known = settings_of(kind)
    for name in value:
        if name not in known:
            raise Problem((*path, name), f"expected one of {', '.join(known)}, got an unknown key")
    for name, one in known.items():
        if name not in value and one.required:
            raise Problem(path, f"expected the key {name}, got none")
    with at(*path):
        return kind(**value)


# What is made of them


def schema_of(kind: Any) -> dict[str, Any]:
    """The JSON Schema (2020-12) of a kind, or of the settings of a dataclass."""
    if not isinstance(kind, type):
        return kind.schema()
    known, properties = settings_of(kind), {}
    for name, one in known.items():
        properties[name] = schema_of(one.kind) | {"description": one.plain}
        if not one.required and one.default not in (None, ...):
            properties[name]["default"] = one.default
    return {
        "type": "object", "properties": properties, "additionalProperties": False,
        "required": [name for name, one in known.items() if one.required],
    }  # fmt: skip


def documented(cls: C) -> C:
    """Decorate a dataclass: its settings stand as arguments in its docstring."""
    lines: list[str] = []
    for name, one in settings_of(cls).items():
        text = f"{name}: {unlinked(one.words)}" + (f"; default: {one.usual}." if one.usual else ".")
        lines += textwrap.wrap(text, 92, initial_indent="    ", subsequent_indent="        ")
    if not lines:
        return cls
    about, _, rest = inspect.cleandoc(cls.__doc__ or "").partition("\n\nRaises")
    args = "\n".join([about, "", "Args:", *lines])
    cls.__doc__ = args + (f"\n\nRaises{rest}" if rest else "")
    return cls
