"""Output files that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import IO, Any

# Errors of writing itself, which do not say of which file.
_WRITE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# Files that are written but wait for others of their set, with the names they get; None: no set.
_waiting: ContextVar[list[tuple[str, str]] | None] = ContextVar("waiting", default=None)


@contextmanager
def all_or_none() -> Iterator[None]:
    """Files that `atomic_write` writes in this block appear at its end; none do if it raises."""
    waiting: list[tuple[str, str]] = []
    token = _waiting.set(waiting)
    try:
        yield
    except BaseException:
        _remove(waiting)
        raise
    finally:
        _waiting.reset(token)
    _put_in_place(waiting)


def _put_in_place(waiting: list[tuple[str, str]]) -> None:
    try:
        while waiting:
            os.replace(*waiting[0])
            del waiting[0]
    except KeyboardInterrupt:  # too late for none of them
        if waiting and not os.path.exists(waiting[0][0]):
            del waiting[0]
        _put_in_place(waiting)
        raise
    except OSError:
        _remove(waiting)
        raise


def _remove(waiting: list[tuple[str, str]]) -> None:
    for temporary, _ in waiting:
        with suppress(FileNotFoundError):  # interrupted when its own writer had removed it
            os.unlink(temporary)


@contextmanager
def _naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Errors of writing in this block say of which file."""
    try:
        yield
    except OSError as error:
        if error.errno in _WRITE_ERRORS and not error.filename:
            error.filename = os.fspath(path)
        raise


@contextmanager
def atomic_write(path: str | os.PathLike[str], mode: str = "wb") -> Iterator[IO[Any]]:
    """Open `path` for writing so that readers see the old file or the complete new one.

    Writes go to a temporary file in the same folder, which replaces `path` when the block ends.
    If the block raises (KeyboardInterrupt included), the temporary file is removed and `path` is
    untouched. A file that is replaced keeps its permissions; one that its owner has made read-only
    is refused. Mode is "wb" or "w" (UTF-8, newlines as given).
    """
    text: dict[str, Any] = {} if "b" in mode else {"encoding": "utf-8", "newline": "\n"}
    target = os.path.realpath(path)  # a link keeps pointing at the file it names
    if os.path.exists(target) and not os.path.isfile(target):
        # A device or pipe (/dev/stdout) must not be replaced; a folder fails here by itself.
        with _naming(path), open(target, mode, **text) as file:
            yield file
        return
    if os.path.exists(target) and not os.access(target, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), os.fspath(path))
    folder, name = os.path.split(target)
    temporary = os.path.join(folder, f".{name[:100]}.{os.urandom(6).hex()}.tmp")
    try:  # from here on: an interrupt while the file is opened may come when it is there already
        try:
            # "x" rather than tempfile: the file gets the user's usual permissions.
            file = open(temporary, mode.replace("w", "x"), **text)  # noqa: SIM115
        except OSError as error:
            error.filename = os.fspath(path)  # the user never chose the temporary name
            raise
        with _naming(path), file:
            with suppress(OSError):  # nothing to replace; nothing is written yet
                os.chmod(temporary, stat.S_IMODE(os.stat(target).st_mode))
            yield file
        waiting = _waiting.get()
        if waiting is None:
            os.replace(temporary, target)
        else:
            waiting.append((temporary, target))
    except BaseException:
        with suppress(OSError):  # it was never made, or has its place already
            os.unlink(temporary)
        raise
