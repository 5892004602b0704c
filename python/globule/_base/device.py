"""Which backend runs: "cpu", "cuda", "cuda:N" or "auto"."""

from __future__ import annotations

import functools
import logging
import os
from typing import NamedTuple

from .. import _core
from .checks import choice, shown

log = logging.getLogger("globule")
_told = False


class Device(NamedTuple):
    """An opened backend: its library's name, the device's number and a line that describes it."""

    backend: str
    index: int  # type: ignore[assignment]  # of the device, not a tuple's method
    description: str

    @property
    def name(self) -> str:
        """Its name as `Scene(device=)` takes it: "cpu" or "cuda:N"."""
        return f"cuda:{self.index}" if self.backend == "cuda" else "cpu"


def cpu_levels() -> list[str]:
    """SIMD levels that this machine runs, best last: "v2", "v3", "v4"."""
    return [name.removeprefix("cpu_") for name in _core.cpu_backends()]


def choose(device: str = "auto") -> Device:
    """Open a backend.

    "auto" takes CUDA when a usable GPU is there and says once (log, level info) why not
    otherwise; "cuda" raises RuntimeError with the reason. The environment variable
    GLOBULE_SIMD=v2|v3|v4 picks the CPU code by hand.
    """
    global _told
    kind, _, number = str(device).partition(":")
    if kind == "cpu" and not number:
        return _cpu()
    if kind == "auto" and not number:
        try:
            return _cuda(0)
        except RuntimeError as error:
            if not _told:
                log.info("using the CPU: %s", error)
                _told = True
            return _cpu()
    if kind == "cuda" and (number.isdecimal() or not number):
        return _cuda(int(number or 0))
    raise ValueError(f"device: expected auto, cpu, cuda or cuda:N, got {shown(device)}")


def of_rank(device: str, local_rank: int) -> str:
    """The device of one of several processes on a computer, or of threads of one: "auto" and "cuda"
    deal the GPUs in turn; what names a device stays."""
    if device not in ("auto", "cuda"):
        return device
    n = 0
    try:
        while _core.describe("cuda", n)[0]:
            n += 1
    except RuntimeError:  # a build without it
        pass
    return f"cuda:{local_rank % n}" if n else device


def _cpu() -> Device:
    levels = cpu_levels()
    if not levels:
        raise RuntimeError("no CPU backend runs here: the processor is older than x86-64-v2")
    level = os.environ.get("GLOBULE_SIMD", levels[-1])
    choice("GLOBULE_SIMD", level, levels)
    return Device(f"cpu_{level}", 0, _core.describe(f"cpu_{level}", 0)[1])


@functools.cache  # the driver takes its time to say what a device is; an error is asked for again
def _cuda(index: int) -> Device:
    ok, text = _core.describe("cuda", index)
    if not ok:
        raise RuntimeError(text)
    return Device("cuda", index, text)
