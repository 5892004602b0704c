"""NRRD (.nrrd, and .nhdr with its data beside it): a text header, then raw or gzip data."""

from __future__ import annotations

import os
import zlib
from typing import IO, Any

import numpy as np

from ..._base.files import atomic_write
from ..errors import bad, shown
from .raw import LONGEST_HEADER, LONGEST_LINE, Progress, RawImage, beside, code_of, deflated, n_of_empty, numbers_of

_TYPES = {
    "u1": ("uint8", "uchar", "unsigned char", "uint8_t"),
    "i1": ("int8", "signed char", "int8_t"),
    "u2": ("uint16", "ushort", "unsigned short", "unsigned short int", "uint16_t"),
    "i2": ("int16", "short", "short int", "signed short", "signed short int", "int16_t"),
    "u4": ("uint32", "uint", "unsigned int", "uint32_t"),
    "i4": ("int32", "int", "signed int", "int32_t"),
    "u8": ("uint64", "ulonglong", "unsigned long long", "unsigned long long int", "uint64_t"),
    "i8": ("int64", "longlong", "long long", "long long int", "signed long long", "int64_t"),
    "f4": ("float",),
    "f8": ("double",),
}
_CODES = {name: code for code, names in _TYPES.items() for name in names}
_GZIP = zlib.MAX_WBITS + 16  # zlib's word for gzip, without a date in it
KEY_VALUE = ":="  # fields of the user's own are stored under their name and this


def read(path: str | os.PathLike[str], progress: Progress = None, empty: bool = False) -> RawImage:
    """Read header and data: fields by name, those of `key:=value` lines as "key:=". empty: as of metaimage.read."""
    with open(path, "rb") as file:
        fields = _header(path, file)
        if empty and (n := n_of_empty(fields.get("sizes", ""))) is not None:
            return RawImage(np.zeros((n, 0, 0), np.uint8), fields)
        shape, dtype = _layout(path, fields)
        name = fields.get("data file", fields.get("datafile"))
        if name is None:
            return RawImage(_data(path, file, fields, shape, dtype, progress), fields)
    with beside(path, "data file", name) as file:
        return RawImage(_data(path, file, fields, shape, dtype, progress), fields)


def write(
    path: str | os.PathLike[str],
    array: np.ndarray,
    fields: dict[str, str],
    compressed: bool = True,
    progress: Progress = None,
) -> None:
    """Write a .nrrd: `fields` in their order, those that describe the data made anew.

    array   (..., z, y, x), little endian in the file.
    Raises ValueError for a type that the format does not have.
    """
    dtype = np.dtype(array.dtype)
    code = code_of(dtype, _TYPES, ".nrrd")
    fixed = {
        "type": _TYPES[code][0],
        "dimension": str(array.ndim),
        "sizes": " ".join(map(str, reversed(array.shape))),
        "endian": "little",
        "encoding": "gzip" if compressed else "raw",
    }
    absent = ("data file", "datafile", "byte skip", "byteskip", "line skip", "lineskip")
    kept = {name: text for name, text in fields.items() if name not in absent}
    # `dimension` must stand before every field with a value per axis.
    header = {"type": "", "dimension": "", **kept, **fixed}
    data = np.ascontiguousarray(array, dtype.newbyteorder("<"))
    with atomic_write(path) as file:
        file.write(b"NRRD0005\n")
        for name, text in header.items():
            line = f"{name}{text}\n" if name.endswith(KEY_VALUE) else f"{name}: {text}\n"
            file.write(line.encode())
        file.write(b"\n")
        if not compressed:
            file.write(data)
            return
        file.writelines(deflated(data, _GZIP, progress))


def _header(path: Any, file: IO[bytes]) -> dict[str, str]:
    magic = file.readline(16).strip()
    if not magic.startswith(b"NRRD000"):
        raise bad(path, "line 1", f"expected NRRD000N, got {shown(magic)}")
    fields: dict[str, str] = {}
    n_lines = 1
    while True:
        line = file.readline(LONGEST_LINE)
        n_lines += 1
        if not line.endswith(b"\n") or file.tell() > LONGEST_HEADER:
            if not line and ("data file" in fields or "datafile" in fields):
                return fields  # a detached header needs no blank line
            problem = f"expected a header that ends in a blank line, got {shown(line)}"
            raise bad(path, f"line {n_lines}", problem)
        text = line.decode("utf-8", "replace").rstrip("\r\n")
        if not text:
            return fields
        if text.startswith("#"):
            continue
        name, key_value, value = text.partition(KEY_VALUE)
        if key_value and ": " not in name:
            fields[name + KEY_VALUE] = value
            continue
        name, colon, value = text.partition(":")
        if not colon:
            raise bad(path, f"line {n_lines}", f"expected NAME: VALUE, got {shown(text)}")
        fields[name.strip().lower()] = value.strip()


def _layout(path: Any, fields: dict[str, str]) -> tuple[tuple[int, ...], np.dtype]:
    kind = fields.get("type", "").lower()
    if kind not in _CODES:
        raise bad(path, "type", f"expected a number type, got {shown(kind)}")
    sizes = fields.get("sizes", "").split()
    good = all(s.isascii() and s.isdigit() and len(s) < 10 and int(s) > 0 for s in sizes)
    if not 2 <= len(sizes) <= 4 or not good:
        raise bad(path, "sizes", f"expected 2 to 4 sizes, got {shown(fields.get('sizes', ''))}")
    if fields.get("dimension") != str(len(sizes)):
        got = shown(fields.get("dimension", ""))
        raise bad(path, "dimension", f"expected {len(sizes)} (sizes), got {got}")
    dtype = np.dtype(_CODES[kind])
    endian = fields.get("endian", "little" if dtype.itemsize == 1 else "").lower()
    if endian not in ("little", "big"):
        raise bad(path, "endian", f"expected little or big, got {shown(endian)}")
    shape = tuple(int(size) for size in reversed(sizes))
    return shape, dtype.newbyteorder("<" if endian == "little" else ">")


def _data(
    path: Any, file: IO[bytes], fields: dict[str, str], shape: tuple[int, ...], dtype: np.dtype, progress: Progress
) -> np.ndarray:
    for name in ("byte skip", "byteskip", "line skip", "lineskip"):
        if fields.get(name, "0") != "0":
            raise bad(path, name, f"expected none, got {shown(fields[name])}")
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("gzip", "gz", "raw"):
        raise bad(path, "encoding", f"expected raw or gzip, got {shown(encoding)}")
    window_bits = None if encoding == "raw" else _GZIP
    return numbers_of(path, file, shape, dtype, window_bits, progress)
