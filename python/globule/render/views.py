"""Several views of a scene in one image."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .._base.arrays import VectorLike
from .._base.checks import image_size, named, shown
from ..fluids.likeness import shows_flat
from ..scene.scene import SceneBase
from ..scene.thesis import Thesis
from .annotate import Annotation, Colors, bounds_of, draw_sheet, draw_view, origin_of, skin_of, traced_size
from .camera import Camera, first_direction, view_axes
from .clips import Clip
from .fit import fitted
from .frame import Frame, save_png
from .layers import layers_of
from .render import render
from .settings import RenderSettings, as_settings, for_flat_data, for_values
from .trace import points_of, values_of

VIEWS = ("front", "back", "left", "right", "side", "top", "bottom", "iso")
_GAP = (128, 128, 128)
_SCALE = 1.3  # of text in one of several views


@dataclass(repr=False)
class Views:
    """Several views in one image; `render_views` makes it.

    Attributes:
        frames: the `Frame` of each view, in the order of the views.
        names: of the views; "" where a camera was given.
    """

    frames: list[Frame]
    names: list[str]
    _size: tuple[int, int] = field(repr=False)
    _draw: Any = field(repr=False)

    def __repr__(self) -> str:
        return f"Views({len(self.frames)} views, {self._size[0]} x {self._size[1]})"

    @property
    def image(self) -> np.ndarray:
        """(H, W, 3) uint8, sRGB; (H, W, 4) where the settings say `transparent`."""
        return self._draw(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the image as PNG; whole or not at all."""
        save_png(path, self.image)


def view_cameras(
    scene: Any,
    views: Sequence[str | Camera],
    size: tuple[int, int],
    up: VectorLike | None = None,
    fov: float = 40.0,
    around: Any = None,
    annotation: Annotation | None = None,
) -> list[Camera]:
    """Cameras that see all particles, for views by name: orthographic ones of one scale along the
    axes, and a perspective one for iso.

    Args:
        scene: `Scene`.
        views: names in `VIEWS`, or cameras, which stay as they are.
        size: (width, height) of one view, pixels.
        up: (3,) upward direction, world; default: that of the particles.
        fov: vertical field of view of iso, degrees.
        around: (M, 3) points to show, world units; default: the particles.
        annotation: to leave room for.
    """
    up = scene.up if up is None else up
    right, above, front = view_axes(up)
    towards = {
        "front": front,
        "back": -front,
        "left": -right,
        "right": right,
        "side": right,
        "top": above,
        "bottom": -above,
    }
    cameras: list[Camera] = []
    for view in views:
        if isinstance(view, Camera):
            cameras.append(view)
            continue
        if view not in VIEWS:
            known = ", ".join(VIEWS)
            raise ValueError(f"views: expected cameras or some of {known}, got {shown(view)}")
        flat = view != "iso"
        direction = towards[view] if flat else first_direction(up)
        upwards = {"top": -front, "bottom": front}.get(view, above)
        cameras.append(
            fitted(scene, size, annotation, around, direction=direction, up=upwards, fov=fov, orthographic=flat)
        )
    return _one_scale(views, cameras)


def _one_scale(views: Sequence[Any], cameras: list[Camera]) -> list[Camera]:
    """The cameras, with one height for all orthographic ones that stand for names."""
    flat = [not isinstance(v, Camera) and v != "iso" for v in views]
    height = max((c.height or 0.0 for c, f in zip(cameras, flat, strict=True) if f), default=0.0)
    return [replace(c, height=height) if f else c for c, f in zip(cameras, flat, strict=True)]


