"""Arrays across the border: NumPy, or anything with __cuda_array_interface__ or DLPack."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .. import _core

# Where an array lies, as in the core: host memory, or a GPU's by number.
VectorLike: TypeAlias = "Sequence[float] | np.ndarray"  # (3,)
ColorLike: TypeAlias = "float | Sequence[float] | np.ndarray"  # linear RGB (3,), or one for all

HOST = -1
_SOME_GPU = -2  # memory of a GPU; the core asks the driver which
_CPU, _CUDA, _PINNED = 1, 2, 3  # DLPack device types; pinned memory is read as the host's


class View(NamedTuple):
    """An array as the core needs it: its place, and an owner that keeps the memory."""

    address: int
    device: int
    stream: int
    shape: tuple[int, ...]
    owner: Any

    @property
    def place(self) -> tuple[int, int, int]:
        """Address, device and stream."""
        return self[:3]


ABSENT = View(0, HOST, 0, (), None)


def on_gpu(array: Any) -> bool:
    """Whether an array's memory is on a GPU."""
    if isinstance(array, np.ndarray) or array is None or np.isscalar(array):
        return False
    if hasattr(array, "__cuda_array_interface__"):
        return True
    if not hasattr(array, "__dlpack_device__"):
        return False
    return int(array.__dlpack_device__()[0]) not in (_CPU, _PINNED)


def gpu_shape(array: Any) -> tuple[int, ...]:
    """The shape of an array on a GPU as numbers: Warp leaves out the 3 of its vectors."""
    interface = getattr(array, "__cuda_array_interface__", None)
    return tuple(array.shape if interface is None else interface["shape"])


def to_host(array: Any) -> np.ndarray:
    """The array as NumPy, copied from the GPU if it is there."""
    if not on_gpu(array):
        return np.asarray(array)
    for method in ("cpu", "get", "numpy"):  # torch, cupy and warp
        if hasattr(array, method):
            return np.asarray(getattr(array, method)())
    try:
        return np.asarray(array)  # jax copies by itself
    except (TypeError, ValueError):
        return np.from_dlpack(array, device="cpu", copy=True)


def view(name: str, value: Any, columns: int | None) -> View:
    """Float32 C-contiguous view of `value`: (n,) for columns None, else (n, columns).

    NumPy arrays of other types are converted; device arrays must already be float32 and
    C-contiguous, and are never copied.
    """
    if on_gpu(value):
        return _device_view(name, value, columns)
    try:
        array = np.ascontiguousarray(value, dtype=np.float32)
    except (TypeError, ValueError):
        raise TypeError(f"{name}: expected numbers, got {type(value).__name__}") from None
    _check_shape(name, array.shape, columns)
    return View(array.__array_interface__["data"][0], HOST, 0, array.shape, array)


def _device_view(name: str, value: Any, columns: int | None) -> View:
    found = device_array(name, value, ("float32",))
    _check_shape(name, found.shape, columns)
    return View(*found.place, found.shape, found.owner)


class DeviceArray:
    """A C-contiguous array in GPU memory, which NumPy reads by copying it.

    owner keeps the memory; fetch copies it into a NumPy array.
    """

    def __init__(
        self, address: int, shape: tuple[int, ...], dtype: Any, owner: Any,
        fetch: Callable[[], np.ndarray] | None = None, device: int = _SOME_GPU, stream: int = 1,
    ):  # fmt: skip
        self.address, self.shape, self.dtype, self.owner = address, shape, np.dtype(dtype), owner
        self.place = (address, device, stream)
        self._fetch = fetch

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        # The core's streams and the default stream wait for each other.
        return {"version": 3, "shape": self.shape, "typestr": self.dtype.str, "strides": None,
                "data": (self.address, False), "stream": self.place[2] or 1}  # fmt: skip

    def __dlpack_device__(self) -> tuple[int, int]:
        return _CUDA, max(self.place[1], 0)

    def __dlpack__(self, *, stream: Any = None, **_: Any) -> Any:
        device = self.__dlpack_device__()[1]
        if stream not in (None, -1, 0, 1):  # the default stream waits for the core's by itself
            _core.let_wait(device, stream)
        code = {"i": 0, "u": 1, "f": 2}[self.dtype.kind]
        return _core.gpu_array(self.address, list(self.shape), code, 8 * self.itemsize, device, self.owner)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        array = self._fetch() if self._fetch else to_host(self.owner)
        return array if dtype is None else array.astype(dtype, copy=False)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: Any) -> np.ndarray:
        """A part of it, in NumPy."""
        return np.asarray(self)[index]

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    @property
    def itemsize(self) -> int:
        return self.dtype.itemsize


