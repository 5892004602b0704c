"""Files that only a library can read are read by a process of their own, with limits.

Libraries for DICOM and OpenEXR are large and old, and a damaged file may crash them. `decode` runs
`decoder.py`: its crash is a FormatError here. The size that the file claims is checked here, before
anything is decoded.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.memory import room
from .errors import bad
from .size import bytes_of, check_size

_LIBRARIES = 2**28  # bytes that they take by themselves
_SECONDS, _BYTES_A_SECOND = 30, 1_000_000  # of the processor: at least, and for a file's length
_PEAK = 3.0  # bytes of memory, there and here, for each byte that is claimed
_LONGEST_LINE = 1 << 20


def need(module: str, package: str, extra: str) -> None:
    """Raise MissingPackageError if a module is not installed."""
    try:
        if importlib.util.find_spec(module):
            return
    except ValueError:  # it stands for one that is not there
        pass
    raise missing(package, extra)


def decode(task: str, path: str | os.PathLike[str], what: str, most: int = 0) -> tuple[dict, list]:
    """What a task of `decoder.py` finds in a file: facts by name, and arrays.

    Args:
        task: "dicom", "series", "exr", "sweep_h5" or "video".
        path: of the file or folder.
        what: that the file is expected to be, for messages.
        most: pixels; 0: no limit beside those of `gb.set_limits`.

    Raises FormatError for a file that is damaged, claims too much, or ends the process.
    """
    path = os.fspath(path)
    held = 0 if os.path.isdir(path) else os.path.getsize(path)
    free = room()
    memory = 0 if math.isinf(free) else int(free) + _LIBRARIES
    seconds = _SECONDS + held // _BYTES_A_SECOND
    script = Path(__file__).with_name("decoder.py")
    header = _LIBRARIES + 4 * held
    words = [sys.executable, script, task, os.path.abspath(path), header, memory, seconds]
    folders = os.pathsep.join(folder for folder in sys.path if folder)
    with subprocess.Popen(
        [str(word) for word in words], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL, env={**os.environ, "PYTHONPATH": folders,
                                        "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    ) as process:  # fmt: skip
        try:
            assert process.stdin
            claim = _line(path, what, process)
            if most and math.prod(claim["sizes"]) > most:
                got = "x".join(map(str, claim["sizes"]))
                raise bad(path, "header", f"expected at most {most:,} pixels, got {got}")
            held = claim.get("held", held)
            check_size(path, "header", claim["claim"], held, _PEAK)
            with contextlib.suppress(BrokenPipeError):  # the next line says what happened
                process.stdin.write(b"\n")
                process.stdin.flush()
            facts = _line(path, what, process)
            arrays = [_array(path, what, process, *about) for about in facts.pop("arrays")]
            return facts, arrays
        finally:
            process.kill()


def _line(path: Any, what: str, process: subprocess.Popen) -> dict[str, Any]:
    assert process.stdout
    line = process.stdout.readline(_LONGEST_LINE)
    if not line.endswith(b"\n"):
        raise _ended(path, what, process)
    facts = json.loads(line)
    if "error" in facts:
        raise bad(path, "", f"expected {what}, got {facts['error']}")
    return facts


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
