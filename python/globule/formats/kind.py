"""The kind of a file, by its content: magic numbers, archive members, roots of XML, lines of text.

The ending decides only between formats that the content does not tell apart, and for content that
is of no known format, so that the reader of that format says what is wrong with it.
"""

from __future__ import annotations

import functools
import os
import re
import stat
import zipfile
from collections import Counter
from typing import NamedTuple

from .._base.checks import a_path
from .._base.structured import parse_toml
from .asciinum import decoded, is_number
from .errors import FormatError, bad
from .fields import place_names
from .packed import packing, plain_name, unpacked, unpacked_head
from .registry import FORMATS, Format, formats
from .table import has_comma, named_line, separator_of

_HEAD = 1 << 16  # bytes that are looked at
_GRID_HEAD = 4096  # bytes in which legacy VTK says what it holds
_LINES = 60  # of text
_MOST_OPENED = 20  # files of a folder
_FEWEST_COLUMNS = 3
_TEXT_COLUMNS = 9
_TABLES = ("text", "xyz", "csv", "tsv", "pts")  # whose endings say that two columns are x and y

PICTURE_ENDINGS = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg")


class Kind(NamedTuple):
    """The kind and format of a file.

    kind     "particles", "mesh", "volume", "sweep", "picture" or "scene"
    format   name of the format in lower case: "vtp", "ply", "nifti", "metaimage", …
    """

    kind: str
    format: str


_BY_ENDING = {
    ".nii": Kind("volume", "nifti"),
    ".nii.gz": Kind("volume", "nifti"),
    ".nrrd": Kind("volume", "nrrd"),
    ".nhdr": Kind("volume", "nrrd"),
    ".mha": Kind("volume", "metaimage"),
    ".mhd": Kind("volume", "metaimage"),
    ".vti": Kind("volume", "vti"),
    ".sparse.npz": Kind("volume", "npz"),
    ".igs.mha": Kind("sweep", "metaimage"),
    ".igs.nrrd": Kind("sweep", "nrrd"),
    ".mrb": Kind("sweep", "mrb"),
    ".sw": Kind("sweep", "stradwin"),
    ".sxi": Kind("sweep", "stradwin"),
    ".dcm": Kind("sweep", "dicom"),
    ".dicom": Kind("sweep", "dicom"),
    ".toml": Kind("scene", "toml"),
    ".hdr": Kind("picture", "hdr"),
    ".exr": Kind("picture", "exr"),
    ".png": Kind("picture", "png"),
    ".jpg": Kind("picture", "jpeg"),
    ".jpeg": Kind("picture", "jpeg"),
}
_MAGIC = (  # at the file's beginning
    (b"glTF", Kind("mesh", "glb")),
    (b"\x89PNG\r\n", Kind("picture", "png")),
    (b"\xff\xd8\xff", Kind("picture", "jpeg")),
    (b"II*\0", Kind("picture", "tiff")),
    (b"MM\0*", Kind("picture", "tiff")),
    (b"GIF8", Kind("picture", "gif")),
    (b"\x76\x2f\x31\x01", Kind("picture", "exr")),
    (b"#?", Kind("picture", "hdr")),
    (b"\x1a\x45\xdf\xa3", Kind("picture", "video")),
)
# Plane Position Sequence and Plane Position (Volume) Sequence of DICOM: frames that are planes.
_PLANES = (b"\x20\x00\x13\x91SQ", b"\x20\x00\x0e\x93SQ")
_XML = {
    "PolyData": Kind("particles", "vtp"),
    "UnstructuredGrid": Kind("particles", "vtu"),
    "ImageData": Kind("volume", "vti"),
}
_SHARED = {  # formats that hold several kinds
    "npz": ("particles", "volume", "sweep"),
    "npy": ("particles", "sweep"),
    "nrrd": ("volume", "sweep"),
    "metaimage": ("volume", "sweep"),
    "dicom": ("volume", "sweep"),
}
_OBJ_WORDS = {"v", "vn", "vt", "f", "o", "g", "s", "l", "p", "mtllib", "usemtl"}


def _row(n: int) -> bytes:
    return rb"[ \t]*\S+" + (n - 1) * rb"[ \t]+\S+" + rb"[ \t]*\r?\n"


