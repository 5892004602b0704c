"""Volumes as VTK XML image data (.vti), with all maps as further arrays.

VTK says nothing of a patient's axes; `space` goes into a field that ParaView shows and we read.
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from ..asciinum import numbers_of_words
from ..errors import bad, shown
from ..size import whole_file
from ..vtk_data import numbers_text
from ..vtk_xml import VtkXml
from ..vtk_xml_data import TYPES, Appended
from .geometry import VolumeData, place, spacing_and_directions


def write(path: str | os.PathLike[str], data: VolumeData) -> None:
    """Write values and maps as appended raw little-endian data."""
    spacing, directions = spacing_and_directions(data.world_from_voxel)
    extent = " ".join(f"0 {n - 1}" for n in data.values.shape[::-1])
    arrays = Appended()
    elements = [arrays.add(name, array, False) for name, array in {"values": data.values, **data.maps}.items()]
    arrays.write(
        path,
        "ImageData",
        f'<ImageData WholeExtent="{extent}" Origin="{numbers_text(data.world_from_voxel[:3, 3])}" '
        f'Spacing="{numbers_text(spacing)}" Direction="{numbers_text(directions.ravel())}">\n'
        '<FieldData>\n<DataArray type="String" Name="space" NumberOfTuples="1" format="ascii">'
        f"{' '.join(str(ord(c)) for c in data.space)} 0</DataArray>\n</FieldData>\n"
        f'<Piece Extent="{extent}">\n<PointData Scalars="values">\n'
        f"{''.join(elements)}</PointData>\n</Piece>\n</ImageData>\n",
    )


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read a .vti of one piece: point data with one component, or where there is none that of cells,
    as voxels at their middles; ascii, binary (base64) or appended (raw or base64), plain or
    compressed with zlib, which is VTK's default. Raises FormatError."""
    file = VtkXml(path, whole_file(path, 2.0))
    image = file.root.find("ImageData")
    if file.root.get("type") != "ImageData" or image is None:
        kind = shown(file.root.get("type", ""))
        raise bad(path, "<VTKFile>", f"expected ImageData, got {kind}")
    pieces = image.findall("Piece")
    if len(pieces) != 1:
        raise bad(path, f"line {image.line}", f"expected one <Piece>, got {len(pieces)}")
    extent = _numbers(path, pieces[0], "Extent", "", 6)
    low, high = extent[::2], extent[1::2]
    if not (high >= low).all() or (high - low).max() > 2**31:
        got = shown(pieces[0].get("Extent", ""))
        raise bad(path, f"line {pieces[0].line}", f"expected Extent with sizes from 1, got {got}")
    n = (high - low + 1).astype(np.int64)
    arrays, scalars, middle = _arrays(file, pieces[0], "PointData", n), "PointData", 0.0
    if not arrays and (n > 1).all():
        arrays, scalars, middle = _arrays(file, pieces[0], "CellData", n - 1), "CellData", 0.5
    if not arrays:
        where = f"line {pieces[0].line}"
        raise bad(path, where, "expected an array of point data with one component, got none")
    name = pieces[0].find(scalars).get("Scalars", "values")
    values = arrays.pop(name if name in arrays else next(iter(arrays)))
    spacing = _numbers(path, image, "Spacing", "1 1 1", 3)
    directions = _numbers(path, image, "Direction", "1 0 0 0 1 0 0 0 1", 9)
    steps = directions.reshape(3, 3) * spacing
    origin = _numbers(path, image, "Origin", "0 0 0", 3) + steps @ (low + middle)
    return VolumeData(values, place(steps, origin), _space(image), arrays)


def _arrays(file: VtkXml, piece: Any, where: str, size: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of one component of points or cells by name, each (Z, Y, X)."""
    shape = tuple(size.tolist()[::-1])
    found = {}
    for element in piece.iterfind(f"{where}/DataArray"):
        if element.get("type") in TYPES and element.get("NumberOfComponents", "1").strip() == "1":
            found[element.get("Name", "")] = file.array(element, math.prod(shape)).reshape(shape)
    return found


def _space(image: Any) -> str:
    for element in image.iterfind("FieldData/DataArray"):
        if element.get("Name") == "space" and (element.text or "").split() == [
            *(str(ord(c)) for c in "RAS"), "0",
        ]:  # fmt: skip
            return "RAS"
    return "LPS"


def _numbers(path: Any, element: Any, name: str, default: str, n: int) -> np.ndarray:
    text = element.get(name, default)
    values = numbers_of_words(text.split())
    if len(values) != n or not np.isfinite(values).all():
        where = f"line {element.line}"
        raise bad(path, where, f"expected {name} of {n} numbers, got {shown(text)}")
    return values
