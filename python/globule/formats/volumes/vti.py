"""Volumes as VTK XML image data (.vti), with all maps as further arrays.

VTK says nothing of a patient's axes; `space` goes into a field that ParaView shows and we read.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from ..._base.files import atomic_write
from ..errors import bad, shown
from ..vtk_xml import _TYPES, parse_xml
from .geometry import VolumeData, place, spacing_and_directions

_NAMES = {code: name for name, code in _TYPES.items()}


def write(path: str | os.PathLike, data: VolumeData) -> None:
    """Write values and maps as appended raw little-endian data."""
    spacing, directions = spacing_and_directions(data.world_from_voxel)
    extent = " ".join(f"0 {n - 1}" for n in data.values.shape[::-1])
    arrays, elements, offset = [], [], 0
    for name, array in {"values": data.values, **data.maps}.items():
        plain = array.astype(np.uint8) if array.dtype == bool else array
        plain = plain.astype(np.float32) if plain.dtype == np.float16 else plain
        plain = np.ascontiguousarray(plain, plain.dtype.newbyteorder("<"))
        kind = _NAMES[f"{plain.dtype.kind}{plain.dtype.itemsize}"]
        elements.append(f'<DataArray type="{kind}" Name={quoteattr(name)} '
                        f'format="appended" offset="{offset}"/>\n')  # fmt: skip
        arrays.append(plain)
        offset += 8 + plain.nbytes
    head = (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">\n'
        f'<ImageData WholeExtent="{extent}" Origin="{_text(data.world_from_voxel[:3, 3])}" '
        f'Spacing="{_text(spacing)}" Direction="{_text(directions.ravel())}">\n'
        '<FieldData>\n<DataArray type="String" Name="space" NumberOfTuples="1" format="ascii">'
        f"{' '.join(str(ord(c)) for c in data.space)} 0</DataArray>\n</FieldData>\n"
        f'<Piece Extent="{extent}">\n<PointData Scalars="values">\n'
        f"{''.join(elements)}</PointData>\n"
        '</Piece>\n</ImageData>\n<AppendedData encoding="raw">\n_'
    )
    with atomic_write(path) as file:
        file.write(head.encode())
        for array in arrays:
            file.write(array.nbytes.to_bytes(8, "little"))
            file.write(array)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def read(path: str | os.PathLike) -> VolumeData:
    """Read a .vti of one piece with appended raw data, as `write` and VTK (uncompressed) make."""
    text = Path(path).read_bytes()
    match = re.search(rb'<AppendedData\s+encoding="raw"\s*>\s*_', text)
    if not match:
        raise bad(path, "AppendedData", "expected appended raw data, got none")
    root = parse_xml(path, text[: match.start()] + b"</VTKFile>")
    image = root.find("ImageData")
    if root.get("type") != "ImageData" or image is None:
        raise bad(path, "", "expected <VTKFile> with <ImageData>")
    if root.get("compressor"):
        raise bad(path, "compressor", f"expected none, got {shown(root.get('compressor'))}")
    pieces = image.findall("Piece")
    if len(pieces) != 1:
        raise bad(path, "Piece", f"expected one, got {len(pieces)}")
    extent = _numbers(path, "Extent", pieces[0].get("Extent", ""), 6)
    low, high = extent[::2], extent[1::2]
    shape = tuple((high - low + 1).astype(np.int64).tolist()[::-1])
    if min(shape) < 1 or max(shape) > 2**31:
        raise bad(path, "Extent", f"expected sizes from 1, got {shown(pieces[0].get('Extent'))}")
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    size = np.dtype("u8" if root.get("header_type") == "UInt64" else "u4").newbyteorder(order)
    arrays = {}
    for element in pieces[0].iterfind("PointData/DataArray"):
        name = element.get("Name", "")
        arrays[name] = _appended(path, element, name, text, match.end(), shape, order, size)
    if not arrays:
        raise bad(path, "PointData", "expected an array, got none")
    scalars = pieces[0].find("PointData").get("Scalars", "values")
    values = arrays.pop(scalars if scalars in arrays else next(iter(arrays)))
    spacing = _numbers(path, "Spacing", image.get("Spacing", "1 1 1"), 3)
    directions = _numbers(path, "Direction", image.get("Direction", "1 0 0 0 1 0 0 0 1"), 9)
    steps = directions.reshape(3, 3) * spacing
    origin = _numbers(path, "Origin", image.get("Origin", "0 0 0"), 3) + steps @ low
    return VolumeData(values, place(steps, origin), _space(image), arrays)


def _appended(
    path: Any, element: Any, name: str, text: bytes, start: int, shape: tuple[int, ...],
    order: str, size: np.dtype,
) -> np.ndarray:  # fmt: skip
    kind = element.get("type", "")
    if kind not in _TYPES or element.get("format") != "appended":
        raise bad(path, name, f"expected appended numbers, got {shown(kind)}")
    if element.get("NumberOfComponents", "1") != "1":
        raise bad(path, name, "expected one component, got several")
    offset = element.get("offset", "")
    if not offset.isascii() or not offset.isdigit() or len(offset) > 18:
        raise bad(path, name, f"expected an offset, got {shown(offset)}")
    begin = start + int(offset)
    dtype = np.dtype(_TYPES[kind]).newbyteorder(order)
    wanted = math.prod(shape) * dtype.itemsize
    head = text[begin : begin + size.itemsize]
    got = int(np.frombuffer(head, size)[0]) if len(head) == size.itemsize else 0
    begin += size.itemsize
    if got != wanted or begin + wanted > len(text):
        raise bad(path, name, f"expected {wanted} bytes, got {min(got, len(text) - begin)}")
    array = np.frombuffer(text, dtype, math.prod(shape), begin).reshape(shape)
    return np.array(array, dtype.newbyteorder("="), order="C")


def _space(image: Any) -> str:
    for element in image.iterfind("FieldData/DataArray"):
        if element.get("Name") == "space" and (element.text or "").split() == [
            *(str(ord(c)) for c in "RAS"), "0",
        ]:  # fmt: skip
            return "RAS"
    return "LPS"


def _numbers(path: Any, name: str, text: str, n: int) -> np.ndarray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != n or not np.isfinite(values).all():
        raise bad(path, name, f"expected {n} numbers, got {shown(text)}")
    return values


def _text(values: Any) -> str:
    return " ".join(repr(value) for value in np.asarray(values, np.float64).tolist())
