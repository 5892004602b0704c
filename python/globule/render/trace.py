"""The image of layers, each of which is one octree or mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..data import attributes
from ..data.particles import Particles
from ..fluids.likeness import shows_flat
from ..scene.mesh import Mesh
from ..scene.scene import SceneBase
from ..scene.thesis import Thesis, check_tracing
from .annotate import Annotation, drawing
from .camera import Camera
from .fit import fitted
from .frame import Frame
from .layers import Layer, core_scene, device_of
from .settings import RenderSettings, for_flat_data, for_values
from .share import Share


def trace(
    layers: Sequence[Layer],
    camera: Camera | None,
    size: tuple[int, int],
    settings: RenderSettings,
    thesis: Thesis | None = None,
    color: tuple[str, str, tuple[float, float] | None] | None = None,
    annotate: Annotation | None = None,
    total: tuple[int, int] | None = None,
    progress: Callable[[int, int], object] | None = None,
    comm: Any = None,
) -> Frame:
    """The image; arguments as of `render`.

    Args:
        color: its color_by, colormap and range; the layers are colored already.
        total: size of the image with what is drawn beside it; default: `size`.
    """
    layers, first = tuple(layers), layers[0].scene
    if shows_flat(first):
        settings = for_flat_data(settings)
    if color is not None:
        settings = for_values(settings)
    if thesis is not None and any(layer.clips for layer in layers):
        raise ValueError("clips: expected none with the thesis's tracing, which knows no cuts")
    if camera is None:
        camera = fitted(first, size, annotate)
    scenes = [layer.scene for layer in layers]
    view, look = camera._view(size), settings._look(scenes)
    share = None
    if comm is not None:
        if thesis is not None:
            raise ValueError("comm: expected None with the thesis's tracing, got one")
        share = Share(comm, camera, size, settings._mixes(scenes))
        view = share.view
    device = device_of(layers)
    kinds = [((layer.material or settings.material)._packed, [c._packed for c in layer.clips]) for layer in layers]
    for layer in layers:
        if isinstance(layer.scene, SceneBase):
            check_tracing(layer.scene, thesis)
        elif thesis is not None:
            raise ValueError("thesis: expected particles alone with the thesis's tracing, got a mesh")
    way = None if thesis is None else thesis._packed

    def surfaces() -> list[tuple[int, float]]:
        """Kernel and threshold of each layer."""
        return [(s._kernel, s.threshold) if isinstance(s, SceneBase) else (0, 1.0) for s in scenes]

    rendered = surfaces()
    # Of scenes whose particles lie in pieces others say what rays meet.
    answers = [getattr(layer.scene, "answers", None) for layer in layers]
    wavefront = next((a.wavefront for a in answers if a is not None), None)

    def traced(passes: int, before: Any, look: Any = look) -> Any:
        if before and rendered != surfaces():
            raise ValueError("refine: expected the scene as it was rendered, got another threshold")
        cores = [core_scene(layer.scene, device) for layer in layers]
        packed = [
            (scene, *surface, *kind, who)
            for scene, surface, kind, who in zip(cores, surfaces(), kinds, answers, strict=True)
        ]
        core = packed[0][0]
        if share is not None and before:
            before = before.own

        def made() -> Any:
            return core.render(packed, view, look, way, passes, before)

        own = made() if wavefront is None else wavefront.run(made)
        return own if share is None else share.whole(own)

    def behind(light: float, passes: int) -> Any:
        """The same rays in front of another light."""
        if share is not None and not settings.transparent:
            raise ValueError("alpha: expected settings with transparent=True for several ranks")
        return traced(passes, None, settings._look(scenes, light))

    values = None
    if color is not None and (settings.is_flat or annotate is not None):
        values = values_of(points_of(first), *color)
    finish = None
    if annotate is not None and annotate.draws:
        finish = drawing(annotate, camera, scenes, values, total or size)
    n = settings.samples
    if progress is None or n == 1:
        first_pass = traced(n, None)
    else:
        first_pass = traced(1, None, replace(settings, edge_samples=0)._look(scenes))
    blended = values[:4] if values and isinstance(first, SceneBase) else None
    frame = Frame(size, first_pass, layers, traced, settings, behind, blended, finish, camera, color)
    if progress is not None:
        progress(1, n)
        if n > 1:
            frame.refine(n - 1, lambda done, _: progress(1 + done, n))
    if share is not None and settings.transparent:
        frame.alpha  # noqa: B018  found by all ranks together
    return frame


def points_of(scene: SceneBase | Mesh) -> Particles:
    """What `color_by` colors: the particles, or a mesh's vertices."""
    return scene.points if isinstance(scene, Mesh) else scene.particles


def values_of(
    particles: Particles, name: str, colormap: str, range: tuple[float, float] | None
) -> tuple[np.ndarray, str, float, float, str, tuple[tuple[float, str], ...]]:
    """What an image of colors by value shows: the particles' values (N,), color map, values of the
    map's ends, label, kinds of `Colors`."""
    values = attributes.attribute_values(particles, name)
    if range is None:
        known = values[np.isfinite(values)]
        range = attributes.ends_of_map(name, known, len(values))
    kinds = attributes.kinds_of(particles, name, colormap)
    lo, hi = attributes.checked_range(range)
    label = attributes.place_label(name, particles.origin)
    return values, attributes.colormap_of(name, colormap), lo, hi, label, kinds
