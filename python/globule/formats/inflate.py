"""Deflated data (zlib, gzip) as a stream that never unpacks more than is asked for."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import IO

GZIP = zlib.MAX_WBITS + 16  # zlib's word for gzip
PIECE = 1 << 20  # bytes that are read at once
_TAIL = 1 << 20  # bytes behind the data in which the end may come


class Inflated:
    """The data of a compressed file from where it stands.

    Args:
        file: binary, at the beginning of the data.
        window_bits: as of zlib; `GZIP` for gzip, whose members may follow each other.

    Every method raises zlib.error for damaged data, and EOFError if they end too early.
    """

    def __init__(self, file: IO[bytes], window_bits: int):
        self._file, self._bits = file, window_bits
        self._unpacker = zlib.decompressobj(window_bits)
        self._packed = b""  # read, but not yet unpacked

    def read(self, size: int) -> bytes:
        """The next `size` bytes; less at the end of the data."""
        data = bytearray()
        while len(data) < size and (piece := self._some(min(size - len(data), PIECE))):
            data += piece
        return bytes(data)

    def fill(self, into: memoryview, progress: Callable[[int, int], None] | None = None) -> int:
        """Unpack into a writable view of bytes; returns how many came, less at the end."""
        n = 0
        while n < len(into) and (piece := self._some(min(len(into) - n, PIECE))):
            into[n : n + len(piece)] = piece
            n += len(piece)
            if progress:
                progress(n, len(into))
        return n

    def skip(self, size: int) -> None:
        """Pass over `size` bytes."""
        while size > 0 and (piece := self._some(min(size, PIECE))):
            size -= len(piece)

    def finish(self) -> int:
        """Look for the end, where the checksum is, in the next MiB; returns how many bytes of
        data lay before it. What is behind that is not read."""
        n = 0
        while n < _TAIL and (piece := self._some(_TAIL - n)):
            n += len(piece)
        return n

    @property
    def ended(self) -> bool:
        """Whether the end of the data was met, and its checksum was right."""
        return self._unpacker.eof

    @property
    def rest(self) -> int:
        """Bytes that were read behind the end of the data."""
        return len(self._unpacker.unused_data)

    def _some(self, most: int) -> bytes:
        """1 to `most` bytes; none at the end."""
        while True:
            if self._unpacker.eof:
                after = self._unpacker.unused_data or self._file.read(PIECE)
                if self._bits != GZIP or after[:2] != b"\x1f\x8b":
                    return b""
                self._unpacker, self._packed = zlib.decompressobj(GZIP), after
            packed = self._packed or self._file.read(PIECE)
            if not packed:
                raise EOFError("data without an end")
            data = self._unpacker.decompress(packed, most)
            self._packed = self._unpacker.unconsumed_tail
            if data:
                return data
