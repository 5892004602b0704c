"""What a simulation is made of beside its solver."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .simulation import Simulation


class Part:
    """Base of a simulation's parts: each locks as its simulation does."""

    def __init__(self, sim: Simulation):
        self._sim, self._lock = sim, sim._lock
