"""Scenes: in one octree, in pieces where the particles do not fit into the memory, or on the ranks
of MPI."""

from __future__ import annotations

import inspect
import os
import threading
import warnings
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from .. import _core
from .._base.checks import choice, named, positive, shown, thread_count
from .._base.device import Device, choose, of_rank
from .._base.memory import free_bytes, resident_bytes, room
from .._base.ranks import ranks_of
from ..data.attributes import attribute_values, checked_range, color_by, ends_of_map
from ..data.particles import Particles
from ..scene.fitting import counted, lacking
from ..scene.scene import KERNELS, SURFACES, SceneBase, check_choices
from ..scene.sources import as_particles, check_update

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .pieces import Pieces

MODES = ("auto", "pieces", "replicate")  # of a scene on ranks


@named
class Scene(SceneBase):
    """Particles sorted into an octree, ready to be traced.

    Particles that the device's free memory, or the limit of `set_limits`, does not hold are kept in
    pieces in temporary files, and a warning says so. `render` reads, builds and traces the pieces
    one after the other. Such a scene answers no questions about the field and has no `particles`.
    The particles of a file whose ranges can be read (HDF5, raw .vtu; .npy, .npz and .bgeo without
    compression) are never all in memory. With `level`, `bounds` or a dense octree, it stays in one.

    Args:
        particles: `Particles`; (N, 3) positions, world units; or the name of a file, which
            `globule.read` reads.
        kernel: one of `KERNELS`.
        threshold: iso-value, compared with the raw sum of weight * b(r); default by kernel.
        support: support radius for all particles, world units, instead of `particles.support`.
            Default: the kernel's default number of spacings; the scene measures the spacing.
        key_bits: 32 (10 levels) or 64 (21 levels).
        level: deepest level of the octree; default: all levels of the key (dense: 6).
        octree: "sparse" (occupied cells only) or "dense" (the array L, at most 8 levels).
        device: "auto", "cpu", "cuda" or "cuda:N".
        threads: CPU threads; 0 takes all.
        bounds: ((x, y, z), (x, y, z)) the octree's space; default: the particles' bounding box,
            computed at each update. The scene counts particles outside; they have no influence.
        surface: "balls": each particle's kernel is a ball (or its `anisotropy`). "smooth": the
            scene finds an ellipsoid and a weight for each particle from its neighbors, so that one
            smooth surface encloses the particles' volume, N * spacing³, and lies half a spacing
            outside of the outermost particles (docs/design/surface.md). "smooth" is for particles
            of one fluid with one spacing; it replaces `support` and has the kernel murakami and
            the default threshold 0.5.
            "spheres": each particle is a sphere, with the kernel murakami and a support of its
            own: of the attribute `radius`, `pscale` or `diameter` (2 radii), without one and with
            `spacing` of half a spacing. `choose_surface` tells which one `render` takes.
        spacing: of the particles for "smooth", world units: the cube root of a particle's volume.
            Default: the scene measures the spacing at its first build and keeps it.
        comm: an mpi4py communicator. The particles are then those that this rank has, anywhere
            in space; all ranks make this call, every `update` and every `render`, and rank 0 has
            the image. Each rank has a device of its own. Fields are not evaluated across ranks.
        ranks: what `render` does with `comm`. "pieces": each rank traces the particles in its part
            of space. "replicate": each rank gets all particles and traces its share of the pixels.
            "auto": pieces, but replicate where light turns (shadows, ambient rays, reflection,
            transmission, sky, ground, meshes) or annotations are drawn, if the memory suffices.
            In pieces, rays that turn go from rank to rank.

    Raises:
        FormatError, OSError: the file cannot be read.
        RuntimeError: the device cannot be used.
    """

    def __new__(cls, *given: Any, **named: Any) -> Scene:
        """The class that suits the particles: with `comm`, one of a scene on ranks; where they do
        not fit into the memory, one of a scene in pieces."""
        if cls is not Scene:
            return object.__new__(cls)
        try:
            o = bound(given, named)
        except TypeError:
            return object.__new__(cls)  # `__init__` says what is wrong
        if o["comm"] is not None:
            return object.__new__(SceneOnRanks)
        if o["ranks"] != "auto":
            raise ValueError(f"ranks: expected comm with it, got {shown(o['ranks'])} without")
        check_choices(o["kernel"], o["surface"], o["octree"], o["key_bits"])
        device, (particles, n, to_read) = choose(o["device"]), counted("particles", o["particles"])
        lack = None
        if o["octree"] == "sparse" and o["level"] is None and o["bounds"] is None:
            lack = lacking(n, to_read, o["surface"], o["key_bits"], device)
        scene: Scene = object.__new__(Scene if lack is None else SceneInPieces)
        scene._counted = particles, device, lack
        return scene

    _counted: Any = None  # particles, read where only that tells how many there are; device; lack

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
        *,
        comm: Any = None,
        ranks: str = "auto",
    ):
        if self._counted is not None:
            particles = vars(self).pop("_counted")[0]
        super().__init__(
            particles, kernel, threshold, support, key_bits, level, octree, device, threads,
            bounds, surface, spacing,
        )  # fmt: skip

    __new__.__wrapped__ = __init__  # type: ignore[attr-defined]  # has its signature


