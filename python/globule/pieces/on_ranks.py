"""A scene whose particles are distributed over the ranks of MPI."""

from __future__ import annotations

import inspect
import os
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import to_host
from .._base.checks import choice, positive, shown, thread_count
from .._base.device import choose, of_rank
from .._base.memory import free_bytes
from .._base.ranks import Alone, ranks_of
from ..render.layers import Layer
from ..render.settings import RenderSettings
from ..scene.attributes import attribute_values, checked_range, color_by, ends_of_map
from ..scene.particles import FIELDS, Particles
from ..scene.scene import KERNELS, SURFACES, Scene
from ..scene.sources import as_particles
from .image import Pieces
from .light import turns
from .scene import BYTES, check_reach
from .store import COLUMNS, Layout

ARGUMENTS = inspect.signature(Scene.__init__)
MODES = ("auto", "pieces", "replicate")
LIGHT_BYTES = 1470  # a particle of a pool of a million: the cells that light needs, on a CPU
FACTORS = ("reflection", "refraction")


def replicated_bytes(n: int, surface: str) -> float:
    """Bytes that n particles take with the cells that light needs, which lie at the surface."""
    return n * (BYTES[surface] + LIGHT_BYTES * (1e6 / max(n, 1)) ** (1 / 3))


class SceneOnRanks(Scene):
    """What `Scene(..., comm=...)` makes: `Pieces` on the ranks, or a scene of all particles on
    each, whichever an image needs. Both are made when they are first needed."""

    def __init__(self, *given: Any, **named: Any):
        arguments = ARGUMENTS.bind(self, *given, **named)
        arguments.apply_defaults()
        o = arguments.arguments
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
        self._whole: Scene | None = None
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
            if particles is None:
                unknown = fields.keys() - set(FIELDS)
                if unknown:
                    raise TypeError(
                        f"update: unknown field {sorted(unknown)[0]!r}, "
                        f"expected {', '.join(FIELDS)}"
                    )
                return self.particles._with(fields, self._known)
            if fields:
                raise TypeError("update: expected particles or fields, got both")
            return as_particles("particles", particles)

        with self._lock:
            self.particles = self.ranks.together(given)
            self._known = dict(vars(self.particles))
            self._old = {"pieces": True, "whole": True}
            self._used()  # what the last image was made of

    def pieces(self) -> Pieces:
        """The ranks' pieces of the particles."""
        with self._lock:
            if self._pieces is None:
                self._pieces = Pieces(self.particles, comm=self.ranks, threshold=self._iso,
                                      **self._options)  # fmt: skip
            elif self._old["pieces"]:
                self._pieces.update(self.particles)
            self.builds += self._old["pieces"]
            self._old["pieces"] = False
            return self._pieces

    def whole(self) -> Scene:
        """A scene of all particles, on every rank."""
        with self._lock:
            if self._old["whole"]:
                everything = gathered(self.ranks, self.particles)

                def build() -> Scene:
                    if self._whole is None:
                        return Scene(everything, threshold=self._iso, **self._options)
                    self._whole.update(everything)
                    return self._whole

                self._whole = self.ranks.together(build)
                self.builds += 1
                self._old["whole"] = False
            assert self._whole is not None
            return self._whole

    def settled(
        self, layers: Sequence[Layer], settings: RenderSettings, comm: Any, whole: bool
    ) -> tuple[tuple[Layer, ...], Any]:
        """The layers with pieces or scenes of all particles in the place of scenes on ranks, and
        the ranks that share out the pixels of the latter.

        whole: the image needs all particles in one scene, whatever the light.
        """
        if comm is not None:
            raise ValueError("comm: expected None with a scene on ranks, which has its own")
        own = [x.scene for x in layers if isinstance(x.scene, SceneOnRanks)]
        if any(x.scene.ranks.size != self.ranks.size for x in layers
               if isinstance(x.scene, SceneOnRanks)):  # fmt: skip
            raise ValueError("scene: expected all layers on the same ranks")
        replicate = self.mode == "replicate" or (whole and self.mode == "auto")
        if self.mode == "auto" and (whole or turns(layers, settings)):
            need = sum(replicated_bytes(len(scene), scene.surface) for scene in own)
            free = float(self.ranks.least(np.float64(self._room())))
            if whole and need > free:
                raise MemoryError(
                    "scene: expected memory for all particles on every rank, which annotations "
                    f"need, {need / 1e9:.3g} GB, got {free / 1e9:.3g} GB; leave them out, or "
                    "start fewer ranks on each computer"
                )
            replicate = need <= free
        found = [x if not isinstance(x.scene, SceneOnRanks) else
                 Layer(x.scene.used(replicate), x.material, x.clips) for x in layers]  # fmt: skip
        return tuple(found), self.ranks if replicate else None

    def used(self, replicate: bool) -> Any:
        """The scene of all particles, or the pieces; updates are for this one from now on."""
        self._used = self.whole if replicate else self.pieces
        return self._used()

    @property
    def factors(self) -> float:
        """The largest factor of reflection or refraction of all ranks' particles."""
        return self.pieces().factors

    def _room(self) -> float:
        """Bytes that this rank can take for a scene."""
        if self.device.backend != "cuda":
            return (free_bytes() or np.inf) / self._here
        return float(_core.Reconstructor("cuda", self.device.index, 0).free_bytes())

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
        raise ValueError(
            "scene: expected a scene in one process, got one on ranks, which can be drawn alone"
        )

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


def gathered(ranks: Alone, particles: Particles) -> Particles:
    """All ranks' particles, in the order of the ranks, on every one; without attributes."""

    def fields() -> tuple[tuple[str, ...], dict[str, Any]]:
        each, one = [], {}
        for name in (*COLUMNS, *FACTORS):
            value = None if name == "positions" else getattr(particles, name)
            if value is None:
                continue
            if np.ndim(value) > (name == "color"):
                each.append(name)
            else:
                one[name] = value if np.ndim(value) == 0 else np.asarray(to_host(value)).tolist()
        return tuple(each), one

    found = [f for f, n in ranks.all((ranks.together(fields), len(particles))) if n]
    found = found or [((), {})]
    check_reach([Layout(*f) for f in found])
    names = sorted({name for each, one in found for name in (*each, *one)})
    ones = [[one.get(name) for _, one in found] for name in names]
    same = {
        name: values[0]
        for name, values in zip(names, ones, strict=True)
        if values[0] is not None and all(v == values[0] for v in values)
    }
    layout = Layout(tuple(n for n in names if n not in same), same)
    rows = ranks.together(lambda: layout.rows(particles))
    return layout.particles(ranks.concatenated(rows))
