"""Volumes as NumPy archives (.npz), whole or as occupied blocks (.sparse.npz), with all maps.

A sparse file stores the blocks of 8x8x8 voxels in which anything differs from the background
(0; for `radius` 255, which means empty; for `source` -1; for `uncertainty` infinity):

    shape (3,)      Z, Y, X
    blocks (B,)     which ones, ascending: (bz * nby + by) * nbx + bx
    values, maps    (B, 8, 8, 8)
"""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from ..errors import bad, shown
from ..numpy_format import read_archive, write_arrays
from ..size import check_size
from .geometry import VolumeData

BLOCK = 8
_BACKGROUND = {"radius": 255, "source": -1, "uncertainty": np.inf}
_OWN = ("values", "world_from_voxel", "space", "shape", "blocks")


def read(path: str | os.PathLike[str]) -> VolumeData:
    """Read either form. Raises FormatError naming the array."""
    arrays = read_archive(path)
    for name in ("values", "world_from_voxel"):
        if name not in arrays:
            raise bad(path, name, f"expected an array, got {', '.join(arrays) or 'none'}")
    space = str(arrays["space"]) if "space" in arrays and not arrays["space"].ndim else "LPS"
    if space not in ("LPS", "RAS"):
        raise bad(path, "space", f"expected LPS or RAS, got {shown(space)}")
    held = {"values": arrays["values"]} | {k: a for k, a in arrays.items() if k not in _OWN}
    if "blocks" in arrays:
        held = _dense(path, arrays, held)
    values = held.pop("values")
    maps = {name: array for name, array in held.items() if array.shape == values.shape}
    return VolumeData(values, arrays["world_from_voxel"], space, maps)


def write(path: str | os.PathLike[str], data: VolumeData) -> None:
    """Write all voxels, or the occupied blocks if the name ends in .sparse.npz."""
    arrays = {"values": data.values, **data.maps}
    if os.fspath(path).lower().endswith(".sparse.npz"):
        arrays = _sparse(arrays)
    write_arrays(path, {"world_from_voxel": data.world_from_voxel, "space": np.array(data.space), **arrays})


def _sparse(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    shape = arrays["values"].shape
    counts = [-(-n // BLOCK) for n in shape]
    occupied = np.zeros(counts, bool)
    for name, array in arrays.items():
        for z in range(counts[0]):  # slab by slab: the peak of memory stays small
            slab = array[z * BLOCK : (z + 1) * BLOCK] != _BACKGROUND.get(name, 0)
            rows = np.logical_or.reduceat(slab.any(axis=0), np.arange(0, shape[1], BLOCK), axis=0)
            occupied[z] |= np.logical_or.reduceat(rows, np.arange(0, shape[2], BLOCK), axis=1)
    blocks = np.flatnonzero(occupied)
    packed = {"shape": np.array(shape, np.int64), "blocks": blocks.astype(np.int64)}
    for name, array in arrays.items():
        background = _BACKGROUND.get(name, 0)
        out = np.full((len(blocks), BLOCK, BLOCK, BLOCK), background, array.dtype)
        for i, (z, y, x) in enumerate(np.argwhere(occupied) * BLOCK):
            part = array[z : z + BLOCK, y : y + BLOCK, x : x + BLOCK]
            out[i, : part.shape[0], : part.shape[1], : part.shape[2]] = part
        packed[name] = out
    return packed


def _dense(path: Any, arrays: dict[str, np.ndarray], held: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    sizes, blocks = arrays.get("shape", np.empty(0)), arrays["blocks"]
    if not (sizes.shape == (3,) and sizes.dtype.kind in "iu" and (sizes > 0).all()):
        raise bad(path, "shape", f"expected three sizes, got {sizes.dtype} {sizes.shape}")
    shape = tuple(sizes.tolist())
    claimed = math.prod(shape) * sum(array.dtype.itemsize for array in held.values())
    check_size(path, "shape", claimed, os.path.getsize(path), 1.1)
    counts = [-(-n // BLOCK) for n in shape]
    if blocks.ndim != 1 or blocks.dtype.kind not in "iu":
        raise bad(path, "blocks", f"expected integers (B,), got {blocks.dtype} {blocks.shape}")
    most = math.prod(counts) - 1
    if len(blocks) and not (blocks.min() >= 0 and blocks.max() <= most
                            and (np.diff(blocks.astype(np.int64)) > 0).all()):  # fmt: skip
        raise bad(path, "blocks", f"expected ascending numbers from 0 to {most}")
    result = {}
    for name, array in held.items():
        if array.shape != (len(blocks), BLOCK, BLOCK, BLOCK):
            expected = f"({len(blocks)}, {BLOCK}, {BLOCK}, {BLOCK})"
            raise bad(path, name, f"expected shape {expected}, got {array.shape}")
        out = np.full(shape, _BACKGROUND.get(name, 0), array.dtype)
        for block, (z, y, x) in zip(array, np.stack(np.unravel_index(blocks, counts), 1) * BLOCK,
                                    strict=True):  # fmt: skip
            part = out[z : z + BLOCK, y : y + BLOCK, x : x + BLOCK]
            part[:] = block[: part.shape[0], : part.shape[1], : part.shape[2]]
        result[name] = out
    return result
