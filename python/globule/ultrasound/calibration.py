"""Calibration of a tracked probe: where a pixel lies on it, and how late its poses are.

    world_from_image = world_from_probe · probe_from_image

probe_from_image maps (column, row, 0, 1) to mm on the probe; a pose for the frame at time t is the
tracker's at t + temporal_offset.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base.checks import number, numeric
from .._base.files import atomic_write
from .._base.structured import parse_toml, read_text
from ..formats.errors import bad, faults
from ..formats.sweeps.transforms import chain, check_pixel_matrix, find_path
from .fitting import Fit, numerical_jacobian, robust_fit
from .region import Clip, Fan, checked_clip, checked_fan
from .temporal import TemporalOffset, temporal_offset

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

__all__ = [
    "Calibration",
    "PointTarget",
    "TemporalOffset",
    "calibrate_point_target",
    "read_calibration",
    "temporal_offset",
    "write_calibration",
]

_KEYS = ("probe_from_image", "temporal_offset", "clip", "fan", "rms", "error", "target")
_FOLDS = 10  # parts of the marks, each predicted from the others


@dataclass(frozen=True)
class Calibration:
    """The calibration of a probe, which a sweep needs.

    probe_from_image   (4, 4) float64: pixel (column, row, 0, 1) to mm in the probe's frame
    temporal_offset    s, added to a frame's time to find its pose
    clip, fan          the pixels that show tissue
    rms                root mean square of the calibration's residuals, mm, if it is known
    error              expected error at the image's worst corner, mm (1 sigma), if it is known
    """

    probe_from_image: Any
    temporal_offset: float = 0.0
    clip: Clip | None = None
    fan: Fan | None = None
    rms: float | None = None
    error: float | None = None

    def __post_init__(self) -> None:
        matrix = check_pixel_matrix("probe_from_image", self.probe_from_image)
        object.__setattr__(self, "probe_from_image", matrix)
        offset = number("temporal_offset", self.temporal_offset)
        object.__setattr__(self, "temporal_offset", offset)
        if self.clip is not None:
            object.__setattr__(self, "clip", checked_clip(self.clip))
        if self.fan is not None:
            object.__setattr__(self, "fan", checked_fan(self.fan))
        for name in ("rms", "error"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, number(name, getattr(self, name)))

    @property
    def spacing(self) -> tuple[float, float]:
        """mm per pixel along a row and along a column."""
        return tuple(np.linalg.norm(self.probe_from_image[:3, :2], axis=0).tolist())


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration (.toml), that of a PLUS configuration or result (.xml), or the
    calib_matrix.csv of TUS-REC.

    Raises FormatError naming the key.
    """
    if os.fspath(path).lower().endswith(".xml"):
        return _of_plus(path)
    if os.fspath(path).lower().endswith(".csv"):
        return _of_tus_rec(path)
    with faults(path, expected="TOML"):
        content = parse_toml(read_text(path))
    unknown = sorted(set(content) - set(_KEYS))
    if unknown:
        raise bad(path, unknown[0], f"expected one of {', '.join(_KEYS)}")
    if "probe_from_image" not in content:
        raise bad(path, "probe_from_image", "expected a 4x4 matrix, got none")
    with faults(path, refused=(TypeError, ValueError)):
        return Calibration(**{key: content[key] for key in content if key != "target"})


def _of_plus(path: str | os.PathLike[str]) -> Calibration:
    from .plus_setup import read_plus

    plus = read_plus(path)
    way = find_path(plus.edges, plus.image, "Probe")
    if way is None:
        got = " ".join(f"{a}To{b}" for a, b in plus.edges) or "none"
        raise bad(path, "Transform", f"expected a way from {plus.image} to Probe, got {got}")
    return Calibration(chain(plus.edges, way, 1).matrices[0], clip=plus.clip, fan=plus.fan)


def _of_tus_rec(path: str | os.PathLike[str]) -> Calibration:
    """Two matrices of four rows, perhaps with titles: mm from pixel, then the tool from mm. Their
    pixels count from 1."""
    rows = []
    for line in read_text(path).splitlines():
        try:
            numbers = [float(word) for word in line.split(",") if word.strip()]
        except ValueError:  # a title
            continue
        if numbers:
            rows.append(numbers)
    if len(rows) != 8 or any(len(row) != 4 for row in rows):
        got = f"{len(rows)} rows"
        raise bad(path, "", f"expected two matrices of four rows of four numbers, got {got}")
    first = np.eye(4)
    first[:2, 3] = 1
    with faults(path):
        return Calibration(np.array(rows[4:]) @ np.array(rows[:4]) @ first)


