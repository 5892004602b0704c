"""Line-of-sight projections: column densities and integrals of attributes, exact by kernel."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import to_host
from .._base.checks import image_size, shown, unit
from ..data.attributes import attribute_values
from ..data.particles import FARTHEST, Particles
from ..fluids.likeness import assess_fluid
from ..pieces.scene import Scene
from ..render.camera import Camera
from .places import SamplePlane
from .sample import different_names
from .samples import Samples
from .surface import box_of, default_spacing, in_blocks, measured_particles

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

LEAST_PIXELS = 2.0  # of a support: no particle falls between the rays
RAYS = 2**20  # that are traced at once: bounds the memory
_MASSES, _DENSITIES = ("mass", "masses", "m"), ("density", "densities", "rho")


def project(
    particles: Any,
    view: ArrayLike | SamplePlane | Camera = (0, 0, 1),
    values: Sequence[str] | str = "density",
    size: tuple[int, int] = (1024, 782),
    volume: float | ArrayLike | None = None,
    kernel: str = "cubic_spline",
    support: float | None = None,
    device: str = "auto",
    threads: int = 0,
) -> Samples:
    """Integrals of attributes along lines of sight, as SPH interpolates them.

    The interpolated attribute is A(x) = sum over j of A_j V_j W(x - x_j), V_j being the particle's
    volume (mass over density) and W its kernel with unit integral (Monaghan 1992, "Smoothed
    Particle Hydrodynamics", eq. 2.4). The value of a pixel is the integral of A along its ray,
    exact for every kernel; the particles' weights count nothing.

    Args:
        particles: Particles, positions (N, 3), the name of a file, or a Scene, whose particles and
            supports are taken.
        view: the direction (3,) of the parallel lines; or a SamplePlane, through whose places they
            go along its normal; or a Camera, whose rays begin at the eye.
        values: names. "density": the density, so that the result is the column density, mass by
            area. "thickness": 1, so that the result is the length within the matter. Any other
            name: x, y, z, a field or an attribute; vectors stay vectors.
        size: (width, height) of a camera's image in pixels. Parallel lines are half a particle
            spacing apart unless a SamplePlane says otherwise.
        volume: of the particles, world units cubed: a number or (N,). Default: an attribute mass
            (mass, masses or m) over density (density, densities or rho); else, of particles of one
            fluid (`globule.fluids.assess_fluid`), the cube of the spacing of their smooth surface;
            else one over the sum of the kernels at each particle. Where all supports are alike, the
            median of these sums stands for all: at a fluid's surface they are too small.
        kernel: one of `globule.scene.scene.KERNELS`.
        support: of all particles, world units; default: the particles' or the scene's own, else the
            kernel's default. For parallel lines, supports below two of their distances are widened
            to two: every particle shows, with its full mass.
        device, threads: as for `Scene`.

    Returns:
        `Samples` of a plane with the values by their names, float64: the attribute's unit times
        the world's unit of length. For a Camera the points lie in the plane through its `look_at`,
        and v runs down the image. The error of a pixel is that of float32, about 1e-6 of the
        value.
    """
    if not (names := different_names(values)):
        raise ValueError("values: expected at least one name, got none")
    own: Any = None
    made = particles if isinstance(particles, Scene) else None
    if made is not None:
        own, particles = made.support, made.particles
    particles = measured_particles("particles", particles)
    if volume is None:
        volume = _fluid_volume(made, particles)
    particles = replace(particles, weight=None)
    if own is not None and particles.anisotropy is None and support is None:
        particles = replace(particles, support=own)
    options: dict[str, Any] = {"kernel": kernel, "device": device, "threads": threads}
    scene = Scene(particles, support=support, **options)  # plain kernels, not those of a surface
    columns = _columns(particles, names, _volumes(scene, volume, options))
    if isinstance(view, Camera):
        samples, origins, directions = _camera_rays(view, image_size(size))
    else:
        plane = view if isinstance(view, SamplePlane) else SamplePlane(unit("view", view))
        distance = plane.spacing or default_spacing(scene)
        scene = _widened(scene, particles, LEAST_PIXELS * distance, options)
        samples, origins, directions = _parallel_rays(scene, replace(plane, spacing=distance))
    found = _integrals(scene, origins, directions, np.concatenate([*columns.values()], axis=1))
    first = 0
    for name, column in columns.items():
        part = found[:, first : first + column.shape[1]]
        first += column.shape[1]
        vector = name in particles.attributes and len(particles.attributes[name].shape) > 1
        samples.values[name] = part.reshape(*samples.shape, *part.shape[1:] if vector else ())
    return replace(samples, origin=particles.origin)


@functools.cache
def kernel_volume(kernel: str) -> float:
    """The integral of a kernel of support 1 over all space."""
    one = Scene(Particles([(0.0, 0.0, 0.0)]), support=1.0, kernel=kernel, device="cpu")
    x, weight = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for lo, hi in ((0, 1 / 3), (1 / 3, 1 / 2), (1 / 2, 1)):  # between them all kernels are smooth
        q = lo + (hi - lo) * (x + 1) / 2
        b = one.field(np.stack([q, 0 * q, 0 * q], axis=1))
        total += (hi - lo) / 2 * float(np.sum(weight * b * 4 * np.pi * q * q))
    return total


def has_volumes(particles: Particles) -> bool:
    """Whether particles have masses and densities."""
    return all(_first(particles, known) is not None for known in (_MASSES, _DENSITIES))


def _fluid_volume(scene: Scene | None, particles: Particles) -> float | None:
    """The volume of a particle of a fluid without masses and densities; None of all others."""
    if has_volumes(particles):
        return None
    if scene is None or scene.surface == "balls":
        if not assess_fluid(particles).yes:
            return None
        scene = Scene(to_host(particles.positions), device="cpu")
    return scene.fluid_spacing() ** 3 or None if scene.surface != "spheres" else None


def _volumes(scene: Scene, volume: Any, options: dict[str, Any]) -> np.ndarray:
    """The particles' volumes (N,) float64."""
    particles = scene.particles
    n = len(particles)
    if volume is not None:
        try:
            given = np.asarray(to_host(volume), np.float64)
        except (TypeError, ValueError):
            given = np.full(1, np.nan)
        if given.shape not in ((), (n,)) or not (np.isfinite(given) & (given >= 0)).all():
            raise ValueError(f"volume: expected a number or ({n},) >= 0, got {shown(volume)}")
        return np.broadcast_to(given, n)
    mass, density = (_first(particles, known) for known in (_MASSES, _DENSITIES))
    if mass is not None and density is not None:
        with np.errstate(all="ignore"):
            return np.where(density > 0, mass / density, 0.0)
    spread = _spread(scene)
    finite = spread[np.isfinite(spread)].max(initial=0.0) or 1.0
    weighted = Scene(replace(particles, weight=(spread / finite).astype(np.float32)), **options)
    positions = to_host(particles.positions)
    known = (np.abs(positions) <= FARTHEST).all(axis=1)
    number = np.zeros(n)  # density of the particles
    number[known] = in_blocks(weighted.field, positions[known]) * finite
    alike = particles.anisotropy is None and np.ptp(to_host(scene.support)) == 0
    if alike and known.any():
        number[:] = np.median(number[known])
    return np.divide(1, number, out=np.zeros(n), where=number > 0)


def _spread(scene: Scene) -> np.ndarray:
    """What the kernels (N,) are multiplied by to have the integral 1, float64."""
    one = kernel_volume(scene.kernel)
    if scene.particles.anisotropy is not None:
        return np.linalg.det(scene.particles.anisotropy.astype(np.float64)) / one
    support = np.asarray(to_host(scene.support), np.float64)
    with np.errstate(all="ignore"):
        spread = np.where(support > 0, 1 / (one * support**3), 0.0)
    return np.broadcast_to(spread, len(scene.particles))


def _first(particles: Particles, names: Sequence[str]) -> np.ndarray | None:
    for name in names:
        if name in particles.attributes:
            return attribute_values(particles, name)
    return None


def _columns(particles: Particles, names: Sequence[str], volumes: np.ndarray) -> dict[str, np.ndarray]:
    """Name -> (N, k) float64: the values times the particles' volumes."""
    found = {}
    for name in names:
        array: Any = particles.attributes.get(name)
        if array is None and name == "thickness":
            array = np.ones(len(particles))
        if array is None and name == "density":
            array = _first(particles, _DENSITIES)
            mass = _first(particles, _MASSES)
            if array is None and mass is not None:  # mass by area needs no density
                found[name] = np.where(np.isfinite(mass), mass, 0.0)[:, None]
                continue
        if array is None or len(array.shape) == 1:
            try:
                array = attribute_values(particles, name) if array is None else array
            except ValueError as error:
                known = str(error).replace("one of ", "one of thickness, ", 1)
                raise ValueError(f"values: {known}") from None
        column = np.asarray(to_host(array), np.float64).reshape(len(particles), -1)
        column = column * volumes[:, None]
        found[name] = np.where(np.isfinite(column), column, 0.0)
    return found


def _integrals(scene: Scene, origins: np.ndarray, directions: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Integrals (M, k) float64 of columns (N, k), each spread by its particle's kernel."""
    with np.errstate(over="ignore"):
        values = columns * _spread(scene)[:, None]
    # To the middle of float32's range: masses and lengths may be those of stars or of molecules.
    scale = np.abs(values).max(axis=0, initial=0.0)
    scale = np.where((scale > 0) & np.isfinite(scale), scale, 1.0)
    values = (values / scale).astype(np.float32)
    found = np.empty((len(origins), columns.shape[1]))
    for begin in range(0, len(origins), RAYS):
        part = slice(begin, begin + RAYS)
        found[part] = scene.integrate(origins[part], directions[part], values) * scale
    return found


def _parallel_rays(scene: Scene, plane: SamplePlane) -> tuple[Samples, np.ndarray, np.ndarray]:
    """Places, and origins and directions (M, 3) float32 of parallel rays."""
    lattice = plane.lattice(scene)
    normal = np.asarray(unit("normal", plane.normal))
    points = lattice.points()
    origins = points.reshape(-1, 3).astype(np.float64)
    lo, hi = box_of(scene)
    middle, radius = (lo + hi) / 2, float(np.linalg.norm(hi - lo)) / 2
    before = (middle @ normal) - radius - origins @ normal
    origins += np.minimum(before, 0.0)[:, None] * normal
    directions = np.broadcast_to(normal, origins.shape).astype(np.float32)
    coords = dict(zip(lattice.dims, lattice.coords, strict=True))
    samples = Samples(points, {}, lattice.dims, coords, lattice.steps)
    return samples, origins.astype(np.float32), directions


def _camera_rays(camera: Camera, size: tuple[int, int]) -> tuple[Samples, np.ndarray, np.ndarray]:
    """The same of a camera's pixels, row 0 at the top."""
    eye, forward, right, up = (np.asarray(v, np.float64) for v in camera.frame(size))
    width, height = size
    sx = (np.arange(width) + 0.5) * 2 / width - 1
    sy = 1 - (np.arange(height) + 0.5) * 2 / height
    across = sx[None, :, None] * right + sy[:, None, None] * up
    distance = float(np.linalg.norm(np.asarray(camera.look_at, np.float64) - eye))
    if camera.height is None:
        ways = forward + across
        points = eye + distance * ways
        directions = ways / np.linalg.norm(ways, axis=2, keepdims=True)
        origins = np.broadcast_to(eye, ways.shape)
        reach = distance
    else:
        origins = eye + across
        points, directions = origins + distance * forward, np.broadcast_to(forward, across.shape)
        reach = 1.0
    half_u, half_v = reach * np.linalg.norm(right), reach * np.linalg.norm(up)
    steps = np.stack([-2 * reach * up / height, 2 * reach * right / width])
    coords = {"v": -sy * half_v, "u": sx * half_u}
    samples = Samples(points.astype(np.float32), {}, ("v", "u"), coords, steps)
    flat = [np.ascontiguousarray(a, np.float32).reshape(-1, 3) for a in (origins, directions)]
    return samples, flat[0], flat[1]


def _widened(scene: Scene, particles: Particles, least: float, options: dict[str, Any]) -> Scene:
    """The scene, its supports at least `least`, if there is one below."""
    if particles.anisotropy is not None:
        return scene
    support = np.asarray(to_host(scene.support))
    narrow = (support < least) & (support > 0)
    if not narrow.any():
        return scene
    support = np.where(narrow, np.float32(least), support)
    return Scene(replace(particles, support=support), **options)
