"""Instruments at work: along their key frames, or wherever somebody moves them."""

from __future__ import annotations

from typing import Any

import numpy as np

from .blade import Knife, check_rigid, scalpel
from .instruments import Instrument
from .schema import switch
from .steered import Steered, checks_of

BELLY = 0.3  # of a scalpel's length: how far its edge stands below the tip


class Tool(Steered):
    """An instrument of a running simulation.

    Its key frames say where it is and whether it works, until `move_to` and `on` say otherwise.
    """

    def __init__(self, table: Instrument, number: int, time: float):
        self.name, self.kind, self.radius = table.name, table.kind, table.radius
        self.ablates = table.ablates
        self._motion, self._number = table.motion, number
        self._wanted: np.ndarray | None = None
        self._on: bool | None = None
        self._holds = False
        self.knife: Knife | None = None
        if table.kind == "scalpel":
            edge = table.edge
            length = table.length
            self.knife = Knife(np.array(edge)) if edge else scalpel(length, BELLY * length)
        self.start(time)
        self._begun = True

    def _checks(self) -> dict[str, Any]:
        taken, more = checks_of(Instrument), {"scalpel": [], "suction": ["radius", "ablates"]}
        switches = {"on": lambda value: None if value is None else switch(value)}
        return switches | {name: taken[name] for name in more.get(self.kind, ["radius"])}

    def _at_start(self) -> set[str]:
        return {"pose", *checks_of(Instrument)}

    def _state(self) -> dict[str, Any]:
        """All that was said by hand and where it is, as JSON holds it."""
        wanted = None if self._wanted is None else self._wanted.tolist()
        return {
            "pose": self.pose.tolist(), "wanted": wanted, "on": self._on, "holds": self._holds,
            "radius": self.radius, "ablates": self.ablates,
        }  # fmt: skip

    def _go_on(self, state: dict[str, Any]) -> None:
        """From what `_state` gave."""
        self._pose, wanted = np.array(state["pose"]), state["wanted"]
        self._wanted = None if wanted is None else np.array(wanted)
        self._on, self._holds = state["on"], state["holds"]
        vars(self).update(radius=state["radius"], ablates=state["ablates"])

    @property
    def pose(self) -> np.ndarray:
        """Where it is, world from instrument (4, 4)."""
        return self._pose

    def start(self, time: float) -> None:
        """Where it is at a time; what was said by hand is forgotten. After the start a grasper that
        is on holds something already."""
        self._wanted = self._on = None
        self._pose = self._motion.pose(time)
        self._holds = time > 0 and self.kind == "grasper" and self._motion.on(time)

    def move_to(self, pose: Any) -> None:
        """Where it will be at the end of the next step, and stays: (4, 4) world from instrument, or
        a position (3,), with which it keeps its rotation."""
        wanted = check_rigid(f"{self._label}.move_to", pose)
        if np.shape(pose) == (3,):
            wanted[:3, :3] = self.pose[:3, :3]
        self._wanted = wanted

    @property
    def on(self) -> bool | None:
        """Whether it works; None: as its key frames say."""
        return self._on

    @on.setter
    def on(self, value: bool | None) -> None:
        self._on = value

    def works(self, time: float) -> bool:
        if self._on is not None:
            return self._on
        return self._wanted is not None or self._motion.on(time)

    def prepare(self, sim: Any, dt: float) -> None:
        """Before a step of dt: where it goes, and what it holds."""
        time = sim.time
        self._next = self._motion.pose(time + dt) if self._wanted is None else self._wanted
        if self.kind != "grasper":
            return
        works = self.works(time)
        if works and not self._holds:
            sim.grasp(self.pose[:3, 3], self.radius, self._number)
        elif self._holds and not works:
            sim.release(self._number)
        self._holds = works
        if works and dt > 0:
            velocity = spin = (0.0, 0.0, 0.0)
            if not np.array_equal(self._next, self.pose):
                velocity = (self._next[:3, 3] - self.pose[:3, 3]) / dt
                spin = _spin(self._next[:3, :3] @ self.pose[:3, :3].T) / dt
            sim.move_grasp(self._number, velocity, spin, self.pose[:3, 3])

    def sink(self, time: float) -> tuple[np.ndarray, float] | None:
        """The ball that suction takes fluid out of."""
        if self.kind == "suction" and self.works(time):
            return self._next[:3, 3], self.radius
        return None

    def operate(self, sim: Any) -> int:
        """After a step: cut or take away what was passed; the number of bonds cut."""
        n_cut = 0
        if self.works(sim.time):
            if self.knife is not None:
                n_cut = sim.cut(self.knife.sweep(self.pose, self._next), relative=True)
            elif self.kind == "suction" and self.ablates:
                sim.ablate(self._next[:3, 3], self.radius)
        self._pose = self._next
        return n_cut


def _spin(turn: np.ndarray) -> np.ndarray:
    """Rotation vector of a small turn (3, 3)."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, (np.trace(turn) - 1) / 2)
    return axis * (angle / sine) if sine > 1e-12 else np.zeros(3)
