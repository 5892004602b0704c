"""Annotations of an image: scale bar, axes, bounding box with ticks, time and step, title, legend.

`draw_view` draws what belongs to a camera, `draw_sheet` what belongs to the whole image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .._base.arrays import to_host
from .._base.checks import flag, number, shown, three, whole
from .._base.fixed import Fixed, read_only
from ..scene.scene import Scene
from .camera import Camera
from .canvas import LEAST_SIDE, Canvas, Color, sizes
from .legend import POSITIONS, draw_legend, strip_width

_TITLE = 1.35  # sizes of text
_BAR = 0.25  # longest scale bar, of the image's width
_AXIS = 0.065  # length of the triad's axes, of the image's shorter side
_COLORS: tuple[Color, ...] = ((214, 66, 56), (52, 150, 72), (58, 104, 214))  # of x, y and z
_MOST_PIECES = 4000  # of an edge that are tested for being hidden


class Colors(NamedTuple):
    """What a legend shows: color map, values of its first and last color, name of the values."""

    colormap: str
    lo: float
    hi: float
    name: str


@read_only
@dataclass(frozen=True)
class Annotation(Fixed):
    """What is drawn into an image, or into each image of a sequence.

    Args:
        title: text at the top.
        scale_bar: whether to draw a bar of a round length: 1, 2 or 5 times a power of ten. The bar
            is true everywhere in an orthographic image. In a perspective image it is true at the
            distance of the camera's `look_at`.
        axes: whether to draw the directions of x, y and z.
        box: True, the bounding box of the particles' centers (of a sequence: of the first frame),
            or its lowest and highest corner, two (3,), world. Edges have ticks with coordinates.
            Parts of edges behind the surface are hidden.
        unit: of world coordinates, for scale bar and box, such as "m".
        time: of the image, or of a sequence's first frame.
        time_step: from one frame of a sequence to the next.
        time_unit: of both.
        step: number of the image, or of a sequence's first frame; each frame adds 1.
        legend: True, or the legend's place: lower-right, lower-left, upper-right, upper-left, or
            outside, on a strip that takes a part of the image's width. True stands for lower-right,
            of several views for outside. Needs colors of values.
        legend_title: name of the values; default: the name after `color_by`.
        legend_unit: unit of the values.

    Raises TypeError and ValueError naming the field, the expected and the given value.
    """

    title: str = ""
    scale_bar: bool = False
    axes: bool = False
    box: Any = False
    unit: str = ""
    time: float | None = None
    time_step: float = 0.0
    time_unit: str = "s"
    step: int | None = None
    legend: bool | str = False
    legend_title: str = ""
    legend_unit: str = ""

    def _check(self) -> None:
        for name in ("title", "unit", "time_unit", "legend_title", "legend_unit"):
            if not isinstance(getattr(self, name), str):
                raise TypeError(f"{name}: expected text, got {shown(getattr(self, name))}")
        flag("scale_bar", self.scale_bar)
        flag("axes", self.axes)
        if not isinstance(self.box, bool):
            try:
                lo, hi = self.box
            except (TypeError, ValueError):
                raise TypeError(
                    f"box: expected a bool or (lo, hi), got {shown(self.box)}"
                ) from None
            lo, hi = three("box", lo), three("box", hi)
            if any(a > b for a, b in zip(lo, hi, strict=True)):
                raise ValueError(f"box: expected lo <= hi, got {shown(self.box)}")
            object.__setattr__(self, "box", (tuple(lo), tuple(hi)))
        if self.time is not None:
            number("time", self.time)
        number("time_step", self.time_step)
        if self.step is not None:
            whole("step", self.step, -(2**53), 2**53)
        if not isinstance(self.legend, bool) and self.legend not in POSITIONS:
            known = ", ".join(POSITIONS)
            raise ValueError(f"legend: expected a bool or one of {known}, got {shown(self.legend)}")

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


def traced_size(
    annotation: Annotation | None, size: tuple[int, int], several: bool = False
) -> tuple[int, int]:
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
            f"size: expected at least {LEAST_SIDE} pixels a side{beside} for annotations, "
            f"got {size[0]}x{size[1]}"
        )
    return size[0] - strip, size[1] - header


def bounds_of(scenes: Iterable[Scene]) -> tuple[np.ndarray, np.ndarray] | None:
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


def skin_of(scenes: Iterable[Scene]) -> float:
    """How far a ray may run between a surface and the box of its particles' centers inside it,
    world units."""
    supports = [getattr(scene, "support", 0.0) for scene in scenes]  # a mesh has none
    widest = [float(np.max(to_host(support), initial=0.0)) for support in supports]
    return 1.5 * max((w for w in widest if math.isfinite(w)), default=0.0)


def drawing(
    annotation: Annotation,
    camera: Camera,
    scenes: Sequence[Scene],
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
        image = draw_view(image, annotation, camera, bounds, distance, skin)
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


def corners_to_fit(annotation: Annotation | None, scene: Scene, around: Any = None) -> Any:
    """The points (M, 3), world, that a fitted image shows: those around, or the corners of the
    annotation's box; None stands for the particles."""
    if around is not None or annotation is None or not annotation.box:
        return around
    ends = bounds_of([scene]) if annotation.box is True else annotation.box
    if ends is None:
        return None
    return np.array([_corner(np.asarray(ends), np.array(c)) for c in np.ndindex(2, 2, 2)])


