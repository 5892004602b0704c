"""Distances and volumes in a reconstructed volume, with the uncertainty that its trust map gives.

The trust map is the expected error of each voxel, gray levels. Errors of voxels nearer to each
other than a correlation length count as one error, farther ones as independent.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .._base.checks import numeric, positive
from ..volumes.slices import sample
from ..volumes.volume import FAR, Volume
from .neighbors import FramePath, usual_step
from .profiles import fit_profile
from .sweep import Sweep

_TESTED, _SIDE = 4, 160  # frames whose errors are correlated, and pixels of each side
_FEWEST = 12  # samples of a line


class MeasuredVolume(NamedTuple):
    """The volume of the voxels on one side of a level.

    volume     mm^3: of the voxels whose value is on that side
    std        mm^3: standard deviation by the errors of the gray values
    expected   mm^3: of all voxels, each times its probability to be on that side
    unknown    mm^3: of the region's voxels without data, which are not counted
    measured   share of the counted voxels that hold a pixel
    """

    volume: float
    std: float
    expected: float
    unknown: float
    measured: float


class MeasuredDistance(NamedTuple):
    """The distance of two edges, or of two bright echoes, along a line.

    distance     mm
    std          mm: standard deviation by the errors of the gray values
    edges        (2, 3) mm, world: where the profile is halfway between both sides, or a peak
    edge_std     (2,) mm: of each edge or peak
    levels       gray levels before, between and behind the edges, or at the first peak, between the
                 peaks, and at the second peak
    residual     gray levels: rms of the profile against the fitted one
    between      "edges" or "echoes"
    """

    distance: float
    std: float
    edges: np.ndarray
    edge_std: np.ndarray
    levels: tuple[float, float, float]
    residual: float
    between: str = "edges"


def find_error_length(sweep: Sweep, spacing: float) -> float:
    """How far the errors of a volume of method `frames` are correlated, mm.

    Up to 4 frames are predicted from their neighbors. The edge is the cube root of the product of
    the integral lengths of the errors' autocorrelation along rows and columns, each at least a
    voxel, and of the usual step between frames.

    Args:
        sweep: with three joined frames. spacing: mm, voxels of the volume.

    Raises ValueError if no frame has two neighbors.
    """
    spacing = positive("spacing", spacing)
    matrices = sweep.world_from_image[sweep.valid]
    poses = np.concatenate([matrices[:, :3, k] for k in (3, 0, 1)], axis=1) / spacing
    path = FramePath(np.asarray(sweep.frames)[sweep.valid], poses, sweep.mask)
    tested = [f for f in range(1, len(poses) - 1) if path.joined[f - 1] and path.joined[f]]
    if not tested:
        raise ValueError("sweep: expected three frames side by side, got none")
    tested = [tested[i] for i in np.unique(np.linspace(0, len(tested) - 1, _TESTED).astype(int))]
    height, width = path.frames.shape[1:]
    rows, columns = (np.arange(max(0, (n - _SIDE) // 2), min(n, (n + _SIDE) // 2)) for n in (height, width))
    j, i = np.meshgrid(rows, columns, indexing="ij")
    sums: list[list[np.ndarray]] = [[], []]
    for f in tested:
        pixels = np.column_stack([np.ones(i.size), i.ravel(), j.ravel()])
        found = path.between(f - 1, f + 1, pixels @ path.poses[f].reshape(3, 3))
        used = found.known.reshape(i.shape)
        if path.mask is not None:
            used &= path.mask[j, i] != 0
        error = found.value.reshape(i.shape) - path.frames[f][j, i]
        error = np.where(used, error - (error[used].mean() if used.any() else 0), 0)
        for axis in (0, 1):
            sums[axis].append(_autocorrelation(error, axis))
    lengths = []
    for axis, step in ((0, sweep.spacing[1]), (1, sweep.spacing[0])):
        curve = np.sum(sums[axis], axis=0)
        if curve[0] <= 0:
            lengths.append(spacing)
            continue
        curve = curve / curve[0]
        end = int(np.argmax(curve <= 0)) or len(curve)
        lengths.append(max(step * (2 * curve[:end].sum() - 1), spacing))
    lengths.append(max(usual_step(path.steps) * spacing, spacing))
    return float(np.prod(lengths)) ** (1 / 3)


def _autocorrelation(error: np.ndarray, axis: int) -> np.ndarray:
    """Sums of products of values so many places apart along an axis, by that number."""
    n = error.shape[axis]
    spectrum = np.abs(np.fft.rfft(error, 2 * n, axis=axis)) ** 2
    return np.fft.irfft(spectrum, 2 * n, axis=axis).sum(axis=1 - axis)[: n // 2]


def measure_volume(
    volume: Volume,
    correlation: float,
    above: float | None = None,
    below: float | None = None,
    center: Any = None,
    radius: float | None = None,
) -> MeasuredVolume:
    """The volume of what is brighter or darker than a level, and how well it is known.

    A voxel of value g and expected error s lies above a level L with the probability
    p = Phi((g - L) / s), Phi the normal distribution. Voxels of one cube of the edge `correlation`
    share one error: the variance of their number is sum_ij (min(p_i, p_j) - p_i p_j). Cubes are
    independent.

    Args:
        volume: with the map `uncertainty` (method `frames`).
        correlation: mm, see `find_error_length`.
        above, below: gray level, one of them.
        center, radius: mm, world: only voxels in this ball count; default: all.

    Raises ValueError naming the argument.
    """
    from scipy.special import ndtr

    if (above is None) == (below is None):
        raise ValueError("above: expected one of above and below")
    level = float(above if above is not None else below)  # type: ignore[arg-type]
    correlation = positive("correlation", correlation)
    known = volume.radius != FAR
    region = np.ones(known.shape, bool)
    if (center is None) != (radius is None):
        raise ValueError("center: expected center and radius together")
    if center is not None and radius is not None:
        region = _ball(volume, _point("center", center), positive("radius", radius))
    inside = region & known
    if not inside.any():
        raise ValueError("center: expected voxels with data in the region, got none")
    signed = (volume.values[inside].astype(np.float64) - level) * (1 if below is None else -1)
    error = volume.uncertainty[inside].astype(np.float64)
    counted = signed > 0
    chance = np.where(error > 0, ndtr(signed / np.where(error > 0, error, 1)), counted)
    cells = np.zeros(len(chance), np.int64)
    for index, n, edge in zip(np.nonzero(inside), known.shape, volume.spacing[::-1], strict=True):
        cells = cells * (n + 1) + (index * edge / correlation).astype(np.int64)
    variance = _variance(chance, cells)
    voxel = abs(float(np.linalg.det(volume.world_from_voxel[:3, :3])))
    measured = volume.radius[inside][counted] == 0
    return MeasuredVolume(
        voxel * int(counted.sum()), voxel * math.sqrt(variance), voxel * float(chance.sum()),
        voxel * int((region & ~known).sum()), float(measured.mean()) if counted.any() else 0.0,
    )  # fmt: skip


def _variance(chance: np.ndarray, cells: np.ndarray) -> float:
    """Variance of the number of voxels whose chances (N,) come true, one error in each cell."""
    order = np.lexsort((chance, cells))
    p, cell = chance[order], cells[order]
    first = np.r_[True, cell[1:] != cell[:-1]]
    start = np.flatnonzero(first)
    number = np.diff(np.r_[start, len(p)])
    group = np.cumsum(first) - 1
    rank = np.arange(len(p)) - start[group]
    pairs = np.bincount(group, p * (2 * (number[group] - rank) - 1))
    return float(np.maximum(pairs - np.bincount(group, p) ** 2, 0).sum())


def measure_distance(volume: Volume, start: Any, end: Any, correlation: float, width: float = 0.0) -> MeasuredDistance:
    """The distance of the two edges or the two bright echoes that a line crosses, and how well it
    is known.

    The profile of gray values along the line is fitted by three levels with edges
    (1 + tanh((t - t_k) / w)) / 2 between them, as of an object, and by two peaks
    exp(-((t - t_k) / w)^2 / 2) over one level, as of wires or walls; the smaller residual decides.
    With J the derivatives by the six parameters, S the
    covariance of the profile and H = (J'J)^-1, their covariance is H J' S J H. S has the trust
    map's errors, correlated as a triangle of the length `correlation`; they are enlarged to the
    residuals if these are larger, as of speckle.

    Args:
        volume: with the map `uncertainty` (method `frames`).
        start, end: (3,) mm, world: points outside of the object or of the echoes, on both sides.
        correlation: mm, see `find_error_length`.
        width: mm, diameter of the disc across the line over which the profile is averaged.

    Raises ValueError: naming the argument, or that no two edges are found.
    """
    a, b = _point("start", start), _point("end", end)
    correlation = positive("correlation", correlation)
    length = float(np.linalg.norm(b - a))
    step = 0.5 * float(volume.spacing.min())
    n = int(length / step) + 1
    if n < _FEWEST:
        least = _FEWEST * step
        raise ValueError(f"end: expected a line of {least:.3g} mm or more, got {length:.3g}")
    t = np.linspace(0, length, n)
    profile, error = _profile(volume, a, (b - a) / length, t, width, correlation)
    fitted = fit_profile(t, profile, float(volume.spacing.min()))
    residual = profile - fitted.values
    inverse = np.linalg.pinv(fitted.slopes)
    independent = n * min(1.0, t[1] / correlation)
    free = max(independent - 6, 1.0) / independent
    rms = float(np.sqrt((residual**2).mean()))
    enlarged = max(1.0, rms**2 / free / max(float((error**2).mean()), 1e-12))
    shared = np.clip(1 - np.abs(t[:, None] - t) / correlation, 0, None)
    covariance = inverse @ (np.outer(error, error) * shared * enlarged) @ inverse.T
    t1, t2 = fitted.places
    variance = covariance[3, 3] + covariance[4, 4] - 2 * covariance[3, 4]
    std = math.sqrt(max(float(variance), 0.0))
    contrast = np.abs(np.diff(fitted.levels)).min()
    unclear = contrast <= max(rms, float(error.mean()), 1e-9) or std > 0.5 * (t2 - t1)
    if unclear or not 0 < t1 < t2 < length:
        got = f"steps of {contrast:.3g} gray levels at the least, residual {rms:.3g}"
        raise ValueError(f"start: expected two clear edges or bright echoes on the line, got {got}")
    if fitted.between == "echoes":
        far = np.abs(t[:, None] - fitted.places).min(axis=1) > 3 * fitted.width
        third = int(np.argmax(np.where(far, profile, -np.inf)))
        if far[third] and profile[third] - fitted.levels[1] > 0.5 * contrast:
            at = ", ".join(f"{v:.4g}" for v in a + t[third] * (b - a) / length)
            raise ValueError(f"start: expected two bright echoes on the line, a third is at ({at})")
    edges = a + np.outer([t1, t2], (b - a) / length)
    before, middle, behind = (float(v) for v in fitted.levels)
    edge_std = np.sqrt(np.maximum(np.diag(covariance)[3:5], 0))
    return MeasuredDistance(float(t2 - t1), std, edges, edge_std, (before, middle, behind), rms, fitted.between)


def _profile(
    volume: Volume, start: np.ndarray, along: np.ndarray, t: np.ndarray, width: float, correlation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Means over discs around points along a line, and their errors, gray levels."""
    across = np.linalg.svd(along[None])[2][1:]
    edge = float(volume.spacing.min())
    reach = int(max(width, 0.0) / 2 / edge)
    offsets = [
        edge * (i * across[0] + j * across[1])
        for i in range(-reach, reach + 1)
        for j in range(-reach, reach + 1)
        if i * i + j * j <= reach * reach
    ]
    voxel_from_world = np.linalg.inv(volume.world_from_voxel)
    error_map = volume.uncertainty
    total, squares = np.zeros(len(t)), np.zeros(len(t))
    for offset in offsets:
        points = start + offset + t[:, None] * along
        places = points @ voxel_from_world[:3, :3].T + voxel_from_world[:3, 3]
        value, origin = sample(volume.values, volume.radius, places, True)
        if (origin == 0).any():
            at = ", ".join(f"{v:.4g}" for v in points[int(np.argmax(origin == 0))])
            raise ValueError(f"start: expected data along the line, got an empty voxel at ({at})")
        total += value
        squares += sample(error_map, volume.radius, places, False)[0].astype(np.float64) ** 2
    independent = max(1.0, len(offsets) * edge**2 / correlation**2)
    return total / len(offsets), np.sqrt(squares / len(offsets) / independent)


def _ball(volume: Volume, center: np.ndarray, radius: float) -> np.ndarray:
    z, y, x = (np.arange(n) for n in volume.shape)
    m = volume.world_from_voxel
    squared = np.zeros(volume.shape)
    for k in range(3):
        place = m[k, 0] * x + m[k, 1] * y[:, None] + m[k, 2] * z[:, None, None] + m[k, 3]
        squared += (place - center[k]) ** 2
    return squared <= radius**2


def _point(name: str, value: Any) -> np.ndarray:
    point = numeric(name, value, "three numbers")
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"{name}: expected three finite numbers, got {value!r}")
    return point
