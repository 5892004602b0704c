"""The scene of some particles with the settings of the page."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.colormaps import colorize
from ..data.attributes import attribute_values, colormap_of, kinds_of
from ..data.particles import Particles
from ..fluids import likeness
from ..pieces.scene import Scene
from ..scene.scene import threshold_of
from ..scene.thesis import Thesis, fitting_level
from .state import State

PERCENTILES = 0.5, 99.5
STRETCHED = 3.0  # times the range between the percentiles; beyond it the percentiles are shown
MOST_LOOKED_AT = 1 << 20  # values for the percentiles


class SceneMaker:
    """Keeps one scene for all images.

    A change of kernel, support or root method makes a new scene; other particles or colors update
    the scene.

    Args:
        device, threads: as for `Scene`.
        given: a scene of the user, which is traced as it is until a setting differs from it.

    Attributes:
        fluids: whether particles like those of a fluid get a smooth surface; not those of volumes.
        threads: that scenes use; 0: all.
        range: values at the two ends of the color map.
        beyond: how many values lie beyond an automatic range.
        lead: gives the particles of a sequence that decide which surface all frames have, and its
            support; None: those that are shown first.
    """

    def __init__(self, device: str = "auto", threads: int = 0, given: Scene | None = None):
        self._options: dict[str, Any] = {"device": device, "threads": threads}
        self.threads = threads
        if given is not None:
            self._options["device"] = given.device.name
        self._given = self._scene = given
        self._built: Any = None
        self._given_threshold: float | None = None
        if given is not None:
            self._built = (given.kernel, None, "exact", given.surface)
            self._given_threshold = given.threshold
        self.fluids = True
        self.lead: Callable[[], Particles] | None = None
        self._judged: tuple[int, str] | None = None  # how many particles were judged, and how
        self._shown: Any = None if given is None else (given.particles, "")
        self._other: Scene | None = None
        self.range = (0.0, 1.0)  # of the color map
        self.beyond = 0
        self.kinds: tuple = ()  # of `Colors`

    def shape(self, particles: Particles, state: State, threshold: float | None = None) -> str:
        """ "smooth", "spheres" or "balls", by the rule of `globule.render`.

        Particles are judged once, so that a surface does not change its kind while it moves; a few
        particles are judged again when there are more.
        """
        surface = state.surface
        if surface.shape != "auto":
            return surface.shape
        own = (surface.kernel, surface.support, surface.root) != ("murakami", None, "exact")
        if own or not (surface.threshold is None and threshold is None):
            return "balls"
        if self._given is not None:
            return self._given.surface
        if not self.fluids or state.look.preset == "thesis":
            return "balls"
        if self._judged is None or self._judged[0] < likeness.MANY:
            judged = self._leading(particles)
            self._judged = len(judged), likeness.suitable_surface(judged)[0]
        return self._judged[1]

    def _leading(self, particles: Particles) -> Particles:
        """Those that lead, or these where that frame cannot be read."""
        if self.lead is not None:
            with contextlib.suppress(ValueError, OSError):
                return self.lead()
        return particles

    def _wanted(self, particles: Particles, state: State, threshold: float | None) -> tuple:
        surface, shape = state.surface, self.shape(particles, state, threshold)
        if shape != "balls":  # finds kernel and supports itself
            return "murakami", None, "exact", shape
        root = "exact" if surface.root == "exact" else "thesis"
        return surface.kernel, surface.support, root, shape

    def scene(self, particles: Particles, state: State, threshold: float | None = None) -> Scene:
        """The scene to trace; `threshold` applies where the settings have none."""
        self._other = None
        wanted = self._wanted(particles, state, threshold)
        colors = self._colors(particles, state)
        shown = (particles, colors)
        same = self._shown is not None and self._shown[0] is particles and self._shown[1] == colors
        if wanted != self._built or self._scene is None:
            leads = self._leading(particles)
            self._scene = self._build(self._colored(leads, state), wanted)
            if leads is not particles:
                self._scene.update(self._colored(particles, state))
        elif not same:
            self._scene.update(self._colored(particles, state))
        self._built, self._shown = wanted, shown
        given = self._given
        own = None if given is None or given.surface != wanted[3] else self._given_threshold
        usual = threshold_of(wanted[3], state.surface.kernel)
        for value in (state.surface.threshold, threshold, own, usual):
            if value is not None:
                self._scene.threshold = float(value)
                break
        return self._scene

    @property
    def last_scene(self) -> Scene | None:
        """The scene of the last image."""
        return self._other or self._scene

    def show(self, scene: Scene) -> None:
        """Note that a scene of another owner was traced instead."""
        self._other = scene

    def _build(self, particles: Particles, wanted: tuple) -> Scene:
        options = scene_options(particles, *wanted, **self._options)
        return Scene(particles, wanted[0], **options, **self._options)

    def _colors(self, particles: Particles, state: State) -> tuple | str:
        color = state.color
        if not color.by:
            return ""
        return color.by, color.colormap, color.automatic or (color.low, color.high)

    def _colored(self, particles: Particles, state: State) -> Particles:
        color = state.color
        if not color.by:
            return particles
        values = attribute_values(particles, color.by)
        known = values[np.isfinite(values)]
        self.range, self.beyond = (color.low, color.high), 0
        if color.automatic:
            self.range, self.beyond = usual_range(known)
        self.kinds = kinds_of(particles, color.by, color.colormap)
        colors = colorize(values, colormap_of(color.by, color.colormap), *self.range)
        return dataclasses.replace(particles, color=colors)


def usual_range(values: np.ndarray) -> tuple[tuple[float, float], int]:
    """The ends of the color map for finite values, and how many lie beyond them.

    From the lowest to the highest, unless few values stretch that range far: then from the 0.5th to
    the 99.5th percentile.
    """
    if not values.size:
        return (0.0, 1.0), 0
    lowest, highest = float(values.min()), float(values.max())
    low, high = (float(v) for v in np.percentile(values[:: 1 + len(values) // MOST_LOOKED_AT], PERCENTILES))
    if not (high > low and highest - lowest > STRETCHED * (high - low)):
        return (lowest, highest), 0
    return (low, high), int(np.count_nonzero((values < low) | (values > high)))


def scene_options(
    particles: Particles, kernel: str, support: float | None, root: str, shape: str, **machine: Any
) -> dict[str, Any]:
    """Further arguments of `Scene` for a support (None: automatic), root method and surface."""
    if shape != "balls":
        return {"surface": shape}
    if root == "exact":
        return {} if support is None else {"support": support}
    if support is None and particles.support is None:
        support = float(np.max(Scene(particles, kernel, **machine).support))
    largest = float(np.max(particles.support if support is None else support))
    extent = float(np.ptp(particles.bounds(), axis=0).max()) if len(particles) else 0.0
    level = fitting_level(extent, largest) if extent else None
    return {"support": support, "octree": "dense", "level": level}


def thesis_of(state: State) -> Thesis | None:
    """The thesis' tracing, or None. Raises ValueError for settings that exclude each other."""
    surface = state.surface
    if surface.root == "exact":
        return None
    if surface.shape == "smooth":
        raise ValueError(f"surface: expected balls or auto with the root method {surface.root}, got smooth")
    return Thesis(root=surface.root)
