"""The overlay of a traced image: slices at their place in space, marks, the legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..data.attributes import colormap_of, place_label
from ..data.particles import HERE
from ..render.annotate import Annotation, Colors, bounds_of, draw_sheet, draw_view, origin_of, skin_of
from ..render.camera import Camera
from ..render.canvas import LEAST_SIDE
from ..render.frame import Frame
from .room import Room
from .state import State

ON_SCREEN = 0.65  # scale of annotations on the page, relative to saved images
RED, AMBER, STEEL = (226, 60, 60), (255, 176, 32), (70, 80, 92)


@dataclass(frozen=True)
class Mark:
    """Points joined by lines, with a text beside the last point.

    Attributes:
        points: (x, y, z) each, world; one or two points get dots.
        text: label.
        color: sRGB, 0 to 255.
        thin: draw a thin line without dots.
    """

    points: tuple[tuple[float, float, float], ...]
    text: str = ""
    color: tuple[int, int, int] = RED
    thin: bool = False


@dataclass(frozen=True)
class Plate:
    """A flat image in space.

    Attributes:
        texture: (H, W, 3) uint8 sRGB.
        world_from_plate: (4, 4), maps the pixel (column, row, 0, 1) to the world.
        mask: (H, W) bool, the pixels to draw; None draws all.
    """

    texture: np.ndarray
    world_from_plate: np.ndarray
    mask: np.ndarray | None = None


@dataclass(frozen=True)
class Flat:
    """An image that is drawn flat along the lower edge.

    Attributes:
        texture: (H, W, 3) uint8 sRGB.
        ratio: of its width to its height, as it is drawn.
        cross: shares of its width and height at which two lines cross.
        title: above it.
    """

    texture: np.ndarray
    ratio: float
    cross: tuple[float, float]
    title: str


def annotation_of(state: State) -> Annotation:
    """The annotations of the page."""
    color, notes = state.color, state.notes
    return Annotation(
        **vars(notes),
        legend=color.legend_at if color.by and color.legend else False,
        legend_title=color.legend_title,
        legend_unit=color.legend_unit,
    )


def box_of(frame: Frame | Any, state: State) -> dict[str, Any]:
    """What `finish` needs of a frame for the bounding box. The caller holds the source's lock."""
    if not state.notes.box:
        return {}
    scenes = [layer.scene for layer in frame._layers]
    return {"bounds": bounds_of(scenes), "skin": skin_of(scenes)}


def origin_seen(frame: Frame | Any) -> tuple[float, float, float]:
    """From where the places of a frame's scenes are given. The caller holds the source's lock."""
    scenes = [layer.scene for layer in getattr(frame, "_layers", ())]
    return origin_of(scenes) if scenes else HERE


def finish(
    picture: np.ndarray,
    state: State,
    camera: Camera,
    marks: list[Mark],
    plates: list[Plate],
    depth: np.ndarray | None,
    ends: tuple[float, float],
    size: tuple[int, int] | None = None,
    bounds: Any = None,
    skin: float = 0.0,
    kinds: tuple[tuple[float, str], ...] = (),
    origin: tuple[float, float, float] = HERE,
    room: Room | None = None,
    flats: Sequence[Flat] = (),
) -> np.ndarray:
    """The image (H, W, 3) uint8 sRGB with its overlay.

    Args:
        picture: (H, W, 3) uint8 sRGB.
        state: for legend and annotations.
        camera: of the image.
        marks, plates: to draw.
        depth: (H, W) distance along the rays, world units; needed for plates and the box.
        ends: values at the two ends of the color map.
        size: (width, height) at which the browser shows the image. A smaller image is enlarged
            before marks and annotations are drawn, so that they stay sharp.
        bounds, skin: as for `draw_view`.
        kinds: as those of `Colors`.
        origin: world, from which the scene's places are given.
        room: the part of the image that no bar of the page covers, for legend, title and flats.
        flats: to draw along the lower edge.
    """
    if plates and depth is not None:
        picture = draw_plates(picture, depth, camera, plates)
    notes = annotation_of(state)
    if size is not None and (marks or notes.draws or flats):
        picture = enlarged(picture, size)
    drawn = notes.draws and min(picture.shape[:2]) >= LEAST_SIDE
    if flats and min(picture.shape[:2]) >= LEAST_SIDE:
        picture = np.array(picture)
        free = picture[(room or Room()).part(picture.shape)]
        free[...] = draw_flats(free, flats)
    scale = 1.0 if size is None else ON_SCREEN
    if drawn:
        picture = draw_view(picture, notes, camera, bounds, depth, skin, scale=scale, origin=origin)
    if marks:
        picture = draw_marks(picture, camera, marks)
    if drawn:
        colormap = colormap_of(state.color.by, state.color.colormap)
        colors = Colors(colormap, *ends, place_label(state.color.by, origin), kinds)
        picture = np.array(picture)
        free = picture[(room or Room()).part(picture.shape)]
        if min(free.shape[:2]) >= LEAST_SIDE:
            free[...] = draw_sheet(np.ascontiguousarray(free), notes, colors, scale=scale)
    return picture


