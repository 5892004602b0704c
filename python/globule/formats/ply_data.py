"""The rows of a PLY file's elements: columns of scalar properties, and the corners of faces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .asciinum import cast, end_of_tokens, parse_numbers
from .errors import FormatError, bad

_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class Element:
    """An element of the header: so many rows of these properties."""

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)  # name, type, length type

    @property
    def has_lists(self) -> bool:
        """Whether a property is a list, as the corners of a face are."""
        return any(length for _, _, length in self.properties)


def read_columns(
    path: Any, data: bytes, position: int, element: Element, order: str
) -> tuple[dict[str, np.ndarray], int]:
    """The element's scalar properties and the position behind it."""
    n, properties = element.count, element.properties
    names = [name for name, _, _ in properties]
    if len(set(names)) < len(names) or (n and not names):
        raise bad(path, f"element {element.name}", "expected properties of different names")

    def short(got: int) -> FormatError:
        return bad(path, f"element {element.name}", f"expected {n} rows of data, got {got}")

    if not order and not element.has_lists:
        total = n * len(properties)
        end = end_of_tokens(data, position, total) if 2 * total <= len(data) - position + 1 else -1
        if end < 0:
            raise short(len(data[position:].split()) // len(properties))
        try:
            numbers = parse_numbers(data[position:end], np.dtype(np.float64))
            rows = numbers.reshape(n, len(names))
        except ValueError:
            problem = "expected numbers, got other text"
            raise bad(path, f"element {element.name}", problem) from None
        columns = [_cast(path, element, p[0], rows[:, i], p[1]) for i, p in enumerate(properties)]
        return dict(zip(names, columns, strict=True)), end
    if order and not element.has_lists:
        row = np.dtype([(f"f{i}", order + kind) for i, (_, kind, _) in enumerate(properties)])
        if n * row.itemsize > len(data) - position:
            raise short((len(data) - position) // row.itemsize)
        rows = np.frombuffer(data, row, n, position)
        columns = [rows[f"f{i}"].astype(kind) for i, (_, kind, _) in enumerate(properties)]
        return dict(zip(names, columns, strict=True)), position + n * row.itemsize
    return _columns_with_lists(path, data, position, element, order)


def _cast(path: Any, element: Element, name: str, values: np.ndarray, kind: str) -> np.ndarray:
    try:
        return cast(values, np.dtype(kind))
    except ValueError as error:
        where = f"element {element.name}, property {name}"
        raise bad(path, where, f"expected numbers of type {np.dtype(kind)}, {error}") from None


def _columns_with_lists(
    path: Any,
    data: bytes,
    position: int,
    element: Element,
    order: str,
    lists: dict[str, list[list[float]]] | None = None,
) -> tuple[dict[str, np.ndarray], int]:
    """Row by row, since lists make rows of different lengths; rare before or in vertices.

    The list properties that `lists` names are appended to it.
    """
    lists = lists or {}
    scalars = {name: kind for name, kind, length in element.properties if not length}
    kept: dict[str, list[float]] = {name: [] for name in scalars}
    for row in range(element.count):
        try:
            if not order:
                while data[position : position + 1].isspace():  # the end of the line before
                    position += 1
                end = data.find(b"\n", position)
                words = data[position : end if end >= 0 else len(data)].split()
                position = end + 1 if end >= 0 else len(data)
                at = 0
            for name, kind, length in element.properties:
                if not order:
                    begin, size = at, int(words[at]) if length else 0
                    if size < 0:
                        raise ValueError
                    at += 1 + size
                    if not length:
                        kept[name].append(float(words[begin]))
                    elif name in lists:
                        lists[name].append([float(word) for word in words[begin + 1 : at]])
                    continue
                size = 1
                if length:
                    (size,) = np.frombuffer(data, order + length, 1, position).tolist()
                    position += np.dtype(length).itemsize
                if not 0 <= size <= len(data):
                    raise ValueError
                values = np.frombuffer(data, order + kind, int(size), position)
                position += values.nbytes
                if not length:
                    kept[name].append(values[0].item())
                elif name in lists:
                    lists[name].append(values.tolist())
            if not order and at != len(words):
                raise ValueError
        except (ValueError, IndexError):
            where = f"element {element.name}, row {row}"
            problem = "expected the properties that the header lists, got other data"
            raise bad(path, where, problem) from None
    columns = {name: _cast(path, element, name, np.array(v, np.float64), scalars[name]) for name, v in kept.items()}
    return columns, position


def read_faces(path: Any, data: bytes, position: int, element: Element, order: str) -> tuple[np.ndarray | None, int]:
    """Triangles (F, 3) int64, polygons cut into fans, and the position behind the element.

    None for the triangles if no property lists corners.
    """
    name = next((p[0] for p in element.properties if p[0] in _CORNERS and p[2]), None)
    if name is None:
        return None, read_columns(path, data, position, element, order)[1]
    found = _equal_faces(data, position, element, order, name) if order else None
    if found is not None:
        polygons, position = found
        return _fans(_cast(path, element, name, polygons, "i8")), position
    lists: dict[str, list[list[float]]] = {name: []}
    _, position = _columns_with_lists(path, data, position, element, order, lists)
    by_size: dict[int, list[list[float]]] = {}
    for corners in lists[name]:
        by_size.setdefault(len(corners), []).append(corners)
    equal = [np.array(same, np.float64) for size, same in by_size.items() if size > 2]
    fans = [_fans(_cast(path, element, name, corners, "i8")) for corners in equal]
    return np.concatenate([np.empty((0, 3), np.int64), *fans]), position


def read_strips(path: Any, data: bytes, position: int, element: Element, order: str) -> tuple[np.ndarray | None, int]:
    """As `read_faces`, of strips of triangles in each of which -1 begins another strip."""
    name = next((p[0] for p in element.properties if p[0] in _CORNERS and p[2]), None)
    if name is None:
        return None, read_columns(path, data, position, element, order)[1]
    lists: dict[str, list[list[float]]] = {name: []}
    _, position = _columns_with_lists(path, data, position, element, order, lists)
    found = [np.empty((0, 3), np.int64)]
    for one in lists[name]:
        corners = _cast(path, element, name, np.array(one, np.float64), "i8")
        three = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1) if len(corners) > 2 else found[0]
        begins = np.where(corners < 0, np.arange(len(corners)) + 1, 0)
        odd = (np.arange(len(three)) - np.maximum.accumulate(begins)[: len(three)]) % 2 == 1
        three[odd] = three[odd][:, [1, 0, 2]]
        apart = (three[:, 0] != three[:, 1]) & (three[:, 1] != three[:, 2]) & (three[:, 0] != three[:, 2])
        found.append(three[apart & (three >= 0).all(axis=1)])
    return np.concatenate(found), position


def _equal_faces(data: bytes, position: int, element: Element, order: str, name: str) -> tuple[np.ndarray, int] | None:
    """Binary faces (F, k) that all have as many corners as the first, or None. This is the usual
    case, and a thousand times faster than row by row."""
    fields: list[Any] = []
    at = position
    for i, (_, kind, length) in enumerate(element.properties):
        size = 1
        if length:
            count = np.dtype(order + length)
            if at + count.itemsize > len(data):
                return None
            size = int(np.frombuffer(data, count, 1, at)[0])
            fields.append((f"n{i}", count))
            at += count.itemsize
        if not 0 <= size <= 255:
            return None
        fields.append((f"f{i}", order + kind, (size,)))
        at += np.dtype(kind).itemsize * size
    row = np.dtype(fields)
    if element.count * row.itemsize > len(data) - position:
        return None
    rows = np.frombuffer(data, row, element.count, position)
    lengths = [rows[label] for label, *_ in fields if label.startswith("n")]
    if any((length != length[0]).any() for length in lengths):
        return None
    which = [p[0] for p in element.properties].index(name)
    return rows[f"f{which}"], position + rows.nbytes


def _fans(polygons: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) of polygons (P, k) int64, all from each polygon's first corner."""
    fans = [polygons[:, [0, i, i + 1]] for i in range(1, polygons.shape[1] - 1)]
    return np.concatenate([np.empty((0, 3), np.int64), *fans])
