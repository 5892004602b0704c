"""PCD, of the Point Cloud Library: a header of words, then rows of text, rows of bytes, or columns
packed by LZF ("The PCD file format", versions 0.6 and 0.7).

`rgb` and `rgba` are four bytes, blue first, also where their type is a float; `normal_x` … become
the attribute `normal`. Points without a place are NaN, and stay.
"""

from __future__ import annotations

import os
import re
from typing import Any

import numpy as np

from .asciinum import cast
from .errors import bad, shown
from .fields import find_positions, join_columns, particles_from
from .size import check_size

_MOST_HEADER = 1 << 16  # bytes
_NAMES = {"normal_x": "nx", "normal_y": "ny", "normal_z": "nz"}


def read(path: str | os.PathLike[str]) -> Any:
    """Read the points of a .pcd file. Raises FormatError naming what is wrong."""
    with open(path, "rb") as file:
        said, begin, how = _header(path, file.read(_MOST_HEADER))
        file.seek(begin)
        row, n = _row(path, said), _count(path, said)
        check_size(path, "POINTS", n * row.itemsize, os.path.getsize(path))
        if how == "ascii":
            columns = _of_text(path, file.read(), row, n)
        elif how == "binary":
            data = file.read(n * row.itemsize)
            if len(data) < n * row.itemsize:
                what = f"expected {n * row.itemsize:,} bytes, got {len(data):,}"
                raise bad(path, "DATA", what)
            rows = np.frombuffer(data, row, n)
            columns = {name: rows[name] for name in row.names or ()}
        else:
            columns = _of_columns(path, file.read(), row, n)
    color = columns.pop("rgb", None)
    color = columns.pop("rgba", None) if color is None else color
    flat: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if not name.startswith("_"):  # padding
            flat |= {name: values} if values.ndim == 1 else {name: values.reshape(n, -1)}
    vectors = {name: values for name, values in flat.items() if values.ndim > 1}
    singles = {_NAMES.get(k, k): values for k, values in flat.items() if values.ndim == 1}
    arrays = join_columns(singles) | vectors
    if color is not None and color.dtype.itemsize == 4:
        channels = np.ascontiguousarray(color).view(np.uint8).reshape(n, 4)
        arrays["color"] = np.ascontiguousarray(channels[:, 2::-1])
    positions = find_positions(arrays)
    if positions is None:
        raise bad(path, "FIELDS", f"expected x, y and z, got {shown(' '.join(columns))}")
    return particles_from(path, positions, arrays)


def _header(path: Any, data: bytes) -> tuple[dict[str, list[str]], int, str]:
    """The header's words by their key, where the points begin, and how they are written."""
    said: dict[str, list[str]] = {}
    at = 0
    while at < len(data):
        end = data.find(b"\n", at)
        if end < 0:
            break
        words = data[at:end].split(b"#")[0].decode("latin-1").split()
        at = end + 1
        if not words:
            continue
        said[words[0].upper()] = words[1:]
        if words[0].upper() == "DATA":
            how = words[1].lower() if len(words) == 2 else ""
            if how not in ("ascii", "binary", "binary_compressed"):
                expected = "expected ascii, binary or binary_compressed"
                raise bad(path, "DATA", f"{expected}, got {shown(' '.join(words[1:]))}")
            return said, at, how
    raise bad(path, "header", "expected a line DATA, got none")


