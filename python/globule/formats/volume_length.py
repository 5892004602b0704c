"""Whether a volume's file holds all its voxels, before they are read.

ITK takes the memory first; of a NIfTI file that is cut it makes a volume without a word, and of a
MetaImage it prints what is wrong.
"""

from __future__ import annotations

import gzip
import math
import os
import re
import zlib
from typing import Any

from .errors import bad

_MOST_GZIP_CAN_EXPAND = 1032  # times, from the format of deflate
_LONGEST_HEADER = 1 << 20
_PIECE = 1 << 22


def check_length(path: str, reader: Any, bytes_per_voxel: int) -> None:
    """Raise FormatError if the file cannot hold what its header announces.

    `reader` is a SimpleITK.ImageFileReader that has read the header.
    """
    needed = math.prod(reader.GetSize()) * bytes_per_voxel
    held = os.path.getsize(path)
    name = path.lower()
    if name.endswith((".mhd", ".nhdr")):  # the voxels are in another file, mostly beside it
        held += sum(entry.stat().st_size for entry in os.scandir(os.path.dirname(path) or "."))
    _compare(path, needed, _MOST_GZIP_CAN_EXPAND * held + 1024)
    if name.endswith((".nii", ".nii.gz")) and reader.HasMetaDataKey("bitpix"):
        # ITK may widen the numbers, so what is on the disk is asked of the file.
        needed = math.prod(reader.GetSize()) * int(reader.GetMetaData("bitpix")) // 8
        needed += int(float(reader.GetMetaData("vox_offset")))
        _compare(path, needed, _unpacked_size(path) if name.endswith(".gz") else held)
    elif name.endswith((".mha", ".mhd")):
        _check_meta_image(path, needed)


def _check_meta_image(path: str, needed: int) -> None:
    with open(path, "rb") as file:
        head = file.read(_LONGEST_HEADER)
    last = re.search(rb"^ElementDataFile *= *([^\r\n]*)\r?\n?", head, re.MULTILINE)
    if not last:
        raise bad(path, "header", "expected a line ElementDataFile, got none")
    where = last[1].strip().decode("utf-8", errors="replace")
    fields = dict(re.findall(rb"^(\w+) *= *([^\r\n]*)", head[: last.start()], re.MULTILINE))
    if fields.get(b"CompressedData", b"").strip().lower() == b"true":
        size = fields.get(b"CompressedDataSize", b"").strip()
        needed = int(size) if size.isdigit() and len(size) < 19 else 1
    if where.upper() == "LOCAL":
        _compare(path, needed, os.path.getsize(path) - last.end())
    elif where.upper().split()[:1] != ["LIST"] and "%" not in where:
        data = os.path.join(os.path.dirname(path), where)
        if not os.path.isfile(data):
            raise bad(path, "ElementDataFile", f"expected a file that is there, got {where!r}")
        _compare(path, needed, os.path.getsize(data))


def _unpacked_size(path: str) -> int:
    size = 0
    try:
        with gzip.open(path) as file:
            while piece := file.read(_PIECE):
                size += len(piece)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise bad(path, "", f"expected a whole gzip file, got {error}") from None
    return size


def _compare(path: str, needed: int, held: int) -> None:
    if needed > held:
        problem = f"expected {needed:,} bytes of voxels, as announced, got at most {max(0, held):,}"
        raise bad(path, "data", problem)
