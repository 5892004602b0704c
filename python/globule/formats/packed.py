"""Files packed by gzip, bzip2, xz or zstd, for every reader: an unpacked copy of a while. That of a
file with several frames stays until another one's is made.

How much a file may unpack to is the rule of `size`, checked while it is unpacked.
"""

from __future__ import annotations

import bz2
import functools
import lzma
import os
import tempfile
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, Any, TypeVar

from .._base.checks import optional
from .errors import bad
from .inflate import GZIP, PIECE, Inflated
from .size import ALWAYS, check_size

ENDINGS = (".gz", ".bz2", ".xz", ".zst")
_MAGIC = {"gzip": b"\x1f\x8b", "bzip2": b"BZh", "xz": b"\xfd7zXZ\0", "zstd": b"\x28\xb5\x2f\xfd"}
_MOST_MEMORY = 1 << 27  # bytes of an unpacker's window: what xz -9 and zstd -19 take
# zstd does not bound what a piece unpacks to: 4 bytes may become 128 KiB.
_ZSTD_PIECE = ALWAYS >> 15


class _Damaged(Exception):
    """Damaged data of bz2, whose OSError is no error of a file, or zstandard."""


_ERRORS = (zlib.error, lzma.LZMAError, EOFError, _Damaged)
_Function = TypeVar("_Function", bound=Callable[..., Any])


class Unpacked(str):
    """The path of an unpacked copy, for the frame that a `FrameOf` stands for. In messages it
    is the name of the packed file, and so it is for files that lie beside it."""

    packed: str
    frame: int

    def __new__(cls, path: str, packed: str) -> Unpacked:
        """The path of a copy, and of the packed file."""
        one = super().__new__(cls, path)
        one.packed = packed
        one.frame = getattr(packed, "frame", 0)
        return one

    def __str__(self) -> str:
        return self.packed

    def __format__(self, form: str) -> str:
        return format(self.packed, form)


def plain_name(path: str | os.PathLike[str]) -> str:
    """A file's name without the ending of its packing."""
    name = os.path.basename(os.fspath(path))
    return os.path.splitext(name)[0] if name.lower().endswith(ENDINGS) else name


def packing(head: bytes) -> str:
    """What packed a file that begins so: "gzip", "bzip2", "xz" or "zstd"; "" for nothing."""
    return next((how for how, magic in _MAGIC.items() if head.startswith(magic)), "")


def is_packed(path: str | os.PathLike[str]) -> bool:
    """Whether a file is packed."""
    if not os.path.isfile(path):
        return False
    with open(path, "rb") as file:
        return bool(packing(file.read(8)))


def unpacked_head(path: str | os.PathLike[str], size: int) -> bytes:
    """The first `size` bytes that a packed file unpacks to; fewer where it is damaged or shorter.

    Raises MissingPackageError for zstd without zstandard.
    """
    head = bytearray()
    with open(path, "rb") as file:
        try:
            for piece in _pieces(file, packing(file.read(8))):
                head += piece
                if len(head) >= size:
                    break
        except _ERRORS:
            pass  # its reader says what is wrong
    return bytes(head[:size])


@contextmanager
def unpacked(path: str | os.PathLike[str], reads_gzip: bool = False) -> Iterator[str | os.PathLike[str]]:
    """The path of an unpacked copy of a packed file, which is gone at the end of the block; the
    path itself for what is no packed file, or where its reader `reads_gzip`.

    Raises FormatError for damaged data and for more than `gb.set_limits` allows;
    MissingPackageError for zstd without zstandard.
    """
    if not isinstance(path, (str, os.PathLike)) or not os.path.isfile(path):
        # Its reader says what is wrong. `open` takes numbers, and closes what they stand for.
        yield path
        return
    with open(path, "rb") as file:
        how = packing(file.read(8))
        if not how or (how == "gzip" and reads_gzip):
            yield path
            return
        if hasattr(path, "frame"):  # others of its frames follow
            with _kept(path, file, how) as folder:
                yield Unpacked(os.path.join(folder, plain_name(path)), os.fspath(path))
            return
        with tempfile.TemporaryDirectory(prefix="globule-") as folder:
            yield Unpacked(_unpack(path, file, how, folder), os.fspath(path))


