"""Scenes of 3D Slicer (.mrb): a sequence of images and the sequences of its transforms.

A .mrb is a zip archive with a scene (.mrml) and its data. Slicer writes a sequence of images as
.seq.nrrd, and a sequence of linear transforms as .seq.mha without pixels, whose header has the
fields of PLUS: Seq_Frame0000_ProbeToReferenceTransform, …Status, Seq_Frame0000_Timestamp
(vtkMRMLLinearTransformSequenceStorageNode). Every matrix of Slicer is to be taken as RAS.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, bad, shown
from ..size import check_size, check_text
from ..volumes.geometry import LPS_FROM_RAS, place
from ..volumes.raw import Progress
from ..xml import parse_xml
from . import igs
from .poses import PoseTable, interpolate
from .transforms import Edges, Transform, parse_matrix, split_name

_DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    OSError,
    OverflowError,
    UnicodeError,
)
_IMAGES = (".seq.nrrd", ".nrrd")
_TRANSFORMS = (".seq.mha", ".seq.mhd", ".mha", ".mhd")
_FIELD = re.compile(r"Seq_Frame(\d{1,9})_([^=]+?) *= *(.*)")
_SLICE = 3  # axes of an item


def read(path: str | os.PathLike[str], progress: Progress = None) -> tuple[igs.Recording, dict[str, np.ndarray]]:
    """The recording of a scene with one sequence of images, and `space`, which is RAS.

    Edges come from sequences and single transforms that are named like ImageToReference; sequences
    with other times than the images are interpolated. Raises FormatError naming the member.
    """
    with tempfile.TemporaryDirectory(prefix="globule-") as folder:
        files = _extracted(path, Path(folder))
        scenes = [name for name in files if name.lower().endswith(".mrml")]
        if len(scenes) != 1:
            problem = f"expected a scene of 3D Slicer with one .mrml, got {len(scenes)}"
            raise bad(path, "archive", problem)
        edges = _single_transforms(path, scenes[0], files[scenes[0]])
        sequences: dict[tuple[str, str], PoseTable] = {}
        found: dict[str, igs.Recording] = {}
        for name, file in sorted(files.items()):
            if name.lower().endswith(_TRANSFORMS):
                sequences |= _transforms(path, name, file)
            if name.lower().endswith(_IMAGES) and _is_sequence(file):
                with _inside(path, name, file):
                    found[name] = igs.read(file, progress)
        if len(found) != 1:
            got = shown(", ".join(map(os.path.basename, found))) if found else "none"
            expected = "expected one sequence of images (.seq.nrrd) in the scene"
            raise bad(path, "archive", f"{expected}, got {got}")
        ((name, recording),) = found.items()
        with _inside(path, name, files[name]):
            ras_from_pixel = _place(files[name], recording.fields)
    n = len(recording.frames)
    for key, table in sequences.items():
        edges[key] = _at(path, key, table, recording.times, n)
    for key, edge in edges.items():
        if key[0] == "Image":  # Slicer puts the image's own place before its transforms
            edges[key] = edge._replace(matrices=edge.matrices @ ras_from_pixel)
    return recording._replace(edges=edges), {"space": np.array("RAS")}


class _inside:
    """Errors about a file that was unpacked name the archive and the member."""

    def __init__(self, path: Any, name: str, file: Path):
        self._path, self._name, self._file = path, name, file

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: Any, error: Any, _: Any) -> None:
        if isinstance(error, FormatError):
            text = str(error).removeprefix(f"{self._file}: ")
            raise bad(self._path, os.path.basename(self._name), text) from None


def _extracted(path: Any, folder: Path) -> dict[str, Path]:
    """The members that count, unpacked under names of their own."""
    wanted = (".mrml", *_IMAGES, *_TRANSFORMS)
    files: dict[str, Path] = {}
    name = "archive"
    try:
        with open(path, "rb") as source, zipfile.ZipFile(source) as archive:
            members = [m for m in archive.infolist() if m.filename.lower().endswith(wanted)]
            held = os.fstat(source.fileno()).st_size
            check_size(path, "archive", sum(member.file_size for member in members), held)
            for i, member in enumerate(members):
                name = member.filename
                ending = next(end for end in wanted if name.lower().endswith(end))
                files[name] = folder / f"{i}{ending}"
                with archive.open(member) as packed, open(files[name], "xb") as file:
                    shutil.copyfileobj(packed, file)
    except _DAMAGED as error:
        if isinstance(error, OSError) and error.filename == path:
            raise
        raise bad(path, os.path.basename(name), f"expected a .mrb archive, got {error}") from None
    return files


def _is_sequence(file: Path) -> bool:
    """Whether a .nrrd has a list of images of more than one pixel."""
    with open(file, "rb") as source:
        header = source.read(1 << 16).split(b"\n\n")[0].decode("utf-8", "replace")
    fields = dict(re.findall(r"^(sizes|kinds): *(.*)$", header, re.MULTILINE))
    return "list" in fields.get("kinds", "").split() and fields.get("sizes", "") != ""


def _transforms(path: Any, name: str, file: Path) -> dict[tuple[str, str], PoseTable]:
    """The sequences of transforms of a .seq.mha, by the frames that they connect."""
    where = os.path.basename(name)
    data = file.read_bytes()[: 1 << 28]
    data = data.partition(b"ElementDataFile")[0]
    check_text(path, data)
    fields: dict[int, dict[str, str]] = {}
    for line in data.decode("utf-8", "replace").splitlines():
        match = _FIELD.fullmatch(line.strip())
        if match:
            fields.setdefault(int(match[1]), {})[match[2]] = match[3]
    rows: dict[tuple[str, str], list[tuple[float, np.ndarray, bool]]] = {}
    for i, frame in sorted(fields.items()):
        for field, text in frame.items():
            key = split_name(field.removesuffix("Transform"))
            if key is None or not field.endswith("Transform"):
                continue
            try:
                time, matrix = float(frame.get("Timestamp", i)), parse_matrix(text)
            except ValueError as error:
                problem = f"expected a time and 16 numbers, got {error}"
                raise bad(path, f"{where}, item {i}", problem) from None
            ok = frame.get(field + "Status", "OK") == "OK" and igs.is_pose(matrix)
            rows.setdefault(key, []).append((time, matrix, bool(ok and np.isfinite(time))))
    tables = {}
    for key, items in rows.items():
        items.sort(key=lambda item: item[0])
        times, matrices, ok = zip(*items, strict=True)
        tables[key] = PoseTable(np.array(times), np.stack(matrices), np.array(ok))
    return tables


def _at(path: Any, key: tuple[str, str], table: PoseTable, times: np.ndarray | None, n: int) -> Transform:
    """The transforms at the images' times."""
    same = table.times is not None and times is not None and np.array_equal(table.times, times)
    if times is None or same:
        if len(table.ok) != n:
            problem = f"expected {n} items, or a sequence of images whose index is the time"
            raise bad(path, "To".join(key), f"{problem}, got {len(table.ok)} items")
        return Transform(table.matrices, table.ok)
    try:
        return Transform(*interpolate(table, times))
    except ValueError as error:
        raise bad(path, "To".join(key), str(error)) from None


