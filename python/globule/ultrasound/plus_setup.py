"""The facts of a PLUS configuration (.xml) about a sweep: calibration and region.

https://plustoolkit.github.io, <CoordinateDefinitions> and <VolumeReconstruction>.
"""

from __future__ import annotations

import os
import re
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._base.files import atomic_write
from ..formats.asciinum import numbers_of_words
from ..formats.errors import bad, faults, shown
from ..formats.sweeps.transforms import Edges, Transform, format_matrix, parse_matrix
from ..formats.xml import parse_xml
from .region import Clip, Fan, checked_clip, checked_fan


class PlusGeometry(NamedTuple):
    """transforms between named frames, region, and the names of the image's and world's frame."""

    edges: Edges
    clip: Clip | None
    fan: Fan | None
    image: str
    world: str | None


def read_plus(path: str | os.PathLike[str]) -> PlusGeometry:
    """Read transforms and region. Raises FormatError naming the element."""
    root = _root(path)
    edges: Edges = {}
    for element in root.iter("Transform"):
        if element.get("Matrix") is None:
            continue
        names = element.get("From"), element.get("To")
        where = f"line {element.line}, Transform {names[0]} to {names[1]}"
        if not all(names):
            where = f"line {element.line}, Transform"
            raise bad(path, where, "expected From and To, got neither or one")
        with faults(path, where, "16 numbers"):
            matrix = parse_matrix(element.get("Matrix"))
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-12:
            raise bad(path, where, "expected a matrix that can be inverted, got a singular one")
        edges[names] = Transform(matrix, np.array(True))
    region = root.find(".//VolumeReconstruction")
    clip = fan = None
    image, world = "Image", None
    if region is not None:
        image = region.get("ImageCoordinateFrame", "Image")
        world = region.get("ReferenceCoordinateFrame")
        origin = _numbers(path, region, "ClipRectangleOrigin", 2)
        size = _numbers(path, region, "ClipRectangleSize", 2)
        angles = _either(path, region, ("FanAnglesDeg", "FanAngles"), [0.0, 0.0])
        apex = _either(path, region, ("FanOriginPixel", "FanOrigin"), [0.0, 0.0])
        start = _either(path, region, ("FanRadiusStartPixel",), [0.0])
        stop = _either(path, region, ("FanRadiusStopPixel", "FanDepth"), [500.0])
        try:
            if origin and size and min(size) > 0:  # other sizes mean the whole image
                clip = checked_clip([*origin, *size])
            if angles[0] != angles[1]:
                fan = checked_fan([*apex, *angles, *start, *stop])
        except ValueError as error:
            where = f"line {region.line}, VolumeReconstruction"
            raise bad(path, where, str(error)) from None
    return PlusGeometry(edges, clip, fan, image, world)


def write_plus(
    path: str | os.PathLike[str],
    transforms: dict[tuple[str, str], np.ndarray],
    base: str | os.PathLike[str] | None = None,
    errors: dict[tuple[str, str], float] | None = None,
) -> None:
    """Write a PLUS configuration (.xml) with transforms (4, 4) by (from, to), mm.

    base     a configuration whose text and line ends are kept; its transforms of the same names are
             replaced. Default: one with nothing but transforms
    errors   mm, by (from, to)

    Raises FormatError if the base is no PLUS configuration.
    """
    text = '<PlusConfiguration version="2.1">\n</PlusConfiguration>\n'
    if base is not None:
        _root(base)
        text = Path(base).read_bytes().decode("utf-8-sig")
    line_end = "\r\n" if "\r\n" in text else "\n"
    for (source, target), matrix in transforms.items():
        numbers = "\n        ".join(format_matrix(row) for row in matrix)
        error = (errors or {}).get((source, target))
        said = "" if error is None else f' Error="{error:.6g}"'
        element = f'<Transform From="{source}" To="{target}"\n      Matrix="\n        {numbers}"'
        element += f'{said}\n      Date="{time.strftime("%Y.%m.%d %X")}" />'
        block = re.search(r"<CoordinateDefinitions\b[^>]*>.*?</CoordinateDefinitions>", text, re.S)
        if block is None:
            new = f"  <CoordinateDefinitions>\n    {element}\n  </CoordinateDefinitions>\n"
            at = text.rindex("</PlusConfiguration>")
            text = text[:at] + new + text[at:]
            continue
        inside = block[0]
        for old in re.finditer(r"<Transform\b[^>]*?/>", inside, re.S):
            names = [re.search(rf'\b{name}\s*=\s*"([^"]*)"', old[0]) for name in ("From", "To")]
            if [name and name[1] for name in names] == [source, target]:
                inside = inside[: old.start()] + element + inside[old.end() :]
                break
        else:
            at = inside.rindex("</CoordinateDefinitions>")
            inside = f"{inside[:at].rstrip()}\n    {element}\n  {inside[at:]}"
        text = text[: block.start()] + inside + text[block.end() :]
    text = text.replace("\r\n", "\n").replace("\n", line_end)
    with atomic_write(path) as file:
        file.write(text.encode())


def _root(path: str | os.PathLike[str]) -> Any:
    root = parse_xml(path, Path(path).read_bytes())
    if root.tag not in ("PlusConfiguration", "ProbeCalibrationResult"):
        raise bad(path, f"line {root.line}", f"expected <PlusConfiguration>, got {shown(root.tag)}")
    return root


def _either(path: Any, element: Any, names: tuple[str, ...], default: list[float]) -> list[float]:
    """The first attribute that is there; later names are older."""
    found = (_numbers(path, element, name, len(default)) for name in names)
    return next((values for values in found if values is not None), default)


def _numbers(path: Any, element: Any, name: str, n: int) -> list[float] | None:
    text = element.get(name)
    if text is None:
        return None
    values = numbers_of_words(text.split()).tolist()
    if len(values) != n:
        raise bad(path, f"line {element.line}, {name}", f"expected {n} numbers, got {shown(text)}")
    return values
