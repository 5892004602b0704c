"""Objects that never change: what the core takes for one is made once and kept on it."""

from __future__ import annotations

from typing import Any

import numpy as np


class Fixed:
    """Base of frozen dataclasses, whose fields are `fixed`.

    A subclass keeps what was made of it as `_packed`, which stays out of copies and pickles.
    """

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            object.__setattr__(self, name, fixed(value))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_packed"}


def fixed(value: Any) -> Any:
    """A list as a tuple, an array as a copy that nobody writes to; anything else as it is."""
    if isinstance(value, list):
        return tuple(value)
    if isinstance(value, np.ndarray):
        value = value.copy()
        value.flags.writeable = False
    return value
