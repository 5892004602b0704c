"""A scene: particles, their octree on one device, and the field that they make."""

from __future__ import annotations

import os
import threading
import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base.arrays import ABSENT, HOST, View, address, on_gpu, rays, to_host, view
from .._base.checks import choice, positive, shown, thread_count, whole
from .._base.device import Device, choose
from .._base.owner import Owner
from ..data.attributes import color_by
from ..data.particles import Particles
from ..data.radii import find_radii
from ..data.spacing import FEW, normal_of
from .octree import Octree
from .sources import (
    MAX_SUPPORT,
    as_particles,
    check_supports,
    check_update,
    field_of,
    in_spacing,
    space_of,
    values_of_particles,
)
from .thesis import Thesis, check_tracing

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

KERNELS = tuple(_core.kernels)
# Default support in spacings and default threshold, by kernel. One particle alone is a ball, a
# flat face of a lattice is flat to a few hundredths of the spacing
# (docs/understand/conventions.md).
DEFAULTS = {name: (spacings, threshold) for name, (spacings, threshold, _) in _core.kernels.items()}
# How far from a particle, in supports, the surface may lie: where b is an eighth of the default
# threshold, so that it takes eight particles at one place to reach that.
REACH = {name: reach for name, (_, _, reach) in _core.kernels.items()}
SURFACES = ("balls", "smooth", "spheres")
SMOOTH_SUPPORT = 2.25  # spacings: of a kernel inside the fluid, src/field/surface_kernels.hpp
SMOOTH_THRESHOLD = 0.5
# A ball alone has this radius, in supports, and hardly reaches farther: b(0.94868) is 0.01.
SPHERE_RADIUS, SPHERE_THRESHOLD = 0.94868, 0.01
SPHERE_SUPPORT = 0.5 / SPHERE_RADIUS  # spacings
DEFAULT_COLOR = (0.28, 0.52, 0.80)
A_DOZEN = 12
MAX_PARTICLES: int = _core.limits["particles"]


class Intersections(NamedTuple):
    """The first intersections of rays with a surface.

    distance  (M,) float32 along the ray, world units; infinite where missed
    normal    (M, 3) float32, unit length; 0 where missed
    color     (M, 3) float32, linear RGB, blended
    """

    distance: np.ndarray
    normal: np.ndarray
    color: np.ndarray