def write_calibration(
    path: str | os.PathLike[str], calibration: Calibration, base: str | os.PathLike[str] | None = None
) -> None:
    """Write a calibration (.toml), or the transform from Image to Probe of a PLUS configuration
    (.xml); every number survives exactly. A configuration holds no temporal offset and region.

    base   a PLUS configuration that the .xml repeats, with its transform replaced
    """
    if os.fspath(path).lower().endswith(".xml"):
        from .plus_setup import write_plus

        key = ("Image", "Probe")
        errors = {} if calibration.rms is None else {key: calibration.rms}
        write_plus(path, {key: calibration.probe_from_image}, base, errors)
        return
    lines = ["# pixel (column, row, 0, 1) to mm in the probe's frame", "probe_from_image = ["]
    lines += [f"  {row.tolist()!r}," for row in calibration.probe_from_image]
    lines += ["]", f"temporal_offset = {calibration.temporal_offset!r}  # s, added to frame times"]
    if calibration.clip is not None:
        lines.append(f"clip = {list(calibration.clip)!r}  # column, row, width, height")
    if calibration.fan is not None:
        names = "column, row, first, last (degrees), start, stop (pixels)"
        lines.append(f"fan = {list(calibration.fan)!r}  # {names}")
    if calibration.rms is not None:
        lines.append(f"rms = {calibration.rms!r}  # mm, of the residuals")
    if calibration.error is not None:
        lines.append(f"error = {calibration.error!r}  # mm, expected at the worst corner, 1 sigma")
    with atomic_write(path, "w") as file:
        file.write("\n".join(lines) + "\n")


class PointTarget(NamedTuple):
    """The result of a point-target calibration.

    calibration   with probe_from_image, rms and error
    target        (3,) mm, world: where the point is
    residuals     (N, 3) mm, world: each marked pixel's place minus the target
    weights       (N,) from 0, an outlier, to 1
    held_out      (N,) mm: distance of each mark from the target, both by a calibration without it
    errors        (4,) mm, expected (1 sigma) at the image's corners: first and last column of the
                  first row, then of the last row
    turns         (3,) degrees: standard deviation of the probe's rotations about the image's rows,
                  columns and normal
    """

    calibration: Calibration
    target: np.ndarray
    residuals: np.ndarray
    weights: np.ndarray
    held_out: np.ndarray
    errors: np.ndarray
    turns: np.ndarray


def calibrate_point_target(
    pixels: ArrayLike, world_from_probe: ArrayLike, size: tuple[int, int] | None = None, most_error: float | None = 2.0
) -> PointTarget:
    """Calibrate from one fixed point in images of many poses, for example a crossing of two wires
    or a bead.

    Args:
        pixels: (N, 2) column and row of the point in each image, N >= 6.
        world_from_probe: (N, 4, 4) poses, mm.
        size: columns and rows of the image; default: up to the last mark.
        most_error: mm, the largest expected error (1 sigma) at a corner of the image; None for any.

    Every pixel must map to one unknown point: world_from_probe · probe_from_image ·
    (column, row, 0, 1) = target. Linear in the columns of probe_from_image and in the target, which
    starts a robust fit of two scales, a rotation, a translation and the target (Prager et al. 1998,
    with the scales of rows and columns free; weights as in `robust_fit`). The expected error
    follows from the residuals and from how well the poses determine each unknown. Raises ValueError
    if the poses do not determine all unknowns, or not to most_error; the message then names the
    motion that is missing.
    """
    pixels, poses = _observations(pixels, world_from_probe)
    columns, rows = size if size is not None else np.ceil(pixels.max(axis=0)) + 1
    corners = [(x, y) for y in (0, rows - 1) for x in (0, columns - 1)]
    start = _linear(pixels, poses)
    model = _Model(start, pixels, poses)
    fit = robust_fit(model.residuals, np.zeros(11))
    turns = _turns(poses, start.axes)
    errors = corner_errors(fit, model.matrix, corners)
    if most_error is not None and errors.max() > most_error:
        about = ", ".join(f"{turn:.1f}" for turn in turns[:2])
        raise ValueError(
            f"poses: expected an error of at most {most_error:g} mm at the image's corners, got "
            f"{errors.max():.3g} mm (1 sigma); {_missing(model, fit, corners, turns)} (the probe "
            f"turned by {about} and {turns[2]:.1f} degrees about rows, columns and normal)"
        )
    used = fit.weights > 0
    rms = float(np.sqrt((fit.residuals[used] ** 2).sum(axis=1).mean()))
    calibration = Calibration(model.matrix(fit.parameters), rms=rms, error=float(errors.max()))
    return PointTarget(
        calibration, model.target(fit.parameters), fit.residuals, fit.weights,
        _held_out(model, fit), errors, turns,
    )  # fmt: skip