_UNKNOWN = (
    "data of no known format; where its own library reads it (ASE, MDAnalysis, meshio), pass gb.Particles(positions)"
)
_OTHERS = (  # formats that are not read, and what makes one that is
    (rb"[\s\S]{0,2000}\bFoamFile\b", "OpenFOAM's own: foamToVTK writes .vtk"),
    (rb"(?:[ \t]*(?:#[^\n]*)?\n)*[ \t]*lattice_vector\b", "FHI-aims' own: ASE writes .extxyz"),
    (rb"\$MeshFormat", "Gmsh's own: gmsh -save -format vtk writes .vtk"),
    (rb"\s*(?:\*\*[^\n]*\n\s*)*\*(?i:heading|include|node|part|preprint)\b", "Abaqus' own: meshio convert writes .vtu"),
    (
        rb"\s*\d+\s+\d+[ \t]*\r?\n" + 4 * _row(3) + 4 * _row(4),
        "a scan of Leica with its transform: CloudCompare saves .ply",
    ),
    (rb"\s*(?:\{|\[\s*(?:[{\"]|\[\s*[-\d]))", "JSON: read it with its own library and pass gb.Particles(positions)"),
    (rb"PK\x03\x04[\s\S]{26}[^\n]{0,200}\.usd[ac]?", "a package of USD: unzip it and read the .usdc in it"),
    (rb"PK\x03\x04[\s\S]*xl/", "an Excel workbook: save it as .csv"),
    (rb"\s*<[\s\S]{0,2000}VTKFile\b[^>]*\btype *= *[\"']\w+", "another VTK XML: ParaView saves it as .vtk or .vtu"),
)
_READERS = {  # who reads a kind, for error messages
    "particles": "globule.read",
    "mesh": "globule.read",
    "volume": "globule.volumes.read_volume, or globule.volumes.sample_tomography for metaballs",
    "sweep": "globule.ultrasound.read_sweep",
    "scene": "globule.Simulation",
    "picture": "globule.Environment",
}


def kind_of(path: str | os.PathLike[str], wanted: str | None = None) -> Kind:
    """The kind and format of a file, or of a folder of images or with a DICOM series.

    Args:
        path: of a file or folder.
        wanted: a kind that counts where neither content nor ending tells it from others: an .npz
            that is cut off may have been particles, a volume or a sweep; a grid of VTK with evenly
            spaced values is a volume, and particles or a mesh where those are wanted.

    Raises FormatError if neither the content nor the extension determines the kind, and for a
    pipe or a device; TypeError if `path` is no path; FileNotFoundError and other OSErrors pass
    unchanged.
    """
    path = a_path(path)
    mode = os.stat(path).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise bad(path, "", "expected a file or a folder, got a pipe or a device")
    if os.path.isdir(path):
        found = _in_folder(path)
        endings = _endings_in(path) if found is None or wanted == "particles" else []
        if endings:
            example = os.path.join(path, f"*{endings[0]}")
            raise bad(path, "", f"expected a file, got a folder; a pattern names those in it, such as '{example}'")
        if found is None:
            remedy = "name a file in it, or a pattern of files: 'VTK/*.vtk'"
            raise bad(path, "", f"expected pictures or a DICOM series in this folder, got neither; {remedy}")
    else:
        found = _by_content(path, wanted)
    found = found or _by_ending(path, wanted)
    if found is None:
        expected = "particles, a mesh, a volume, a sweep, a picture or a scene"
        raise bad(path, "", f"expected {expected}, got {_other(_head_of(path)[0]) or _UNKNOWN}")
    if found.format in ("vtk", "vts", "vtr") and wanted not in ("particles", "mesh"):
        state = os.stat(path)
        if _is_even_grid(os.path.abspath(path), found.format, state.st_mtime_ns, state.st_size):
            return found._replace(kind="volume")
    return found


@functools.lru_cache(256)
def _is_even_grid(path: str, form: str, changed: int, size: int) -> bool:
    """Whether a file of VTK is a grid of evenly spaced values, once for each state of it."""
    from .vtk_xml_grids import is_volume  # where it is needed: most files are none

    with unpacked(path) as plain:
        if form == "vtk":
            with open(plain, "rb") as file:
                head = file.read(_GRID_HEAD)
            if not re.search(rb"\nDATASET[ \t]+(STRUCTURED|RECTILINEAR)_GRID\b", head, re.IGNORECASE):
                return False
        return is_volume(plain)


def _other(head: bytes) -> str:
    """What to call a file that is not read, by its beginning."""
    return next((said for content, said in _OTHERS if re.match(content, head)), "")


def kind_or_none(path: str | os.PathLike[str], wanted: str | None = None) -> Kind | None:
    """As `kind_of`, but None where `kind_of` raises FormatError."""
    try:
        return kind_of(path, wanted)
    except FormatError:
        return None


def wrong_kind(path: str | os.PathLike[str], expected: str, got: Kind) -> FormatError:
    """The error of a reader for a file of another kind; the message names the right function."""
    what = got.kind if got.kind == "particles" else f"a {got.kind}"
    problem = f"expected {expected}, got {what} ({got.format}): read it with {_READERS[got.kind]}"
    return bad(path, "", problem)


