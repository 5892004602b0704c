"""Instruments that follow key frames, and their blades."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from .._base.settings import Choice, Direction, Each, Number, Problem, Switch, Table, setting
from .schema import NAME, PLACE, POINTS, POSITIVE


@dataclass(kw_only=True)
class Key(Table):
    """Key frames move boundaries and instruments. If a frame omits a key, the key keeps the value
    of the previous frame. Positions follow straight lines between key frames; rotations have a
    constant angular speed."""

    time: float = setting(Number(least=0.0), help="time, rising from key frame to key frame",
        unit="s")  # fmt: skip
    position: tuple | None = setting(PLACE, None, "position; of a boundary, its displacement", "m",
        usual="[0, 0, 0]")  # fmt: skip
    axis: tuple | None = setting(Direction(), None, "axis of a rotation, beside `angle`")
    angle: float | None = setting(Number(), None, "angle about `axis`", "degrees")
    on: bool | None = setting(Switch(), None, "whether an instrument works", usual="true")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.axis is None) != (self.angle is None):
            raise ValueError("expected axis and angle together, got one of them")


class Motion:
    """A pose for every time: positions along straight lines between the key frames, rotations by
    the shortest turn at constant speed (slerp). The motion rests before the first frame and after
    the last.

    Args:
        keys: `Key`s, rising in time; the first position is the origin unless given.

    Raises:
        Problem: times that do not rise.
    """

    def __init__(self, keys: list[Key]):
        for i in range(1, len(keys)):
            if keys[i].time <= keys[i - 1].time:
                raise Problem((i, "time"), f"expected more than {keys[i - 1].time:g}, got {keys[i].time:g}")
        from scipy.spatial.transform import Rotation, Slerp

        position, turn, on = (0.0, 0.0, 0.0), Rotation.identity(), True
        self.times = [float(k.time) for k in keys]
        positions, turns, self.switches = [], [], []
        for k in keys:
            position = k.position if k.position is not None else position
            if k.axis is not None:
                angle = math.radians(math.remainder(k.angle or 0.0, 360.0))
                turn = Rotation.from_rotvec(angle * np.asarray(k.axis))
            on = k.on if k.on is not None else on
            positions.append(position)
            turns.append(turn)
            self.switches.append(on)
        self.positions = np.array(positions, float)
        several = len(keys) > 1
        self._turns = Slerp(self.times, Rotation.concatenate(turns)) if several else lambda _: turn
        self._resting: tuple[int, np.ndarray] | None = None

    def pose(self, time: float) -> np.ndarray:
        """(4, 4) world_from_instrument at a time, s; m."""
        i, share = self._between(time)
        if share > 0:
            return self._at(time)
        if self._resting is None or self._resting[0] != i:  # asked for at every step
            self._resting = i, self._at(self.times[i])
        return self._resting[1].copy()

    def _at(self, time: float) -> np.ndarray:
        pose = np.eye(4)
        pose[:3, 3] = [np.interp(time, self.times, line) for line in self.positions.T]
        pose[:3, :3] = self._turns(time).as_matrix()
        return pose

    def way(self, start: float, end: float, reach: float) -> float:
        """How far a point moves, m, between two times, s; reach: from the point turned about, m."""
        if start >= self.times[-1] or end <= self.times[0]:
            return 0.0
        before, after = self.pose(start), self.pose(end)
        turn = np.trace(before[:3, :3].T @ after[:3, :3])
        angle = math.acos(min(1.0, max(-1.0, 0.5 * (turn - 1))))
        return float(np.linalg.norm(after[:3, 3] - before[:3, 3])) + reach * angle

    def on(self, time: float) -> bool:
        """Whether the instrument works at a time, s, by the previous key frame; off before the
        first."""
        return bool(time >= self.times[0] and self.switches[self._between(time)[0]])

    def _between(self, time: float) -> tuple[int, float]:
        i = bisect_right(self.times, time) - 1
        if i < 0 or i + 1 >= len(self.times):
            return max(0, min(i, len(self.times) - 1)), 0.0
        return i, (time - self.times[i]) / (self.times[i + 1] - self.times[i])


@dataclass(kw_only=True)
class Instrument(Table):
    """A tool and its key frames.

    The origin of its own frame is the tip. A scalpel's moving edge cuts the bonds that it sweeps
    over. `length` gives a curved edge along +x from the tip, whose sharp side is -z; `edge` gives
    any line of points. Suction removes fluid from a ball around the tip, and tissue with `ablates`.
    A grasper that is on moves the tissue in its ball.
    """

    name: str = setting(NAME, help="a name of its own")
    kind: str = setting(Choice("scalpel", "suction", "grasper"),
        help='"scalpel", "suction" or "grasper"')  # fmt: skip
    keys: list = setting(Each(Key, least=1), help="[key frames](#key-frames)")
    edge: list | None = setting(POINTS, None, "of a scalpel: points in its own frame, whose origin "
        "is the tip", "m")  # fmt: skip
    length: float | None = setting(POSITIVE, None, "of a scalpel without `edge`: a curved edge "
        "from the tip along +x", "m")  # fmt: skip
    radius: float | None = setting(POSITIVE, None, "radius of suction and grasper", "m")
    ablates: bool = setting(Switch(), False, "whether suction removes tissue, too")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind == "scalpel":
            if (self.edge is None) == (self.length is None):
                got = "none" if self.edge is None else "both"
                raise ValueError(f"a scalpel: expected edge or length, got {got}")
            if self.edge is not None and len(set(self.edge)) == 1:
                got = f"got {self.edge[0]} {len(self.edge)} times"
                raise Problem(("edge",), f"expected points apart, {got}")
        elif self.radius is None:
            raise ValueError(f"a {self.kind}: expected the key radius, got none")
        try:
            self.motion = Motion(self.keys)
        except Problem as problem:
            raise Problem(("keys", *problem.path), problem.message) from None