def _row(path: Any, said: dict[str, list[str]]) -> np.dtype:
    fields = said.get("FIELDS", said.get("COLUMNS", []))
    sizes, kinds = said.get("SIZE", []), said.get("TYPE", [])
    counts = said.get("COUNT", ["1"] * len(fields))
    if not fields or not len(fields) == len(sizes) == len(kinds) == len(counts):
        lengths = f"{len(fields)}, {len(sizes)}, {len(kinds)} and {len(counts)}"
        raise bad(path, "FIELDS", f"expected as many SIZE, TYPE and COUNT, got {lengths}")
    columns: list[tuple[Any, ...]] = []
    for k, (name, size, kind, count) in enumerate(zip(fields, sizes, kinds, counts, strict=True)):
        code = {"F": "f", "I": "i", "U": "u"}.get(kind.upper())
        sizes_of = ("4", "8") if code == "f" else ("1", "2", "4", "8")
        if code is None or size not in sizes_of or not re.fullmatch(r"[1-9]\d{0,5}", count):
            raise bad(path, name, f"expected a known TYPE, SIZE and COUNT, got {kind} {size} {count}")
        own = name if name not in [c[0] for c in columns] and name != "_" else f"_{k}"
        shape = () if count == "1" else (int(count),)
        columns.append((own, f"<{code}{size}", *([shape] if shape else [])))
    return np.dtype(columns)


def _count(path: Any, said: dict[str, list[str]]) -> int:
    size = [*said.get("WIDTH", []), *said.get("HEIGHT", ["1"])]
    words = said.get("POINTS") or size
    if not words or not all(re.fullmatch(r"\d{1,15}", word) for word in words):
        raise bad(path, "POINTS", f"expected a number, got {shown(' '.join(words))}")
    n = 1
    for word in words:
        n *= int(word)
    return n


def _of_text(path: Any, data: bytes, row: np.dtype, n: int) -> dict[str, np.ndarray]:
    width = sum(int(np.prod(row[name].shape, dtype=int)) for name in row.names or ())
    words = data.split()
    if len(words) != n * width:
        raise bad(path, "DATA", f"expected {n} rows of {width} numbers, got {len(words)} numbers")
    try:
        table = np.array(words, np.float64).reshape(n, width)
    except ValueError as error:
        raise bad(path, "DATA", f"expected numbers, got others: {error}") from None
    found, at = {}, 0
    for name in row.names or ():
        base, shape = row[name].base, row[name].shape
        k = int(np.prod(shape, dtype=int))
        values = table[:, at] if not shape else table[:, at : at + k]
        try:
            found[name] = cast(values, base)
        except ValueError as error:
            raise bad(path, f"DATA, field {name}", f"expected numbers of type {base}, {error}") from None
        at += k
    return found


def _of_columns(path: Any, data: bytes, row: np.dtype, n: int) -> dict[str, np.ndarray]:
    packed, whole = np.frombuffer(data[:8].ljust(8, b"\0"), "<u4").tolist()
    if whole != n * row.itemsize or packed > len(data) - 8:
        what = f"expected {n * row.itemsize:,} bytes in {len(data) - 8:,}"
        raise bad(path, "DATA", f"{what}, got {whole:,} in {packed:,}")
    plain = unpack_lzf(data[8 : 8 + packed], whole)
    if plain is None:
        raise bad(path, "DATA", "expected data packed by LZF, got others")
    found, at = {}, 0
    for name in row.names or ():
        base, shape = row[name].base, row[name].shape
        k = n * int(np.prod(shape, dtype=int))
        found[name] = np.frombuffer(plain, base, k, at).reshape(n, *shape)
        at += k * base.itemsize
    return found


def unpack_lzf(data: bytes, size: int) -> bytes | None:
    """What LZF (Lehmann) packed to `data`, of a known size; None where it is none."""
    out, at, end = bytearray(), 0, len(data)
    while at < end:
        head = data[at]
        at += 1
        if head < 32:  # as they are
            out += data[at : at + head + 1]
            at += head + 1
            continue
        length = head >> 5
        if length == 7 and at < end:
            length += data[at]
            at += 1
        if at >= end:
            return None
        begin = len(out) - ((head & 31) << 8) - data[at] - 1
        at += 1
        length += 2
        if begin < 0 or len(out) + length > size:
            return None
        for _ in range(0, length, max(1, len(out) - begin)):  # may reach into what it makes
            step = min(length, len(out) - begin)
            out += out[begin : begin + step]
            begin, length = begin + step, length - step
    return bytes(out) if len(out) == size else None
