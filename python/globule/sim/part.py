"""What a simulation is made of beside its solver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from .._base.owner import Owner
from .solver import Solver


class Part(Owner):
    """Base of a simulation's parts: each locks as its solver does."""

    def __init__(self, solver: Solver):
        self._solver, self._lock = solver, solver.lock


class Stateful(Protocol):
    """A part that has arrays of a simulation's whole state."""

    def _state(self) -> dict[str, np.ndarray]:
        """Its arrays by name."""

    def _check_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Refuse arrays that are none of this simulation: raises ValueError."""

    def _set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from what `_state` returned."""
