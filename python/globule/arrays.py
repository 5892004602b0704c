"""Arrays across the border: NumPy, or anything with __cuda_array_interface__ or DLPack."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from . import _core

_CUDA = (2, 3, 13)  # DLPack device types: CUDA, pinned host, managed


class View(NamedTuple):
    """What the core needs of an array: where it is, and something that keeps it there."""

    address: int
    on_device: bool
    shape: tuple[int, ...]
    owner: Any

    @property
    def pair(self) -> tuple[int, bool]:
        return self.address, self.on_device


ABSENT = View(0, False, (), None)


def is_device_array(value: Any) -> bool:
    """True for an array in GPU memory."""
    if isinstance(value, np.ndarray) or value is None or np.isscalar(value):
        return False
    if hasattr(value, "__cuda_array_interface__"):
        return True
    device = getattr(value, "__dlpack_device__", None)
    return device is not None and device()[0] in _CUDA


def view(name: str, value: Any, columns: int | None) -> View:
    """Float32 C-contiguous view of `value`: (n,) for columns None, else (n, columns).

    NumPy arrays of other types are converted; device arrays must already be float32 and
    C-contiguous, and are never copied.
    """
    if is_device_array(value):
        return _device_view(name, value, columns)
    try:
        array = np.ascontiguousarray(value, dtype=np.float32)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected numbers, got {type(value).__name__}") from None
    _check_shape(name, array.shape, columns)
    return View(array.__array_interface__["data"][0], False, array.shape, array)


def _device_view(name: str, value: Any, columns: int | None) -> View:
    interface = getattr(value, "__cuda_array_interface__", None)
    if interface is not None:
        shape, kind = tuple(interface["shape"]), interface["typestr"]
        strides = interface.get("strides")
        address = interface["data"][0] or 0
    else:
        address, shape, steps, code, bits, _, _, value = _core.dlpack_view(value)
        kind = "<f4" if (code, bits) == (2, 32) else f"DLPack type {code}, {bits} bits"
        strides = tuple(4 * s for s in steps)
    if kind != "<f4":
        raise TypeError(f"{name}: expected float32 on the device, got {kind}")
    packed = tuple(4 * int(np.prod(shape[i + 1 :])) for i in range(len(shape)))
    if strides is not None and tuple(strides) != packed and 0 not in shape:
        raise TypeError(f"{name}: expected a C-contiguous device array, got strides {strides}")
    _check_shape(name, shape, columns)
    return View(address, True, shape, value)


def _check_shape(name: str, shape: tuple[int, ...], columns: int | None) -> None:
    good = len(shape) == 1 if columns is None else len(shape) == 2 and shape[1] == columns
    if not good:
        wanted = "(n,)" if columns is None else f"(n, {columns})"
        raise ValueError(f"{name}: expected shape {wanted}, got {tuple(shape)}")


def address(array: np.ndarray) -> int:
    """Where a NumPy array's data lies."""
    return array.__array_interface__["data"][0]
