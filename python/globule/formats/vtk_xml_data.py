"""Data of VTK XML files: base64, blocks that zlib, lz4 or lzma have packed, and what is written."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.files import atomic_write
from .guarded import need

TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}
_NAMES = {code: name for name, code in TYPES.items()}


def unpack(how: str, raw: bytes, packed_sizes: list[int], sizes: list[int], stream: Stream) -> bytes:
    """The bytes of packed blocks, whose sizes are given. Raises FormatError."""
    blocks, position = [], 0
    unpack = {"zlib": _zlib, "lz4": _lz4, "lzma": _lzma}[how]
    for packed_size, size in zip(packed_sizes, sizes, strict=True):
        try:
            block = unpack(raw[position : position + packed_size], size)
        except ValueError as error:
            raise stream.bad(f"expected {how} data, got {error}") from None
        if len(block) != size:
            raise stream.bad(f"expected a block of {size} bytes, got another size")
        blocks.append(block)
        position += packed_size
    return b"".join(blocks)


def _zlib(packed: bytes, size: int) -> bytes:
    import zlib

    inflater = zlib.decompressobj()
    try:
        block = inflater.decompress(packed, size + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    return block if inflater.eof else b""


def _lz4(packed: bytes, size: int) -> bytes:
    need("lz4", "lz4", "formats")
    import lz4.block

    try:
        return lz4.block.decompress(packed, uncompressed_size=size)
    except lz4.block.LZ4BlockError as error:
        raise ValueError(str(error)) from None


def _lzma(packed: bytes, size: int) -> bytes:
    import lzma

    try:  # a dictionary need not be larger than what it unpacks to, but has a least size
        inflater = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=2 * size + (1 << 27))
        return inflater.decompress(packed, size + 1)
    except (lzma.LZMAError, EOFError) as error:
        raise ValueError(str(error)) from None


class Stream:
    """Header and data of one array, raw or as base64.

    In base64 the header of compressed data is padded and encoded on its own. That of plain data
    is encoded together with them, though some writers pad it too; a '=' in it tells.
    """

    def __init__(self, source: memoryview, start: int, is_base64: bool, bad_array: Any) -> None:
        self.source = source
        self.start = start
        self.is_base64 = is_base64
        self.bad = bad_array
        self.header_size = 0

    def header(self, size: int) -> bytes:
        """The first `size` bytes; a longer header may be asked for next."""
        self.header_size = size
        raw = self.take(self.start, size)
        last, padding = self.start + 4 * -(-size // 3), b"=" * (-size % 3)
        if self.is_base64 and padding and self.source[last - len(padding) : last] == padding:
            self.end_header()  # one = less ends data of one byte
        return raw

    def end_header(self) -> None:
        """The data begin anew behind the header."""
        if self.header_size:
            size = self.header_size
            self.start += 4 * -(-size // 3) if self.is_base64 else size
            self.header_size = 0

    def rest(self, size: int) -> bytes:
        """The bytes behind the header."""
        return self.take(self.start, self.header_size + size)[self.header_size :]

    def take(self, start: int, size: int) -> bytes:
        """Bytes from a place on."""
        import binascii

        length = 4 * -(-size // 3) if self.is_base64 else size
        if start + length > len(self.source):
            left = max(0, len(self.source) - start)
            raise self.bad(f"expected {length} bytes at offset {start}, got {left}")
        piece = self.source[start : start + length]
        if not self.is_base64:
            return bytes(piece)
        try:
            raw = binascii.a2b_base64(piece)
        except binascii.Error as error:
            raise self.bad(f"expected base64 at offset {start}, got {error}") from None
        if len(raw) < size:
            raise self.bad(f"expected {size} bytes at offset {start}, got {len(raw)}")
        return raw[:size]


class Appended:
    """Data arrays behind the XML of a file that is written, raw and little-endian, each with its size."""

    def __init__(self) -> None:
        self.blocks: list[np.ndarray] = []
        self.offset = 0

    def add_all(self, arrays: Mapping[str, np.ndarray]) -> str:
        """The elements of arrays by name."""
        return "".join(self.add(name, values) for name, values in arrays.items())

    def add(self, name: str, values: np.ndarray, components: bool = True) -> str:
        """The element of an array (n,) or (n, k). components: whether it says k."""
        from xml.sax.saxutils import quoteattr  # it takes longer to load than a file to read

        if values.dtype == bool:
            values = values.astype(np.uint8)
        elif values.dtype.kind == "f" and values.itemsize not in (4, 8):
            values = values.astype(np.float32 if values.itemsize == 2 else np.float64)
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        k = 1 if values.ndim == 1 else values.shape[1]
        of = f'NumberOfComponents="{k}" ' if components else ""
        kind = _NAMES[f"{values.dtype.kind}{values.dtype.itemsize}"]
        element = f'<DataArray type="{kind}" Name={quoteattr(name)} {of}format="appended" offset="{self.offset}"/>\n'
        self.blocks.append(values)
        self.offset += 8 + values.nbytes
        return element

    def write(self, path: str | os.PathLike[str], kind: str, body: str) -> None:
        """Write the file of a data set of this kind. body: its element."""
        head = (
            f'<?xml version="1.0" encoding="utf-8"?>\n<VTKFile type="{kind}" version="1.0" '
            f'byte_order="LittleEndian" header_type="UInt64">\n{body}'
            '<AppendedData encoding="raw">\n_'
        )
        with atomic_write(path) as file:
            file.write(head.encode())
            for values in self.blocks:
                file.write(values.nbytes.to_bytes(8, "little"))
                file.write(values.tobytes())
            file.write(b"\n</AppendedData>\n</VTKFile>\n")