class SceneBase(Owner):
    """Particles in one octree: what `Scene`, whose arguments these are, adds to is the choice of
    what the memory holds.

    Raises:
        FormatError, OSError: the file cannot be read.
        RuntimeError: the device cannot be used.
    """

    particles: Particles  # as given last, with arrays converted
    support: Any  # world units: a float for all, or (N,) as in the particles
    kernel: str
    device: Device
    builds: int  # how often the octree has been built
    surface: str = "balls"  # or "smooth"

    def __init__(
        self,
        particles: Particles | ArrayLike | str | os.PathLike[str],
        kernel: str = "murakami",
        threshold: float | None = None,
        support: float | None = None,
        key_bits: int = 32,
        level: int | None = None,
        octree: str = "sparse",
        device: str = "auto",
        threads: int = 0,
        bounds: ArrayLike | None = None,
        surface: str = "balls",
        spacing: float | None = None,
    ):
        check_choices(kernel, surface, octree, key_bits)
        self.device = choose(device)
        particles = as_particles("particles", particles)
        if n := particles.n_missing():
            what = f"{n:,} of {len(particles):,} are not drawn: they have NaN or inf"
            warnings.warn(f"positions: {what}", stacklevel=4)
        own = surface != "balls"
        if own and (kernel, octree, support) != ("murakami", "sparse", None):
            raise ValueError(
                f"surface: {surface!r} has the kernel murakami, the sparse octree and supports of "
                f"its own, got {kernel}, {octree} and support {shown(support)}"
            )
        if spacing is not None and not own:
            raise ValueError("spacing: expected surface='smooth' with it, got 'balls'")
        if octree == "dense" and key_bits != 32:
            raise ValueError("key_bits: the dense octree uses 32-bit keys, got 64")
        deepest = 8 if octree == "dense" else 10 if key_bits == 32 else 21
        if level is None:
            level = 6 if octree == "dense" else deepest
        if not 0 <= whole("level", level, -(2**31), 2**31) <= deepest:
            expected = f"expected 0 to {deepest} ({octree}, {key_bits}-bit keys)"
            raise ValueError(f"level: {expected}, got {shown(level)}")
        self.kernel = kernel
        self.surface = surface
        self.threshold = threshold_of(self.surface, self.kernel) if threshold is None else threshold
        self.builds = 0
        self._kernel = KERNELS.index(kernel)
        self._tree = (key_bits, int(level), octree == "dense", space_of(bounds))
        self._raw = _core.Scene(self.device.backend, self.device.index, thread_count(threads))
        self._lock = threading.RLock()
        self._stale = False
        self._support = None if support is None else positive("support", support)
        self._spacing = None if spacing is None else positive("spacing", spacing)
        self._found: dict[str, Any] = {}  # what was measured of the particles
        self._known: dict[str, Any] = {}  # the particles' fields when the octree was built
        self._build(particles)

    _gives_up = False  # whether the build may empty the positions once it has read them

    def update(self, particles: Particles | ArrayLike | str | os.PathLike[str] | None = None, **fields: Any) -> None:
        """The next frame: new particles, or new arrays for some of their fields.

        `scene.update(positions=p)` keeps all fields except the attributes; arrays may have a
        different length and be on any device. The update rebuilds the octree; a measured support
        stays, and so does the origin from which positions are given. Images read color, reflection
        and refraction in place: float32 arrays must not change until the next update. An
        interrupted update keeps the old particles.

        Args:
            particles: as for `Scene`.
            fields: arrays by their names in `Particles`.
        """
        check_update(particles, fields)
        if particles is None:
            found = self.particles._with(fields, self._known)
        else:
            found = as_particles("particles", particles)
            if isinstance(particles, (Particles, str, os.PathLike)):
                found = found.at(self.origin)
        with self._lock:
            self._build(found)

    @property
    def _scene(self) -> Any:
        """The core's scene; built again first where an update was interrupted half way."""
        if self._stale:
            with self._lock:
                if self._stale:
                    self._build(self.particles)
        return self._raw

    def _color_by(self, name: str, colormap: str, range: tuple[float, float] | None) -> None:
        """Color the particles by a value, from the next image on."""
        self.update(color_by(self.particles, name, colormap, range))

    def become(self, surface: str) -> None:
        """Draw "smooth" or "spheres" of the same particles, with the spacing that was measured."""
        with self._lock:
            self._spacing = self._spacing or self._measured(surface) or None
            self.surface, self._support = surface, None
            self.threshold = threshold_of(self.surface, self.kernel)
            self._build(self.particles)

    def become_spheres(self) -> None:
        """Draw the same particles as spheres of the radii that they have."""
        with self._lock:
            self._spacing = self._support = None
            self.surface, self.threshold = "spheres", SPHERE_THRESHOLD
            self._build(self.particles)

    def _build(self, p: Particles) -> None:
        """Sort them into the octree. If that stops half way, the scene keeps its particles and
        builds them again when it is next used."""
        positions = view("positions", p.positions, 3)
        n = positions.shape[0]
        if n > MAX_PARTICLES:
            raise ValueError(f"positions: expected at most {MAX_PARTICLES:,} particles, got {n:,}")
        stretch, most_stretch, found, spacing = ABSENT, 1.0, self._support, self._spacing
        known: dict[str, Any] = {}
        smooth = self.surface == "smooth"
        if smooth:
            support, one_support = ABSENT, SMOOTH_SUPPORT * spacing if spacing else None
        elif self.surface == "spheres" and not spacing and (radii := find_radii(p)) is not None:
            support, one_support = view("support", radii / SPHERE_RADIUS, None), None
        elif self.surface == "spheres":
            support, one_support = ABSENT, SPHERE_SUPPORT * spacing if spacing else found
        elif p.anisotropy is not None:
            stretch, longest, most_stretch = self._stretch(p.anisotropy)
            support, one_support = view("support", longest, None), None
        elif self._support:
            support, one_support = ABSENT, self._support
        else:
            support, one_support = field_of("support", p.support, None, n)
        weight, one_weight = field_of("weight", in_spacing(p, spacing) if smooth else p.weight, None, n)
        color, one_color = field_of("color", p.color, 3, n)
        reflection, one_reflection = field_of("reflection", p.reflection, None, n)
        refraction, one_refraction = field_of("refraction", p.refraction, None, n)
        if one_weight is None:
            one_weight = 1.0
        arrays = [positions, weight, color, reflection, refraction, stretch]

        def build(one: float) -> None:
            self._stale = True
            self._raw.build(
                n,
                positions.place,
                support.place,
                one,
                weight.place,
                float(one_weight),
                color.place,
                list(DEFAULT_COLOR if one_color is None else one_color),
                reflection.place,
                float(one_reflection or 0.0),
                refraction.place,
                float(one_refraction or 0.0),
                stretch.place,
                most_stretch,
                one / SMOOTH_SUPPORT if smooth else 0.0,
                *self._tree,
                self._gives_up and one > 0,  # 0: another build follows
            )

        if support is ABSENT and one_support is None:
            build(0.0)
            measured = _spacing(self._raw, p, self.surface)
            known = dict.fromkeys(SURFACES if n < FEW else (self.surface,), measured)
            one_support = defaults_of(self.surface, self.kernel)[0] * (measured or 1.0)
            if smooth:
                arrays[1] = weight = field_of("weight", in_spacing(p, measured), None, n)[0]
            if measured and smooth and n > A_DOZEN:
                spacing = measured
            elif measured and n > A_DOZEN:  # of fewer it is found anew next time
                found = one_support
        elif support is ABSENT:
            one_support = positive("support", one_support)
        if one_support is not None and one_support > MAX_SUPPORT:
            if support is ABSENT and not self._support and p.support is None:  # it was measured
                lo, hi = p.bounds()
                raise ValueError(
                    "positions: expected particles 1e-18 to 1e18 apart, whose squares float32 "
                    f"holds, got all within {float(np.max(hi - lo)):.3g}; scale the positions"
                )
            raise ValueError(f"support: expected at most {MAX_SUPPORT:g}, got {one_support:g}")
        checked = support is ABSENT or support.owner is self._known.get("support")
        if not checked and support.device == HOST:
            check_supports(support.owner)
        build(1.0 if one_support is None else float(one_support))
        made = p.anisotropy is not None or self.surface == "spheres"
        own = support.owner if made else p.support
        self.__dict__.update(  # in one go
            particles=p,
            support=one_support if support is ABSENT else own,
            builds=self.builds + 1,
            _known=dict(vars(p)),
            _support=found,
            _spacing=spacing,
            _arrays=[*arrays, support],  # the core reads them again when it gathers colors
            _stale=False,
            _found=known,
        )

    def _stretch(self, matrices: np.ndarray) -> tuple[View, np.ndarray, float]:
        """For the core: six numbers a matrix; the longest axes; the largest ratio of axes."""
        if self._tree[2]:
            raise ValueError("anisotropy: expected the sparse octree, got dense")
        short = np.linalg.eigvalsh(matrices.astype(np.float64))  # ascending, 1 / axes
        six = matrices[:, (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        longest = np.float32(1.0001 / short[:, 0])  # rounding must not cut off what it reaches
        ratio = float(np.max(short[:, 2] / short[:, 0], initial=1.0))
        return view("anisotropy", six, 6), np.asarray(longest), 1.0001 * ratio

    @property
    def threshold(self) -> float:
        """Iso-value of the surface, > 0. A new value applies from the next image on."""
        return self._threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self._threshold = positive("threshold", value)

    @property
    def origin(self) -> tuple[float, float, float]:
        """Place, world units, from which the scene's positions are given; see `Particles`."""
        return self.particles.origin

    @property
    def up(self) -> tuple[float, float, float]:
        """(x, y, z) of unit length, upwards in images: that of the particles."""
        return self.particles.up

    @property
    def spacing(self) -> float:
        """Spacing of the particles, world units; 0 if the scene has none at two
        places. Of the smooth surface and of spheres, the one given or measured first. Of fewer than
        1000 particles or those in a plane or line, from their tessellation: the cube root of a
        particle's volume, the square root of its area or its length. Of more balls, the median
        over up to 1024 particles, from their nearest neighbors."""
        if self.surface != "balls" and self._spacing:
            return self._spacing
        return self._measured("balls")

    def fluid_spacing(self) -> float:
        """The spacing that a smooth surface of these particles has, world units: the cube root of a
        particle's volume, measured around up to 1024 particles; 0 if they are all at one
        place."""
        if self.surface == "smooth" and self._spacing:
            return self._spacing
        return self._measured("smooth")

    def _measured(self, surface: str) -> float:
        if surface not in self._found:
            self._found[surface] = _spacing(self._scene, self.particles, surface)
        return self._found[surface]

    @property
    def normal(self) -> np.ndarray | None:
        """Unit normal (3,) of the plane that holds all particles, if there is one, world."""
        if "normal" not in self._found:
            self._found["normal"] = normal_of(self.particles.finite_positions())
        return self._found["normal"]

    @property
    def octree(self) -> Octree:
        """Facts about the current octree: level, nodes, leaves, bytes, hashes, build time."""
        return Octree(self._scene)

    def surface_kernels(self) -> tuple[np.ndarray, np.ndarray]:
        """The kernels that a scene with `surface="smooth"` found on its device.

        Returns:
            G (N, 3, 3) float32, 1 / world, and weight (N,) float32, as in `SurfaceKernels`; one row
            a particle.

        Raises ValueError for another scene.
        """
        if self.surface != "smooth":
            raise ValueError('surface_kernels: expected a scene with surface="smooth"')
        n = len(self)
        six, weight = np.empty((n, 6), np.float32), np.empty(n, np.float32)
        self._scene.surface_kernels(address(six), address(weight))
        _, index = self.octree.sorted_keys(n)
        G = np.empty((n, 3, 3), np.float32)
        G[index] = six[:, (0, 3, 4, 3, 1, 5, 4, 5, 2)].reshape(n, 3, 3)
        own = np.empty(n, np.float32)
        own[index] = weight
        return G, own

    def field(self, points: ArrayLike) -> np.ndarray:
        """The field at points: sum of weight * b(r).

        Args:
            points: (M, 3) world; NumPy or on the scene's device.

        Returns:
            (M,) float32.
        """
        return self._evaluate(points, True, False)[0]

    def gradient(self, points: ArrayLike) -> np.ndarray:
        """The gradient of the field at points. The gradient points inwards.

        Args:
            points: (M, 3) world; NumPy or on the scene's device.

        Returns:
            (M, 3) float32, per world unit.
        """
        return self._evaluate(points, False, True)[1]

    def _field_and_gradient(self, points: ArrayLike) -> np.ndarray:
        """The field and the gradient at points (M, 3): (M, 4) float32, in less time than one after
        the other."""
        return np.column_stack(self._evaluate(points, True, True))

    def _evaluate(self, points: ArrayLike, field: bool, gradient: bool) -> tuple[np.ndarray, np.ndarray]:
        """The field (M,) and the gradient (M, 3) at points; one that is not asked for is empty."""
        p = view("points", points, 3)
        n = p.shape[0]
        f, g = np.empty(n * field, np.float32), np.empty((n * gradient, 3), np.float32)
        self._scene.evaluate(self._kernel, n, p.place, address(f) if field else 0, address(g) if gradient else 0)
        return f, g

    def intersect(self, origins: ArrayLike, directions: ArrayLike, thesis: Thesis | None = None) -> Intersections:
        """First intersection of arbitrary rays with the surface.

        Args:
            origins: (M, 3) world.
            directions: (M, 3) unit vectors. A ray whose direction is zero or not finite meets
                nothing.
            thesis: trace as the source thesis does, with these choices; default: exactly.

        Returns:
            distance (M,) along the ray, normal (M, 3), color (M, 3).
        """
        o, d = rays(origins, directions)
        n = o.shape[0]
        distance = np.empty(n, np.float32)
        normal, color = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        check_tracing(self, thesis)
        self._scene.intersect(
            self._kernel,
            self.threshold,
            None if thesis is None else thesis._packed,
            n,
            o.place,
            d.place,
            address(distance),
            address(normal),
            address(color),
        )
        return Intersections(distance, normal, color)

    def neighbors(self, points: ArrayLike, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Particles within `radius` of each point, as compressed rows.

        Args:
            points: (M, 3) world.
            radius: world units, inclusive.

        Returns:
            offsets (M + 1,) uint64 and indices uint32 into the particles; row i is
            indices[offsets[i]:offsets[i + 1]], in Morton order, the same on every backend.
        """
        p = view("points", points, 3)
        return self._scene.neighbors(p.shape[0], p.place, positive("radius", radius))

    def blend(self, points: ArrayLike, values: ArrayLike) -> np.ndarray:
        """Attribute values at points: sum w v / sum w with w = weight * b(r), §6.0.2.

        Args:
            points: (M, 3) world; NumPy or on the scene's device.
            values: (N,) or (N, K) numbers, one row a particle.

        Returns:
            (M,) or (M, K) float32; NaN where no particle reaches.
        """
        p = view("points", points, 3)
        v, out, given_back = values_of_particles(values, p.shape[0])
        self._scene.blend(self._kernel, p.shape[0], p.place, v.place, v.shape[0], out.shape[1], address(out))
        return given_back

    def integrate(self, origins: ArrayLike, directions: ArrayLike, values: ArrayLike) -> np.ndarray:
        """Integrals along rays: the sum over the particles of value * the integral of b(r) from
        the ray's origin on, weights left out; in closed form, with float64 sums in Morton order.

        `globule.measure.project` makes column densities of them.

        Args:
            origins: (M, 3) world; NumPy or on the scene's device.
            directions: (M, 3) unit vectors. A ray whose direction is zero or not finite has 0.
            values: (N,) or (N, K) numbers, one row a particle.

        Returns:
            (M,) or (M, K) float32, the values' unit times the world's unit of length.
        """
        o, d = rays(origins, directions)
        v, out, given_back = values_of_particles(values, o.shape[0])
        self._scene.integrate(
            self._kernel, o.shape[0], o.place, d.place, v.place, v.shape[0], out.shape[1], address(out)
        )
        return given_back

    def __len__(self) -> int:
        return len(self.particles)

    def __repr__(self) -> str:
        one = isinstance(self.support, (int, float))
        support = f"{self.support:.4g}" if one else "of each particle"
        return (
            f"Scene({len(self)} particles, {self.kernel}, threshold {self.threshold:g}, "
            f"support {support}, {self.device.name})"
        )


def defaults_of(surface: str, kernel: str) -> tuple[float, float]:
    """The support in spacings, and the iso-value."""
    own = {"smooth": (SMOOTH_SUPPORT, SMOOTH_THRESHOLD), "spheres": (SPHERE_SUPPORT, SPHERE_THRESHOLD)}
    return own.get(surface, DEFAULTS[kernel])


def threshold_of(surface: str, kernel: str) -> float:
    """The default iso-value."""
    return defaults_of(surface, kernel)[1]


def check_choices(kernel: str, surface: str, octree: str, key_bits: int) -> None:
    """Raise ValueError for arguments of a scene that are none of the choices there are."""
    choice("kernel", kernel, KERNELS)
    choice("surface", surface, SURFACES)
    choice("octree", octree, ("sparse", "dense"))
    choice("key_bits", key_bits, (32, 64))


def _spacing(core: Any, particles: Particles, surface: str) -> float:
    """The measured spacing, 0 where all are at one place; of a core's particles that it has."""
    n, positions = len(particles), particles.positions
    known = n < FEW or not on_gpu(positions)  # of many on a GPU it is that of a body
    positions = np.ascontiguousarray(to_host(positions)) if known else np.empty(0)
    return core.spacing(address(positions) if known else 0, n, surface == "smooth")
