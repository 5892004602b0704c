"""Instruments at work: along their key frames, or moved from Python; grasps and pushers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.checks import number as finite
from .._base.checks import shown
from .._base.checks import whole as int_in
from .._base.interrupts import whole
from .._base.owner import Owner
from .._base.settings import Setting, Switch, settings_of
from .arrays import numbers, vector
from .blade import Knife, check_rigid, scalpel
from .instruments import Instrument, Key
from .operate import BondedTissue
from .solver import Solver
from .steered import Named, Steered
from .tissue import BALL, GRASPED, HALF_SPACE, MOST_GRASPS

MOST_PUSHERS = 8
_ZERO = (0.0, 0.0, 0.0)
_AT_REST = (_ZERO,) * 3

BELLY = 0.3  # of a scalpel's length: how far its edge stands below the tip


class Tool(Owner, Steered):
    """An instrument of a running simulation.

    Key frames determine the pose of the instrument and whether the instrument works, until the
    program uses `move_to` and `on`. A program may assign `on`, the `radius` (m) of suction and
    graspers, and `ablates` of suction.

    Args:
        table: the instrument's table in the scene.
        number: number of the grasp that a grasper uses.
        time: start time, s.
    """

    def __init__(self, table: Instrument, number: int, time: float):
        self.name, self.kind, self.radius = table.name, table.kind, table.radius
        self.ablates = table.ablates
        self._motion, self.number = table.motion, number
        self._wanted: np.ndarray | None = None
        self._on: bool | None = None
        self._holds = False
        self._tools: Tools | None = None
        self.knife: Knife | None = None
        if table.kind == "scalpel":
            if table.edge:
                self.knife = Knife(np.array(table.edge))
            else:
                assert table.length is not None  # a scalpel has an edge or a length
                self.knife = scalpel(table.length, BELLY * table.length)
        self.start(time)
        self._begun = True

    def _checks(self) -> dict[str, Setting]:
        taken, more = settings_of(Instrument), {"scalpel": [], "suction": ["radius", "ablates"]}
        names = more.get(self.kind, ["radius"])
        return {"on": settings_of(Key)["on"], **{name: taken[name] for name in names}}

    def _at_start(self) -> set[str]:
        return {"pose", *settings_of(Instrument)}

    def _state(self) -> dict[str, Any]:
        """All that was said by hand and where it is, as JSON holds it."""
        wanted = None if self._wanted is None else self._wanted.tolist()
        return {
            "pose": self.pose.tolist(), "wanted": wanted, "on": self._on, "holds": self._holds,
            "radius": self.radius, "ablates": self.ablates,
        }  # fmt: skip

    def _go_on(self, state: dict[str, Any]) -> None:
        """From what `_state` gave."""
        numbers("pose", state["pose"], (4, 4))
        wanted, on = state["wanted"], state["on"]
        if wanted is not None:
            numbers("wanted", wanted, (4, 4))
        radius = state["radius"]
        radius = None if radius is None else finite("radius", radius, 0.0)
        switch = Switch()
        ablates = switch(state["ablates"])
        self._pose = np.array(state["pose"], float)
        self._wanted = None if wanted is None else np.array(wanted, float)
        self._on, self._holds = None if on is None else switch(on), switch(state["holds"])
        vars(self).update(radius=radius, ablates=ablates)

    @property
    def pose(self) -> np.ndarray:
        """The current pose: (4, 4) world_from_instrument, m."""
        return self._pose

    def start(self, time: float) -> None:
        """Follow the key frames again from a time, s, and discard `move_to` and `on`. After the
        start, a grasper that is on already holds tissue."""
        self._wanted = self._on = None
        self._pose = self._motion.pose(time)
        self._holds = time > 0 and self.kind == "grasper" and self._motion.on(time)

    def move_to(self, pose: Any) -> None:
        """Set the pose at the end of the next step. The instrument stays at this pose. Tissue in a
        grasper makes the whole way in that step.

        Args:
            pose: (4, 4) world_from_instrument, m; or a position (3,), which keeps the rotation.

        Raises:
            ValueError: a pose that is not a rotation and a position.
        """
        wanted = check_rigid(f"{self._label}.move_to", pose)
        if np.shape(pose) == (3,):
            wanted[:3, :3] = self.pose[:3, :3]
        self._wanted = wanted

    @property
    def force(self) -> np.ndarray:
        """What a grasper feels of the tissue, (3,) N in world axes, as of `Tools.grasp_force`: the
        mean of the last step; 0 after `load` until a step. 0 for other instruments: a blade cuts
        without resistance."""
        return self._felt()[0]

    @property
    def torque(self) -> np.ndarray:
        """The torque of `force` about the instrument's tip at the beginning of the last step, (3,)
        N m."""
        return self._felt()[1]

    def _felt(self) -> tuple[np.ndarray, np.ndarray]:
        if self.kind != "grasper" or self._tools is None or not self._holds:
            return np.zeros(3), np.zeros(3)
        return self._tools.grasp_force(self.number)

    @property
    def on(self) -> bool | None:
        """Whether the instrument works; None: the key frames decide."""
        return self._on

    @on.setter
    def on(self, value: bool | None) -> None:
        self._on = value

    def works(self, time: float) -> bool:
        """Whether the instrument cuts, removes or holds tissue at a time, s."""
        if self._on is not None:
            return self._on
        return self._wanted is not None or self._motion.on(time)

    def prepare(self, tools: Tools, time: float, dt: float) -> None:
        """Before a step of dt seconds from a time, s: decide the motion of the instrument and the
        held tissue."""
        self._tools = tools
        self._next = self._motion.pose(time + dt) if self._wanted is None else self._wanted
        if self.kind != "grasper":
            return
        works = self.works(time)
        if works and not self._holds:
            tools.grasp(self.pose[:3, 3], self._reach, self.number)
        elif self._holds and not works:
            tools.release(self.number)
        self._holds = works
        if works and dt > 0:
            if np.array_equal(self._next, self.pose):
                tools._move_grasp(self.number, (_ZERO, _ZERO, tuple(self.pose[:3, 3].tolist())))
                return
            velocity = (self._next[:3, 3] - self.pose[:3, 3]) / dt
            spin = _spin(self._next[:3, :3] @ self.pose[:3, :3].T) / dt
            tools.move_grasp(self.number, velocity, spin, self.pose[:3, 3])

    def grasps_by_keys(self, time: float) -> bool:
        """Whether at a time, s, it holds tissue that its key frames move."""
        return self.kind == "grasper" and self.works(time) and self._wanted is None

    def way(self, begin: float, end: float) -> float:
        """How far what it holds moves along the key frames between two times, s: m."""
        return self._motion.way(begin, end, self._reach)

    @property
    def _reach(self) -> float:
        assert self.radius is not None  # only a scalpel has none
        return self.radius

    def sink(self, time: float) -> tuple[np.ndarray, float] | None:
        """Center (3,) and radius, m, of the ball that suction empties; None without suction."""
        if self.kind == "suction" and self.works(time):
            return self._next[:3, 3], self._reach
        return None

    def operate(self, tissue: BondedTissue, time: float) -> int:
        """After a step, at a time, s: cut or ablate the passed tissue.

        Returns:
            the number of cut bonds.
        """
        n_cut = 0
        if self.works(time):
            if self.knife is not None:
                n_cut = tissue.cut(self.knife.sweep(self.pose, self._next), relative=True)
            elif self.kind == "suction" and self.ablates:
                tissue.ablate(self._next[:3, 3], self._reach)
        self._pose = self._next
        return n_cut


def _spin(turn: np.ndarray) -> np.ndarray:
    """Rotation vector of a small turn (3, 3)."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    sine = float(np.linalg.norm(axis))
    angle = np.arctan2(sine, (np.trace(turn) - 1) / 2)
    return axis * (angle / sine) if sine > 1e-12 else np.zeros(3)