ARGUMENTS = inspect.signature(Scene.__init__)


def bound(given: tuple[Any, ...], named: dict[str, Any]) -> dict[str, Any]:
    """All arguments of a scene, by name."""
    arguments = ARGUMENTS.bind(None, *given, **named)
    arguments.apply_defaults()
    return dict(list(arguments.arguments.items())[1:])


class SceneInPieces(Scene):
    """What `Scene(...)` makes where its particles do not fit: `Pieces`, one after the other."""

    pieces: Pieces
    close: Callable[[], object]  # removes the temporary files
    in_pieces = True  # by which `render` and cameras know that nobody has all particles

    def __init__(self, *given: Any, **named: Any):
        options = bound(given, named)
        particles, device, lack = self._counted
        for name in ("particles", "device", "octree", "level", "bounds", "comm", "ranks"):
            del options[name]
        self._divide(particles, lack, device, None, **options)

    @classmethod
    def made(
        cls, particles: Any, lack: tuple[float, float], device: Device,
        color: tuple[Any, Any, Any] | None, **options: Any,
    ) -> SceneInPieces:  # fmt: skip
        """The scene of particles that are known not to fit; lack: bytes that one octree would
        take, and that are free; color: the arguments of `color_by`."""
        scene = object.__new__(cls)
        scene._divide(particles, lack, device, color, **options)
        return scene

    def _divide(
        self, particles: Any, lack: tuple[float, float], device: Device,
        color: tuple[Any, Any, Any] | None, **options: Any,
    ) -> None:  # fmt: skip
        """In place of the octree; arguments as of `made`."""
        self._lock = threading.RLock()
        self.device, self._lack = device, lack
        self._options = {"kernel": "murakami", **options, "device": device.name}
        self.kernel = self._options["kernel"]
        self._kernel = KERNELS.index(self.kernel)
        self.builds = 0
        self._make(particles, color)
        import tempfile

        warnings.warn(
            f"scene: {self.why()}: they are in {self.pieces.partition.n} pieces, in temporary "
            f"files in {tempfile.gettempdir()}, and drawn one after the other",
            stacklevel=5,
        )

    def _make(self, particles: Any, color: tuple[Any, Any, Any] | None) -> None:
        """Divide particles; what goes wrong on the way leaves the pieces from before."""
        from .pieces import Pieces

        given = dict(zip(("color_by", "colormap", "range"), color or (), strict=False))
        pieces = Pieces(particles, memory=resident_bytes() + room(), **given, **self._options)
        if self.builds:
            self.close()
        self._given, self._color, self.pieces = particles, color, pieces
        self.close = weakref.finalize(self, pieces.close)
        self.surface = pieces.surface
        # What was measured stays.
        self._options |= {"surface": pieces.surface, "threshold": pieces.threshold}
        if pieces.surface != "balls":
            self._options["spacing"] = pieces.spacing
        else:
            self._options["support"] = pieces.support
        self.builds += 1

    def update(self, particles: Any = None, **fields: Any) -> None:
        """The next frame: other particles, or other arrays for fields of those that were given as
        arrays. They are divided again, and stay in pieces. A measured support stays; colors by a
        value do not."""
        check_update(particles, fields)
        if particles is None:
            if isinstance(self._given, (str, os.PathLike)):
                raise ValueError(
                    "update: expected particles or a file's name with a scene in pieces of "
                    f"{os.fspath(self._given)}, got fields alone"
                )
            particles = as_particles("particles", self._given)._with(fields, {})
        with self._lock:
            self._make(counted("particles", particles)[0], None)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lowest, highest) corner of the particles: (3,) float64 each, world."""
        return self.pieces.bounds()

    def _color_by(self, name: str, colormap: str, range: tuple[float, float] | None) -> None:
        color = name, colormap, None if range is None else checked_range(range)
        if color != self._color:
            with self._lock:
                self._make(self._given, color)

    def why(self) -> str:
        """Why the particles are in pieces."""
        need, free = self._lack
        return (
            f"{len(self):,} particles take about {need / 1e9:.3g} GB as one scene on "
            f"{self.device.name}, which has room for {free / 1e9:.3g} GB"
        )

    def _refuse(self) -> NoReturn:
        raise ValueError(
            f"scene: expected particles in one scene, got pieces, which can be drawn alone: "
            f"{self.why()}; free memory, or make a scene of a part of the particles"
        )

    @property
    def origin(self) -> tuple[float, float, float]:
        """That of the particles that were given, or of the file."""
        return getattr(self._given, "origin", None) or self.pieces.origin

    @property
    def up(self) -> tuple[float, float, float]:
        """(x, y, z) of unit length, upwards in images: that of the particles."""
        return self.pieces.up

    @property
    def particles(self) -> Particles:  # type: ignore[override]
        """Not in pieces."""
        self._refuse()

    @property
    def _scene(self) -> Any:
        self._refuse()

    @property
    def threshold(self) -> float:
        """Iso-value of the surface, > 0."""
        return self.pieces.threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self.pieces.threshold = self._options["threshold"] = positive("threshold", value)

    @property
    def support(self) -> Any:
        """World units: one for all, or None where each particle has its own."""
        own = self.pieces.support
        return self.pieces.one("support") if own is None else own

    @property
    def spacing(self) -> float:
        """Spacing of a smooth surface or of spheres, world units; of balls it is not measured, and
        is 0."""
        return float(self.pieces.spacing or 0.0)

    @property
    def normal(self) -> np.ndarray | None:
        """Unit normal (3,) of the plane that holds all particles, if there is one, world."""
        return self.pieces.normal

    def become(self, surface: str) -> None:
        """Not in pieces: give `surface` to `Scene`."""
        self._refuse()

    def __len__(self) -> int:
        return len(self.pieces)

    def __repr__(self) -> str:
        return (
            f"Scene({len(self)} particles in {self.pieces.partition.n} pieces, {self.kernel}, "
            f"threshold {self.threshold:g}, {self.device.name})"
        )


class SceneOnRanks(Scene):
    """What `Scene(..., comm=...)` makes: `Pieces` on the ranks, or a scene of all particles on
    each, whichever an image needs. Both are made when they are first needed."""

    def __init__(self, *given: Any, **named: Any):
        o = bound(given, named)
        choice("kernel", o["kernel"], KERNELS)
        choice("surface", o["surface"], SURFACES)
        choice("ranks", o["ranks"], MODES)
        for name in ("level", "octree", "bounds"):
            value, usual = o[name], ARGUMENTS.parameters[name].default
            if not isinstance(value, type(usual)) or (usual and value != usual):
                raise ValueError(f"{name}: expected none with comm, got {shown(value)}")
        self.ranks, self.mode = ranks_of(o["comm"]), o["ranks"]
        self._lock = threading.RLock()
        self.kernel, self.surface = o["kernel"], o["surface"]
        self._kernel = KERNELS.index(self.kernel)
        local, here = self.ranks.local()
        self._here = here
        # Every rank of a computer has a GPU of its own, or its share of the cores.
        threads = thread_count(o["threads"]) or max(1, len(os.sched_getaffinity(0)) // here)
        self.device = self.ranks.together(lambda: choose(of_rank(o["device"], local)))
        self._options: dict[str, Any] = {
            name: o[name] for name in ("kernel", "support", "surface", "spacing", "key_bits")
        } | {"device": self.device.name, "threads": threads}
        iso = o["threshold"]
        self._iso = None if iso is None else positive("threshold", iso)
        self._pieces: Pieces | None = None
        self._whole: SceneBase | None = None
        self._old = {"pieces": True, "whole": True}  # whether they have other particles
        self.builds = 0
        self.particles = self.ranks.together(lambda: as_particles("particles", o["particles"]))
        self._known = dict(vars(self.particles))
        self._used: Any = self.whole if self.mode == "replicate" else self.pieces
        self._used()

    def update(self, particles: Any = None, **fields: Any) -> None:
        """The next frame: this rank's particles, as many as it has now; all ranks call it.

        The ranks keep their parts of space until one of them has 1.25 times the mean number of
        particles, or particles have left the space. What was measured stays.
        """

        def given() -> Particles:
            check_update(particles, fields)
            if particles is None:
                return self.particles._with(fields, self._known)
            return as_particles("particles", particles)

        with self._lock:
            self.particles = self.ranks.together(given)
            self._known = dict(vars(self.particles))
            self._old = {"pieces": True, "whole": True}
            self._used()  # what the last image was made of

    def pieces(self) -> Pieces:
        """The ranks' pieces of the particles."""
        from .pieces import Pieces

        with self._lock:
            if self._pieces is None:
                self._pieces = Pieces(self.particles, comm=self.ranks, threshold=self._iso,
                                      **self._options)  # fmt: skip
            elif self._old["pieces"]:
                self._pieces.update(self.particles)
            self.builds += self._old["pieces"]
            self._old["pieces"] = False
            return self._pieces

    def whole(self) -> SceneBase:
        """A scene of all particles, on every rank."""
        from .gathered import gathered

        with self._lock:
            if self._old["whole"]:
                everything = gathered(self.ranks, self.particles)

                def build() -> SceneBase:
                    if self._whole is None:
                        return Scene(everything, threshold=self._iso, **self._options)
                    self._whole.update(everything)
                    return self._whole

                self._whole = self.ranks.together(build)
                self.builds += 1
                self._old["whole"] = False
            assert self._whole is not None
            return self._whole

    def used(self, replicate: bool) -> Any:
        """The scene of all particles, or the pieces; updates are for this one from now on."""
        self._used = self.whole if replicate else self.pieces
        return self._used()

    @property
    def factors(self) -> float:
        """The largest factor of reflection or refraction of all ranks' particles."""
        return self.pieces().factors

    def room(self) -> float:
        """Bytes that this rank can take for a scene."""
        if self.device.backend != "cuda":
            return (free_bytes() or np.inf) / self._here
        return float(_core.SweepGrid(self.device.name, 0).free_bytes())

    def _color_by(self, name: str, colormap: str, range: tuple[float, float] | None) -> None:
        """Colors by a value; without a range from the lowest to the highest of all ranks."""

        def ends() -> np.ndarray:
            values = attribute_values(self.particles, name)
            known = values[np.isfinite(values)]
            return np.array([known.min(initial=np.inf), -known.max(initial=-np.inf)])

        if range is None:
            found = self.ranks.least(self.ranks.together(ends)) * (1, -1)
            n = int(self.ranks.total(np.int64(len(self.particles))))
            range = ends_of_map(name, found[np.isfinite(found)], n)
        checked = checked_range(range)
        self.update(self.ranks.together(lambda: color_by(self.particles, name, colormap, checked)))

    @property
    def _scene(self) -> Any:
        raise ValueError("scene: expected a scene in one process, got one on ranks, which can be drawn alone")

    @property
    def normal(self) -> np.ndarray | None:
        """Unit normal (3,) of the plane that holds all ranks' particles, if there is one, world."""
        return self._made().normal

    def _made(self) -> Any:
        return self._pieces if self._used == self.pieces else self._whole

    @property
    def threshold(self) -> float:
        """Iso-value of the surface, > 0; the same on all ranks."""
        return self._made().threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self._iso = positive("threshold", value)
        if self._whole is not None:
            self._whole.threshold = self._iso
        if self._pieces is not None:
            self._pieces.threshold = self._iso
            for _, scene in self._pieces.visit():
                scene.threshold = self._iso

    @property
    def support(self) -> Any:
        """World units: one for all, or None where each particle has its own."""
        found = self._made().support
        return found if np.ndim(found) == 0 else None

    @property
    def spacing(self) -> float:
        """Spacing of a smooth surface or of spheres, world units; of balls it is not measured
        across ranks, and is 0."""
        return float(self._made().spacing or 0.0) if self.surface != "balls" else 0.0

    def __len__(self) -> int:
        return len(self._made())

    def __repr__(self) -> str:
        return (
            f"Scene({len(self)} particles on {self.ranks.size} ranks, {self.kernel}, "
            f"threshold {self.threshold:g}, {self.device.name})"
        )
