"""Processes that open files with libraries of others (`decoder.py`), kept for the next file.

A worker loads its library once, which takes most of the time of a small file, and opens each file
in a fork of its own with limits. A worker that does not answer for its file is ended, with its
fork; the next file gets another worker. Workers end with this program.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from .registry import FORMATS

_KEPT = 2  # idle workers of a library
# What a worker loads. pyarrow starts threads, which a fork must not have.
_LIBRARIES = {
    "hdf5": "h5py", "sweep_h5": "h5py", "dicom": "SimpleITK", "series": "SimpleITK",
    "regions": "pydicom", "exr": "OpenEXR", "video": "av", "usd": "pxr.UsdGeom", "arrow": "numpy", "matlab": "scipy.io",
}  # fmt: skip
# By process, too: a fork of this program must not use the workers of its parent.
_idle: dict[tuple[int, str], list[subprocess.Popen]] = {}


def lend(task: str) -> subprocess.Popen:
    """A worker for one file, until `take_back`."""
    idle = _idle_for(task)
    with contextlib.suppress(IndexError):  # raised where none is left; other threads take some, too
        while True:
            process = idle.pop()
            if process.poll() is None:
                return process
            _end(process)
    return _start(_LIBRARIES[task])


def take_back(task: str, process: subprocess.Popen, answered: bool) -> None:
    """Keep a worker that has answered, and end it if not."""
    idle = _idle_for(task)
    if answered and len(idle) < _KEPT:
        idle.append(process)
    else:
        _end(process)


def _idle_for(task: str) -> list[subprocess.Popen]:
    return _idle.setdefault((os.getpid(), _LIBRARIES[task]), [])


def prepare(paths: Iterable[str]) -> None:
    """Start the workers that these files will need, by their endings, and do not wait for them."""
    for form in FORMATS:
        if form.name in _LIBRARIES and any(p.lower().endswith(form.endings) for p in paths):
            idle = _idle_for(form.name)
            if not idle:
                idle.append(_start(_LIBRARIES[form.name]))


def _start(library: str) -> subprocess.Popen:
    folders = os.pathsep.join(folder for folder in sys.path if folder)
    environment = {
        **os.environ, "PYTHONPATH": folders, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
        "PXR_WORK_THREAD_LIMIT": "1",
    }  # fmt: skip
    # A session of its own: Ctrl-C is for this program, which ends the worker and its fork.
    return subprocess.Popen(
        [sys.executable, Path(__file__).with_name("decoder.py"), library],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env=environment, start_new_session=True,
    )  # fmt: skip


def _end(process: subprocess.Popen) -> None:
    """End a worker and its fork."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    assert process.stdin
    assert process.stdout
    process.stdout.close()
    with contextlib.suppress(BrokenPipeError):  # what it has not read
        process.stdin.close()
    process.wait()


@atexit.register
def _end_all() -> None:
    for (owner, _), idle in _idle.items():
        if owner == os.getpid():
            while idle:
                _end(idle.pop())
