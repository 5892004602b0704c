"""Annotations of an image: scale bar, axes, bounding box with ticks, time and step, title, legend.

`draw_view` draws what belongs to a camera, `draw_sheet` what belongs to the whole image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import to_host
from .._base.checks import shown, three
from .._base.colormaps import CATEGORICAL
from .._base.fixed import Fixed, read_only
from .._base.settings import Choice, Kind, Number, Switch, Text, Whole, WrongType, check_all, setting
from ..data.particles import HERE
from ..scene.scene import SceneBase
from .box import corner, draw_box, short
from .camera import Camera
from .canvas import LEAST_SIDE, Canvas, Color, sizes
from .legend import POSITIONS, draw_legend, strip_width

_TITLE = 1.35  # sizes of text
_BAR = 0.25  # longest scale bar, of the image's width
_AXIS = 0.065  # length of the triad's axes, of the image's shorter side
_COLORS: tuple[Color, ...] = ((214, 66, 56), (52, 150, 72), (58, 104, 214))  # of x, y and z


class Colors(NamedTuple):
    """What a legend shows: color map, values of its first and last color, name of the values, and
    the values and names of types or elements, where they are those."""

    colormap: str
    lo: float
    hi: float
    name: str
    kinds: tuple[tuple[float, str], ...] = ()


WORDS = Text(empty=True, longest=200)


class BoxKind(Kind):
    """A bool, or the two corners of a box."""

    expected = "a bool or (lo, hi)"

    def _take(self, value: Any) -> Any:
        if isinstance(value, bool):
            return value
        try:
            lo, hi = value
        except (TypeError, ValueError):
            raise self.wrong(value, WrongType) from None
        lo, hi = three("corner", lo), three("corner", hi)
        if any(a > b for a, b in zip(lo, hi, strict=True)):
            raise ValueError(f"expected lo <= hi, got {shown(value)}")
        return tuple(lo), tuple(hi)


class LegendKind(Choice):
    """A bool, or a place."""

    def __init__(self, *names: str):
        super().__init__(*names)
        self.expected = f"a bool or one of {', '.join(names)}"

    def _take(self, value: Any) -> Any:
        return value if isinstance(value, bool) else super()._take(value)


@read_only
@dataclass(frozen=True)
class Annotation(Fixed):
    """What is drawn into an image, or into each image of a sequence."""

    title: str = setting(WORDS, "", "title at the top")
    scale_bar: bool = setting(
        Switch(),
        False,
        "draw a bar of a round length, true at the distance "
        "of the camera's `look_at`. The length is 1, 2 or 5 times a power of ten, and true "
        "everywhere in an orthographic image",
    )
    axes: bool = setting(Switch(), False, "draw the directions of x, y and z")
    box: Any = setting(
        BoxKind(),
        False,
        "draw the bounding box of the particles' centers with "
        "coordinates along its edges. Of a sequence: of the frame that leads. Or its lowest and "
        "highest corner, two (3,), world. Parts of edges behind the surface are "
        "hidden",
    )
    unit: str = setting(WORDS, "", "unit of lengths for scale bar and box", label="Unit of lengths")
    time: float | None = setting(Number(), None, "time of the image, or of the first frame")
    time_step: float = setting(Number(), 0.0, "time from one frame of a sequence to the next")
    time_unit: str = setting(WORDS, "s", "unit of the time")
    step: int | None = setting(Whole(-(2**53), 2**53), None, "number of the image, or of the first frame; each adds 1")
    legend: bool | str = setting(
        LegendKind(*POSITIONS),
        False,
        "draw the color map and its range "
        "into the image. Or the legend's place: lower-right, lower-left, upper-right, upper-left, "
        "or outside, on a strip that takes a part of the image's width. True stands for "
        "lower-right, of several views for outside. Needs colors of values",
    )
    legend_title: str = setting(WORDS, "", "name of the values in the legend", usual="the name of what colors are by")
    legend_unit: str = setting(WORDS, "", "unit of the values in the legend")

    def _check(self) -> None:
        object.__setattr__(self, "box", check_all(self)["box"])

    def at(self, frame: int) -> Annotation:
        """The annotation of a sequence's frame, counted from 0."""
        time = None if self.time is None else self.time + frame * self.time_step
        return replace(self, time=time, step=None if self.step is None else self.step + frame)

    def for_views(self, n: int) -> Annotation:
        """The annotation of an image of n views, where a legend in a corner would cover one."""
        return replace(self, legend="outside") if n > 1 and self.legend is True else self

    @property
    def draws(self) -> bool:
        """Whether there is anything to draw."""
        words = (self.title, self.scale_bar, self.axes, self.box, self.legend)
        return any(words) or self.time is not None or self.step is not None