def device_array(name: str, value: Any, dtypes: tuple[str, ...]) -> DeviceArray:
    """A C-contiguous array of one of these types on the GPU, which is used where it is."""
    interface = getattr(value, "__cuda_array_interface__", None)
    # DLPack orders the data for us; version 2 of the interface says nothing of streams (torch).
    if interface is not None and ("stream" in interface or not hasattr(value, "__dlpack__")):
        shape, kind = tuple(interface["shape"]), dtype_name(interface["typestr"])
        strides = interface.get("strides")
        address, device = interface["data"][0] or 0, _SOME_GPU
        stream = interface.get("stream") or 0
    else:
        address, shape, steps, code, bits, kind, device, value = _core.dlpack_view(value)
        device, stream = device if kind == _CUDA else _SOME_GPU, 0  # ordered for the default one
        kind = {0: "int", 1: "uint", 2: "float"}.get(code, f"DLPack type {code}, ") + str(bits)
        strides = tuple(bits // 8 * s for s in steps)
    if kind not in dtypes:
        raise TypeError(f"{name}: expected {' or '.join(dtypes)} on the device, got {kind}")
    item = np.dtype(kind).itemsize
    packed = tuple(item * math.prod(shape[i + 1 :]) for i in range(len(shape)))
    if strides is not None and tuple(strides) != packed and 0 not in shape:
        raise TypeError(f"{name}: expected a C-contiguous device array, got strides {strides}")
    return DeviceArray(address, tuple(shape), kind, value, None, device, stream)


@functools.cache  # NumPy takes 3 µs to name one
def dtype_name(typestr: str) -> str:
    """The name of an array interface's type: "float32" of "<f4"."""
    return np.dtype(typestr).name


def rays(origins: Any, directions: Any) -> tuple[View, View]:
    """Origins and directions (M, 3) of rays, as many of both; directions as `unit_vectors`."""
    o, d = view("origins", origins, 3), view("directions", directions, 3)
    if o.shape != d.shape:
        raise ValueError(f"directions: expected {o.shape[0]} rows, got {d.shape[0]}")
    return o, unit_vectors(d)


def unit_vectors(directions: View) -> View:
    """Host directions (M, 3) of rays, whose steps are distances: refused unless they are unit
    vectors; those that are not finite or zero become NaN, rays that meet nothing."""
    if directions.device != HOST:
        return directions
    with np.errstate(all="ignore"):
        length = np.linalg.norm(directions.owner.astype(np.float64), axis=1)
    none = ~np.isfinite(length) | (length == 0)
    wrong = ~none & (np.abs(length - 1) > 5e-4)
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(f"directions: expected unit vectors, got length {length[i]:g} (ray {i})")
    if not none.any():
        return directions
    return view("directions", np.where(none[:, None], np.float32(np.nan), directions.owner), 3)


def _check_shape(name: str, shape: tuple[int, ...], columns: int | None) -> None:
    good = len(shape) == 1 if columns is None else len(shape) == 2 and shape[1] == columns
    if not good:
        wanted = "(n,)" if columns is None else f"(n, {columns})"
        raise ValueError(f"{name}: expected shape {wanted}, got {tuple(shape)}")


def address(array: np.ndarray) -> int:
    """Where a NumPy array's data lies."""
    return array.__array_interface__["data"][0]


def located(array: np.ndarray | DeviceArray) -> tuple[int, int, int]:
    """Address, device and stream of an array's data."""
    return array.place if isinstance(array, DeviceArray) else (address(array), HOST, 0)


def extent(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(lowest, highest) coordinates of points (N, 3), N > 0; NaN where one is NaN."""
    rows = 256  # side by side: NumPy takes twenty times as long for rows of three
    n = len(points) // rows * rows
    if n == 0 or not points.flags.c_contiguous:
        return points.min(axis=0), points.max(axis=0)
    wide, rest = points[:n].reshape(-1, 3 * rows), points[n:]
    lo = np.concatenate([wide.min(axis=0).reshape(rows, 3), rest]).min(axis=0)
    return lo, np.concatenate([wide.max(axis=0).reshape(rows, 3), rest]).max(axis=0)


def box_corners(lo: Any, hi: Any) -> np.ndarray:
    """The corners (8, 3) of the box between two corners (3,)."""
    return np.array(np.meshgrid(*zip(lo, hi, strict=True))).reshape(3, -1).T
