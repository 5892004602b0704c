"""Objects that never change: what the core takes for one is made once and kept on it."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields
from typing import Any, TypeVar

import numpy as np

from .checks import named
from .settings import check_all, documented

_Class = TypeVar("_Class", bound=type)


class Fixed:
    """Base of frozen dataclasses, whose fields are `fixed` and then checked.

    A subclass keeps what was made of it as `_packed`, which stays out of copies and pickles.
    """

    def __post_init__(self) -> None:
        for name, value in list(vars(self).items()):
            object.__setattr__(self, name, fixed(value))
        self._check()

    def _check(self) -> None:
        """Refuse wrong fields with an error that names the field, expected and got."""
        check_all(self)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_packed"}


def read_only(cls: _Class) -> _Class:
    """Decorate a frozen dataclass: its settings stand in its docstring, and an assignment says what
    to write instead, a call what it has."""

    def refuse(self: Any, name: str, *_: Any) -> None:
        known = [field.name for field in fields(self)]
        if name not in known:
            raise AttributeError(f"{cls.__name__}: expected one of {', '.join(known)}, got {name}")
        raise FrozenInstanceError(
            f"{cls.__name__}.{name} cannot be assigned; "
            f"dataclasses.replace({cls.__name__.lower()}, {name}=...) makes a changed copy"
        )

    cls.__setattr__ = cls.__delattr__ = refuse  # type: ignore[assignment]  # a method for each
    return named(documented(cls))


def fixed(value: Any) -> Any:
    """A list as a tuple, an array as a copy that nobody writes to; anything else as it is."""
    if isinstance(value, list):
        return tuple(value)
    if isinstance(value, np.ndarray):
        value = value.copy()
        value.flags.writeable = False
    return value


class Checked(dict[str, Any]):
    """A dictionary whose `__setitem__` checks what is assigned, in whatever way."""

    def update(self, *args: Any, **kwargs: Any) -> None:
        """Assign each of several values."""
        for name, value in dict(*args, **kwargs).items():
            self[name] = value

    def setdefault(self, name: str, default: Any = None) -> Any:
        """The value of a name, assigned first where there is none."""
        if name not in self:
            self[name] = default
        return self[name]

    def __ior__(self, other: Any) -> Any:  # type: ignore[misc]  # not a plain dict
        self.update(other)
        return self