class _Copy:
    """An unpacked copy in a folder of its own, and how many use it now."""

    def __init__(self) -> None:
        self.folder, self.users = tempfile.TemporaryDirectory(prefix="globule-"), 0


_copies: dict[tuple, _Copy] = {}  # by the file's state and the process, whose children leave it alone
_copying = threading.Lock()


@contextmanager
def _kept(path: Any, file: IO[bytes], how: str) -> Iterator[str]:
    """The folder of a copy, which stays until another file's is made or the process ends."""
    state = os.fstat(file.fileno())
    key = (os.getpid(), plain_name(path), state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns)
    with _copying:
        for other, copy in list(_copies.items()):
            if other != key and other[0] == key[0] and not copy.users:
                _copies.pop(other).folder.cleanup()
        copy = _copies.get(key) or _Copy()
        if key not in _copies:
            try:
                _unpack(path, file, how, copy.folder.name)
            except BaseException:
                copy.folder.cleanup()
                raise
            _copies[key] = copy
        copy.users += 1
    try:
        yield copy.folder.name
    finally:
        with _copying:
            copy.users -= 1


def _unpack(path: Any, file: IO[bytes], how: str, folder: str) -> str:
    """The path of a copy in a folder. Raises FormatError."""
    copy = os.path.join(folder, plain_name(path))
    held, size = os.fstat(file.fileno()).st_size, 0
    with open(copy, "wb") as out:
        try:
            for piece in _pieces(file, how):
                size += len(piece)
                check_size(path, "", size, held)
                out.write(piece)
        except _ERRORS as error:
            raise bad(path, "", f"expected whole {how} data, got {error}") from None
    return copy


def opens_packed(function: _Function) -> _Function:
    """A function of a file's path that is given the path of an unpacked copy."""

    @functools.wraps(function)
    def of_packed(path: Any, *arguments: Any, **options: Any) -> Any:
        with unpacked(path) as plain:
            return function(plain, *arguments, **options)

    return of_packed  # type: ignore[return-value]


def _pieces(file: IO[bytes], how: str) -> Iterator[bytes]:
    """What a file unpacks to, in bounded pieces. Its parts may follow each other."""
    file.seek(0)
    if how == "gzip":
        inflated = Inflated(file, GZIP)
        while piece := inflated.read(PIECE):
            yield piece
        return
    unpackers: dict[str, tuple[Callable[[], Any], int]] = {
        "bzip2": (bz2.BZ2Decompressor, PIECE),
        "xz": (functools.partial(lzma.LZMADecompressor, lzma.FORMAT_XZ, _MOST_MEMORY), PIECE),
        "zstd": (_Zstd, _ZSTD_PIECE),
    }
    new, step = unpackers[how]
    unpacker = new()
    while True:
        packed = b""
        if unpacker.eof:
            packed = unpacker.unused_data.lstrip(b"\0") or file.read(step)
            packed += file.read(step) if len(packed) < 8 else b""
            if packing(packed) != how:
                return
            unpacker = new()
        elif unpacker.needs_input:
            packed = file.read(step)
            if not packed:
                raise EOFError("data without an end")
        try:
            piece = unpacker.decompress(packed, PIECE)
        except (OSError, ValueError) as error:
            raise _Damaged(error) from None
        if piece:
            yield piece


class _Zstd:
    """zstandard's unpacker as those of bz2 and lzma are."""

    needs_input = True

    def __init__(self) -> None:
        zstandard = optional("zstandard", "formats")
        self._error = zstandard.ZstdError
        self._unpacker = zstandard.ZstdDecompressor(max_window_size=_MOST_MEMORY).decompressobj()

    @property
    def eof(self) -> bool:
        return self._unpacker.eof

    @property
    def unused_data(self) -> bytes:
        return self._unpacker.unused_data

    def decompress(self, data: bytes, _: int) -> bytes:
        try:
            return self._unpacker.decompress(data)
        except self._error as error:
            raise _Damaged(error) from None