def _single_transforms(path: Any, name: str, file: Path) -> Edges:
    """Transforms of the scene that are no sequences, such as a calibration."""
    text = file.read_bytes()
    check_text(path, text)
    with _inside(path, name, file):
        root = parse_xml(file, text)
    edges: Edges = {}
    for element in root.iter("LinearTransform"):
        key = split_name(element.get("name", "").removesuffix("Transform"))
        matrix = element.get("matrixTransformToParent")
        if key is None or matrix is None:
            continue
        try:
            edges[key] = Transform(parse_matrix(matrix), np.array(True))
        except ValueError as error:
            where = f"{os.path.basename(name)}, line {element.line}"
            raise bad(path, where, f"expected 16 numbers, got {error}") from None
    return edges


def _place(file: Path, fields: dict[str, str]) -> np.ndarray:
    """(4, 4) RAS from the pixel (column, row, 0, 1), which the header of a .seq.nrrd gives."""
    words = [word for word in fields.get("space directions", "").split() if word != "none"]
    origin = fields.get("space origin", "(0,0,0)")
    words = words or ["(1,0,0)", "(0,1,0)", "(0,0,1)"]
    try:
        vectors = np.array([[float(number) for number in word.strip("()").split(",")] for word in (*words, origin)])
    except ValueError:
        vectors = np.empty(0)
    if vectors.shape != (_SLICE + 1, 3) or not np.isfinite(vectors).all():
        got = shown(fields.get("space directions", ""))
        raise bad(file, "space directions", f"expected three vectors and an origin, got {got}")
    matrix = place(vectors[:_SLICE].T, vectors[_SLICE])
    space = fields.get("space", "right-anterior-superior").lower()
    if space in ("right-anterior-superior", "ras"):
        return matrix
    if space in ("left-posterior-superior", "lps"):
        return np.asarray(LPS_FROM_RAS @ matrix)
    raise bad(file, "space", f"expected RAS or LPS, got {shown(space)}")