def _by_ending(path: str | os.PathLike[str], wanted: str | None = None) -> Kind | None:
    name = os.path.basename(os.fspath(path)).lower()
    known = dict(_BY_ENDING)
    for form in formats():
        known.update(dict.fromkeys(form.endings, Kind(form.kind, form.name)))
    endings = [ending for ending in known if name.endswith(ending)]
    if not endings:
        name = plain_name(name)
        endings = [ending for ending in known if name.endswith(ending)]
    if not endings:
        return None
    found = known[max(endings, key=len)]
    if wanted in _SHARED.get(found.format, ()):
        return found._replace(kind=wanted)
    return found


def _by_content(path: str | os.PathLike[str], wanted: str | None) -> Kind | None:
    head, size = _head_of(path)
    if head[:4] == b"PK\3\4":
        with unpacked(path) as plain:
            return _in_archive(plain, wanted)
    found = _by_magic(head, size) or _registered(head, formats())
    if found:
        return found
    text = decoded(head)
    if text.lstrip().startswith("<"):  # XML, in which VTK has raw data
        vtk = re.search(r"<VTKFile\b[^>]*?\btype *= *[\"'](\w+)", text)
        known = _XML.get(vtk[1]) if vtk else None
    else:
        ending = _by_ending(path)
        theirs = {form.name for form in formats()[len(FORMATS) :] if not form.content}
        if ending and ending.format in theirs:
            return ending  # a table of numbers, in the eyes of globule, may be more to its reader
        known = None if "\0" in text[:4096] or _other(head) else _in_text(text, ending)
    return known


def _head_of(path: str | os.PathLike[str]) -> tuple[bytes, int]:
    """The beginning of a file, of what a packed one holds; its bytes, -1 where they are not known."""
    with open(path, "rb") as file:
        head = file.read(_HEAD)
        size = os.fstat(file.fileno()).st_size
    return (unpacked_head(path, _HEAD), -1) if packing(head) else (head, size)


def _registered(head: bytes, known: tuple[Format, ...]) -> Kind | None:
    """The format of the registry that a file's beginning matches."""
    for form in known:
        if form.content and re.match(form.content, head):
            return Kind(form.kind, form.name)
    return None


def _by_magic(head: bytes, size: int) -> Kind | None:
    if head.startswith(b"\x93NUMPY"):  # frames (F, H, W), or particles (N, 3), (F, N, 3)
        found = re.search(rb"'shape': *\(([^)]*)\)", head[:1024])
        shape = found[1].replace(b" ", b"").split(b",") if found else []
        return Kind("sweep" if len(shape) == 3 and shape[2] not in (b"", b"2", b"3") else "particles", "npy")
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head[344:348] in (b"n+1\0", b"ni1\0") or head[4:8] in (b"n+2\0", b"ni2\0"):
        return Kind("volume", "nifti")
    if re.match(rb"# vtk DataFile[^\n]*\n[^\n]*\n\s*\w+\s+DATASET\s+STRUCTURED_POINTS\b", head, re.I):
        return Kind("volume", "structured points")
    if head[128:132] == b"DICM":
        return Kind("volume" if any(tag in head for tag in _PLANES) else "sweep", "dicom")
    if head[4:8] == b"ftyp" or (head[:4] == b"RIFF" and head[8:12] == b"AVI "):
        return Kind("picture", "video")
    if head[:2] == b"BM" and int.from_bytes(head[2:6], "little") == size:
        return Kind("picture", "bmp")
    if head[:7] == b"NRRD000":
        return Kind(_tracked(head.split(b"\n\n")[0]), "nrrd")
    if re.match(rb"\s*(ObjectType|NDims|Comment)\s*=", head) and b"DimSize" in head:
        return Kind(_tracked(head.split(b"ElementDataFile")[0]), "metaimage")
    if head[:4] in (b"ply\n", b"ply\r"):
        faces = re.search(rb"^element (?:face|tristrips) +0*[1-9]", head.split(b"end_header")[0], re.MULTILINE)
        return Kind("mesh" if faces else "particles", "ply")
    if len(head) >= 84 and size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return Kind("mesh", "stl")
    return None


def _tracked(header: bytes) -> str:
    """Whether the header of an image is that of a tracked sweep or of a volume."""
    return "sweep" if re.search(rb"Seq_Frame\d+_\w*Transform\b", header) else "volume"


def _in_archive(path: str | os.PathLike[str], wanted: str | None) -> Kind | None:
    try:
        with zipfile.ZipFile(path) as archive:
            names = {*archive.namelist()}
    except (zipfile.BadZipFile, OSError, NotImplementedError, UnicodeError):
        return None  # its reader says what is wrong
    if any(name.lower().endswith(".mrml") for name in names):
        return Kind("sweep", "mrb")
    members = {name.removesuffix(".npy") for name in names if name.endswith(".npy")}
    if not members:
        return None  # an Excel workbook, a package of USD
    if "positions" in members:
        return Kind("particles", "npz")
    if {"values", "world_from_voxel"} <= members:
        return Kind("volume", "npz")
    return Kind("sweep" if "frames" in members else wanted or "particles", "npz")


