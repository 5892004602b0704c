"""N-wire phantoms: their definition, and their wires' echoes in images.

An N consists of two parallel wires and a diagonal one between them, in one plane. An image shows
three bright dots on a line; where the middle one lies between the outer ones says how far along the
diagonal the image cuts it (Pagoulatos et al. 2001).
"""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._base.files import atomic_write
from .._base.structured import parse_toml
from ..formats.asciinum import numbers_of_words
from ..formats.errors import bad, faults, shown
from ..formats.sweeps.transforms import parse_matrix
from ..formats.xml import parse_xml
from .region import Clip, checked_clip, region_mask

_MOST_DOTS = 20  # of an image, the brightest
_THRESHOLDS = (0.1, 0.2, 0.35, 0.5)  # of the image's largest value, until all wires are found
_LARGEST_DOT = 0.08  # of the image's diagonal
_DOT = 0.005  # of it: deviation of the weights that find a dot's middle
_STRETCH = 1.5  # most difference of scales in a cut through parallel wires
_RIGID = 0.01  # products of axes of a rotation may be off by so much: it was written with few digits
_NEAR = 0.12  # of the smallest distance between parallel wires: a dot is where it is expected


@dataclass(frozen=True, eq=False)
class NWirePhantom:
    """The wires of a phantom, mm, in the phantom's frame.

    names       (3K,) of the wires: of each N an outer, the diagonal and the other outer one
    wires       (3K, 2, 3): front and back end of each
    landmarks   points by name, for `register_landmarks`
    reference_from_phantom   (4, 4), or None if the phantom is not registered yet
    error       mm, of that registration; 0.5 if it is not known
    spacing     mm per pixel, about, or None
    clip        (column, row, width, height) in pixels: where dots are looked for, or None
    landmark_error   mm, of a landmark by that registration, as PLUS states it, or None
    """

    names: tuple[str, ...]
    wires: np.ndarray
    landmarks: dict[str, np.ndarray] = field(default_factory=dict)
    reference_from_phantom: np.ndarray | None = None
    error: float = 0.5
    spacing: float | None = None
    clip: Clip | None = None
    landmark_error: float | None = None

    def __post_init__(self) -> None:
        wires = np.asarray(self.wires, np.float64)
        if wires.ndim != 3 or wires.shape[1:] != (2, 3) or len(wires) % 3 or len(wires) < 6:
            expected = "(3K, 2, 3) for K >= 2 patterns of three wires"
            raise ValueError(f"wires: expected shape {expected}, got {wires.shape}")
        if not np.isfinite(wires).all() or (wires[:, 0] == wires[:, 1]).all(axis=1).any():
            raise ValueError("wires: expected finite, different ends, got others")
        object.__setattr__(self, "wires", wires)
        if self.clip is not None:
            object.__setattr__(self, "clip", checked_clip(self.clip))
        outer = wires[self.outer]
        along = outer[:, 1] - outer[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        if np.abs(along @ along[0]).min() < np.cos(np.radians(3)):
            raise ValueError("wires: expected the first and third wire of every N to be parallel")
        for name in ("error", "landmark_error"):
            size = getattr(self, name)
            if size is not None and not 0 <= size < np.inf:
                raise ValueError(f"{name}: expected millimeters from 0, got {size:g}")
        if self.reference_from_phantom is not None:
            _check_rigid("reference_from_phantom", self.reference_from_phantom)

    @property
    def outer(self) -> np.ndarray:
        """(2K,) indices of the parallel wires."""
        return np.flatnonzero(np.arange(len(self.wires)) % 3 != 1)

    def cut(self) -> np.ndarray:
        """(2K, 2) mm: where a plane across the parallel wires meets them."""
        outer = self.wires[self.outer]
        along = outer[0, 1] - outer[0, 0]
        along = along / np.linalg.norm(along)
        first = outer[1, 0] - outer[0, 0]
        first = first - along * (first @ along)
        first /= np.linalg.norm(first)
        return outer[:, 0] @ np.stack([first, np.cross(along, first)], axis=1)

    def middles(self, points: np.ndarray) -> np.ndarray:
        """(F, K, 3) mm, phantom: the diagonals' points of dots (F, 3K, 2), pixels."""
        found = []
        for k in range(0, len(self.wires), 3):
            left, middle, right = self.wires[k : k + 3]
            along = (left[1] - left[0]) / np.linalg.norm(left[1] - left[0])
            across = right[0] - left[0]
            across = across - along * (along @ across)
            width = np.linalg.norm(across)
            across /= width
            a, b, c = (points[:, k + i] for i in range(3))
            share = ((b - a) * (c - a)).sum(axis=1) / ((c - a) ** 2).sum(axis=1)
            first, last = ((end - left[0]) @ across for end in middle)
            found.append(middle[0] + ((share * width - first) / (last - first))[:, None]
                         * (middle[1] - middle[0]))  # fmt: skip
        return np.stack(found, axis=1)


def _check_rigid(name: str, matrix: np.ndarray) -> None:
    turn = np.asarray(matrix, np.float64)[:3, :3]
    if not np.isfinite(matrix).all() or not np.array_equal(matrix[3], (0, 0, 0, 1)):
        raise ValueError(f"{name}: expected finite numbers and 0 0 0 1 as the last row, got others")
    lengths = np.linalg.norm(turn, axis=0)
    if not np.allclose(turn.T @ turn, np.eye(3), atol=_RIGID) or np.linalg.det(turn) < 0:
        got = " x ".join(f"{length:.4g}" for length in lengths)
        got = f"axes of length {got}" if np.abs(lengths - 1).max() > _RIGID / 2 else "skew or left-handed axes"
        raise ValueError(f"{name}: expected a rotation and a shift in mm, got {got}")


class WirePoints(NamedTuple):
    """The dots of all wires in images.

    found    (F,) bool: all wires are seen
    points   (F, 3K, 2) column and row, NaN where not found
    dots     of every image the dots (n, 3): column, row, brightness
    """

    found: np.ndarray
    points: np.ndarray
    dots: list[np.ndarray]


def read_phantom(path: str | os.PathLike[str]) -> NWirePhantom:
    """Read the wires of a phantom: a PLUS configuration (.xml) or a table of our own (.toml).

    PLUS: <PhantomDefinition> with <Pattern Type="NWire"> or <NWire>, and <Landmarks>, and the transform from
    Phantom to Reference. TOML: `wires`, a list of patterns of three wires, each of two ends, mm;
    and, if known, `reference_from_phantom`, `error` (mm), `spacing` (mm per pixel), `clip` (pixels)
    and a table `landmarks` of points. Raises FormatError naming the element or key.
    """
    if os.fspath(path).lower().endswith(".toml"):
        return _read_toml(path)
    root = parse_xml(path, Path(path).read_bytes())
    names: list[str] = []
    wires: list[list[list[float]]] = []
    landmarks: dict[str, np.ndarray] = {}
    patterns = [pattern for pattern in root.iter("Pattern") if pattern.get("Type") == "NWire"]
    for pattern in [*patterns, *root.iter("NWire")]:  # the latter of older configurations
        of_pattern = list(pattern.iter("Wire"))
        if len(of_pattern) != 3:
            where = f"line {pattern.line}, Pattern"
            raise bad(path, where, f"expected 3 wires of an NWire, got {len(of_pattern)}")
        for wire in of_pattern:
            names.append(wire.get("Name") or str(len(names) + 1))
            ends = ("EndPointFront", "EndPointBack")
            wires.append([_point(path, wire, end) for end in ends])
    for mark in root.iter("Landmark"):
        landmarks[mark.get("Name") or str(len(landmarks) + 1)] = np.array(_point(path, mark, "Position"))
    matrix, error, landmark_error = None, 0.5, None
    for element in root.iter("Transform"):
        if (element.get("From"), element.get("To")) == ("Phantom", "Reference"):
            where = f"line {element.line}, Transform Phantom to Reference"
            with faults(path, where, "16 numbers"):
                matrix = parse_matrix(element.get("Matrix") or "")
                landmark_error = float(element.get("Error")) if element.get("Error") else None
                error = error if landmark_error is None else landmark_error
    segmentation = next(root.iter("Segmentation"), None)
    spacing = None
    if segmentation is not None and segmentation.get("ApproximateSpacingMmPerPixel"):
        try:
            spacing = float(segmentation.get("ApproximateSpacingMmPerPixel"))
        except ValueError:
            where = f"line {segmentation.line}, ApproximateSpacingMmPerPixel"
            raise bad(path, where, "expected a number, got another text") from None
    clip = None
    if segmentation is not None and segmentation.get("ClipRectangleSize"):
        words = (segmentation.get("ClipRectangleOrigin") or "0 0").split()
        words += segmentation.get("ClipRectangleSize").split()
        try:
            numbers = [float(word) for word in words]
            if len(numbers) == 4 and min(numbers[2:]) > 0:  # other sizes mean the whole image
                clip = checked_clip(numbers)
        except ValueError as problem:
            where = f"line {segmentation.line}, ClipRectangleSize"
            raise bad(path, where, f"expected numbers, got {problem}") from None
    if not wires:
        raise bad(path, "PhantomDefinition", 'expected <Pattern Type="NWire">, got none')
    return _checked(path, tuple(names), wires, landmarks, matrix, error, spacing, clip, landmark_error)


def write_phantom(path: str | os.PathLike[str], phantom: NWirePhantom) -> None:
    """Write a phantom as TOML; every number survives exactly."""
    lines = [f"names = {list(phantom.names)!r}", "wires = [  # outer, diagonal, outer: two ends, mm"]
    for pattern in phantom.wires.reshape(-1, 3, 2, 3).tolist():
        lines.append(f"  {pattern!r},")
    lines.append("]")
    if phantom.reference_from_phantom is not None:
        lines.append("reference_from_phantom = [")
        lines += [f"  {row!r}," for row in phantom.reference_from_phantom.tolist()]
        lines.append("]")
    lines.append(f"error = {float(phantom.error)!r}  # mm, of reference_from_phantom")
    if phantom.spacing is not None:
        lines.append(f"spacing = {float(phantom.spacing)!r}  # mm per pixel, about")
    if phantom.clip is not None:
        lines.append(f"clip = {list(phantom.clip)!r}  # column, row, width, height")
    if phantom.landmarks:
        lines += ["", "[landmarks]"]
        lines += [f'"{name}" = {point.tolist()!r}' for name, point in phantom.landmarks.items()]
    with atomic_write(path, "w") as file:
        file.write("\n".join(lines) + "\n")


def _read_toml(path: str | os.PathLike[str]) -> NWirePhantom:
    with faults(path, expected="TOML"):
        content = parse_toml(Path(path).read_text(encoding="utf-8"))
    keys = ("wires", "names", "landmarks", "reference_from_phantom", "error", "spacing", "clip")
    unknown = sorted(set(content) - set(keys))
    if unknown:
        raise bad(path, unknown[0], f"expected one of {', '.join(keys)}")
    try:
        wires = np.array(content.get("wires", []), np.float64)
        if wires.ndim != 4 or wires.shape[1:] != (3, 2, 3):
            expected = "a list of patterns, each of 3 wires of 2 ends [x, y, z]"
            raise bad(path, "wires", f"expected {expected}, got shape {wires.shape}")
        n = 3 * len(wires)
        names = tuple(content.get("names", map(str, range(1, n + 1))))
        if len(names) != n:
            raise bad(path, "names", f"expected {n}, got {len(names)}")
        marks = {k: np.array(v, np.float64) for k, v in content.get("landmarks", {}).items()}
        matrix = content.get("reference_from_phantom")
        matrix = None if matrix is None else np.array(matrix, np.float64).reshape(4, 4)
        registered, spacing = content.get("error", 0.5), content.get("spacing")
    except (TypeError, ValueError) as problem:
        if "expected" in str(problem):
            raise
        raise bad(path, "", f"expected numbers, got {problem}") from None
    clip = content.get("clip")
    return _checked(path, names, wires.reshape(n, 2, 3), marks, matrix, registered, spacing, clip)


def _checked(path: Any, *values: Any) -> NWirePhantom:
    with faults(path):
        return NWirePhantom(*values)


def _point(path: Any, element: Any, name: str) -> list[float]:
    text = element.get(name) or ""
    values = numbers_of_words(text.split()).tolist()
    if len(values) != 3 or not np.isfinite(values).all():
        raise bad(path, f"line {element.line}, {name}", f"expected 3 numbers, got {shown(text)}")
    return values


# Dots


def find_dots(image: np.ndarray, threshold: float = _THRESHOLDS[0]) -> np.ndarray:
    """The bright dots of an image (H, W): (n, 3) column, row, summed value; brightest first.

    A dot is a connected region (8 neighbors) above a threshold, a share of the largest value; its
    place is the center of its values. Regions longer than 8 % of the image's diagonal are no dots.
    """
    from scipy import ndimage

    bright = image > threshold * float(image.max(initial=0))
    label, n = ndimage.label(bright, np.ones((3, 3)))
    if not n:
        return np.zeros((0, 3))
    rows, columns = np.nonzero(bright)
    which, values = label[rows, columns] - 1, image[rows, columns].astype(np.float64)
    total, *sums = (np.bincount(which, v) for v in (values, values * columns, values * rows))
    dots = np.column_stack([*(s / total for s in sums), total])
    boxes = ndimage.find_objects(label)
    extent = np.array([max(side.stop - side.start - 1 for side in box) for box in boxes])
    dots = dots[extent < _LARGEST_DOT * np.hypot(*image.shape)]
    return dots[np.argsort(-dots[:, 2], kind="stable")][:_MOST_DOTS]


# Which dot is which wire


def find_wires(frames: Any, phantom: NWirePhantom) -> list[WirePoints]:
    """Find the dots of all wires in images (F, H, W).

    A plane cuts the parallel wires in points that are an affine image of their places across
    (`NWirePhantom.cut`). Every three dots are tried as three of these wires; the other ones must
    then have a dot where they are expected, and every diagonal one between its outer two. Returns
    one answer for each of the eight ways in which the pattern may be turned or mirrored in the
    image and was found, the one seen in most images first, then the one that fits best: a
    symmetric phantom looks the same in several ways, and only the poses tell (see
    `calibrate_n_wires`).
    """
    frames = np.asarray(frames)
    dots = []
    ways: dict[int, dict[int, tuple[float, np.ndarray]]] = {}
    outside = None
    if phantom.clip is not None:
        inside = region_mask(frames.shape[1:], phantom.clip, None, None)
        outside = None if inside is None else ~inside
    for i, frame in enumerate(frames):
        if outside is not None:
            frame = np.where(outside, 0, frame)
        of_frame, matches = _seen(frame, phantom)
        dots.append(of_frame)
        for way, (error, where) in matches.items():
            ways.setdefault(way, {})[i] = error, _middle_of_dots(frame, where)
    answers = []
    for of_way in ways.values():
        points = np.full((len(frames), len(phantom.wires), 2), np.nan)
        for i, (_, where) in of_way.items():
            points[i] = where
        error = float(np.median([error for error, _ in of_way.values()]))
        seen = np.isfinite(points).all(axis=(1, 2))
        answers.append((-len(of_way), error, WirePoints(seen, points, dots)))
    answers.sort(key=lambda answer: answer[:2])
    if not answers:
        seen = np.zeros(len(frames), bool)
        nothing = np.full((len(frames), len(phantom.wires), 2), np.nan)
        return [WirePoints(seen, nothing, dots)]
    return [answer for _, _, answer in answers]


def _seen(image: np.ndarray, phantom: NWirePhantom) -> tuple[np.ndarray, dict[int, Any]]:
    """Dots of an image, and the wires among them: of the image as it is, and if there are not all,
    of what is brighter than its surroundings, each by higher and higher thresholds."""
    first = None
    for flat in (False, True):
        shown = _above_surroundings(image) if flat else image
        for threshold in _THRESHOLDS:
            dots = find_dots(shown, threshold)
            first = dots if first is None else first
            matches = _matches(dots[:, :2], phantom)
            if matches:
                return dots, matches
    assert first is not None  # there are thresholds
    return first, {}


def _middle_of_dots(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Places (n, 2) of the bright middles of dots: the mean of what is near, by Gaussian weights
    around it. A dot's tail, or a reflection that touches it, then hardly pulls."""
    size = max(_DOT * np.hypot(*image.shape), 1.0)
    reach = np.arange(-int(3 * size) - 1, int(3 * size) + 2)
    found = places
    for _ in range(8):
        columns, rows = np.rint(found).astype(int).T[:, :, None] + reach
        inside = [np.clip(i, 0, n - 1) for i, n in ((columns, image.shape[1]), (rows, image.shape[0]))]
        x, y = (np.exp(-0.5 * ((i - at[:, None]) / size) ** 2)
                for i, at in ((columns, found[:, 0]), (rows, found[:, 1])))  # fmt: skip
        light = image[inside[1][:, :, None], inside[0][:, None, :]] * y[:, :, None] * x[:, None, :]
        total = light.sum(axis=(1, 2))
        moved = np.stack([np.einsum("nyx,nx->n", light, inside[0]), np.einsum("nyx,ny->n", light, inside[1])], 1)
        found = np.where(total[:, None] > 0, moved / np.maximum(total, 1e-12)[:, None], found)
    return found


def _above_surroundings(image: np.ndarray) -> np.ndarray:
    """A mean over 3x3 pixels less that over a fifteenth of the smaller side."""
    from scipy.ndimage import uniform_filter

    sides = 3, 2 * max(2, min(image.shape) // 30) + 1
    small, large = (uniform_filter(image.astype(np.float64), n, mode="nearest") for n in sides)
    return np.maximum(small - large, 0)


def _matches(dots: np.ndarray, phantom: NWirePhantom) -> dict[int, tuple[float, np.ndarray]]:
    """For each way the best error, pixels, and the wires' places (3K, 2)."""
    cut = phantom.cut()
    if len(dots) < len(phantom.wires):
        return {}
    basis = max(itertools.combinations(range(len(cut)), 3), key=lambda t: _area(cut[list(t)]))
    rest = [i for i in range(len(cut)) if i not in basis]
    chosen = np.array(list(itertools.permutations(range(len(dots)), 3)))
    corner = dots[chosen]  # (h, 3, 2)
    across = np.stack([cut[basis[1]] - cut[basis[0]], cut[basis[2]] - cut[basis[0]]], axis=1)
    seen = np.stack([corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]], axis=2)
    linear = seen @ np.linalg.inv(across)  # (h, 2, 2) pixels per mm
    a, b, c, d = (linear[:, i, j] for i in (0, 1) for j in (0, 1))
    half, det = (a * a + b * b + c * c + d * d) / 2, a * d - b * c
    root = np.sqrt(np.maximum(half**2 - det**2, 0))
    large, small = np.sqrt(half + root), np.sqrt(np.maximum(half - root, 0))
    good = (small > 0) & (large < _STRETCH * small)
    if phantom.spacing is not None:
        scale = np.sqrt(np.abs(det)) * phantom.spacing
        good &= (scale > 0.75) & (scale < 1.4)
    chosen, corner, linear, small = chosen[good], corner[good], linear[good], small[good]
    nearest = min(float(np.linalg.norm(p - q)) for p, q in itertools.combinations(cut, 2))
    near = _NEAR * nearest * small  # (h,) pixels
    expected = corner[:, :1] + np.einsum("hij,mj->hmi", linear, cut[rest] - cut[basis[0]])
    apart = np.linalg.norm(expected[:, :, None] - dots, axis=3)  # (h, m, n)
    which = apart.argmin(axis=2)
    off = np.take_along_axis(apart, which[:, :, None], axis=2)[:, :, 0]
    good = (off < near[:, None]).all(axis=1)
    best: dict[int, tuple[float, np.ndarray]] = {}
    for h in np.flatnonzero(good):
        place = np.empty(len(cut), int)
        place[list(basis)], place[rest] = chosen[h], which[h]
        if len(set(place.tolist())) < len(place):
            continue
        middle = _middles(dots, place, float(near[h]))
        if middle is None:
            continue
        error = float(np.sqrt((off[h] ** 2).sum() + (middle[1] ** 2).sum()))
        way = int(np.rint(np.arctan2(linear[h, 1, 0], linear[h, 0, 0]) / (np.pi / 2))) % 4
        way += 4 * int(np.linalg.det(linear[h]) < 0)
        if way not in best or error < best[way][0]:
            points = np.empty((len(phantom.wires), 2))
            points[phantom.outer], points[1::3] = dots[place], dots[middle[0]]
            best[way] = error, points
    return best


def _middles(dots: np.ndarray, place: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Of each pattern the brightest dot on the line between its outer two, and how far off."""
    free = np.setdiff1d(np.arange(len(dots)), place)
    if len(free) < len(place) // 2:
        return None
    taken, off = [], []
    for left, right in place.reshape(-1, 2):
        line = dots[right] - dots[left]
        length = float(np.linalg.norm(line))
        from_left = dots[free] - dots[left]
        share = from_left @ line / length**2
        beside = np.abs(from_left[:, 0] * line[1] - from_left[:, 1] * line[0]) / length
        beside[(share < 0.02) | (share > 0.98)] = np.inf
        on_line = np.flatnonzero(beside < near)
        if not len(on_line) or free[on_line[0]] in taken:
            return None
        i = on_line[0]  # the brightest
        taken.append(free[i])
        off.append(beside[i])
    return np.array(taken), np.array(off)


def _area(corners: np.ndarray) -> float:
    (a, b), (c, d) = corners[1] - corners[0], corners[2] - corners[0]
    return float(abs(a * d - b * c))
