"""Images of a scene."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any

from .._base.checks import image_size, shown
from ..pieces.scene import Scene, SceneInPieces, SceneOnRanks
from ..scene.thesis import Thesis
from .annotate import Annotation, traced_size
from .camera import Camera
from .clips import Clip
from .frame import Frame
from .layers import in_pieces, layers_of
from .settings import NAMES, RenderSettings, as_settings, for_values
from .trace import trace

SIZE = (1024, 782)  # of an image, where none is asked for


def render(
    scene: Any,
    camera: Camera | tuple[int, int] | None = None,
    size: tuple[int, int] | Camera | RenderSettings | Mapping[str, Any] = SIZE,
    settings: RenderSettings | Mapping[str, Any] | None = None,
    clips: Clip | Sequence[Clip] = (),
    thesis: Thesis | None = None,
    *,
    color_by: str | None = None,
    colormap: str = "auto",
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
            to 4 of these or of `Layer`s for one image. 2-D data (particles in one plane) are shown
            as spheres of half a spacing, in flat colors where the settings leave the lights at
            their default.
        camera: default: `Camera.fit` of the first scene; of 2-D data along the normal. A
            size may replace the camera; settings may follow it.
        size: (width, height) pixels.
        settings: `RenderSettings`, or a dict of its fields.
        clips: cuts through every scene, or a single one.
        thesis: trace the camera's rays as the source thesis does, with these choices; default:
            exactly.
        color_by: color the particles, or a mesh's vertices, by a field or attribute, instead of
            their own colors and the material's: x, y, z, support, an attribute (a vector's length),
            or NAME:0 … for a component. A `Scene` or `Mesh` keeps these colors. Where the settings
            leave the lights at their default, white and diffuse light keeps the colors' hue.
        colormap: of `color_by`: auto (types or elements for an attribute of that name, else
            viridis), or a name as for `colorize`.
        range: (lo, hi), values of the map's ends; default: the lowest and highest finite value.
        annotate: `Annotation`, drawn into the frame's `image`.
        progress: called as progress(done, total) after each sample per pixel; may raise to stop.
        comm: an mpi4py communicator whose ranks all have this scene and make this call: each
            traces its share of the pixels, and rank 0 has the image, with the same bits as one rank
            alone. Other ranks' frames have no hits. All ranks call `refine`, and `alpha` after it.
            (`Scene(..., comm=...)` is for particles that are distributed over the ranks.)

    Raises:
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
    # Kept here: they own the files of the pieces that take their place.
    spread = [x.scene for x in layers if isinstance(x.scene, (SceneInPieces, SceneOnRanks))]
    if spread:
        if color_by is not None:
            if annotate is not None:
                raise ValueError("annotate: expected no color_by with it for a scene on ranks or in pieces")
            settings, color_by = for_values(settings), None
        from .spread import settled

        layers, comm = settled(spread[0], layers, settings, comm, annotate is not None)
    if any(in_pieces(layer.scene) for layer in layers):
        if thesis is not None or annotate is not None or color_by is not None:
            raise ValueError(
                "scene: expected no thesis, annotate and color_by with pieces; Pieces(..., color_by=...) colors them"
            )
        if comm is not None:
            raise ValueError("comm: expected None with pieces, which have their own, got one")
        from .pieces.image import render_pieces

        return render_pieces(layers, camera, size, settings, progress)
    color = None if color_by is None else (color_by, colormap, range)
    return trace(layers, camera, size, settings, thesis, color, annotate, total, progress, comm)


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
