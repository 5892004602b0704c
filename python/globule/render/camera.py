"""The camera: where rays come from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base.arrays import VectorLike, box_corners, on_gpu
from .._base.checks import flag, image_size, number, numeric, positive, shown, three, unit
from .._base.fixed import Fixed, read_only
from ..data.particles import FARTHEST
from ..scene.sources import as_particles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike


_LEAST_FOV = 1e-9  # degrees; between two keys of a path it must not become 0
# Of an eye: it sees particles at FARTHEST from outside; its square is still a float32.
_FARTHEST = 10 * float(FARTHEST)


def _check_fov(fov: float) -> None:
    if not _LEAST_FOV <= number("fov", fov) < 180:
        raise ValueError(f"fov: expected degrees between {_LEAST_FOV:g} and 180, got {fov!r}")


@read_only
@dataclass(frozen=True)
class Camera(Fixed):
    """A pinhole camera, or an orthographic one.

    World frames are right-handed; image rows go from top to bottom, and the center of pixel (0, 0)
    is half a pixel inside the top left corner.

    Args:
        eye: (3,) world.
        look_at: (3,) world, the point in the middle of the image.
        up: (3,) direction that points up in the image.
        fov: vertical field of view, degrees, above 0 and below 180.
        height: world units from the bottom to the top of the image; makes the camera
            orthographic, and `fov` is then not used.
    """

    eye: VectorLike
    look_at: VectorLike
    up: VectorLike = (0.0, 1.0, 0.0)
    fov: float = 40.0
    height: float | None = None

    def _check(self) -> None:
        for name in ("eye", "look_at", "up"):
            given = getattr(self, name)
            value = numeric(name, given, "three numbers")
            if value.shape != (3,) or not np.isfinite(value).all():
                raise ValueError(f"{name}: expected three finite numbers, got {shown(given)}")
            if np.abs(value).max() > _FARTHEST:
                expected = f"expected numbers up to {_FARTHEST:g}"
                raise ValueError(f"{name}: {expected}, got {shown(given)}")
            object.__setattr__(self, name, tuple(value.tolist()))
        _check_fov(self.fov)
        if self.height is not None:
            positive("height", self.height)
        if np.linalg.norm(np.subtract(self.look_at, self.eye)) == 0:
            raise ValueError(f"look_at: expected a point other than eye, got {self.look_at!r}")

    @classmethod
    def fit(
        cls,
        particles: Any,
        direction: VectorLike | None = None,
        up: VectorLike | None = None,
        fov: float = 40.0,
        size: tuple[int, int] = (1024, 782),
        margin: float = 0.0,
        orthographic: bool = False,
    ) -> Camera:
        """A camera that sees all particles, from `direction` as seen from their middle.

        Args:
            particles: `Particles`, `Scene`, (N, 3) positions, or the name of a file.
            direction: (3,) world, from the particles' middle towards the eye; default: in front, a
                little to the right and above.
            up: (3,) direction that is upwards in the image; default: that of the particles.
            fov: vertical field of view, degrees.
            size: (width, height) of the image, for its aspect.
            margin: world units added around the particles, e.g. their support.
            orthographic: whether rays are parallel.

        Returns:
            The camera; where no position is finite, one that looks at the origin.

        Raises TypeError and ValueError: the argument, what was expected and what came.
        """
        points, middle, own = _outline(particles)
        size, up = image_size(size), three("up", own if up is None else up)
        direction = first_direction(up) if direction is None else direction
        _check_fov(fov)
        number("margin", margin, 0.0)
        flag("orthographic", orthographic)
        unit("direction", direction)
        back = np.asarray(direction, dtype=np.float64)
        back = back / np.linalg.norm(back)
        right, true_up = _axes(-back, np.asarray(up, dtype=np.float64))
        x, y, z = (points @ axis for axis in (right, true_up, back))
        aspect = size[0] / size[1]
        grown = 1.15 * margin + 1e-6 * float(np.abs(middle).max())
        if not (grown > 0 or np.ptp(points) > 0):  # one point at the origin
            grown = 0.5

        def span(v: np.ndarray, slope: float) -> tuple[float, float]:
            """Where to stand across the view, and how far back, to see all v within +-slope."""
            plus, minus = float(np.max(v + slope * z)), float(np.max(slope * z - v))
            return (plus - minus) / 2, (plus + minus + 2 * grown) / (2 * slope)

        depth = float(np.max(z)) + 2 * grown
        if orthographic:
            (cx, width), (cy, height) = ((float(v.max() + v.min()) / 2, float(np.ptp(v))) for v in (x, y))
            target = middle + right * cx + true_up * cy
            size_y = 1.05 * max(height + 2 * grown, (width + 2 * grown) / aspect)
            return cls(tuple(target + back * (depth + size_y)), tuple(target), up, fov, size_y)
        slope = math.tan(math.radians(fov) / 2) / 1.05
        (cx, far_x), (cy, far_y) = span(x, slope * aspect), span(y, slope)
        target = middle + right * cx + true_up * cy
        return cls(tuple(target + back * max(far_x, far_y, depth)), tuple(target), up, fov)

    def frame(self, size: tuple[int, int]) -> np.ndarray:
        """Rows eye, forward, right, up, float64 (4, 3), world; right and up span half the image at
        distance 1 (orthographic: half the image)."""
        eye = np.asarray(self.eye)
        forward = np.asarray(self.look_at) - eye
        forward = forward / np.linalg.norm(forward)
        right, up = _axes(forward, np.asarray(self.up))
        half = math.tan(math.radians(self.fov) / 2) if self.height is None else self.height / 2
        return np.stack([eye, forward, right * half * size[0] / size[1], up * half])

    def __repr__(self) -> str:
        words = [_short("eye", self.eye), _short("look_at", self.look_at), _short("up", self.up)]
        if self.height is None:
            words.append(f"fov={self.fov:.6g}")
        else:
            words.append(f"height={self.height:.6g}")
        return f"Camera({', '.join(words)})"

    def _view(self, size: tuple[int, int]) -> Any:
        """What the core takes; that of the last size is kept."""
        kept = vars(self).get("_packed")
        if kept is None or kept[0] != size:
            view = _core.View(self.frame(size).ravel().tolist(), *size, self.height is not None)
            kept = size, view
            object.__setattr__(self, "_packed", kept)
        return kept[1]

    def towards(self, points: ArrayLike) -> np.ndarray:
        """Unit directions (N, 3) float64 of the rays through points (N, 3), world; NaN at the eye."""
        points = np.asarray(points, np.float64)
        ahead = np.subtract(self.look_at, self.eye)
        away = points - np.asarray(self.eye) if self.height is None else np.broadcast_to(ahead, points.shape)
        with np.errstate(invalid="ignore"):
            return away / np.linalg.norm(away, axis=1, keepdims=True)

    def project(self, points: ArrayLike, size: tuple[int, int]) -> np.ndarray:
        """Where points (N, 3), world, are in an image of (width, height): (N, 2) float64 pixels,
        column and row from the top left corner; NaN for points behind the eye."""
        eye, forward, right, up = self.frame(size)
        away = np.asarray(points, np.float64) - eye
        place = np.stack([away @ right / (right @ right), away @ up / (up @ up)], axis=1)
        if self.height is None:
            ahead = away @ forward
            place /= np.where(ahead > 0, ahead, np.nan)[:, None]
        return (place * (1, -1) + 1) / 2 * np.asarray(size)

    def along(self, points: ArrayLike) -> np.ndarray:
        """Distances (N,) float64, world units, of points (N, 3) along the rays through them."""
        away = np.asarray(points, np.float64) - np.asarray(self.eye)
        if self.height is None:
            return np.linalg.norm(away, axis=1)
        return away @ self.frame((1, 1))[1]

    def ray(self, size: tuple[int, int], screen: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin and unit direction, (3,) float64 each, world, of the ray through a place (x, y) of
        an image, (0, 0) its top left and (1, 1) its lower right corner."""
        eye, forward, right, up = self.frame(size)
        across = (2 * screen[0] - 1) * right + (1 - 2 * screen[1]) * up
        if self.height is not None:
            return eye + across, forward
        return eye, (forward + across) / np.linalg.norm(forward + across)

    def rays(self, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Origins and unit directions of all pixels' rays, (H, W, 3) float32 each, world."""
        eye, forward, right, up = self.frame(size)
        x = (np.arange(size[0]) + 0.5) * 2 / size[0] - 1
        y = 1 - (np.arange(size[1]) + 0.5) * 2 / size[1]
        across = x[None, :, None] * right + y[:, None, None] * up
        if self.height is not None:
            directions = np.broadcast_to(forward, across.shape)
            return (eye + across).astype(np.float32), directions.astype(np.float32)
        directions = forward + across
        directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(eye, across.shape).astype(np.float32), directions.astype(np.float32)


def _short(name: str, vector: Any) -> str:
    return f"{name}=({', '.join(f'{v:.6g}' for v in vector)})"


def view_axes(up: VectorLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors to the right, upwards and towards the viewer, whatever axis is upwards: x, y, z
    where it is y."""
    above = np.array(up, dtype=np.float64) / (np.linalg.norm(up) or 1.0)
    right = np.eye(3)[1 if abs(above[0]) > 0.7 else 0]
    front = np.cross(right, above)
    front = front / (np.linalg.norm(front) or 1.0)
    return np.cross(above, front), above, front


def first_direction(up: VectorLike) -> np.ndarray:
    """Towards an eye in front, a little to the right and above, whatever axis is upwards."""
    right, above, front = view_axes(up)
    return 0.6 * right + 0.45 * above + front


def _axes(forward: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit right and up vectors of an image seen along `forward`; an `up` along it is replaced."""
    right = _cross(forward, up)
    if np.linalg.norm(right) <= 1e-9 * max(float(np.linalg.norm(up)), 1e-300):
        right = _cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    right = right / np.linalg.norm(right)
    return right, _cross(right, forward)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """numpy's own takes 20 µs, and every image needs two."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _outline(particles: Any) -> tuple[np.ndarray, np.ndarray, tuple[float, float, float]]:
    """Points that stand for all particles, relative to the middle of their box, that middle, and
    what is upwards: the positions, or the box's corners where they are many or on a GPU."""
    in_pieces = getattr(particles, "in_pieces", False) is True
    owner = particles if in_pieces else as_particles("particles", particles)
    try:
        lo, hi = (v.astype(np.float64) for v in owner.bounds())
    except ValueError:  # no finite position
        return np.zeros((1, 3)), np.zeros(3), owner.up
    middle = (lo + hi) / 2
    if in_pieces or on_gpu(owner.positions) or len(owner) > 1_000_000:
        return box_corners(lo, hi) - middle, middle, owner.up
    return owner.finite_positions() - middle, middle, owner.up
