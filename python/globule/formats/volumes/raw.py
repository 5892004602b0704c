"""What MetaImage and NRRD have in common: a text header, then numbers, here or in a file beside."""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Callable, Container, Iterator
from typing import IO, Any, NamedTuple

import numpy as np

from ..errors import bad, shown
from ..inflate import Inflated
from ..size import bytes_of, check_size

Progress = Callable[[int, int], None] | None
PIECE = 1 << 24  # bytes that are read, packed and unpacked at once
LONGEST_HEADER = 256 * 2**20  # bytes: some hundred thousand frames
LONGEST_LINE = 65536


class RawImage(NamedTuple):
    """What a file holds: array (..., z, y, x) or (..., z, y, x, channels), and its header."""

    array: np.ndarray
    fields: dict[str, str]


def beside(path: str | os.PathLike[str], field: str, name: str) -> IO[bytes]:
    """Open the data's file that a header names in `field`. Raises FormatError if there is none."""
    if not name or os.path.basename(name) != name or name.upper().startswith("LIST") or "\0" in name:
        raise bad(path, field, f"expected one file of the same folder, got {shown(name)}")
    place = os.path.join(os.path.dirname(str(path)), name)
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
    if window_bits is None and left != size:
        raise bad(path, "data", f"expected {size} bytes, got {left}")
    check_size(path, "data", size, left)
    array = np.empty(shape, dtype)
    view = bytes_of(array)
    if window_bits is not None:
        _inflate(path, file, view, left, window_bits, progress)
    else:
        n = 0
        while n < size and (got := file.readinto(view[n : n + PIECE])):  # type: ignore[attr-defined]
            n += got
            if progress:
                progress(n, size)
        if n < size:  # it has become shorter
            raise bad(path, "data", f"expected {size} bytes, got {n}")
    return array if dtype.isnative else array.byteswap(inplace=True).view(dtype.newbyteorder("="))


def deflated(array: np.ndarray, window_bits: int, progress: Progress = None) -> Iterator[bytes]:
    """A C-contiguous array's bytes, deflated, in pieces; `progress(done, total)` in its bytes."""
    packer = zlib.compressobj(6, wbits=window_bits)
    data = array.reshape(-1).view(np.uint8).data
    for start in range(0, len(data), PIECE):
        yield packer.compress(data[start : start + PIECE])
        if progress:
            progress(min(start + PIECE, len(data)), len(data))
    yield packer.flush()


def _inflate(path: Any, file: IO[bytes], into: memoryview, left: int, window_bits: int, progress: Progress) -> None:
    """Fill `into` with all that the rest of the file, `left` bytes, unpacks to."""
    size, end = len(into), file.tell() + left
    data = Inflated(file, window_bits)
    try:
        n = data.fill(into, progress)
        more = data.finish()
    except EOFError:
        raise bad(path, "data", f"expected {size} bytes, got data without an end") from None
    except zlib.error as error:
        raise bad(path, "data", f"expected zlib data, got {error}") from None
    if n < size or more:
        got = f"{n}" if n < size else "more"
        raise bad(path, "data", f"expected {size} bytes, got {got}")
    n = data.rest + end - file.tell()
    if n:
        raise bad(path, "data", f"expected the end of the file after the data, got {n} bytes more")


def n_of_empty(sizes: str) -> int | None:
    """The number of images of 0 x 0 pixels that a header's sizes say; None of others."""
    words = sizes.split()
    empty = len(words) == 3 and words[:2] == ["0", "0"] and words[2].isdecimal() and len(words[2]) < 8
    return int(words[2]) if empty else None


def code_of(dtype: np.dtype, known: Container[str], format: str) -> str:
    """The code "f4" of a type of numbers. Raises ValueError for one that a format does not know."""
    code = f"{dtype.kind}{dtype.itemsize}"
    if code not in known:
        raise ValueError(f"values: expected a type that {format} can hold, got {dtype}")
    return code