class Tools(Owner, Named):
    """A simulation's instruments by their names, and grasps and pushers.

    `sim.tools["scalpel"].move_to(pose)` moves an instrument of the scene. `grasp` and `set_pushers`
    hold and push tissue without an instrument.
    """

    def __init__(self, solver: Solver):
        super().__init__("tools", Tool)
        self._solver, self._lock = solver, solver.lock
        self._motions: list[Any] = [_AT_REST] * MOST_GRASPS
        self._pushers: list[Any] = []

    @whole
    def grasp(self, center: VectorLike, radius: float, number: int = 0) -> int:
        """Hold the free tissue within a ball; `move_grasp` moves the held tissue.

        Args:
            center: (3,) m.
            radius: m.
            number: number of the grasp, 0 to 7; a new grasp with a number releases the old grasp.
                Graspers of a scene use the number of their instrument.

        Returns:
            the number of particles that it holds: 0 where there is no free tissue.

        Raises:
            ValueError: another number, or a ball that is not finite.
        """
        at, radius = vector("center", center), finite("radius", radius, 0.0)
        tissue = self._solver.core.tissue()
        tissue.grasp(at, radius, _grasp_number(number))
        hold = np.empty(tissue.n(), np.uint8)
        tissue.get(hold=hold)
        return int(np.count_nonzero(hold == GRASPED + number))

    @whole
    def release(self, number: int = 0) -> None:
        """Release the tissue of a grasp; errors as for `grasp`."""
        self.grasp((1e9, 1e9, 1e9), 0.0, number)

    @whole
    def move_grasp(
        self, number: int = 0, velocity: VectorLike = (0, 0, 0), spin: VectorLike = (0, 0, 0),
        center: VectorLike = (0, 0, 0),
    ) -> None:  # fmt: skip
        """Set the motion of a grasp: velocity m/s, and spin rad/s about center m, (3,) each; errors
        as for `grasp`."""
        given = {"velocity": velocity, "spin": spin, "center": center}
        motion = tuple(tuple(vector(name, part)) for name, part in given.items())
        self._move_grasp(_grasp_number(number), motion)

    def _move_grasp(self, number: int, motion: tuple[tuple[float, ...], ...]) -> None:
        if self._motions[number] != motion:
            self._motions[number] = motion
            self._send()

    @whole
    def grasp_force(self, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """What a grasp feels: force (3,) N and torque (3,) N m about its center, world axes, as the
        mean of the last step.

        The sum of all substeps: the elastic force on the held tissue, its weight, and the pressure
        of fluid and free tissue. The held tissue's inertia is not in it. 0 while nothing is held.

        Raises:
            ValueError: another number than 0 to 7.
        """
        return _force(self._solver.core.tissue().felt(), _grasp_number(number))

    @whole
    def pusher_force(self, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """What a pusher of `set_pushers` feels of the tissue that meets it: force (3,) N and torque
        (3,) N m about its point `a`, world axes, as the mean of the last step, with friction.

        Raises:
            ValueError: a pusher that there is not.
        """
        if not 0 <= number < len(self._pushers):
            raise ValueError(
                f"number: expected a pusher from 0 to {len(self._pushers) - 1}, got {number}"
                if self._pushers
                else f"number: expected pushers first, got {number}"
            )
        return _force(self._solver.core.tissue().felt(), MOST_GRASPS + number)

    def _forces(self) -> dict[str, float]:
        """What graspers and pushers felt in the last step, N, by name."""
        numbers = {name: tool.number for name, tool in self.items() if tool.kind == "grasper"}
        numbers |= {f"pusher {i}": MOST_GRASPS + i for i in range(len(self._pushers))}
        if not numbers:
            return {}
        felt = self._solver.core.tissue().felt()
        return {name: math.hypot(*felt[6 * number : 6 * number + 3]) for name, number in numbers.items()}

    @whole
    def set_pushers(self, shapes: Any) -> None:
        """Replace the solid shapes that tissue cannot enter.

        Args:
            shapes: at most 8 of (kind, a, b, radius, velocity): kind tissue.BALL with center a,
                CAPSULE from a to b, or HALF_SPACE with a point a and an outward normal b; m, m/s.
                A sixth item is the shape's coefficient of friction, 0 without it; a contact has
                the larger one of the shape's and the tissue's (`Phase.friction`).

        Raises:
            ValueError: more than 8 shapes, another kind, numbers that are not finite, or a negative
                friction.
        """
        shapes = list(shapes)
        if len(shapes) > MOST_PUSHERS:
            raise ValueError(f"shapes: expected at most {MOST_PUSHERS}, got {len(shapes)}")
        self._pushers = [_pusher(f"shapes[{i}]", shape) for i, shape in enumerate(shapes)]
        self._send()

    def _move_pushers(self, dt: float) -> None:
        """Where they are after a step, as its substeps left them but for rounding: what comes next
        depends on what is known here, which a checkpoint keeps."""
        if any(any(velocity) for *_, velocity, _ in self._pushers):
            self._pushers = [
                (kind, _shifted(a, v, dt), b if kind == HALF_SPACE else _shifted(b, v, dt), r, v, f)
                for kind, a, b, r, v, f in self._pushers
            ]
            self._send()

    def _send(self) -> None:
        self._solver.core.tissue().instruments(self._motions, self._pushers)

    def _by_hand(self) -> dict[str, Any]:
        """What was said by hand and where each is, as JSON holds it."""
        tools = {name: tool._state() for name, tool in self.items()}
        return {"tools": tools, "motions": self._motions, "pushers": self._pushers}

    def _take_up(self, by_hand: dict[str, Any]) -> None:
        """From what `_by_hand` returned."""
        for name, state in by_hand["tools"].items():
            self[name]._go_on(state)
        motions = [tuple(tuple(vector("motions", part)) for part in motion)
                   for motion in by_hand["motions"]]  # fmt: skip
        if [len(motion) for motion in motions] != [3] * MOST_GRASPS:
            raise ValueError(f"motions: expected three vectors of {MOST_GRASPS} grasps, got others")
        self._motions = motions
        self.set_pushers(by_hand["pushers"])


def _force(felt: list[float], which: int) -> tuple[np.ndarray, np.ndarray]:
    """Force and torque of one instrument among those of all; 0 before the first step with it."""
    all_of_them = np.asarray(felt).reshape(-1, 6)
    own = all_of_them[which] if which < len(all_of_them) else np.zeros(6)
    return own[:3].copy(), own[3:].copy()


def _shifted(point: list[float], velocity: list[float], dt: float) -> list[float]:
    return [x + v * dt for x, v in zip(point, velocity, strict=True)]


def _pusher(name: str, shape: Any) -> tuple:
    try:
        kind, a, b, radius, velocity, *more = shape
        (friction,) = more or [0.0]
    except (TypeError, ValueError):
        expected = "expected (kind, a, b, radius, velocity) or (..., velocity, friction)"
        raise ValueError(f"{name}: {expected}, got {shown(shape)}") from None
    kind = int_in(f"{name}: kind", kind, BALL, HALF_SPACE)
    radius = finite(f"{name}: radius", radius, 0.0)
    a, b, velocity = (vector(name, v) for v in (a, b, velocity))
    return kind, a, b, radius, velocity, finite(f"{name}: friction", friction, 0.0)


def _grasp_number(number: int) -> int:
    return int_in("number", number, 0, MOST_GRASPS - 1)
