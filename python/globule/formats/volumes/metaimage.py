"""MetaImage (.mha, and .mhd with its data beside it): a text header, then raw or zlib data.

The header is kept as text, field by field, because tracked sweeps store their poses in it.
"""

from __future__ import annotations

import os
import zlib
from io import BufferedReader
from typing import IO, Any

import numpy as np

from ..._base.files import atomic_write
from ..asciinum import numbers_of_words
from ..errors import bad, shown
from .raw import LONGEST_HEADER, LONGEST_LINE, Progress, RawImage, beside, code_of, deflated, n_of_empty, numbers_of

_TYPES = {
    "MET_UCHAR": "u1", "MET_CHAR": "i1", "MET_USHORT": "u2", "MET_SHORT": "i2",
    "MET_UINT": "u4", "MET_INT": "i4", "MET_ULONG_LONG": "u8", "MET_LONG_LONG": "i8",
    "MET_FLOAT": "f4", "MET_DOUBLE": "f8",
}  # fmt: skip
_NAMES = {code: name for name, code in _TYPES.items()}


def read(path: str | os.PathLike[str], progress: Progress = None, empty: bool = False) -> RawImage:
    """Read header and data. Raises FormatError naming the field that is wrong.

    empty   allow images of 0 x 0 pixels: the buffer of a tracker, whose header holds its poses
    """
    with open(path, "rb") as file:
        fields = _header(path, file)
        if empty and (n := n_of_empty(fields.get("DimSize", ""))) is not None:
            return RawImage(np.zeros((n, 0, 0), np.uint8), fields)
        shape, dtype = _layout(path, fields)
        name = fields.get("ElementDataFile", "")
        if name.upper() == "LOCAL":
            return RawImage(_data(path, file, fields, shape, dtype, progress), fields)
    with beside(path, "ElementDataFile", name) as file:
        return RawImage(_data(path, file, fields, shape, dtype, progress), fields)


def write(
    path: str | os.PathLike[str],
    array: np.ndarray,
    fields: dict[str, str],
    compressed: bool = True,
    progress: Progress = None,
) -> None:
    """Write a .mha: `fields` in their order, those that describe the data made anew.

    array   (..., z, y, x), any dtype of MetaImage, little endian in the file.
    Raises ValueError for a type that the format does not have.
    """
    dtype = np.dtype(array.dtype)
    code = code_of(dtype, _NAMES, ".mha")
    data = np.ascontiguousarray(array, dtype.newbyteorder("<"))
    packed = b"".join(deflated(data, zlib.MAX_WBITS, progress)) if compressed else data
    fixed = {
        "ObjectType": "Image",
        "NDims": str(array.ndim),
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": str(compressed),
        "DimSize": " ".join(map(str, reversed(array.shape))),
        "ElementType": _NAMES[code],
    }
    if compressed:
        fixed["CompressedDataSize"] = str(len(packed))
    absent = ["ElementDataFile", "ElementByteOrderMSB", "ElementNumberOfChannels", "HeaderSize"]
    if not compressed:
        absent.append("CompressedDataSize")
    kept = {name: text for name, text in fields.items() if name not in absent}
    # NDims decides how the others are read, so it stays in front of them.
    header = {"ObjectType": "Image", "NDims": "", **kept, **fixed, "ElementDataFile": "LOCAL"}
    with atomic_write(path) as file:
        file.write("".join(f"{name} = {text}\n" for name, text in header.items()).encode())
        file.write(packed)


def numbers(path: Any, fields: dict[str, str], name: str, n: int, default: list[float]) -> Any:
    """The `n` finite numbers of a field, (n,) float64."""
    text = fields.get(name)
    if text is None:
        return np.array(default, np.float64)
    values = numbers_of_words(text.split())
    if len(values) != n or not np.isfinite(values).all():
        raise bad(path, name, f"expected {n} numbers, got {shown(text)}")
    return values


def _header(path: Any, file: BufferedReader) -> dict[str, str]:
    fields: dict[str, str] = {}
    while "ElementDataFile" not in fields:
        line = file.readline(LONGEST_LINE)
        where = f"line {len(fields) + 1}"
        last = line.startswith(b"ElementDataFile") and not file.peek(1)  # needs no line end
        if not (line.endswith(b"\n") or last) or file.tell() > LONGEST_HEADER:
            problem = f"expected a MetaImage header that ends in ElementDataFile, got {shown(line)}"
            raise bad(path, where, problem)
        name, equals, text = line.decode("utf-8", "replace").partition("=")
        if not equals:
            raise bad(path, where, f"expected NAME = VALUE, got {shown(line)}")
        fields[name.strip()] = text.strip()
    return fields


def _layout(path: Any, fields: dict[str, str]) -> tuple[tuple[int, ...], np.dtype]:
    """Shape (slowest axis first, channels last if there are several) and type of the data."""
    kind = fields.get("ElementType", "")
    if kind not in _TYPES:
        expected = f"one of {' '.join(_TYPES)}"
        raise bad(path, "ElementType", f"expected {expected}, got {shown(kind)}")
    if fields.get("BinaryData", "True").lower() != "true":
        raise bad(path, "BinaryData", "expected True, got text data")
    big = fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "False"))
    sizes = fields.get("DimSize", "").split()
    if not 2 <= len(sizes) <= 4 or not all(s.isascii() and s.isdigit() for s in sizes):
        problem = f"expected 2 to 4 sizes, got {shown(fields.get('DimSize', ''))}"
        raise bad(path, "DimSize", problem)
    if any(len(size) > 9 or int(size) < 1 for size in sizes):
        raise bad(path, "DimSize", f"expected sizes from 1, got {shown(fields['DimSize'])}")
    if fields.get("NDims", str(len(sizes))) != str(len(sizes)):
        raise bad(path, "DimSize", f"expected {fields['NDims']} sizes (NDims), got {len(sizes)}")
    shape = tuple(int(size) for size in reversed(sizes))
    channels = fields.get("ElementNumberOfChannels", "1")
    if channels not in ("1", "2", "3", "4"):
        raise bad(path, "ElementNumberOfChannels", f"expected 1 to 4, got {shown(channels)}")
    if channels != "1":
        shape += (int(channels),)
    return shape, np.dtype(_TYPES[kind]).newbyteorder(">" if big.lower() == "true" else "<")


def _data(
    path: Any, file: IO[bytes], fields: dict[str, str], shape: tuple[int, ...], dtype: np.dtype, progress: Progress
) -> np.ndarray:
    skip = fields.get("HeaderSize", "0")
    if skip not in ("0", "-1"):
        raise bad(path, "HeaderSize", f"expected none, got {shown(skip)}")
    compressed = fields.get("CompressedData", "False").lower() == "true"
    return numbers_of(path, file, shape, dtype, zlib.MAX_WBITS if compressed else None, progress)
