"""Images of a scene."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from .._base.checks import image_size, shown
from ..scene import attributes
from ..scene.fluid import shows_flat
from ..scene.mesh import Mesh
from ..scene.particles import Particles
from ..scene.scene import Scene
from ..scene.thesis import Thesis, check_tracing
from .annotate import Annotation, drawing, traced_size
from .camera import Camera
from .clips import ClipBox, ClipPlane, ClipSphere
from .fit import fitted
from .frame import Frame
from .layers import core_scene, device_of, in_pieces, layers_of
from .settings import NAMES, RenderSettings, as_settings, for_flat_data, for_values
from .share import Share

SIZE = (1024, 782)  # of an image, where none is asked for
# How scenes in pieces are rendered; the room `pieces`, which comes after this one, puts it here.
beyond: list[Callable[..., Any]] = []


def render(
    scene: Any,
    camera: Camera | tuple[int, int] | None = None,
    size: tuple[int, int] | Camera | RenderSettings | Mapping[str, Any] = SIZE,
    settings: RenderSettings | Mapping[str, Any] | None = None,
    clips: Sequence[ClipPlane | ClipBox | ClipSphere] = (),
    thesis: Thesis | None = None,
    *,
    color_by: str | None = None,
    colormap: str = "viridis",
    range: tuple[float, float] | None = None,
    annotate: Annotation | None = None,
    progress: Callable[[int, int], object] | None = None,
    comm: Any = None,
    **others: Any,
) -> Frame:
    """Render an image: for each pixel, the light from the first point where the field is the
    threshold, and from where that light is reflected and refracted.

        render("splash.vtk").save("splash.png")
        render(particles, (640, 480), settings={"shadows": True}, color_by="speed")

    Args:
        scene: a `Scene`; a `Mesh`; an argument of `Scene`, i.e. `Particles`, (N, 3) positions or a
            file's name (a file with faces is drawn as its triangles); a simulation; or a list of up
            to 4 of these or of `Layer`s for one image. 2-D data (at least 100 particles of equal z)
            are shown as spheres of half a spacing, in flat colors where the settings leave the
            lights at their default.
        camera: default: `Camera.fit` of the first scene; of 2-D data from above, orthographic. A
            size may replace the camera; settings may follow it.
        size: (width, height) pixels.
        settings: `RenderSettings`, or a dict of its fields.
        clips: cuts through every scene.
        thesis: trace the camera's rays as the source thesis does, with these choices; default:
            exactly.
        color_by: color the particles, or a mesh's vertices, by a field or attribute, instead of
            their own colors and the material's: x, y, z, support, an attribute (a vector's length),
            or NAME:0 … for a component. A `Scene` or `Mesh` keeps these colors. Where the settings
            leave the lights at their default, white and diffuse light keeps the colors' hue.
        colormap: of `color_by`: viridis, magma, inferno, plasma, cividis, turbo, coolwarm or gray.
        range: (lo, hi), values of the map's ends; default: the lowest and highest finite value.
        annotate: `Annotation`, drawn into the frame's `image`.
        progress: called as progress(done, total) after each sample per pixel; may raise to stop.
        comm: an mpi4py communicator whose ranks all have this scene and make this call: each
            traces its share of the pixels, and rank 0 has the image, with the same bits as one rank
            alone. Other ranks' frames have no hits. All ranks call `refine`, and `alpha` after it.
            (`Scene(..., comm=...)` is for particles that are distributed over the ranks.)

    Raises:
        TypeError, ValueError: naming the argument, the expected and the given value.
        FormatError, OSError: a file cannot be read.
        MissingPackageError: `comm` without mpi4py.
    """
    if others:
        raise TypeError(f"render: {_instead(next(iter(others)))}")
    if settings is None and isinstance(size, (RenderSettings, Mapping)):
        settings, size = size, SIZE  # after a size in the camera's place
    camera, total = camera_and_size(camera, size)
    size = traced_size(annotate, total)
    settings = as_settings(settings)
    layers = layers_of(scene, clips, (color_by, colormap, range))
    spread = next((x.scene for x in layers if hasattr(x.scene, "settled")), None)
    if spread is not None:
        if color_by is not None:
            if annotate is not None:
                raise ValueError(
                    "annotate: expected no color_by with it for a scene on ranks or in pieces"
                )
            settings, color_by = for_values(settings), None
        layers, comm = spread.settled(layers, settings, comm, annotate is not None)
    first = layers[0].scene
    if any(in_pieces(layer.scene) for layer in layers):
        if thesis is not None or annotate is not None or color_by is not None:
            raise ValueError(
                "scene: expected no thesis, annotate and color_by with pieces; "
                "Pieces(..., color_by=...) colors them"
            )
        if comm is not None:
            raise ValueError("comm: expected None with pieces, which have their own, got one")
        return beyond[0](layers, camera, size, settings, progress)
    if shows_flat(first):
        settings = for_flat_data(settings)
    if color_by is not None:
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
    kinds = [
        ((layer.material or settings.material)._packed, [c._packed for c in layer.clips])
        for layer in layers
    ]
    for layer in layers:
        if isinstance(layer.scene, Scene):
            check_tracing(layer.scene, thesis)
        elif thesis is not None:
            raise ValueError(
                "thesis: expected particles alone with the thesis's tracing, got a mesh"
            )
    way = None if thesis is None else thesis._packed

    def surfaces() -> list[tuple[int, float]]:
        """Kernel and threshold of each layer."""
        scenes = (layer.scene for layer in layers)
        return [(s._kernel, s.threshold) if isinstance(s, Scene) else (0, 1.0) for s in scenes]

    rendered = surfaces()
    # Of scenes whose particles lie in pieces others say what rays meet.
    answers = [getattr(layer.scene, "answers", None) for layer in layers]
    wavefront = next((a.wavefront for a in answers if a is not None), None)

    def trace(passes: int, before: Any, look: Any = look) -> Any:
        if before and rendered != surfaces():
            raise ValueError("refine: expected the scene as it was rendered, got another threshold")
        scenes = [core_scene(layer.scene, device) for layer in layers]
        packed = [
            (scene, *surface, *kind, who)
            for scene, surface, kind, who in zip(scenes, surfaces(), kinds, answers, strict=True)
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
        return trace(passes, None, settings._look(scenes, light))

    values = None
    if color_by is not None and (settings.is_flat or annotate is not None):
        values = values_of(points_of(first), color_by, colormap, range)
    finish = None
    if annotate is not None and annotate.draws:
        finish = drawing(annotate, camera, [layer.scene for layer in layers], values, total)
    n = settings.samples
    if progress is None or n == 1:
        first_pass = trace(n, None)
    else:
        first_pass = trace(1, None, replace(settings, edge_samples=0)._look(scenes))
    blended = values[:4] if values and isinstance(first, Scene) else None
    frame = Frame(size, first_pass, layers, trace, settings, behind, blended, finish)
    if progress is not None:
        progress(1, n)
        if n > 1:
            frame.refine(n - 1, lambda done, _: progress(1 + done, n))
    if share is not None and settings.transparent:
        frame.alpha  # noqa: B018  found by all ranks together
    return frame


def points_of(scene: Scene | Mesh) -> Particles:
    """What `color_by` colors: the particles, or a mesh's vertices."""
    return scene.points if isinstance(scene, Mesh) else scene.particles


