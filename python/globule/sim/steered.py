"""Values that Python changes in a running simulation, with a scene's names and checks."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from .._base.checks import shown
from .._base.fixed import Checked
from .._base.settings import Setting


class Unknown(KeyError):
    """A name that there is not; unlike a KeyError it shows its message without quotes."""

    __str__ = Exception.__str__


class Named(Checked):
    """Things of one class by their names; an unknown name is a KeyError that lists the names."""

    def __init__(self, what: str, kind: type):
        super().__init__()
        self._what, self._kind = what, kind

    def __missing__(self, name: Any) -> Any:
        listed = ", ".join(self) or "none, as there are none"
        raise Unknown(f"{self._what}: expected one of {listed}, got {name!r}")

    def __setitem__(self, name: str, thing: Any) -> None:
        label = f"{self._what}[{name!r}]"
        if not isinstance(thing, self._kind):
            raise TypeError(f"{label}: expected {self._kind.__name__}, got {shown(thing)}")
        setattr(thing, "_label", label)  # noqa: B010  # its messages begin with it
        super().__setitem__(name, thing)
        Steered.last_change = object()

    def __reduce__(self) -> Any:
        """For `copy` and `pickle`: what it holds is checked by its own words."""
        return type(self), (self._what, self._kind), None, None, iter(self.items())


class Kept(Named):
    """Things that stay: particles refer to them."""

    def _stay(self, *_: Any) -> Any:
        raise TypeError(f"{self._what}: cannot be removed, as particles refer to them")

    __delitem__ = pop = popitem = clear = _stay


class Steered:
    """Base of objects that check what is assigned to them; other names are AttributeErrors.

    Attributes:
        last_change: another object after each value that is assigned, to whichever of them: what
            was handed on is as it was where this is. Any thread may assign.
    """

    last_change: ClassVar[object] = None
    _begun = False
    _label = ""

    def _checks(self) -> dict[str, Setting]:
        """The check of each name that may be assigned."""
        raise NotImplementedError

    def _at_start(self) -> Iterable[str]:
        """Names that are set when it is made, and not afterwards."""
        raise NotImplementedError

    def __setattr__(self, name: str, value: Any) -> None:
        steers = self._begun and not name.startswith("_")
        if steers:
            checks = self._checks()
            if name not in checks:
                known = ", ".join(checks)
                why = f"expected one of {known}, got an unknown name"
                if name in self._at_start():
                    why = f"cannot be changed after the start, expected one of {known}"
                raise AttributeError(f"{self._label}.{name}: {why}")
            value = checks[name].check(value, (self._label, name))
        super().__setattr__(name, value)
        if steers:
            Steered.last_change = object()
