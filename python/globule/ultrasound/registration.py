"""Several sweeps of one anatomy, registered rigidly by their images and joined into one sweep.

One sweep becomes a volume (method `frames`). The pixels of the other sweep are turned and moved
until their gray values correlate best with the volume's where both hold data, from coarse to fine
voxels. Registrations from other starts, of disjoint parts of the overlap and in the other direction
tell how far the result can be trusted.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._base.checks import numeric, positive
from ..volumes.volume import FAR
from .calibration import turn_by
from .reconstruct import reconstruct
from .sweep import Sweep

_VOXELS = 300_000  # of the smaller sweep's box at the finest level
_LEVELS = (4, 2, 1)  # voxels of each level, in those of the finest
_POINTS = 30_000  # pixels that are compared
_STEPS, _LONGEST, _ENOUGH = 40, 2.0, 2e-3  # of Gauss and Newton: how many; lengths in voxels
_SMALLEST_OVERLAP = 0.1  # of the smaller sweep
_LEAST_CORRELATION = 0.3
_NEAR = 2.0  # finest voxels: starts that end so near each other agree
_BLOCK = 6  # voxels: edge of the blocks of the overlap's parts
_PARTS = 4
_SHIFT, _TURN = 0.06, 6.0  # other starts: share of the box's diagonal, degrees


class RegistrationError(ValueError):
    """A registration that is not trustworthy; `report` is the `Registration` that was refused."""

    def __init__(self, message: str, report: Registration | None = None):
        super().__init__(message)
        self.report = report


class Registration(NamedTuple):
    """Where one sweep lies in the world of another.

    fixed_from_moving   (4, 4) float64, mm, rigid: a place in the moving sweep's world to that in
                        the fixed sweep's
    rotation            degrees: angle of the turn
    translation         mm: way of the overlap's center
    correlation         of the gray values of both volumes where both hold data, -1 to 1
    correlation_before  the same with the poses as they were; nan where nothing overlapped
    overlap             share of the smaller sweep's voxels that the other sweep holds, too
    error               mm: expected error at the overlap's corners (1 sigma), from registrations of
                        4 disjoint parts of the overlap and from that in the other direction
    inverse_error       mm: distance at these corners from the registration in the other direction
    agreeing            share of 6 other starts that end within two voxels of this result
    spacing             mm: voxels of the finest level
    """

    fixed_from_moving: np.ndarray
    rotation: float
    translation: float
    correlation: float
    correlation_before: float
    overlap: float
    error: float
    inverse_error: float
    agreeing: float
    spacing: float


def register_sweeps(
    fixed: Sweep,
    moving: Sweep,
    spacing: float | None = None,
    max_error: float | None = None,
    initial: Any = None,
    check: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Registration:
    """Find the rigid motion that brings a sweep onto another sweep of the same anatomy.

    Args:
        fixed, moving: `Sweep`s that overlap, in one space. Their poses may share a world, as with
            a reference on the patient, or not.
        spacing: mm, voxels of the finest level; default: 300,000 in the smaller sweep's box.
        max_error: mm, largest `error` and `inverse_error` that is trusted; default: two voxels.
        initial: (4, 4) rigid, a first guess of `fixed_from_moving`, mm. Default: the better of the
            poses as they are and of equal centers of both sweeps.
        check: raise RegistrationError for a result that is not trustworthy.
        progress: called as progress(done, total), in steps.

    Returns:
        Registration. Same input, same bits, for any number of threads.

    Raises:
        RegistrationError: naming what is wrong: the sweeps overlap by less than a tenth, their gray
            values correlate below 0.3, fewer than half of the other starts agree, or an error
            exceeds `max_error`.
        TypeError, ValueError: naming the argument.
    """
    _check(fixed, moving)
    if spacing is None:
        spacing = min(_default_spacing(sweep) for sweep in (fixed, moving))
    spacing = positive("spacing", spacing)
    limit = 2 * spacing if max_error is None else positive("max_error", max_error)
    total = len(_LEVELS) + 3
    say = progress or (lambda done, total: None)
    guesses = [_rigid(initial)] if initial is not None else _guesses(fixed, moving)
    levels = [(_Level(fixed, n * spacing), _Level(moving, n * spacing)) for n in _LEVELS]
    say(1, total)

    coarse = levels[0]
    box = coarse[1].corners
    reach = _SHIFT * float(np.linalg.norm(np.ptp(box, axis=0)))
    best = max((_registered(*coarse, g) for g in guesses), key=lambda m: _score(*coarse, m))
    others = [_registered(*coarse, best @ start) for start in _starts(box.mean(axis=0), reach)]
    best = max([best, *others], key=lambda matrix: _score(*coarse, matrix))
    say(2, total)
    for step, level in enumerate(levels[1:]):
        best = _registered(*level, best)
        # The other starts follow to the last level but one: the coarsest optimum is wide.
        if step < len(_LEVELS) - 2:
            others = [_registered(*level, other) for other in others]
        say(3 + step, total)
    a, b = levels[-1]
    overlap, corners = _overlap(a, b, best)
    agreeing = float(np.mean([_apart(best, o, corners) <= _NEAR * spacing for o in others]))
    parts = [_registered(a, b, best, part) for part in range(_PARTS)]
    spread = np.mean([_apart(best, part, corners) ** 2 for part in parts])
    say(total - 1, total)
    back = np.linalg.inv(_registered(b, a, np.linalg.inv(best)))
    inverse_error = _apart(best, back, corners)
    # Each of n parts has n times the variance of the whole; their mean is nearly the whole's. All of
    # them share the error of one volume; two estimates of different volumes are sqrt(2) of it apart.
    error = math.sqrt(float(spread) / (_PARTS - 1) + inverse_error**2 / 2)
    say(total, total)
    angle = math.degrees(math.acos(np.clip((np.trace(best[:3, :3]) - 1) / 2, -1, 1)))
    middle = corners.mean(axis=0)[None]
    report = Registration(
        best, angle, float(np.linalg.norm(_moved(best, middle) - middle)), _seen(a, b, best),
        _seen(a, b, np.eye(4)), overlap, error, inverse_error, agreeing, spacing,
    )  # fmt: skip
    if check and (wrong := _distrust(report, limit)):
        raise RegistrationError(f"moving: expected sweeps of one anatomy that register, got {wrong}", report)
    return report


def join_sweeps(sweeps: Sequence[Sweep], registrations: Sequence[Registration | None]) -> Sweep:
    """One sweep with the frames of several, in the world of the first.

    Args:
        sweeps: with images of one size, type and mask, and one space.
        registrations: of each sweep onto the first, None for a sweep that stays as it is.

    Returns:
        Sweep with the frames in the order of the sweeps; `reconstruct` averages where passes
        overlap.

    Raises ValueError naming the sweep whose images differ.
    """
    if not sweeps or len(sweeps) != len(registrations):
        got = f"{len(sweeps)} sweeps and {len(registrations)} registrations"
        raise ValueError(f"sweeps: expected a registration or None for each, got {got}")
    first = sweeps[0]
    frames, poses, valid = [], [], []
    for i, (sweep, found) in enumerate(zip(sweeps, registrations, strict=True)):
        here, there = ((s.frames.shape[1:], s.frames.dtype) for s in (sweep, first))
        if here != there or sweep.space != first.space:
            raise ValueError(
                f"sweeps[{i}]: expected images of {there[1]} {there[0]} in {first.space} as in the "
                f"first, got {here[1]} {here[0]} in {sweep.space}"
            )
        if not np.array_equal(_mask(sweep), _mask(first)):
            raise ValueError(f"sweeps[{i}]: expected the mask of the first sweep, got another")
        place = np.eye(4) if found is None else found.fixed_from_moving
        frames.append(np.asarray(sweep.frames))
        poses.append(place @ sweep.world_from_image)
        valid.append(sweep.valid)
    return Sweep(np.concatenate(frames), np.concatenate(poses), None, np.concatenate(valid),
                 first.mask, first.world, first.space)  # fmt: skip


def register_and_join(
    sweeps: Sequence[Sweep], progress: Callable[[int, int], None] | None = None, **options: Any
) -> tuple[Sweep, list[Registration]]:
    """Register each sweep onto the first sweep and join them: the joined sweep, and a Registration
    for each sweep but the first.

    Args: sweeps: two or more; options: those of `register_sweeps`. progress: called as
    progress(done, total). Raises what `register_sweeps` and `join_sweeps` raise.
    """
    if len(sweeps) < 2:
        raise ValueError(f"sweeps: expected two or more, got {len(sweeps)}")
    join_sweeps(sweeps, [None] * len(sweeps))  # before the work: whether they can be joined
    found = []
    for i, sweep in enumerate(sweeps[1:], 1):
        try:
            found.append(register_sweeps(sweeps[0], sweep, **options))
        except RegistrationError as error:
            text = str(error).replace("moving:", f"sweeps[{i}]:", 1)
            raise RegistrationError(text, error.report) from None
        if progress:
            progress(i, len(sweeps) - 1)
    return join_sweeps(sweeps, [None, *found]), found


def _mask(sweep: Sweep) -> np.ndarray:
    return np.ones(sweep.frames.shape[1:], bool) if sweep.mask is None else sweep.mask


class _Level:
    """A sweep for one spacing: its volume, and some of its pixels, averaged over a voxel's edge."""

    def __init__(self, sweep: Sweep, spacing: float):
        volume = reconstruct(sweep, method="frames", spacing=spacing)
        self.values = np.where(volume.radius == FAR, np.nan, volume.values.astype(np.float64))
        self.voxel_from_world = np.linalg.inv(volume.world_from_voxel)
        self.points, self.seen, self.part = _pixels(sweep, spacing)
        self.corners = _box(self.points.min(axis=0), self.points.max(axis=0))

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (P,) and gradients (P, 3), gray levels per mm, at points (P, 3) mm, trilinear;
        nan where one of the eight voxels around is not known."""
        places = _moved(self.voxel_from_world, points)
        sizes = np.array(self.values.shape[::-1])
        low = np.floor(places).astype(np.int64)
        inside = ((low >= 0) & (low < sizes - 1)).all(axis=1)
        low = np.where(inside[:, None], low, 0)
        share = places - low
        steps = np.where(sizes > 1, [1, sizes[0], sizes[0] * sizes[1]], 0)
        index = low @ steps
        flat = self.values.reshape(-1)
        value, slope = np.zeros(len(points)), np.zeros((len(points), 3))
        for corner in itertools.product((0, 1), repeat=3):
            corner_values = flat[index + int(steps @ corner)]
            weights = [share[:, k] if c else 1 - share[:, k] for k, c in enumerate(corner)]
            value += weights[0] * weights[1] * weights[2] * corner_values
            for k, c in enumerate(corner):
                others = weights[k - 1] * weights[k - 2]
                slope[:, k] += (others if c else -others) * corner_values
        value[~inside] = np.nan
        return value, slope @ self.voxel_from_world[:3, :3]


def _pixels(sweep: Sweep, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (P, 3) mm with gray values (P,), means over squares of about a voxel's edge, of at
    most about 30,000 squares; and the part of each that stands for itself."""
    frames = np.flatnonzero(sweep.valid)
    height, width = sweep.frames.shape[1:]
    nx, ny = (min(max(1, round(spacing / step)), n) for step, n in zip(sweep.spacing, (width, height), strict=True))
    rows, columns = height // ny, width // nx
    step = -(-len(frames) * rows * columns // _POINTS)
    if step > 1:  # the ends count, and what lies between them evenly
        chosen = np.linspace(0, len(frames) - 1, max(2, len(frames) // step)).astype(int)
        frames = frames[np.unique(chosen)]
    mask = _mask(sweep)

    def squares(image: np.ndarray) -> np.ndarray:
        return image[: rows * ny, : columns * nx].reshape(rows, ny, columns, nx).mean(axis=(1, 3))

    used = squares(mask.astype(np.float64)) == 1
    j, i = np.nonzero(used)
    at = np.column_stack([i * nx + (nx - 1) / 2, j * ny + (ny - 1) / 2, np.zeros(len(i))])
    points = [_moved(sweep.world_from_image[f], at) for f in frames]
    seen = [squares(np.asarray(sweep.frames[f], np.float64))[used] for f in frames]
    part = [(i // _BLOCK + j // _BLOCK + k) % _PARTS for k in range(len(frames))]
    return np.concatenate(points), np.concatenate(seen), np.concatenate(part)


def _registered(fixed: _Level, moving: _Level, start: np.ndarray, part: int | None = None) -> np.ndarray:
    """fixed_from_moving of the best correlation near a start.

    Gauss-Newton steps of the turn about the points' center and of the shift, with free gain and
    offset of the gray values (Evangelidis and Psarakis, PAMI 2008).
    """
    chosen = slice(None) if part is None else moving.part == part
    points, seen = moving.points[chosen], moving.seen[chosen]
    if len(points) == 0:
        return start
    center = points.mean(axis=0)
    edge = 1 / np.linalg.norm(fixed.voxel_from_world[0, :3])
    arm = float(np.sqrt(((points - center) ** 2).sum(axis=1).mean())) + edge
    best, current = -2.0, start
    step = np.zeros(6)
    for _ in range(_STEPS):
        tried = _stepped(current, step, center)
        places = _moved(tried, points)
        value, slope = fixed.at(places)
        known = np.isfinite(value)
        score = _correlation_of(value[known], seen[known], len(seen))
        if not score > best:  # too long a step
            step = step / 2
            if np.abs(step[:3]).max() * arm + np.abs(step[3:]).max() < _ENOUGH * edge:
                break
            continue
        best, current = score, tried
        pivot = _moved(current, center[None])[0]
        turned = np.cross(places[known] - pivot, slope[known])
        system = np.column_stack([turned, slope[known], seen[known], np.ones(known.sum())])
        system[:, :3] /= arm
        normal = system.T @ system
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
        normal = normal / scale / scale[:, None] + 1e-9 * np.eye(8)
        found = np.linalg.solve(normal, (system.T @ value[known]) / scale) / scale
        # value + slope . step = gain * seen + offset
        step = -found[:6]
        step[:3] /= arm
        length = np.abs(step[:3]).max() * arm + np.abs(step[3:]).max()
        step *= min(1.0, _LONGEST * edge / max(length, 1e-12))
        if length < _ENOUGH * edge:
            break
    return current


def _stepped(matrix: np.ndarray, step: np.ndarray, center: np.ndarray) -> np.ndarray:
    """The motion turned about where the center lies, and shifted: step (6,) radians, mm."""
    pivot = _moved(matrix, center[None])[0]
    moved = np.eye(4)
    moved[:3, :3] = turn_by(step[:3])
    moved[:3, 3] = pivot + step[3:] - moved[:3, :3] @ pivot
    return moved @ matrix


def _correlation_of(value: np.ndarray, seen: np.ndarray, n: int) -> float:
    """Correlation, less 1 where fewer than a tenth of n points are known; -2: none."""
    if len(value) < 8 or value.std() == 0 or seen.std() == 0:
        return -2.0
    correlation = float(np.corrcoef(value, seen)[0, 1])
    return correlation if len(value) >= _SMALLEST_OVERLAP * n else correlation - 1


def _score(fixed: _Level, moving: _Level, matrix: np.ndarray) -> float:
    value = fixed.at(_moved(matrix, moving.points))[0]
    known = np.isfinite(value)
    return _correlation_of(value[known], moving.seen[known], len(known))


def _seen(fixed: _Level, moving: _Level, matrix: np.ndarray) -> float:
    """The correlation, of however few points; nan for none."""
    value = fixed.at(_moved(matrix, moving.points))[0]
    known = np.isfinite(value)
    found = _correlation_of(value[known], moving.seen[known], 0)
    return found if found >= -1 else math.nan


def _overlap(fixed: _Level, moving: _Level, matrix: np.ndarray) -> tuple[float, np.ndarray]:
    """Share of the pixels of the moving sweep, or of the fixed one if more, that the other sweep
    holds, too; and the corners (8, 3) of the box around them, mm, in the moving world."""
    inside = np.isfinite(fixed.at(_moved(matrix, moving.points))[0])
    other = np.isfinite(moving.at(_moved(np.linalg.inv(matrix), fixed.points))[0])
    points = moving.points[inside] if inside.any() else moving.points
    share = float(max(inside.mean(), other.mean()))
    return share, _box(points.min(axis=0), points.max(axis=0))


def _distrust(report: Registration, limit: float) -> str:
    """What is wrong with a result; empty: nothing."""
    r = report
    if r.overlap < _SMALLEST_OVERLAP:
        return f"an overlap of {100 * r.overlap:.0f} % of the smaller sweep (10 % needed)"
    if not r.correlation >= _LEAST_CORRELATION:
        return f"a correlation of {r.correlation:.2f} ({_LEAST_CORRELATION:g} needed)"
    if r.agreeing < 0.5:
        return f"{round(6 * r.agreeing)} of 6 other starts that end at the same place (3 needed)"
    for name, value in (("an expected error", r.error), ("a difference of both directions", r.inverse_error)):
        if not value <= limit:
            return f"{name} of {value:.3g} mm (at most {limit:.3g} mm; max_error)"
    return ""


def _guesses(fixed: Sweep, moving: Sweep) -> list[np.ndarray]:
    """The poses as they are, and equal centers."""
    centered = np.eye(4)
    middles = [np.mean(sweep.bounds(), axis=0) for sweep in (fixed, moving)]
    centered[:3, 3] = middles[0] - middles[1]
    return [np.eye(4), centered]


def _starts(center: np.ndarray, shift: float) -> list[np.ndarray]:
    """Six motions: a shift along each axis, and a turn about each axis around a center."""
    motions = []
    for axis in range(3):
        moved = np.eye(4)
        moved[axis, 3] = shift if axis % 2 else -shift
        motions.append(moved)
        step = np.zeros(6)
        step[axis] = math.radians(_TURN)
        motions.append(_stepped(np.eye(4), step, center))
    return motions


def _apart(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> float:
    """Root mean square distance of points (P, 3) that two motions move, mm."""
    return float(np.sqrt(((_moved(a, points) - _moved(b, points)) ** 2).sum(axis=1).mean()))


def _moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _box(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.array(list(itertools.product(*zip(low, high, strict=True))))


def _default_spacing(sweep: Sweep) -> float:
    low, high = sweep.bounds()
    size = np.maximum(high - low, max(sweep.spacing))
    return max(float(np.prod(size) / _VOXELS) ** (1 / 3), 2 * max(sweep.spacing))


def _rigid(matrix: Any) -> np.ndarray:
    array = numeric("initial", matrix, "a 4x4 matrix")
    turn = array[:3, :3] if array.shape == (4, 4) else np.zeros((3, 3))
    if not np.isfinite(array).all() or not np.allclose(turn.T @ turn, np.eye(3), atol=1e-6):
        raise ValueError("initial: expected a rigid 4x4 matrix (no scale), mm")
    if np.linalg.det(turn) < 0 or array[3].tolist() != [0, 0, 0, 1]:
        raise ValueError("initial: expected a rotation and the last row 0 0 0 1")
    return array


def _check(fixed: Any, moving: Any) -> None:
    for name, sweep in (("fixed", fixed), ("moving", moving)):
        if not isinstance(sweep, Sweep):
            raise TypeError(f"{name}: expected Sweep, got {type(sweep).__name__}")
        if sweep.n_valid < 2:
            raise ValueError(f"{name}: expected two frames with poses or more, got {sweep.n_valid}")
    if fixed.space != moving.space:
        raise ValueError(f"moving: expected a sweep in {fixed.space}, got {moving.space}")
