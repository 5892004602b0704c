"""What Python changes in a running simulation: by a scene file's names, and checked as there."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from .schema import shown, spell

T = TypeVar("T")


class Unknown(KeyError):
    """A name that nothing has; its message is shown as it is."""

    __str__ = Exception.__str__


class Named(dict):
    """Things of one class by their names."""

    def __init__(self, what: str, kind: type):
        super().__init__()
        self._what, self._kind = what, kind

    def __missing__(self, name: Any) -> Any:
        listed = ", ".join(self) or "none, as there are none"
        raise Unknown(f"{self._what}: expected one of {listed}, got {name!r}")

    def __setitem__(self, name: str, thing: Any) -> None:
        if not isinstance(thing, self._kind):
            expected = f"{self._what}[{name!r}]: expected {self._kind.__name__}"
            raise TypeError(f"{expected}, got {shown(thing)}")
        thing._label = f"{self._what}[{name!r}]"
        super().__setitem__(name, thing)


class Steered:
    """Attributes that may be set once it has begun, and are checked then; no others."""

    _begun = False
    _label = ""

    def _checks(self) -> dict[str, Callable[[Any], Any]]:
        """Of what may be set."""
        raise NotImplementedError

    def _at_start(self) -> Iterable[str]:
        """Names that only a scene file or the making of it sets."""
        raise NotImplementedError

    def __setattr__(self, name: str, value: Any) -> None:
        if self._begun and not name.startswith("_"):
            checks = self._checks()
            if name not in checks:
                known = ", ".join(checks)
                why = f"expected one of {known}, got an unknown name"
                if name in self._at_start():
                    why = f"cannot be changed after the start, expected one of {known}"
                raise AttributeError(f"{self._label}.{name}: {why}")
            value = checked(self._label, name, checks[name], value)
        super().__setattr__(name, value)


def checked(label: str, name: str, check: Callable[[Any], Any], value: Any) -> Any:
    """A value that a scene file's check takes; NumPy's numbers and arrays count as lists."""
    value = value.tolist() if hasattr(value, "tolist") else value
    try:
        return check(value)
    except ValueError as error:
        path, message = getattr(error, "path", ()), getattr(error, "message", str(error))
        raise ValueError(f"{label}.{spell((name, *path))}: {message}") from None


def checks_of(table: type) -> dict[str, Callable[[Any], Any]]:
    """A scene file's table: what each of its keys takes."""
    return {f.name: f.metadata["check"] for f in dataclasses.fields(table) if f.metadata}


def made(kind: type[T], values: Any, label: str = "", others: tuple[str, ...] = ()) -> T:
    """A dataclass of these values. label: what stands before their names in messages; others: keys
    that stand beside them."""
    fields = dataclasses.fields(kind)
    if not isinstance(values, dict):
        raise ValueError(f"{label}: expected a dict of names with values, got {shown(values)}")
    dot = "." if label else ""
    for name in values:
        if name not in (known := [f.name for f in fields]):
            listed = ", ".join([*known, *others])
            raise ValueError(f"{label}{dot}{name}: expected one of {listed}, got an unknown key")
    for f in fields:
        if f.name not in values and f.default is f.default_factory is dataclasses.MISSING:
            raise ValueError(f"{label}{dot}{f.name}: expected this key, got none")
    return kind(**values)