def _endings_in(path: str | os.PathLike[str]) -> list[str]:
    """The endings of a folder's files of particles, the most frequent first."""
    known = [ending for form in formats() if form.kind == "particles" for ending in form.endings]
    names = [name.lower() for name in sorted(os.listdir(path)) if not name.startswith(".")]
    found = Counter(max(ends, key=len) for name in names if (ends := [end for end in known if name.endswith(end)]))
    return [ending for ending, _ in found.most_common()]


def _in_folder(path: str | os.PathLike[str]) -> Kind | None:
    names = sorted(os.listdir(path))
    if any(name.lower().endswith(PICTURE_ENDINGS) for name in names):
        return Kind("sweep", "pictures")
    files = [os.path.join(path, name) for name in names if not name.startswith(".")]
    for file in [file for file in files if os.path.isfile(file)][:_MOST_OPENED]:
        found = kind_or_none(file)
        if found is not None and found.format == "dicom":
            return Kind("volume", "dicom")
    return None


def _in_text(text: str, ending: Kind | None) -> Kind | None:
    lines = [line.strip() for line in text.splitlines()[:_LINES]]
    lines = [line for line in lines if line and not line.startswith(("#", "%"))]
    if not lines:  # of no particles, where a comment names the columns
        return (
            Kind("particles", "csv") if ending and ending.format in _TABLES and named_line(text.splitlines()) else None
        )
    if re.search(r"^RES_BUF_FRAMES +\d", text, re.MULTILINE):
        return Kind("sweep", "stradwin")
    if lines[0].split()[0].lower() == "solid" and "facet" in text:
        return Kind("mesh", "stl")
    words = {line.split()[0] for line in lines}
    if "v" in words and words <= _OBJ_WORDS:
        return Kind("mesh", "obj")
    if "=" in lines[0] or lines[0].startswith("["):
        return Kind("scene", "toml") if _is_toml(text) else None
    found = _in_table(lines, ending)
    mark, row = text.lstrip()[0], lines[0].split()
    numbers = len(row) > 1 and is_number(row[0])
    named = numbers and len(named_line(text.splitlines()).split()) == len(row)  # some of whose columns may be words
    if (found and mark == "%") or (mark == "#" and (named or (found and found.format == "xyz" and numbers))):
        return Kind("particles", "csv")
    return found


def _in_table(lines: list[str], ending: Kind | None) -> Kind | None:
    """The format of a table of numbers."""
    rows = [line.split("#")[0].replace('"', " ").split() for line in lines[:3]]
    named = ending.format if ending else ""
    fewest = 2 if named in _TABLES else _FEWEST_COLUMNS
    last = lines[:2][-1]
    mark = separator_of(last)
    if mark == "\t" and (_n_numbers(rows[0]) or named == "xyz"):
        mark = None  # as good as a blank
    if mark is not None and mark in last:
        cells = [cell.strip('" \t') for cell in last.split(mark)]
        return Kind("particles", "csv") if _n_numbers(cells) >= fewest else None
    names = place_names(rows[0])
    head = len(names) >= 2 or (named in _TABLES and not _n_numbers(rows[0]))
    if len(rows) == 1 and len(names) >= 2 and named in _TABLES:  # of no particles
        return Kind("particles", "csv")
    more = len(rows[-1]) - len(rows[0])  # 1: the names of rows
    if head and _n_numbers(rows[-1]) >= fewest and (more == 0 or (more == 1 and '"' in lines[-1])):
        return Kind("particles", "csv")
    if len(rows[0]) == 1 and rows[0][0].isdigit():  # a count: nine columns follow, or a title
        nine = len(rows) > 1 and len(rows[1]) == _n_numbers(rows[1]) == _TEXT_COLUMNS
        if nine and named != "xyz":
            return Kind("particles", "text")
        rows = rows[2:]
    elif len(rows[0]) == _TEXT_COLUMNS and named == "text":
        return ending  # without its count: the reader says so
    if not rows:
        return None
    row = rows[0] if _n_numbers(rows[0][:1]) else rows[0][1:]  # an element's symbol
    if len(row) >= fewest and _n_numbers(row) == len(row):
        plain = "pts" if named == "pts" else "xyz"
        return Kind("particles", "csv" if any(map(has_comma, row)) else plain)
    return None


def _n_numbers(words: list[str]) -> int:
    return sum(is_number(word) or has_comma(word) for word in words)


def _is_toml(text: str) -> bool:
    try:
        return bool(parse_toml(text))
    except ValueError:
        return False
