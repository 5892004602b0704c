"""Instruments that follow key frames, and their blades."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from .schema import (
    Problem,
    Table,
    choice,
    direction,
    each,
    key,
    number,
    place,
    positive,
    switch,
    text,
)


@dataclass(kw_only=True)
class Key(Table):
    """A key frame: the pose of an instrument or boundary at a time. Omitted keys keep the value of
    the previous frame."""

    time: float = key(number(least=0.0))
    position: tuple | None = key(place, None)
    axis: tuple | None = key(direction, None)
    angle: float | None = key(number(), None)  # degrees about the axis
    on: bool | None = key(switch, None)

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
                raise Problem(
                    (i, "time"), f"expected more than {keys[i - 1].time:g}, got {keys[i].time:g}"
                )
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

    name: str = key(text)
    kind: str = key(choice("scalpel", "suction", "grasper"))
    keys: list = key(each(Key, least=1))
    edge: list | None = key(each(place, least=2), None)  # m
    length: float | None = key(positive, None)  # m, of a curved edge, where no `edge` is given
    radius: float | None = key(positive, None)  # m, of suction and grasper
    ablates: bool = key(switch, False)  # suction, of tissue

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