def _linear(pixels: np.ndarray, poses: np.ndarray) -> Start:
    rotations, offsets = poses[:, :3, :3], poses[:, :3, 3]
    n = len(pixels)
    # Unknowns: u, v (pixel steps in mm), t (pixel 0, 0), target. R (u c + v r + t) - target = -o.
    design = np.concatenate(
        [
            rotations * pixels[:, 0, None, None],
            rotations * pixels[:, 1, None, None],
            rotations,
            np.tile(-np.eye(3), (n, 1, 1)),
        ],
        axis=2,
    ).reshape(3 * n, 12)
    lengths = np.linalg.norm(design, axis=0)  # one size of columns, so that ranks mean something
    if not lengths.all():
        raise ValueError("pixels: expected marks in different rows and columns, got all at 0")
    solution, _, _, sizes = np.linalg.lstsq(design / lengths, -offsets.ravel(), rcond=None)
    if sizes[-1] < 1e-6 * sizes[0]:
        raise ValueError(
            "poses: expected the point seen under rotations about two axes or more and in "
            "different places of the image, got poses that leave the calibration undetermined"
        )
    u, v, t, target = (solution / lengths).reshape(4, 3)
    return Start.nearest(u, v, t, target)


class Start(NamedTuple):
    scales: np.ndarray  # (2,) mm per pixel
    axes: np.ndarray  # (3, 3) rotation, probe from image
    t: np.ndarray  # (3,) mm
    target: np.ndarray  # (3,) mm

    @staticmethod
    def nearest(u: np.ndarray, v: np.ndarray, t: np.ndarray, target: np.ndarray) -> Start:
        scales = np.array([np.linalg.norm(u), np.linalg.norm(v)])
        normal = np.cross(u, v)
        if not scales.all() or not normal.any():
            raise ValueError("pixels: expected marks that span the image, got all on one line")
        left, _, right = np.linalg.svd(
            np.stack([u / scales[0], v / scales[1], normal / np.linalg.norm(normal)], axis=1)
        )
        return Start(scales, left @ right, t, target)

    def matrix(self, parameters: np.ndarray) -> np.ndarray:
        """(4, 4) of a change: two logarithms of scales, a rotation vector, mm."""
        result = np.eye(4)
        scales = self.scales * np.exp(parameters[:2])
        # The third column has no pixels; the mean scale keeps the matrix invertible and its size.
        scales = np.append(scales, np.sqrt(scales.prod()))
        result[:3, :3] = turn_by(parameters[2:5]) @ self.axes * scales
        result[:3, 3] = self.t + parameters[5:8]
        return result


class _Model(NamedTuple):
    """Marks as a function of eleven parameters, changes of a start: those of `Start.matrix` and
    the target's."""

    start: Start
    pixels: np.ndarray
    poses: np.ndarray

    def matrix(self, parameters: np.ndarray) -> np.ndarray:
        return self.start.matrix(parameters)

    def target(self, parameters: np.ndarray) -> np.ndarray:
        return self.start.target + parameters[8:]

    def residuals(self, parameters: np.ndarray) -> np.ndarray:
        matrix = self.matrix(parameters)
        on_probe = self.pixels @ matrix[:3, :2].T + matrix[:3, 3]
        places = np.einsum("nij,nj->ni", self.poses[:, :3, :3], on_probe) + self.poses[:, :3, 3]
        return places - self.target(parameters)