def enlarged(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The image (H, W, 3) uint8, enlarged to (width, height) if it is smaller."""
    from PIL import Image

    if size[0] <= picture.shape[1]:
        return picture
    small = Image.fromarray(np.ascontiguousarray(picture))
    return np.asarray(small.resize(size, Image.Resampling.BILINEAR))


def draw_plates(picture: np.ndarray, depth: np.ndarray, camera: Camera, plates: list[Plate]) -> np.ndarray:
    """The image (H, W, 3) with plates where nothing hides them; `depth`: as for `finish`."""
    height, width = depth.shape
    nearest = depth.reshape(-1).astype(np.float32).copy()
    out = np.array(picture).reshape(-1, 3)
    eye, forward, right, up = (v.astype(np.float32) for v in camera.frame((width, height)))
    x = (np.arange(width, dtype=np.float32) + 0.5) * 2 / width - 1
    y = 1 - (np.arange(height, dtype=np.float32) + 0.5) * 2 / height
    lengths: Any = 1.0
    if camera.height is None:
        lengths = np.sqrt(
            1 + (x * np.linalg.norm(right))[None, :] ** 2 + (y * np.linalg.norm(up))[:, None] ** 2
        ).reshape(-1)
    for plate in plates:
        rows, columns = plate.texture.shape[:2]
        plate_from_world = np.linalg.inv(plate.world_from_plate)
        # A ray is eye + t (forward + x right + y up), or with parallel rays eye + x right + y up
        # + t forward: in the plate's frame linear in x and y.
        start = plate_from_world[:3, :3] @ eye + plate_from_world[:3, 3]
        axes = plate_from_world[:3, :3] @ np.stack([forward, right, up], axis=1)
        across = (
            (axes[:, 1, None, None] * x[None, None, :] + axes[:, 2, None, None] * y[None, :, None])
            .astype(np.float32)
            .reshape(3, -1)
        )
        begin, way = start[:, None].astype(np.float32), axes[:, :1].astype(np.float32)
        begin, way = (begin, way + across) if camera.height is None else (begin + across, way)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -begin[2] / way[2]
            column = np.floor(begin[0] + t * way[0] + 0.5)
            row = np.floor(begin[1] + t * way[1] + 0.5)
            along = t * lengths
            seen = (t > 0) & (along < nearest) & (column >= 0) & (column < columns)
            seen &= (row >= 0) & (row < rows)
        at = np.flatnonzero(seen)
        pixels = row[at].astype(np.intp), column[at].astype(np.intp)
        if plate.mask is not None:
            kept = plate.mask[pixels]
            at, pixels = at[kept], tuple(p[kept] for p in pixels)
        out[at] = plate.texture[pixels]
        nearest[at] = along[at]
    return out.reshape(picture.shape)


def draw_flats(picture: np.ndarray, flats: Sequence[Flat]) -> np.ndarray:
    """The image (H, W, 3) uint8 with flat images along its lower edge."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(np.ascontiguousarray(picture))
    draw, gap = ImageDraw.Draw(image), round(0.012 * image.width)
    widest = (image.width - gap * (len(flats) + 1)) / sum(flat.ratio for flat in flats)
    tall = max(1, round(min(0.32 * image.height, widest)))
    font = ImageFont.load_default(size=max(10, round(tall / 14)))
    x = gap
    for flat in flats:
        size = max(1, round(flat.ratio * tall)), tall
        y = image.height - tall - gap
        image.paste(Image.fromarray(flat.texture).resize(size, Image.Resampling.BILINEAR), (x, y))
        across, down = x + flat.cross[0] * size[0], y + flat.cross[1] * tall
        draw.line([(across, y), (across, y + tall)], fill=AMBER)
        draw.line([(x, down), (x + size[0], down)], fill=AMBER)
        draw.rectangle([x, y, x + size[0], y + tall], outline=STEEL)
        draw.text((x + 4, y + 2), flat.title, (255, 255, 255), font, stroke_width=2, stroke_fill=(20, 24, 30))
        x += size[0] + gap
    return np.asarray(image)


def draw_marks(picture: np.ndarray, camera: Camera, marks: list[Mark]) -> np.ndarray:
    """The image (H, W, 3) uint8 with lines, dots and texts over everything."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(np.ascontiguousarray(picture))
    draw = ImageDraw.Draw(image)
    unit = max(1.0, min(image.size) / 720)
    font = ImageFont.load_default(size=round(14 * unit))
    taken: list[tuple[float, float, float, float]] = []  # by texts
    for mark in marks:
        places = camera.project(np.reshape(mark.points, (-1, 3)), image.size)
        seen = [tuple(place) for place in places.tolist() if place[0] == place[0]]
        if len(seen) > 1:
            if not mark.thin:
                draw.line(seen, fill=(255, 255, 255), width=round(4 * unit))
            draw.line(seen, fill=mark.color, width=round(2 * unit))
        for px, py in seen if len(seen) < 3 and not mark.thin else ():
            r = 4 * unit
            draw.ellipse(
                (px - r, py - r, px + r, py + r), fill=mark.color, outline=(255,) * 3, width=max(1, round(unit))
            )
        if mark.text and seen:
            place = seen[-1][0] + 9 * unit, seen[-1][1] - 9 * unit
            rim = max(1, round(1.5 * unit))
            box = draw.multiline_textbbox(place, mark.text, font, stroke_width=rim)
            down = free_below(box, taken)
            taken.append((box[0], box[1] + down, box[2], box[3] + down + 2 * unit))
            draw.multiline_text(
                (place[0], place[1] + down), mark.text, (20, 24, 30), font, stroke_width=rim, stroke_fill=(255,) * 3
            )
    return np.asarray(image)


def free_below(box: tuple, taken: list[tuple]) -> float:
    """How far down a box (left, top, right, bottom) has to move to be free of others, pixels."""
    down = 0.0
    for left, top, right, bottom in sorted(taken, key=lambda other: other[1]):
        beside = box[2] <= left or right <= box[0]
        if not beside and box[1] + down < bottom and top < box[3] + down:
            down = bottom - box[1]
    return down
