"""Whether the octree of particles fits into the memory of a device."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from .. import _core
from .._base.device import Device
from .._base.memory import always_fits, limits, room
from .sources import as_particles

# Bytes a particle that the build and a first image take beside the particles' own arrays, with
# 32-bit keys; measured on a CPU: 32 to 42, and 72 to 79. Keys of 64 bits take 10 more.
BUILT = {"balls": 42, "spheres": 42, "smooth": 80}
WIDE_KEYS = 10


def octree_bytes(n: int, surface: str, key_bits: int) -> float:
    """Bytes that a scene of n particles takes beside their arrays."""
    return n * float(BUILT[surface] + (WIDE_KEYS if key_bits == 64 else 0))


def room_on(device: Device) -> float:
    """Bytes that a scene may take on a device: those that are free, and at most the limit that
    `set_limits` has set."""
    if device.backend != "cuda":
        return room()
    free = float(_core.SweepGrid(device.name, 0).free_bytes())
    return min(free, limits()["memory"] or math.inf)


def lacking(n: int, to_read: float, surface: str, key_bits: int, device: Device) -> tuple[float, float] | None:
    """Bytes that a scene takes and that are free where these do not suffice; else None.

    to_read: bytes that reading the particles takes.
    """
    octree = octree_bytes(n, surface, key_bits)
    if always_fits(octree + to_read):
        return None
    needs = [(octree, room_on(device)), (to_read, room())]
    if device.backend != "cuda":
        needs = [(octree + to_read, room_on(device))]
    return next(((need, free) for need, free in needs if need > free), None)


def counted(name: str, value: Any) -> tuple[Any, int, float]:
    """An argument of `Scene`, read where only that tells how many particles it has; their number;
    and the bytes that reading the rest of it takes."""
    if isinstance(value, (str, os.PathLike)):
        from ..formats.ranges import counted_rows  # formats are loaded when they are needed

        found = counted_rows(os.fspath(value))
        if found is not None:
            return value, found[0], found[0] * found[1]
    elif is_positions(value):
        as_is = value.dtype == np.float32 and value.flags.c_contiguous and value.shape[1] == 3
        return value, len(value), 0 if as_is else 12 * len(value)
    particles = as_particles(name, value)
    return particles, len(particles), 0.0


def is_positions(value: Any) -> bool:
    """Whether a NumPy array, of a file perhaps, is positions without more ado."""
    good = isinstance(value, np.ndarray) and value.ndim == 2 and value.shape[1] in (2, 3)
    return good and value.dtype.kind in "biuf"