def corner_errors(fit: Fit, matrix: Callable[[np.ndarray], np.ndarray], corners: Any) -> np.ndarray:
    """Expected distance (1 sigma), mm, of pixels (K, 2) from where the true calibration has them.

    matrix(parameters) is the calibration (4, 4) of a fit's first parameters.
    """
    pixels = np.column_stack([corners, np.zeros(len(corners)), np.ones(len(corners))])
    slopes = []
    for i in range(len(fit.parameters)):
        step = np.zeros(len(fit.parameters))
        step[i] = 1e-5
        ahead, behind = matrix(fit.parameters + step), matrix(fit.parameters - step)
        slopes.append((pixels @ (ahead - behind)[:3].T) / 2e-5)
    slope = np.array(slopes)  # (P, K, 3)
    return np.sqrt(np.maximum(np.einsum("pkx,pq,qkx->k", slope, fit.covariance, slope), 0))


def _turns(poses: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Degrees (3,), standard deviation about the image's rows, columns and normal."""
    from scipy.spatial.transform import Rotation

    found = Rotation.from_matrix(poses[:, :3, :3])
    about = (found.mean() * Rotation.from_matrix(axes)).inv() * found * Rotation.from_matrix(axes)
    return np.degrees(about.as_rotvec().std(axis=0))


def _missing(model: _Model, fit: Fit, corners: Any, turns: np.ndarray) -> str:
    """The motion that would lower the expected error most: six images of it are added in thought
    (the D-optimal idea, with the error at the corners instead of the determinant)."""
    matrix, target = model.matrix(fit.parameters), model.target(fit.parameters)
    reference = model.poses[0, :3, :3]
    names = (
        "tilt the probe about the image's rows (forward and back)",
        "turn the probe about the image's columns (its long axis)",
        "rock the probe in the image's plane",
        "place the point in other parts of the image",
    )
    information = np.einsum(
        "n,nkp,nkq->pq", fit.weights, fit.jacobian, fit.jacobian
    ) / max(fit.sigma, 1e-12) ** 2  # fmt: skip
    best, found = np.inf, names[0]
    middle = np.mean(model.pixels, axis=0)
    for which, name in enumerate(names):
        pixels = np.tile(middle, (6, 1)) if which < 3 else np.array([*corners, middle, middle])
        poses = np.tile(np.eye(4), (6, 1, 1))
        for pose, pixel, turn in zip(poses, pixels, (-30, -20, -10, 10, 20, 30), strict=True):
            vector = np.zeros(3)
            if which < 3:
                vector[which] = np.radians(turn)
            axes = model.start.axes
            pose[:3, :3] = reference @ axes @ turn_by(vector) @ axes.T
            pose[:3, 3] = target - pose[:3, :3] @ (matrix @ [*pixel, 0, 1])[:3]
        added = _Model(model.start, pixels, poses)
        slopes = numerical_jacobian(added.residuals, fit.parameters).reshape(-1, 11)
        more = information + slopes.T @ slopes / max(fit.sigma, 1e-12) ** 2
        error = corner_errors(fit._replace(covariance=np.linalg.pinv(more, rcond=1e-14)), model.matrix, corners).max()
        if error < best:
            best, found = error, name
    return found


def _held_out(model: _Model, fit: Fit) -> np.ndarray:
    """(N,) mm: each mark's distance from the target by a calibration without its part."""
    n = len(model.pixels)
    distance = np.empty(n)
    for part in range(min(_FOLDS, n)):
        out = np.arange(n) % _FOLDS == part
        use = ~out & (fit.weights > 0)
        rest = _Model(model.start, model.pixels[use], model.poses[use])
        found = robust_fit(rest.residuals, fit.parameters, robust=False).parameters
        left = _Model(model.start, model.pixels[out], model.poses[out])
        distance[out] = np.linalg.norm(left.residuals(found), axis=1)
    return distance


def turn_by(vector: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) by |vector| radians about a vector (3,)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


def _observations(pixels: Any, world_from_probe: Any) -> tuple[np.ndarray, np.ndarray]:
    pixels, poses = numeric("pixels", pixels), numeric("world_from_probe", world_from_probe)
    if pixels.ndim != 2 or pixels.shape[1] != 2 or len(pixels) < 6:
        raise ValueError(f"pixels: expected shape (N, 2), N >= 6, got {pixels.shape}")
    if poses.shape != (len(pixels), 4, 4):
        expected = f"({len(pixels)}, 4, 4)"
        raise ValueError(f"world_from_probe: expected shape {expected}, got {poses.shape}")
    for name, array in (("pixels", pixels), ("world_from_probe", poses)):
        good = np.isfinite(array).reshape(len(array), -1).all(axis=1)
        if not good.all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or inf (observation {np.argmin(good)})")
    return pixels, poses
