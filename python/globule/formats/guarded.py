"""Files that only a library can read are read by a process of their own, with limits.

Libraries for DICOM, OpenEXR and HDF5 are large and old, and a damaged file may crash them. `decode`
lets a worker (see `workers`) open the file: its crash is a FormatError here. The size that the file
claims is checked here, before anything is decoded.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.memory import room
from .errors import bad
from .size import bytes_of, check_size
from .workers import lend, take_back

_LIBRARIES = 2**28  # bytes that they take by themselves
_SECONDS, _BYTES_A_SECOND = 30, 1_000_000  # of the processor: at least, and for a file's length
_PEAK = 3.0  # bytes of memory, there and here, for each byte that is claimed
_LONGEST_LINE = 1 << 24


def need(module: str, package: str, extra: str) -> None:
    """Raise MissingPackageError if a module is not installed."""
    try:
        if importlib.util.find_spec(module):
            return
    except ValueError:  # it stands for one that is not there
        pass
    raise missing(package, extra)


def decode(
    task: str,
    path: str | os.PathLike[str],
    what: str,
    most: int = 0,
    choose: Callable[[dict], tuple[float, Any]] | None = None,
) -> tuple[dict, list]:
    """What a task of `decoder.py` finds in a file: facts by name, and arrays.

    Args:
        task: the name of a function of `decoder.py`.
        path: of the file or folder.
        what: that the file is expected to be, for messages.
        most: pixels; 0: no limit beside those of `gb.set_limits`.
        choose: what is wanted of a file with several things: choose(what the task claims) is the
            size in bytes that this takes, and the request for the task.

    Raises FormatError for a file that is damaged, claims too much, or ends the process.
    """
    path = os.fspath(path)
    held = 0 if os.path.isdir(path) else os.path.getsize(path)
    free = room()
    memory = 0 if math.isinf(free) else int(free) + _LIBRARIES
    seconds = _SECONDS + held // _BYTES_A_SECOND
    header = _LIBRARIES + 4 * held
    process, answered = lend(task), False
    assert process.stdout
    try:
        _tell(process, json.dumps([task, os.path.abspath(path), header, memory, seconds]))
        claim = _line(path, what, process)
        if "error" not in claim:
            try:
                if most and "sizes" in claim and math.prod(claim["sizes"]) > most:
                    got = "x".join(map(str, claim["sizes"]))
                    raise bad(path, "header", f"expected at most {most:,} pixels, got {got}")
                held = claim.get("held", held)
                size, request = choose(claim) if choose else (claim["claim"], None)
                check_size(path, "header", size, held, _PEAK)
            except ValueError:
                _tell(process, "")
                answered = process.stdout.readline() == b"{}\n"
                raise
            _tell(process, json.dumps(request))
            facts = _line(path, what, process)
        else:
            facts = claim
        if "error" in facts:
            answered = True
            raise bad(path, "", f"expected {what}, got {facts['error']}")
        arrays = [_array(path, what, process, *about) for about in facts.pop("arrays")]
        answered = True
        return facts, arrays
    finally:
        take_back(task, process, answered)


def _tell(process: subprocess.Popen, line: str) -> None:
    assert process.stdin
    with contextlib.suppress(BrokenPipeError):  # its next line says what happened
        process.stdin.write(line.encode() + b"\n")
        process.stdin.flush()


def _line(path: Any, what: str, process: subprocess.Popen) -> dict[str, Any]:
    assert process.stdout
    line = process.stdout.readline(_LONGEST_LINE)
    if len(line) == _LONGEST_LINE:
        problem = f"got a description of more than {_LONGEST_LINE >> 20} MiB"
        raise bad(path, "header", f"expected {what}, {problem}")
    if not line.endswith(b"\n"):
        raise _ended(path, what, process)
    return json.loads(line)


def _array(path: Any, what: str, process: subprocess.Popen, dtype: str, shape: Any) -> np.ndarray:
    array = np.empty(shape, dtype)
    source: Any = process.stdout
    if array.size and source.readinto(bytes_of(array)) < array.nbytes:
        raise _ended(path, what, process)
    return array


def _ended(path: Any, what: str, process: subprocess.Popen) -> Exception:
    status = process.wait()
    how = "a file that its library does not survive" if status < 0 else "a file that breaks off"
    return bad(path, "", f"expected {what}, got {how} (status {status})")
