"""Old names of arguments and attributes stay for one version, with a DeprecationWarning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

_Decorated = TypeVar("_Decorated", bound=Callable[..., Any])
_Class = TypeVar("_Class", bound=type)


def renamed(**names: str) -> Callable[[_Decorated], _Decorated]:
    """Decorate a function so that calls may still use old names of its arguments: `old="new"`.

    An argument that is given by both names has the old one's value: `dataclasses.replace(x, old=v)`
    passes the new name too.
    """

    def decorate(function: _Decorated) -> _Decorated:
        @functools.wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            for old in names.keys() & kwargs.keys():
                warn_of(f"{function.__qualname__.removesuffix('.__init__')}({old}=)", names[old])
                kwargs[names[old]] = kwargs.pop(old)
            return function(*args, **kwargs)

        return call  # type: ignore[return-value]  # `wraps` keeps the signature

    return decorate


def renamed_fields(**names: str) -> Callable[[_Class], _Class]:
    """Decorate a dataclass so that fields are still found by their old names: `old="new"`."""

    def decorate(cls: _Class) -> _Class:
        cls.__init__ = renamed(**names)(cls.__init__)  # type: ignore[misc]
        for old, new in names.items():
            setattr(cls, old, old_attribute(old, new))
        return cls

    return decorate


def old_attribute(old: str, new: str) -> property:
    """An attribute under its old name."""

    def get(self: Any) -> Any:
        warn_of(f"{type(self).__name__}.{old}", new)
        return getattr(self, new)

    return property(get, doc=f"Old name of `{new}`.")


def warn_of(old: str, new: str) -> None:
    """Warn that a caller of the caller uses an old name."""
    warnings.warn(
        f"globule: {old} is now {new}; the old name goes with the next version",
        DeprecationWarning,
        stacklevel=3,
    )