def traced_size(annotation: Annotation | None, size: tuple[int, int], several: bool = False) -> tuple[int, int]:
    """The size to trace for an annotated image of a size: without the strip of a legend, and
    without the header of several views.

    Raises ValueError for an image that is too small for annotations.
    """
    if annotation is None or not annotation.draws:
        return size
    strip = strip_width(size) if annotation.legend == "outside" else 0
    titled = annotation.title or annotation.time is not None or annotation.step is not None
    font, _, margin = sizes(min(size))
    header = round(2 * margin + _TITLE * font) if several and titled else 0
    if min(size[0] - strip, size[1] - header) < LEAST_SIDE:
        beside = " beside the legend" if strip else ""
        raise ValueError(
            f"size: expected at least {LEAST_SIDE} pixels a side{beside} for annotations, got {size[0]}x{size[1]}"
        )
    return size[0] - strip, size[1] - header


def bounds_of(scenes: Iterable[SceneBase]) -> tuple[np.ndarray, np.ndarray] | None:
    """Lowest and highest corner (3,) of the scenes' particles or meshes; None without any."""
    found = []
    for scene in scenes:
        try:
            owner: Any = getattr(scene, "particles", scene)  # a mesh has bounds of its own
            found.append(owner.bounds())
        except ValueError:  # no finite position
            continue
    if not found:
        return None
    return np.min([lo for lo, _ in found], axis=0), np.max([hi for _, hi in found], axis=0)


def origin_of(scenes: Sequence[SceneBase]) -> tuple[float, float, float]:
    """From where the places of an image's scenes are given, (x, y, z), world."""
    return getattr(scenes[0], "origin", None) or HERE


def skin_of(scenes: Iterable[SceneBase]) -> float:
    """How far a ray may run between a surface and the box of its particles' centers inside it,
    world units."""
    supports = [getattr(scene, "support", 0.0) for scene in scenes]  # a mesh has none
    widest = [float(np.max(to_host(support), initial=0.0)) for support in supports]
    return 1.5 * max((w for w in widest if math.isfinite(w)), default=0.0)


def drawing(
    annotation: Annotation,
    camera: Camera,
    scenes: Sequence[SceneBase],
    values: Sequence[Any] | None,
    size: tuple[int, int],
) -> Callable[[np.ndarray, Any], np.ndarray]:
    """A function of a frame's image and the frame that draws the annotation.

    Args:
        values: as `frame.values_of` gives them; a legend needs them.
        size: (width, height) of the annotated image.
    """
    if annotation.legend and values is None:
        raise ValueError("annotate: expected color_by beside a legend, got none")
    colors = None if values is None else Colors(*values[1:])
    bounds, skin = (bounds_of(scenes), skin_of(scenes)) if annotation.box else (None, 0.0)
    strip = size[0] - traced_size(annotation, size)[0]

    def draw(image: np.ndarray, frame: Any) -> np.ndarray:
        distance = frame.distance if annotation.box else None
        image = draw_view(image, annotation, camera, bounds, distance, skin, origin=origin_of(scenes), colors=colors)
        return draw_sheet(image, annotation, colors, strip)

    return draw


