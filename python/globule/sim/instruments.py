"""Instruments that follow key frames, and their blades."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import Any

import numpy as np

from .._base.rotations import matrix
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
        position, turn, on = (0.0, 0.0, 0.0), np.array([1.0, 0, 0, 0]), True
        self.times = [float(k.time) for k in keys]
        self.positions, self.turns, self.switches = [], [], []
        for k in keys:
            position = k.position if k.position is not None else position
            turn = quaternion(k.axis, k.angle or 0.0) if k.axis is not None else turn
            on = k.on if k.on is not None else on
            self.positions.append(np.asarray(position, float))
            self.turns.append(turn)
            self.switches.append(on)
        self._resting: tuple[int, np.ndarray] | None = None

    def pose(self, time: float) -> np.ndarray:
        """(4, 4) world_from_instrument at a time, s; m."""
        i, share = self._between(time)
        if share > 0:
            return self._mixed(i, share)
        if self._resting is None or self._resting[0] != i:  # asked for at every step
            self._resting = i, self._mixed(i, share)
        return self._resting[1].copy()

    def _mixed(self, i: int, share: float) -> np.ndarray:
        j = min(i + 1, len(self.times) - 1)
        pose = np.eye(4)
        pose[:3, 3] = (1 - share) * self.positions[i] + share * self.positions[j]
        pose[:3, :3] = matrix(slerp(self.turns[i], self.turns[j], share))
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


def quaternion(axis: Any, degrees: float) -> np.ndarray:
    """(4,) w, x, y, z of a rotation about a unit axis (3,) by an angle in degrees."""
    half = math.radians(degrees) / 2
    return np.array([math.cos(half), *(math.sin(half) * np.asarray(axis, float))])


def slerp(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    """(4,) quaternion between two, share 0 to 1, along the shorter way."""
    cosine = float(a @ b)
    if cosine < 0:
        b, cosine = -b, -cosine
    if cosine > 1 - 1e-12:
        mixed = (1 - share) * a + share * b
    else:
        angle = math.acos(cosine)
        mixed = (math.sin((1 - share) * angle) * a + math.sin(share * angle) * b) / math.sin(angle)
    return mixed / np.linalg.norm(mixed)


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
