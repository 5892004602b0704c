"""A scene whose particles do not fit into the memory: it has pieces instead of an octree."""

from __future__ import annotations

import os
import tempfile
import threading
import warnings
import weakref
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np

from .._base.checks import positive
from .._base.device import Device
from .._base.memory import resident_bytes, room
from ..render.layers import Layer
from ..render.settings import RenderSettings
from ..scene.attributes import checked_range
from ..scene.fitting import counted
from ..scene.particles import FIELDS, Particles
from ..scene.scene import KERNELS, Scene
from ..scene.sources import as_particles
from .image import Pieces


class SceneInPieces(Scene):
    """What `Scene(...)` becomes where its particles do not fit: `Pieces`, one after the other."""

    _pieces: Pieces
    close: Callable[[], object]  # removes the temporary files
    in_pieces = True  # by which `render` and cameras know that nobody has all particles

    def _divide(
        self, particles: Any, lack: tuple[float, float], device: Device,
        color: tuple[Any, Any, Any] | None, **options: Any,
    ) -> None:  # fmt: skip
        """In place of the octree. lack: bytes that it would take, and that are free."""
        self._lock = threading.RLock()
        self.device, self._lack = device, lack
        self._options = {"kernel": "murakami", **options, "device": device.name}
        self.kernel = self._options["kernel"]
        self._kernel = KERNELS.index(self.kernel)
        self.builds = 0
        self._make(particles, color)
        warnings.warn(
            f"scene: {self._why()}: they are in {self._pieces.partition.n} pieces, in temporary "
            f"files in {tempfile.gettempdir()}, and drawn one after the other",
            stacklevel=4,
        )

    def _make(self, particles: Any, color: tuple[Any, Any, Any] | None) -> None:
        """Divide particles; what goes wrong on the way leaves the pieces from before."""
        given = dict(zip(("color_by", "colormap", "range"), color or (), strict=False))
        pieces = Pieces(particles, memory=resident_bytes() + room(), **given, **self._options)
        if self.builds:
            self.close()
        self._given, self._color, self._pieces = particles, color, pieces
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
        if particles is None:
            unknown = fields.keys() - set(FIELDS)
            if unknown:
                raise TypeError(
                    f"update: unknown field {sorted(unknown)[0]!r}, expected {', '.join(FIELDS)}"
                )
            if isinstance(self._given, (str, os.PathLike)):
                raise ValueError(
                    "update: expected particles or a file's name with a scene in pieces of "
                    f"{os.fspath(self._given)}, got fields alone"
                )
            particles = as_particles("particles", self._given)._with(fields, {})
        elif fields:
            raise TypeError("update: expected particles or fields, got both")
        with self._lock:
            self._make(counted("particles", particles)[0], None)

    def settled(
        self, layers: Sequence[Layer], settings: RenderSettings, comm: Any, whole: bool
    ) -> tuple[tuple[Layer, ...], None]:
        """The layers with pieces in the place of scenes in pieces, for `render`."""
        if comm is not None:
            raise ValueError(
                "comm: expected None with a scene in pieces, got one; "
                "globule.Scene(particles, comm=...) shares particles out among the ranks"
            )
        if whole:
            raise ValueError(f"annotate: expected None with a scene in pieces: {self._why()}")
        if any(isinstance(x.scene, Scene) and hasattr(x.scene, "ranks") for x in layers):
            raise ValueError("scene: expected all layers on the same ranks")
        found = [
            Layer(x.scene._pieces, x.material, x.clips) if isinstance(x.scene, SceneInPieces) else x
            for x in layers
        ]
        return tuple(found), None

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lowest, highest) corner of the particles: (3,) float64 each, world."""
        return self._pieces.bounds()

    def _color_by(self, name: str, colormap: str, range: tuple[float, float] | None) -> None:
        color = name, colormap, None if range is None else checked_range(range)
        if color != self._color:
            with self._lock:
                self._make(self._given, color)

    def _why(self) -> str:
        need, free = self._lack
        return (
            f"{len(self):,} particles take about {need / 1e9:.3g} GB as one scene on "
            f"{self.device.name}, which has room for {free / 1e9:.3g} GB"
        )

    def _refuse(self) -> NoReturn:
        raise ValueError(
            f"scene: expected particles in one scene, got pieces, which can be drawn alone: "
            f"{self._why()}; free memory, or make a scene of a part of the particles"
        )

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
        return self._pieces.threshold

    @threshold.setter
    def threshold(self, value: float) -> None:
        self._pieces.threshold = self._options["threshold"] = positive("threshold", value)

    @property
    def support(self) -> Any:
        """World units: one for all, or None where each particle has its own."""
        own = self._pieces.support
        return self._pieces.one("support") if own is None else own

    @property
    def spacing(self) -> float:
        """Spacing of a smooth surface or of spheres, world units; of balls it is not measured, and
        is 0."""
        return float(self._pieces.spacing or 0.0)

    def become_smooth(self) -> None:
        """Not in pieces: give `surface` to `Scene`."""
        self._refuse()

    def __len__(self) -> int:
        return len(self._pieces)

    def __repr__(self) -> str:
        return (
            f"Scene({len(self)} particles in {self._pieces.partition.n} pieces, {self.kernel}, "
            f"threshold {self.threshold:g}, {self.device.name})"
        )