def room(annotation: Annotation | None) -> float:
    """By how much wider than its content a fitted image is, to have room for the annotation."""
    if annotation is None:
        return 1.0
    below = 0.1 if annotation.scale_bar else 0.0
    if annotation.box:
        return 1.25 + below
    above = annotation.title or annotation.time is not None or annotation.step is not None
    return 1.1 + below if above or below or annotation.axes else 1.0


def corners_to_fit(annotation: Annotation | None, scene: Any, around: Any = None) -> Any:
    """The points (M, 3), world, that a fitted image shows: those around, or the corners of the
    annotation's box; None stands for the particles."""
    if around is not None or annotation is None or not annotation.box:
        return around
    ends = bounds_of([scene]) if annotation.box is True else annotation.box
    if ends is None:
        return None
    return np.array([corner(np.asarray(ends), np.array(c)) for c in np.ndindex(2, 2, 2)])


def draw_view(
    image: np.ndarray,
    annotation: Annotation,
    camera: Camera,
    bounds: Any = None,
    distance: np.ndarray | None = None,
    skin: float = 0.0,
    name: str = "",
    scale: float = 1.0,
    origin: Any = HERE,
    colors: Colors | None = None,
) -> np.ndarray:
    """The image with box, axes, scale bar and the view's name.

    Args:
        image: (h, w, 3) or (h, w, 4) uint8.
        camera: of the image.
        bounds: corners (lo, hi) of the box where the annotation has none of its own.
        distance: (H, W) along the rays, world units, of the same view; hides edges behind.
        skin: what lies less than this behind the surface is not hidden, world units.
        name: of the view, for the upper right corner.
        scale: factor of all sizes.
        origin: (x, y, z), world, from which places are given.
        colors: of a legend that is drawn later; one of many kinds reaches from corner to corner.
    """
    canvas = Canvas(image, scale)
    box = annotation.box if not isinstance(annotation.box, bool) else bounds
    if annotation.box and box is not None:
        draw_box(canvas, camera, np.asarray(box, np.float64), distance, skin, annotation.unit, origin)
    if annotation.axes:
        high = annotation.legend == "upper-left" and colors is not None and colors.colormap in CATEGORICAL
        _draw_axes(canvas, camera, annotation.legend == "lower-left" or high)
    if annotation.scale_bar:
        free = annotation.legend in (False, "outside")
        _draw_scale_bar(canvas, camera, annotation.unit, free)
    if name:
        canvas.text((canvas.width - canvas.margin, canvas.margin), name, "ra")
    return canvas.pixels


def draw_sheet(
    image: np.ndarray,
    annotation: Annotation,
    colors: Colors | None = None,
    strip: int = 0,
    header: int = 0,
    scale: float = 1.0,
) -> np.ndarray:
    """The image with time and step, title and legend.

    `strip`, `header`: width added for the legend, height added for time and title, pixels.
    """
    canvas = Canvas(image, scale)
    if header:
        canvas.raise_by(header, (255, 255, 255))
    words = []
    if annotation.time is not None:
        words.append(f"t = {short(annotation.time)} {annotation.time_unit}".rstrip())
    if annotation.step is not None:
        words.append(f"step {annotation.step}")
    margin = canvas.margin
    canvas.text((margin, margin), ", ".join(words), "la")
    if annotation.title:
        size = round(_TITLE * canvas.font)
        used = canvas.text_width(", ".join(words)) + margin if words else 0.0
        title = canvas.shortened(annotation.title, canvas.width - 2 * (margin + used), size)
        # In the middle of the whole image, to which the legend's strip is added below.
        half = canvas.text_width(title, size) / 2
        middle = min((canvas.width + strip) / 2, canvas.width - margin - half)
        canvas.text((middle, margin), title, "ma", size)
    if not annotation.legend or colors is None:
        return canvas.pixels
    place = "lower-right" if annotation.legend is True else str(annotation.legend)
    label = annotation.legend_title or colors.name
    return draw_legend(
        canvas.pixels,
        colors.colormap,
        colors.lo,
        colors.hi,
        label,
        annotation.legend_unit,
        place,
        scale,
        strip,
        colors.kinds,
        round(_TITLE * canvas.text_height()) if (words or annotation.title) and not header else 0,
    )


