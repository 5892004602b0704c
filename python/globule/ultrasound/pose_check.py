"""Poses that cannot be right: jumps, bursts, steps, a frozen tracker, repeated poses."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from .._base.arrays import DeviceArray
from .matching import Order
from .sweep import Sweep

_FAST = 5.0  # times the sweep's speed; faster between two frames is a jump
_LONGEST = 32  # frames of a burst, at most
_STEP = 12.0  # cost of a step: as many frames left out, or a quarter of a short sweep
_SMOOTH = 0.7  # second differences of poses beside first ones where a probe moves steadily
_FROZEN = 4  # frames of one pose
_PAUSE = 100.0  # steps between a clock that was set back and before: nobody knows how long


class PoseFinding(NamedTuple):
    """Something strange about the poses of frames first to last.

    kind   "jump": one frame elsewhere; "burst": several in succession; "freeze": the tracker
           repeats a pose while the probe moves; "step": the poses from `last` on are displaced from
           those up to `first`; "identical": a pose is repeated and the probe may well be at rest
    size   mm: how far the image's fastest corner moves; 0 for identical poses
    """

    kind: str
    first: int
    last: int
    size: float

    def __str__(self) -> str:
        where = f"frame {self.first}" if self.first == self.last else (
            f"frames {self.first} to {self.last}"
        )  # fmt: skip
        return {
            "jump": f"{where}: the pose jumps by {self.size:.3g} mm",
            "burst": f"{where}: the poses jump by up to {self.size:.3g} mm",
            "freeze": f"{where}: the tracker repeats one pose while "
            + (f"the probe moves {self.size:.3g} mm" if self.size else "the images change"),
            "step": f"{where}: the pose steps by {self.size:.3g} mm and stays there",
            "identical": f"{where}: one pose in all frames",
        }[self.kind]


class PoseCheck(NamedTuple):
    """outliers (F,) bool: frames of jumps, bursts and freezes; speed (F,) mm/s, to the slower
    neighbor, NaN for frames not valid; findings, in the order of frames."""

    outliers: np.ndarray
    speed: np.ndarray
    findings: list[PoseFinding]


def check_poses(sweep: Sweep, most_speed: float | None = None) -> PoseCheck:
    """Find frames whose pose a hand cannot reach, and poses that do not follow the probe.

    Distances are those of the image's fastest corner, and therefore include rotation. The sweep's
    speed is the 80th percentile over the frames where the probe moves steadily; a probe at rest
    does not count.

    Frames are left out or kept so that a sum is least (dynamic programming): the number of frames
    left out, plus the excess of the distances between kept neighbors. Excess is counted in the
    sweep's distance from frame to frame, over 4.5 of these and one for each frame left out between.
    A single frame is an outlier beyond 5 times the speed, a burst of 10 beyond 9.5 times. Bursts
    have at most 32 frames; a displacement that stays, or returns later, is a step. Frames of a step
    are no outliers, as it is not known which side is right. A pose repeated in 4 or more frames is
    a freeze if the probe has moved on afterwards or if the images change as they do elsewhere in
    the sweep.

    most_speed   mm/s, replaces 5 times the sweep's speed. Without time stamps, the frames are a
                 second apart.
    """
    n = len(sweep)
    outliers, speed = np.zeros(n, bool), np.full(n, np.nan)
    kept = np.flatnonzero(sweep.valid)
    if len(kept) < 3:
        return PoseCheck(outliers, speed, [])
    times = sweep.timestamps
    if times is None or not np.ptp(times[kept]):  # or a server without a clock
        times = np.arange(n, dtype=float)
    times = _on_one_clock(times)
    kept = kept[np.argsort(times[kept], kind="stable")]
    corners, t = sweep.corners()[kept], times[kept]
    spans = np.maximum(np.diff(t), 1e-9)
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1)
    speed[kept] = _slower(steps / spans)
    interval = float(np.median(spans))
    typical = _typical(corners, t) if most_speed is None else most_speed / _FAST
    if typical <= 0:  # nothing ever moves
        findings = [PoseFinding("identical", int(kept.min()), int(kept.max()), 0.0)]
        return PoseCheck(outliers, speed, findings)
    frozen = _freezes(sweep, kept, corners, t, typical)
    held = np.zeros(len(kept), bool)
    for finding, run in frozen:
        if finding.kind == "freeze":
            held[run[1:]] = True  # the first has its own pose
    judged = np.flatnonzero(~held)
    path = judged[_best_path(corners[judged], t[judged], typical, interval)]
    findings = [finding for finding, _ in frozen]
    on_path = np.zeros(len(kept), bool)
    on_path[path] = True
    findings += _jumps(kept, corners, judged, on_path)
    for a, b in itertools.pairwise(path):
        size = float(_distance(corners[a], corners[b]))
        if size > _FAST * typical * max(t[b] - t[a], interval):
            findings.append(PoseFinding("step", int(kept[a]), int(kept[b]), size))
    outliers[kept[~on_path]] = True
    return PoseCheck(outliers, speed, sorted(findings, key=lambda f: (f.first, f.last)))


def _on_one_clock(times: np.ndarray) -> np.ndarray:
    """Stamps (F,) that run on where a clock was set back, after a pause, or a stamp is missing (0)."""
    if (np.diff(times) >= 0).all():
        return times
    order, found, anew = Order(), times.copy(), []
    for i, time in enumerate(times.tolist()):
        likely, how = order.next, order.add(time)
        found[i] = likely if how == "none" else time
        if how == "anew":
            anew.append(i - 1)
    step = float(np.median(np.abs(np.diff(times))))
    for i in anew:
        found[i:] += found[:i].max() + _PAUSE * step - found[i]
    return found


def _distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of the fastest corner."""
    return np.linalg.norm(b - a, axis=-1).max(axis=-1)