def values_of(
    particles: Particles, name: str, colormap: str, range: tuple[float, float] | None
) -> tuple[np.ndarray, str, float, float, str]:
    """What an image of colors by value shows: the particles' values (N,), color map, values of the
    map's ends, name."""
    values = attributes.attribute_values(particles, name)
    if range is None:
        known = values[np.isfinite(values)]
        range = attributes.ends_of_map(name, known, len(values))
    return values, colormap, *attributes.checked_range(range), name


def camera_and_size(camera: Any, size: Any) -> tuple[Camera | None, tuple[int, int]]:
    """Both, checked, in whichever order they come; the size may stand in the camera's place."""
    if isinstance(size, Camera):
        camera, size = size, SIZE if camera is None else camera
    elif isinstance(camera, (tuple, list)) and len(camera) == 2:
        if size != SIZE:
            raise TypeError(f"size: expected one, got {shown(camera)} and {shown(size)}")
        camera, size = None, camera
    if isinstance(camera, (RenderSettings, Mapping)):
        raise TypeError("camera: expected Camera, got settings; write settings=... for settings")
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera: expected Camera or a size (width, height), got {shown(camera)}")
    return camera, image_size(size)


def _instead(name: str) -> str:
    """What to write for an argument that `render` does not have."""
    if name in inspect.signature(Scene).parameters:
        return f"{name} belongs to the scene: globule.Scene(particles, {name}=...)"
    if name in NAMES:
        return f"{name} belongs to the settings: settings={{{name!r}: ...}}"
    if name in (f.name for f in fields(Camera)):
        return f"{name} belongs to the camera: camera=globule.Camera(..., {name}=...)"
    known = ", ".join(p for p in inspect.signature(render).parameters if p != "others")
    return f"expected {known}, got {name!r}"
