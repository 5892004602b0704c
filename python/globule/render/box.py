"""The bounding box of an annotated image: edges, hidden where a surface is in front, and ticks."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from ..data.attributes import place_label
from .camera import Camera
from .canvas import Canvas, Color

_MOST_PIECES = 4000  # of an edge that are tested for being hidden


def draw_box(
    canvas: Canvas, camera: Camera, box: np.ndarray, distance: Any, skin: float, unit: str, origin: Any
) -> None:
    """Draw the box (2, 3), world; distance, skin, origin: as for `annotate.draw_view`; unit: of the
    ticks' coordinates."""
    size = (canvas.width, canvas.height)
    inks = canvas.ink(0, 0, *size)
    runs = []
    for axis, low in _edges():
        ends = np.stack([corner(box, low), corner(box, low + np.eye(3, dtype=int)[axis])])
        runs += visible_parts(ends, camera, size, distance, skin)
    canvas.lines(runs, inks[1], 3 * canvas.line, 0.45)
    canvas.lines(runs, inks[0], canvas.line)
    middle = camera.project(box.mean(axis=0)[None], size)[0]
    for axis in range(3):
        edge = _labelled_edge(box, axis, camera, size)
        if edge is not None and np.isfinite(middle).all():
            name = place_label("xyz"[axis], origin) + (f", {unit}" if unit else "")
            _draw_ticks(canvas, camera, edge, axis, middle, name, inks)


def _edges() -> list[tuple[int, np.ndarray]]:
    """Axis and lower end, as 0 and 1 along x, y and z, of the 12 edges of a box."""
    corners = [np.array((i >> 2 & 1, i >> 1 & 1, i & 1)) for i in range(8)]
    return [(axis, corner) for axis in range(3) for corner in corners if not corner[axis]]


def corner(box: np.ndarray, which: np.ndarray) -> np.ndarray:
    """The corner (3,) of a box (2, 3): the lower end where `which` (3,) is 0, the upper where 1."""
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
    part = _within(ends, camera, size)
    if part is None:
        return []
    ends = part
    line = camera.project(ends, size)
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


def _within(ends: np.ndarray, camera: Camera, size: tuple[int, int], around: float = 0.1) -> np.ndarray | None:
    """The part of a line (2, 3), world, that is in an image of (width, height) or near it; None
    without one. around: of the half size of the image, that still counts."""
    eye, forward, right, up = camera.frame(size)
    away = ends - eye
    ahead = away @ forward
    wide = (1 + around) * (ahead if camera.height is None else np.ones(2))
    least, most = 0.0, 1.0
    sides = [ahead - 1e-9 * np.abs(ahead).max()] if camera.height is None else []
    for axis in (right, up):
        place = away @ axis / (axis @ axis)
        sides += [wide - place, wide + place]
    for first, last in sides:  # a share counts where all of these are positive
        if first < 0 and last < 0:
            return None
        if first < 0:
            least = max(least, first / (first - last))
        elif last < 0:
            most = min(most, first / (first - last))
    return ends[0] + np.array([[least], [most]]) * (ends[1] - ends[0]) if least < most else None


def _without_short(seen: np.ndarray, what: bool, least: int) -> np.ndarray:
    """The same (N,) bool without runs of `what` that are shorter than `least`, except at the ends:
    a rough surface makes an edge in its skin appear and vanish from pixel to pixel."""
    seen = seen.copy()
    steps = np.flatnonzero(np.diff(seen)) + 1
    for first, last in pairwise(steps):
        if seen[first] == what and last - first < least:
            seen[first:last] = not what
    return seen


def _labelled_edge(box: np.ndarray, axis: int, camera: Camera, size: tuple[int, int]) -> np.ndarray | None:
    """Both ends (2, 3) of the edge along an axis that is on the outline of the box in the image:
    the lowest one, or the one most to the left where it is upright; None without one."""
    others = [a for a in range(3) if a != axis]
    best, found = -math.inf, None
    for sides in ((0, 0), (0, 1), (1, 0), (1, 1)):
        low = np.zeros(3, int)
        low[others] = sides
        ends = np.stack([corner(box, low), corner(box, low + np.eye(3, dtype=int)[axis])])
        middle = ends.mean(axis=0)
        towards = -camera.towards(middle[None])[0]
        facing = [(1 if side else -1) * towards[a] > 1e-6 for a, side in zip(others, sides, strict=True)]
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
    name: str,
    inks: tuple[Color, Color],
) -> None:
    """Ticks with coordinates along an edge (2, 3), and a name in their middle."""
    size, font = (canvas.width, canvas.height), canvas.font
    part = _within(ends, camera, size, 0.0)
    if part is None:
        return
    ends = part
    line = camera.project(ends, size)
    along = line[1] - line[0]
    length = float(np.linalg.norm(along))
    if not length >= 4 * font:
        return
    out = np.array((-along[1], along[0])) / length
    if out @ (line.mean(axis=0) - middle) < 0:
        out = -out
    lo, hi = float(ends[0, axis]), float(ends[1, axis])
    # Texts need room along the edge: their width where it is level, their height where upright.
    need = abs(along[0]) / length * 5.5 * font + abs(along[1]) / length * 2.2 * font
    values = round_values(lo, hi, max(2, int(length / need)))
    texts = [short(value) for value in values]
    points = np.repeat(ends[:1], len(values), axis=0)
    points[:, axis] = values
    places = camera.project(points, size)
    tick = 0.45 * font
    canvas.lines([[p, p + tick * out] for p in places], inks[0])
    anchor = ("l" if out[0] > 0.5 else "r" if out[0] < -0.5 else "m") + (
        "a" if out[1] > 0.5 else "d" if out[1] < -0.5 else "m"
    )
    for place, text in zip(places, texts, strict=True):
        canvas.text(tuple(place + 1.7 * tick * out), text, anchor, inks=inks, inside=True)
    widest = max((canvas.text_width(text) for text in texts), default=0.0)
    far = 2.6 * tick + abs(out[0]) * widest + abs(out[1]) * canvas.text_height()
    canvas.text(tuple(line.mean(axis=0) + far * out), name, anchor, inks=inks, inside=True)


def round_values(lo: float, hi: float, most: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten in [lo, hi], about `most` of them, at least 2."""
    if not hi > lo:
        return [lo]
    span = (hi - lo) / most
    power = 10.0 ** math.floor(math.log10(span))
    coarsest = next(f for f in (1, 2, 5, 10) if f * power >= span * (1 - 1e-9))
    for factor in (10, 5, 2, 1, 0.5, 0.2):
        step = factor * power
        first, last = math.ceil(lo / step - 1e-9), math.floor(hi / step + 1e-9)
        if factor <= coarsest and last > first:  # one value alone says nothing about the length
            break
    return [i * step for i in range(first, last + 1)]


def short(value: float) -> str:
    """A number with at most six digits."""
    return f"{value:.6g}"
