"""Instruments that follow key frames, and their blades."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .._base.settings import Choice, Direction, Each, Number, Problem, Switch, Table, at, setting
from .schema import NAME, PLACE, POINTS, POSITIVE


@dataclass(kw_only=True)
class Key(Table):
    """Key frames move boundaries and instruments. If a frame omits a key, the key keeps the value
    of the previous frame. Positions follow straight lines between key frames. The angle changes at
    a constant rate and may pass whole turns: from 0 to 720 degrees, the body turns twice. Where the
    axes of two key frames differ, the axis goes from one to the other along the shortest arc."""

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
    """A pose for every time: positions along straight lines between the key frames, angles at a
    constant rate about an axis that goes the shortest arc. The motion rests before the first frame
    and after the last.

    Args:
        keys: `Key`s, rising in time; the first position is the origin unless given.

    Raises:
        Problem: times that do not rise.
    """

    def __init__(self, keys: list[Key]):
        for i in range(1, len(keys)):
            if keys[i].time <= keys[i - 1].time:
                raise Problem((i, "time"), f"expected more than {keys[i - 1].time:g}, got {keys[i].time:g}")
        turn: tuple[np.ndarray | None, float] = None, 0.0
        position, on = (0.0, 0.0, 0.0), True
        self.times = [float(k.time) for k in keys]
        positions, turns, self.switches = [], [], []
        for k in keys:
            position = k.position if k.position is not None else position
            if k.axis is not None:
                turn = np.asarray(k.axis, float), math.radians(k.angle or 0.0)
            on = k.on if k.on is not None else on
            positions.append(position)
            turns.append(turn)
            self.switches.append(on)
        self.positions = np.array(positions, float)
        self._turns = [_Turn(*a, *b) for a, b in pairwise([*turns, turns[-1]])]
        self._resting: tuple[int, np.ndarray] | None = None

    def pose(self, time: float) -> np.ndarray:
        """(4, 4) world_from_instrument at a time, s; m."""
        i, share = self._between(time)
        if share > 0:
            return self._at(i, share)
        if self._resting is None or self._resting[0] != i:  # asked for at every step
            self._resting = i, self._at(i, 0.0)
        return self._resting[1].copy()

    def _at(self, i: int, share: float) -> np.ndarray:
        pose = np.eye(4)
        after = self.positions[min(i + 1, len(self.positions) - 1)]
        pose[:3, 3] = (1 - share) * self.positions[i] + share * after
        pose[:3, :3] = self._turns[i].at(share)
        return pose

    def way(self, start: float, end: float, reach: float) -> float:
        """How far a point moves at most, m, between two times, s; reach: from the point turned
        about, m."""
        way = 0.0
        first, last = self._between(start), self._between(end)
        for i in range(first[0], min(last[0] + 1, len(self.times) - 1)):
            share = (last[1] if i == last[0] else 1.0) - (first[1] if i == first[0] else 0.0)
            moved = float(np.linalg.norm(self.positions[i + 1] - self.positions[i]))
            way += share * (moved + reach * self._turns[i].most)
        return way

    def on(self, time: float) -> bool:
        """Whether the instrument works at a time, s, by the previous key frame; off before the
        first."""
        return bool(time >= self.times[0] and self.switches[self._between(time)[0]])

    def _between(self, time: float) -> tuple[int, float]:
        i = bisect_right(self.times, time) - 1
        if i < 0 or i + 1 >= len(self.times):
            return max(0, min(i, len(self.times) - 1)), 0.0
        return i, (time - self.times[i]) / (self.times[i + 1] - self.times[i])


class Steady:
    """A pose for every time, of what moves and turns at a constant rate; as `Motion` has it.

    Args:
        velocity: (3,), m/s.
        spin: (3,), rad/s.
        about: (3,), m: the point that it turns about, which moves with `velocity`.
    """

    def __init__(self, velocity: Any, spin: Any, about: Any):
        self._velocity, self._about = np.array(velocity, float), np.array(about, float)
        self._rate = float(np.linalg.norm(spin))
        self._turn = _Turn(None, 0.0, np.array(spin, float) / self._rate if self._rate else None, 1.0)

    def pose(self, time: float) -> np.ndarray:
        """(4, 4) world_from_body at a time, s; m."""
        pose = np.eye(4)
        pose[:3, 3] = self._about + time * self._velocity
        pose[:3, :3] = self._turn.at(math.fmod(self._rate * time, 2 * math.pi))
        return pose

    def way(self, start: float, end: float, reach: float) -> float:
        """How far a point moves at most, m, between two times, s; reach: from `about`, m."""
        return (end - start) * (float(np.linalg.norm(self._velocity)) + reach * self._rate)


class _Turn:
    """From one key frame's rotation to the next one's.

    Args:
        axis, angle: before, (3,) of length 1, or None where none was given, and rad.
        next_axis, next_angle: after.

    Attributes:
        most: how far the rotation can turn in all, rad.
    """

    def __init__(self, axis: np.ndarray | None, angle: float, next_axis: np.ndarray | None, next_angle: float):
        axis = next_axis if axis is None else axis
        axis = np.array([0.0, 0.0, 1.0]) if axis is None else axis
        next_axis = axis if next_axis is None else next_axis
        across = np.cross(axis, next_axis)
        sine, cosine = float(np.linalg.norm(across)), float(axis @ next_axis)
        if sine < 1e-12 and cosine < 0:  # the same line the other way round
            next_angle, cosine = -next_angle, 1.0
        self._arc = math.atan2(sine, cosine)
        self._axis, self._angle, self._by = axis, angle, next_angle - angle
        self._aside = np.cross(across / sine, axis) if sine > 1e-12 else np.zeros(3)
        self.most = abs(self._by) + 2 * self._arc

    def at(self, share: float) -> np.ndarray:
        """The rotation (3, 3) after a share of the time, 0 to 1."""
        arc, angle = share * self._arc, self._angle + share * self._by
        x, y, z = math.cos(arc) * self._axis + math.sin(arc) * self._aside
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


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
        with at("keys"):
            self.motion = Motion(self.keys)