def _slower(speeds: np.ndarray) -> np.ndarray:
    """A good frame beside a wrong one is fast on one side only."""
    return np.minimum(np.append(speeds, np.inf), np.append(np.inf, speeds))


def _typical(corners: np.ndarray, times: np.ndarray) -> float:
    """The speed of a moving probe. Noise at rest and frames in wrong places zigzag, motion does
    not: its second differences are smaller than its first ones."""
    new = np.append(True, (corners[1:] != corners[:-1]).any(axis=(1, 2)))
    corners, times = corners[new], times[new]
    if len(corners) < 3:
        return 0.0
    slower = _slower(_distance(corners[:-1], corners[1:]) / np.maximum(np.diff(times), 1e-9))
    first = np.linalg.norm(np.diff(corners, axis=0), axis=2).max(axis=1)
    second = np.linalg.norm(np.diff(corners, n=2, axis=0), axis=2).max(axis=1)
    steady = second < _SMOOTH * np.minimum(first[1:], first[:-1])
    base = float(np.median(slower))
    if steady.sum() >= max(3, 0.05 * len(slower)):
        return max(base, float(np.percentile(slower[1:-1][steady], 80)))
    return float(np.percentile(slower, 80))


def _best_path(corners: np.ndarray, times: np.ndarray, typical: float, interval: float) -> np.ndarray:
    """The frames that are kept (see `check_poses`)."""
    n = len(corners)
    unit = typical * interval
    best = np.arange(n, dtype=float)  # all frames before it left out
    best[_LONGEST:] = np.inf
    came = np.full(n, -1)
    for j in range(1, n):
        low = max(0, j - _LONGEST - 1)
        size = _distance(corners[low:j], corners[j])
        span = np.maximum(times[j] - times[low:j], 0)
        allowed = typical * (span + (_FAST - 1.5) * np.minimum(span, interval))
        cost = np.maximum(size - allowed, 0) / unit
        cost[-1] = min(cost[-1], _STEP, max(n / 4, 3))  # a step, between neighbors only
        cost += np.arange(j - low - 1, -1, -1) + best[low:j]
        i = len(cost) - 1 - int(np.argmin(cost[::-1]))
        if cost[i] < best[j]:
            best[j], came[j] = cost[i], low + i
    last = n - 1 - int(np.argmin((best + np.arange(n - 1, -1, -1))[::-1]))
    path = [last]
    while came[path[-1]] >= 0:
        path.append(int(came[path[-1]]))
    return np.array(path[::-1])


def _jumps(kept: np.ndarray, corners: np.ndarray, judged: np.ndarray, on_path: np.ndarray) -> list[PoseFinding]:
    """Runs of frames that are off the path."""
    off = np.flatnonzero(~on_path[judged])
    findings = []
    for run in np.split(off, np.flatnonzero(np.diff(off) > 1) + 1):
        if not len(run):
            continue
        beside = [i for i in (run[0] - 1, run[-1] + 1) if 0 <= i < len(judged)]
        there = corners[judged[run]]
        size = max(float(_distance(there, corners[judged[i]]).max()) for i in beside)
        frames = kept[judged[run]]
        kind = "jump" if len(run) == 1 else "burst"
        findings.append(PoseFinding(kind, int(frames[0]), int(frames[-1]), size))
    return findings


def _freezes(
    sweep: Sweep, kept: np.ndarray, corners: np.ndarray, times: np.ndarray, typical: float
) -> list[tuple[PoseFinding, np.ndarray]]:
    """Runs of one pose, freeze or identical, and which of the kept frames they are."""
    same = (corners[1:] == corners[:-1]).all(axis=(1, 2))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same, [0]])))
    runs = [np.arange(a, b + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    # A tracker slower than the images repeats every pose a few times.
    usual = float(np.median([len(run) for run in runs])) if len(runs) > 3 else 1.0
    long = [run for run in runs if len(run) >= max(_FROZEN, 3 * usual)]
    if not long:
        return []
    steps = _distance(corners[:-1], corners[1:]) / np.maximum(np.diff(times), 1e-9)
    changes = _changes(sweep, kept)
    moving = steps > 0.2 * typical
    found = []
    for run in long:
        a, b = int(run[0]), int(run[-1])
        sides = [s for s in (steps[max(a - 4, 0) : max(a - 1, 0)], steps[b + 1 : b + 4]) if len(s)]
        frozen, size = False, 0.0
        if b + 1 < len(kept):
            size = float(_distance(corners[b], corners[b + 1]))
            speed = max((float(np.median(side)) for side in sides), default=typical)
            speed = max(speed, 0.2 * typical)
            frozen = size > 0.5 * speed * (times[b + 1] - times[a])
        if changes is not None and moving.any():
            usual_change = float(np.median(changes[moving]))
            frozen |= usual_change > 0 and np.median(changes[a:b]) > 0.6 * usual_change
        kind = "freeze" if frozen else "identical"
        first = int(kept[run[1] if frozen else run[0]])
        found.append((PoseFinding(kind, first, int(kept[b]), size if frozen else 0.0), run))
    return found


def _changes(sweep: Sweep, kept: np.ndarray) -> np.ndarray | None:
    """Mean absolute difference of neighboring images, of every fourth pixel either way."""
    if isinstance(sweep.frames, DeviceArray):
        return None
    thin = sweep.frames[:, ::4, ::4]
    return np.array(
        [float(np.abs(np.subtract(thin[b], thin[a], dtype=np.float32)).mean()) for a, b in itertools.pairwise(kept)]
    )