def round_length(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above `most` > 0."""
    power = 10.0 ** math.floor(math.log10(most))
    return max((f * power for f in (1, 2, 5) if f * power <= most * (1 + 1e-9)), default=power)


def scale_bar(camera: Camera, size: tuple[int, int]) -> tuple[float, float]:
    """Length of the scale bar of an image of (width, height), in world units and in pixels."""
    high = camera.height
    if high is None:
        away = float(np.linalg.norm(np.subtract(camera.look_at, camera.eye)))
        high = 2 * away * math.tan(math.radians(camera.fov) / 2)
    unit = high / size[1]  # world units in a pixel
    length = round_length(_BAR * size[0] * unit)
    return length, length / unit


def _draw_scale_bar(canvas: Canvas, camera: Camera, unit: str, at_right: bool) -> None:
    length, pixels = scale_bar(camera, (canvas.width, canvas.height))
    left = canvas.width - canvas.margin - pixels if at_right else (canvas.width - pixels) / 2
    right, y, cap = left + pixels, canvas.height - canvas.margin, 0.35 * canvas.font
    inks = canvas.ink(left, y - 2 * canvas.font, right, y)
    ends = [[(x, y - cap), (x, y + cap)] for x in (left, right)]
    bar = [[(left, y), (right, y)]]
    canvas.lines([*ends, *bar], inks[1], 4 * canvas.line)
    canvas.lines(ends, inks[0], canvas.line)
    canvas.lines(bar, inks[0], 2 * canvas.line)
    text = f"{short(length)} {unit}".rstrip()
    canvas.text(((left + right) / 2, y - cap - 2 * canvas.line), text, "ms", inks=inks)


def _draw_axes(canvas: Canvas, camera: Camera, at_right: bool) -> None:
    """The directions of x, y and z in a lower corner, the nearest last."""
    _, forward, right, up = camera.frame((canvas.width, canvas.height))
    right, up = right / np.linalg.norm(right), up / np.linalg.norm(up)
    long = max(1.8 * canvas.font, _AXIS * canvas.side)
    x = canvas.margin + 1.4 * long
    start = np.array((canvas.width - x if at_right else x, canvas.height - x))
    flat = long * np.stack([right, -up], axis=1)  # (3, 2): an axis' way in the image
    for axis in np.argsort(-forward, kind="stable"):
        tip, name = start + flat[axis], "xyz"[axis]
        length = float(np.linalg.norm(flat[axis]))
        if length > 0.25 * long:
            ahead = flat[axis] / length
            aside = np.array((-ahead[1], ahead[0]))
            head = 0.22 * long
            neck = tip - head * ahead
            arrow = [tip, neck + 0.42 * head * aside, neck - 0.42 * head * aside]
            canvas.lines([[start, tip]], (255, 255, 255), 4 * canvas.line, 0.6)
            canvas.lines([[start, neck]], _COLORS[axis], 2 * canvas.line)
            canvas.lines([arrow], _COLORS[axis], filled=True)
            place = start + (length + 0.75 * canvas.font) * ahead
        else:  # towards the eye, or away from it
            place = start - 0.75 * canvas.font
            canvas.lines([_circle(start, 2.5 * canvas.line)], _COLORS[axis], filled=True)
        canvas.text((place[0], place[1]), name, "mm", inks=(_COLORS[axis], (255, 255, 255)))


def _circle(middle: np.ndarray, radius: float) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return middle + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