def draw_view(
    image: np.ndarray,
    annotation: Annotation,
    camera: Camera,
    bounds: Any = None,
    distance: np.ndarray | None = None,
    skin: float = 0.0,
    name: str = "",
    scale: float = 1.0,
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
    """
    canvas = Canvas(image, scale)
    box = annotation.box if not isinstance(annotation.box, bool) else bounds
    if annotation.box and box is not None:
        _draw_box(canvas, camera, np.asarray(box, np.float64), distance, skin, annotation.unit)
    if annotation.axes:
        _draw_axes(canvas, camera, annotation.legend == "lower-left")
    if annotation.scale_bar:
        free = annotation.legend not in (True, "lower-right", "lower-left")
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
        words.append(f"t = {_round(annotation.time)} {annotation.time_unit}".rstrip())
    if annotation.step is not None:
        words.append(f"step {annotation.step}")
    margin = canvas.margin
    canvas.text((margin, margin), ", ".join(words), "la")
    if annotation.title:
        size = round(_TITLE * canvas.font)
        used = canvas.text_width(", ".join(words)) + margin if words else 0.0
        title = canvas.shortened(annotation.title, canvas.width - 2 * (margin + used), size)
        canvas.text((canvas.width / 2, margin), title, "ma", size)
    if not annotation.legend or colors is None:
        return canvas.pixels
    place = "lower-right" if annotation.legend is True else str(annotation.legend)
    label = annotation.legend_title or colors.name
    return draw_legend(
        canvas.pixels, colors.colormap, colors.lo, colors.hi, label, annotation.legend_unit, place,
        scale, strip,
    )  # fmt: skip


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
    text = f"{_round(length)} {unit}".rstrip()
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


# The box


def _draw_box(
    canvas: Canvas, camera: Camera, box: np.ndarray, distance: Any, skin: float, unit: str
) -> None:
    size = (canvas.width, canvas.height)
    inks = canvas.ink(0, 0, *size)
    runs = []
    for axis, low in _edges():
        ends = np.stack([_corner(box, low), _corner(box, low + np.eye(3, dtype=int)[axis])])
        runs += visible_parts(ends, camera, size, distance, skin)
    canvas.lines(runs, inks[1], 3 * canvas.line, 0.45)
    canvas.lines(runs, inks[0], canvas.line)
    middle = camera.project(box.mean(axis=0)[None], size)[0]
    for axis in range(3):
        edge = _labelled_edge(box, axis, camera, size)
        if edge is not None and np.isfinite(middle).all():
            _draw_ticks(canvas, camera, edge, axis, middle, unit, inks)


def _edges() -> list[tuple[int, np.ndarray]]:
    """Axis and lower end, as 0 and 1 along x, y and z, of the 12 edges of a box."""
    corners = [np.array((i >> 2 & 1, i >> 1 & 1, i & 1)) for i in range(8)]
    return [(axis, corner) for axis in range(3) for corner in corners if not corner[axis]]


def _corner(box: np.ndarray, which: np.ndarray) -> np.ndarray:
    return np.where(which, box[1], box[0])


def visible_parts(
    ends: np.ndarray, camera: Camera, size: tuple[int, int], distance: Any, skin: float = 0.0
) -> list[np.ndarray]:
    """The parts of a line (2, 3), world, that no surface hides, as pixels (2, 2) each.

    Args:
        size: (width, height) of the image in which the pixels count.
        distance: (H, W) along the rays, world units, perhaps of another resolution; None: nothing
            hides.
        skin: what lies less than this behind the surface is not hidden, world units.
    """
    line = camera.project(ends, size)
    if not np.isfinite(line).all():  # an end is behind the eye
        n = _MOST_PIECES
    else:
        n = int(np.clip(np.ceil(np.linalg.norm(line[1] - line[0])), 1, _MOST_PIECES))
    shares = (np.arange(n) + 0.5) / n
    points = ends[0] + shares[:, None] * (ends[1] - ends[0])
    pixels = camera.project(points, size)
    seen = np.isfinite(pixels).all(axis=1)
    if distance is not None:
        height, width = distance.shape
        with np.errstate(invalid="ignore"):
            at = np.floor(pixels * (width / size[0], height / size[1]))
        inside = seen & ((at >= 0) & (at < (width, height))).all(axis=1)
        column, row = at[inside].astype(int).T
        seen[inside] = camera.along(points[inside]) <= distance[row, column] + skin
    seen = _without_short(_without_short(seen, False, 8), True, 4)
    steps = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(int)))
    parts = []
    for first, last in steps.reshape(-1, 2):
        if last - first > 1:
            parts.append(pixels[[first, last - 1]])
        elif n == 1:
            parts.append(line)
    return parts


def _without_short(seen: np.ndarray, what: bool, least: int) -> np.ndarray:
    """The same (N,) bool without runs of `what` that are shorter than `least`, except at the ends:
    a rough surface makes an edge in its skin appear and vanish from pixel to pixel."""
    seen = seen.copy()
    steps = np.flatnonzero(np.diff(seen)) + 1
    for first, last in pairwise(steps):
        if seen[first] == what and last - first < least:
            seen[first:last] = not what
    return seen


def _labelled_edge(
    box: np.ndarray, axis: int, camera: Camera, size: tuple[int, int]
) -> np.ndarray | None:
    """Both ends (2, 3) of the edge along an axis that is on the outline of the box in the image:
    the lowest one, or the one most to the left where it is upright; None without one."""
    others = [a for a in range(3) if a != axis]
    best, found = -math.inf, None
    for sides in ((0, 0), (0, 1), (1, 0), (1, 1)):
        low = np.zeros(3, int)
        low[others] = sides
        ends = np.stack([_corner(box, low), _corner(box, low + np.eye(3, dtype=int)[axis])])
        middle = ends.mean(axis=0)
        towards = -camera.towards(middle[None])[0]
        facing = [
            (1 if side else -1) * towards[a] > 1e-6 for a, side in zip(others, sides, strict=True)
        ]
        line = camera.project(ends, size)
        if facing[0] == facing[1] or not np.isfinite(line).all():
            continue
        across, down = np.abs(line[1] - line[0])
        score = -line[:, 0].mean() if down > 2 * across else line[:, 1].mean() + size[1] * 10
        if score > best:
            best, found = score, ends
    return found


def _draw_ticks(
    canvas: Canvas,
    camera: Camera,
    ends: np.ndarray,
    axis: int,
    middle: np.ndarray,
    unit: str,
    inks: tuple[Color, Color],
) -> None:
    """Ticks with coordinates along an edge (2, 3), and the name of the axis."""
    size, font = (canvas.width, canvas.height), canvas.font
    line = camera.project(ends, size)
    along = line[1] - line[0]
    length = float(np.linalg.norm(along))
    if length < 4 * font:
        return
    out = np.array((-along[1], along[0])) / length
    if out @ (line.mean(axis=0) - middle) < 0:
        out = -out
    lo, hi = float(ends[0, axis]), float(ends[1, axis])
    # Texts need room along the edge: their width where it is level, their height where upright.
    need = abs(along[0]) / length * 5.5 * font + abs(along[1]) / length * 2.2 * font
    values = round_values(lo, hi, max(2, int(length / need)))
    texts = [_round(value) for value in values]
    points = np.repeat(ends[:1], len(values), axis=0)
    points[:, axis] = values
    places = camera.project(points, size)
    tick = 0.45 * font
    canvas.lines([[p, p + tick * out] for p in places], inks[0])
    anchor = ("l" if out[0] > 0.5 else "r" if out[0] < -0.5 else "m") + (
        "a" if out[1] > 0.5 else "d" if out[1] < -0.5 else "m"
    )
    for place, text in zip(places, texts, strict=True):
        canvas.text(tuple(place + 1.7 * tick * out), text, anchor, inks=inks)
    widest = max((canvas.text_width(text) for text in texts), default=0.0)
    far = 2.6 * tick + abs(out[0]) * widest + abs(out[1]) * canvas.text_height()
    name = "xyz"[axis] + (f", {unit}" if unit else "")
    canvas.text(tuple(line.mean(axis=0) + far * out), name, anchor, inks=inks)


def round_values(lo: float, hi: float, most: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten in [lo, hi], about `most` of them at most."""
    if not hi > lo:
        return [lo]
    span = (hi - lo) / most
    power = 10.0 ** math.floor(math.log10(span))
    step = next(f * power for f in (1, 2, 5, 10) if f * power >= span * (1 - 1e-9))
    first, last = math.ceil(lo / step - 1e-9), math.floor(hi / step + 1e-9)
    return [i * step for i in range(first, last + 1)]


def _round(value: float) -> str:
    """A number with at most six digits."""
    return f"{value:.6g}"
