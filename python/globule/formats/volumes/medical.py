"""Volumes as MetaImage (.mha, .mhd) and NRRD (.nrrd, .nhdr): values only, no maps."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..asciinum import numbers_of_words
from ..errors import bad, shown
from . import metaimage, nrrd
from .geometry import VolumeData, in_space, place, plain, spacing_and_directions
from .raw import Progress

_NRRD_SPACES = {
    "left-posterior-superior": "LPS", "lps": "LPS",
    "right-anterior-superior": "RAS", "ras": "RAS",
}  # fmt: skip


def read_metaimage(path: str | os.PathLike[str], progress: Progress = None) -> VolumeData:
    """Read a .mha or .mhd; ITK's world is LPS (MetaImage calls that RAI). Raises FormatError."""
    image = metaimage.read(path, progress)
    array = image.array[0] if image.array.ndim == 4 and len(image.array) == 1 else image.array
    fields = image.fields
    n = len(fields["DimSize"].split())
    spacing = metaimage.numbers(path, fields, "ElementSpacing", n, [1.0] * n)[:3]
    if "ElementSpacing" not in fields:
        spacing = metaimage.numbers(path, fields, "ElementSize", n, [1.0] * n)[:3]
    for name in ("Offset", "Position", "Origin"):
        if name in fields:
            break
    origin = metaimage.numbers(path, fields, name, n, [0.0] * n)[:3]
    for name in ("TransformMatrix", "Rotation", "Orientation"):
        if name in fields:
            break
    matrix = metaimage.numbers(path, fields, name, n * n, np.eye(n).ravel().tolist())
    # A row of MetaImage's matrix is the direction of one axis.
    directions = matrix.reshape(n, n)[:3, :3].T
    if n == 2:
        raise bad(path, "DimSize", "expected three sizes, got two")
    return VolumeData(array, place(directions * spacing, origin))


def write_metaimage(path: str | os.PathLike[str], data: VolumeData, progress: Progress = None) -> None:
    """Write a .mha in LPS."""
    matrix = in_space(data, "LPS").world_from_voxel
    spacing, directions = spacing_and_directions(matrix)
    fields = {
        "BinaryData": "True",
        "TransformMatrix": _text(directions.T.ravel()),
        "Offset": _text(matrix[:3, 3]),
        "CenterOfRotation": "0 0 0",
        "AnatomicalOrientation": "RAI",
        "ElementSpacing": _text(spacing),
    }
    metaimage.write(path, plain(data.values), fields, progress=progress)


def read_nrrd(path: str | os.PathLike[str], progress: Progress = None) -> VolumeData:
    """Read a .nrrd or .nhdr of three axes; its space may be LPS or RAS. Raises FormatError."""
    image = nrrd.read(path, progress)
    fields = image.fields
    named = fields.get("space", "left-posterior-superior").lower()
    if named not in _NRRD_SPACES:
        expected = "left-posterior-superior or right-anterior-superior"
        raise bad(path, "space", f"expected {expected}, got {shown(named)}")
    n = image.array.ndim
    if n != 3:
        raise bad(path, "dimension", f"expected 3, got {n}")
    if "space directions" in fields:
        steps = np.array([_vector(path, "space directions", text)
                          for text in _vectors(path, fields["space directions"], 3)]).T  # fmt: skip
    else:
        words = fields.get("spacings", "1 1 1").split()
        steps = np.diag(_vector(path, "spacings", "(" + ",".join(words) + ")"))
    origin = _vector(path, "space origin", fields.get("space origin", "(0,0,0)"))
    return VolumeData(image.array, place(steps, origin), _NRRD_SPACES[named])


def write_nrrd(path: str | os.PathLike[str], data: VolumeData, progress: Progress = None) -> None:
    """Write a .nrrd in the volume's own space."""
    names = {short: long for long, short in _NRRD_SPACES.items() if "-" in long}
    matrix = data.world_from_voxel
    steps = " ".join(_bracketed(matrix[:3, axis]) for axis in range(3))
    fields = {
        "space": names[data.space],
        "space directions": steps,
        "kinds": "domain domain domain",
        "space origin": _bracketed(matrix[:3, 3]),
    }
    nrrd.write(path, plain(data.values), fields, progress=progress)


def _text(values: Any) -> str:
    return " ".join(repr(value) for value in np.asarray(values, np.float64).tolist())


def _bracketed(values: Any) -> str:
    return "(" + ",".join(repr(value) for value in np.asarray(values, np.float64).tolist()) + ")"


def _vectors(path: Any, text: str, n: int) -> list[str]:
    words = text.replace(", ", ",").split()
    if len(words) != n:
        raise bad(path, "space directions", f"expected {n} vectors, got {shown(text)}")
    return words


def _vector(path: Any, name: str, text: str) -> np.ndarray:
    values = numbers_of_words(text.strip("() ").split(","))
    if len(values) != 3 or not np.isfinite(values).all():
        raise bad(path, name, f"expected (x,y,z), got {shown(text)}")
    return values
