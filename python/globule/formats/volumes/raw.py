"""What MetaImage and NRRD have in common: a text header, then numbers, here or in a file beside."""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Callable, Iterator
from typing import IO, Any, NamedTuple

import numpy as np

from ..errors import bad, shown

Progress = Callable[[int, int], None] | None
PIECE = 1 << 24  # bytes that are read, packed and unpacked at once
LONGEST_HEADER = 256 * 2**20  # bytes: some hundred thousand frames
LONGEST_LINE = 65536
MOST_DEFLATE_CAN_EXPAND = 1032  # times


class RawImage(NamedTuple):
    """What a file holds: array (..., z, y, x) or (..., z, y, x, channels), and its header."""

    array: np.ndarray
    fields: dict[str, str]


def beside(path: str | os.PathLike[str], field: str, name: str) -> IO[bytes]:
    """Open the data's file that a header names in `field`. Raises FormatError if there is none."""
    if (
        not name
        or os.path.basename(name) != name
        or name.upper().startswith("LIST")
        or "\0" in name
    ):
        raise bad(path, field, f"expected one file of the same folder, got {shown(name)}")
    place = os.path.join(os.path.dirname(os.fspath(path)), name)
    if not os.path.isfile(place):
        raise bad(path, field, f"expected the data beside it, got no file {shown(name)}")
    return open(place, "rb")


def numbers_of(
    path: Any,
    file: IO[bytes],
    shape: tuple[int, ...],
    dtype: np.dtype,
    window_bits: int | None,
    progress: Progress = None,
) -> np.ndarray:
    """The numbers that the rest of the file holds, deflated if zlib's `window_bits` are given.

    `progress(done, total)` is called with bytes of the numbers. Raises FormatError for too few or
    too many.
    """
    size = math.prod(shape) * dtype.itemsize
    left = os.fstat(file.fileno()).st_size - file.tell()
    if window_bits is not None:
        raw = _inflate(path, file, size, left, window_bits, progress)
    elif left != size:
        raise bad(path, "data", f"expected {size} bytes, got {left}")
    else:
        raw = bytearray()
        while len(raw) < size and (piece := file.read(min(PIECE, size - len(raw)))):
            raw += piece
            if progress:
                progress(len(raw), size)
        if len(raw) < size:  # it has become shorter
            raise bad(path, "data", f"expected {size} bytes, got {len(raw)}")
    array = np.frombuffer(raw, dtype).reshape(shape)
    return np.array(array, dtype.newbyteorder("="), order="C")


def deflated(array: np.ndarray, window_bits: int, progress: Progress = None) -> Iterator[bytes]:
    """A C-contiguous array's bytes, deflated, in pieces; `progress(done, total)` in its bytes."""
    packer = zlib.compressobj(6, wbits=window_bits)
    data = array.reshape(-1).view(np.uint8).data
    for start in range(0, len(data), PIECE):
        yield packer.compress(data[start : start + PIECE])
        if progress:
            progress(min(start + PIECE, len(data)), len(data))
    yield packer.flush()


def _inflate(
    path: Any, file: IO[bytes], size: int, left: int, window_bits: int, progress: Progress
) -> bytearray:
    """The `size` bytes that the rest of the file, `left` bytes, unpacks to."""
    if size > MOST_DEFLATE_CAN_EXPAND * left + 64:
        raise bad(path, "data", f"expected {size} bytes, got {left} compressed ones")
    end = file.tell() + left
    unpacker = zlib.decompressobj(window_bits)
    raw, more = bytearray(), b""
    try:
        while not unpacker.eof and not more:
            piece = unpacker.unconsumed_tail or file.read(PIECE)
            if not piece:
                break
            if len(raw) < size:
                raw += unpacker.decompress(piece, size - len(raw))
                if progress:
                    progress(len(raw), size)
            else:  # to the end, where the checksum is
                more = unpacker.decompress(piece, 1)
    except zlib.error as error:
        raise bad(path, "data", f"expected zlib data, got {error}") from None
    if len(raw) < size:
        raise bad(path, "data", f"expected {size} bytes, got {len(raw)}")
    if more or not unpacker.eof:
        got = "more" if more else "data without an end"
        raise bad(path, "data", f"expected {size} bytes, got {got}")
    n = len(unpacker.unused_data) + end - file.tell()
    if n:
        raise bad(path, "data", f"expected the end of the file after the data, got {n} bytes more")
    return raw