class Grid:
    """Where the views of an image are, row by row.

    Args:
        n: number of views.
        size: (width, height) of the whole image, pixels.

    Attributes:
        cell: (width, height) of each view, pixels.
    """

    def __init__(self, n: int, size: tuple[int, int]):
        self.size = size
        self.gap = max(1, min(size) // 300)
        cells = []
        for columns in range(1, n + 1):
            rows = math.ceil(n / columns)
            width = (size[0] - self.gap * (columns - 1)) // columns
            height = (size[1] - self.gap * (rows - 1)) // rows
            cells.append((min(width, height), -columns * rows, -columns, (width, height)))
        _, _, columns, self.cell = max(cells)
        self.columns = -columns
        if min(self.cell) < 1:
            raise ValueError(f"size: expected room for {n} views, got {size[0]}x{size[1]}")

    def together(self, images: Sequence[np.ndarray]) -> np.ndarray:
        """One image (H, W, C) of the views' images (h, w, C) uint8."""
        out = np.zeros((self.size[1], self.size[0], images[0].shape[2]), np.uint8)
        if out.shape[2] == 3:
            out[:] = _GAP
        width, height = self.cell
        for i, image in enumerate(images):
            row, column = divmod(i, self.columns)
            y, x = row * (height + self.gap), column * (width + self.gap)
            out[y : y + height, x : x + width] = image
        return out


def draw_views(
    frames: Sequence[Frame],
    cameras: Sequence[Camera],
    names: Sequence[str],
    grid: Grid,
    annotation: Annotation | None,
    colors: Colors | None = None,
    bounds: Any = None,
    strip: int = 0,
    header: int = 0,
) -> np.ndarray:
    """One annotated image (H, W, 3 or 4) of the frames of several views, or of a single one."""
    notes = annotation or Annotation()
    scenes = [layer.scene for layer in frames[0]._layers]
    skin = skin_of(scenes) if notes.box else 0.0
    if notes.box and bounds is None:
        bounds = bounds_of(scenes)
    images, scale = [], 1.0 if len(frames) == 1 else _SCALE
    for frame, camera, name in zip(frames, cameras, names, strict=True):
        image = frame.image
        if name or notes.draws:
            distance = frame.distance if notes.box else None
            image = draw_view(image, notes, camera, bounds, distance, skin, name, scale, origin_of(scenes), colors)
        images.append(image)
    whole = images[0] if len(images) == 1 else grid.together(images)
    return draw_sheet(whole, notes, colors, strip, header) if notes.draws else whole


@named
def render_views(
    scene: Any,
    views: str | Camera | Iterable[str | Camera] = ("front", "top", "side", "iso"),
    size: tuple[int, int] = (1024, 782),
    settings: RenderSettings | Mapping[str, Any] | None = None,
    clips: Clip | Sequence[Clip] = (),
    thesis: Thesis | None = None,
    *,
    up: VectorLike | None = None,
    color_by: str | None = None,
    colormap: str = "auto",
    range: tuple[float, float] | None = None,
    annotate: Annotation | None = None,
) -> Views:
    """Render several views of a scene into one image, in rows from the top left.

        render_views("splash.vtk", ("front", "top", "side", "iso")).save("views.png")

    Views along the axes are orthographic and have one scale; iso is in perspective. Views by name
    have their name in the upper right corner.

    Args:
        scene: as for `render`.
        views: front, back, left, right (also: side), top, bottom, iso, or cameras.
        size: (width, height) of the whole image, pixels.
        settings, clips, thesis: as for `render`.
        up: (3,) upward direction, world, for views by name; default: that of the particles.
        color_by, colormap, range: as for `render`.
        annotate: `Annotation`: scale bar, axes and box are in each view, the rest in the image.
    """
    chosen = [views] if isinstance(views, (str, Camera)) else list(views)
    if not chosen:
        raise ValueError("views: expected at least one view, got none")
    size = image_size(size)
    annotate = annotate and annotate.for_views(len(chosen))
    traced = traced_size(annotate, size, len(chosen) > 1)
    grid = Grid(len(chosen), traced)
    names = ["" if isinstance(view, Camera) else view for view in chosen]
    settings = as_settings(settings)
    layers = layers_of(scene, clips, (color_by, colormap, range))
    first, colors = layers[0].scene, None
    if shows_flat(first):
        settings = for_flat_data(settings)
    if color_by is not None:
        settings = for_values(settings)
    cameras = view_cameras(first, chosen, grid.cell, up, annotation=annotate)
    frames = [render(layers, camera, grid.cell, settings, thesis=thesis) for camera in cameras]
    if color_by is not None:
        values = values_of(points_of(first), color_by, colormap, range)
        colors = Colors(*values[1:])
        for frame in frames:
            frame._values = values[:4] if isinstance(first, SceneBase) else None
    elif annotate is not None and annotate.legend:
        raise ValueError("annotate: expected color_by beside a legend, got none")
    strip, header = size[0] - traced[0], size[1] - traced[1]

    def draw(shown: Views) -> np.ndarray:
        return draw_views(shown.frames, cameras, names, grid, annotate, colors, None, strip, header)

    return Views(frames, names, size, draw)
