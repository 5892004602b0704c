"""PySPH's .npz files: two pickled dictionaries, of particles and of the solver's data.

A pickle may run any program. This reader takes its instructions one by one, and knows of nothing
but numbers, texts, lists, dictionaries and arrays (`pickle` calls that restricting globals).
"""

from __future__ import annotations

import io
import math
import pickle
import re
import zipfile
from typing import Any

import numpy as np

from .contents import Contents
from .errors import FormatError, bad, faults, shown
from .fields import join_columns, particles_from

MEMBERS = ("particles.npy", "solver_data.npy")
_NAMES = {"m": "mass", "rho": "density"}


def read(path: Any, archive: zipfile.ZipFile, species: str | None = None) -> Contents:
    """One group of particles: `species`, or "fluid", or the first. The support is 2 h.

    Raises FormatError, and ValueError for an unknown group.
    """
    groups, solver = (_dictionary(path, archive, member) for member in MEMBERS)
    found = {
        str(name): group["arrays"]
        for name, group in groups.items()
        if isinstance(group, dict) and isinstance(group.get("arrays"), dict)
    }
    if not found:
        raise bad(path, "particles", "expected groups of arrays, as PySPH writes them, got none")
    chosen = species or min(found, key=lambda name: name != "fluid")
    if chosen not in found:
        names = ", ".join(found)
        raise ValueError(f"species: expected one of {names} for {path}, got {species!r}")
    columns = {
        _NAMES.get(name, str(name)): value.array(path, str(name))
        for name, value in found[chosen].items()
        if isinstance(value, _Array)
    }
    axes = [columns.get(axis, np.empty(())) for axis in "xyz"]
    if any(a.ndim != 1 or a.shape != axes[0].shape for a in axes):
        got = shown(", ".join(columns))
        raise bad(path, chosen, f"expected arrays x, y and z of one length, got {got}")
    n = len(columns["x"])
    arrays = join_columns({name: array for name, array in columns.items() if len(array) == n})
    if {"u", "v", "w"} <= arrays.keys():
        arrays["velocity"] = np.stack([arrays.pop(name) for name in "uvw"], axis=1)
    particles = particles_from(path, arrays.pop("positions"), arrays)
    time = solver.get("t")
    return Contents(particles, time=float(time) if isinstance(time, (int, float)) else None, species=tuple(found))


def _dictionary(path: Any, archive: zipfile.ZipFile, member: str) -> dict[Any, Any]:
    """The dictionary in a pickled array () of objects."""
    where = member.removesuffix(".npy")
    try:
        file = io.BytesIO(archive.read(member))
        version = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else None
        if header is None:
            raise ValueError(f"version {version}")
        header(file)
        found = _Unpickler(file, encoding="latin1").load()
        (found,) = found.data
        if not isinstance(found, dict):
            raise TypeError(f"expected a dictionary, got {type(found).__name__}")
    except FormatError:
        raise
    except Exception as error:  # instructions of a pickle fail in many ways
        raise bad(path, where, f"expected a dictionary of arrays, got {error}") from None
    return found


class _Kind:
    """An array's type: its code, as "f8", and the order of bytes."""

    order = "="

    def __init__(self, code: str, *_: Any):
        self.code = code

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.order = state[1]


class _Array:
    """An array as it is pickled: shape, type, order of axes, and bytes or objects."""

    shape: tuple[int, ...] = ()
    data: Any = ()

    def __init__(self, *_: Any):
        pass

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, self.shape, self.kind, self.fortran, self.data = state

    def array(self, path: Any, name: str) -> np.ndarray:
        """As NumPy has it. Raises FormatError."""
        with faults(path, name, "an array", refused=Exception):  # anything may be in its place
            if not re.fullmatch("[biuf][1248]", self.kind.code) or self.kind.order not in "<>=|":
                raise ValueError(f"numbers of type {self.kind.code}")
            data = self.data.encode("latin1") if isinstance(self.data, str) else self.data
            dtype = np.dtype(self.kind.order + self.kind.code)
            if len(data) != math.prod(self.shape) * dtype.itemsize:
                raise ValueError(f"{len(data)} bytes for {dtype} {self.shape}")
            array = np.frombuffer(data, dtype).reshape(self.shape, order="F" if self.fortran else "C")
        return np.ascontiguousarray(array, dtype.newbyteorder("="))


def _scalar(kind: _Kind, data: Any) -> Any:
    """A number of NumPy's."""
    found = _Array()
    found.__setstate__((1, (), kind, False, data))
    return found.array("", "number")[()]


def _from_buffer(data: Any, kind: _Kind, shape: tuple[int, ...], order: str) -> _Array:
    found = _Array()
    found.__setstate__((1, shape, kind, order == "F", data))
    return found


_KNOWN = {
    ("numeric", "_frombuffer"): _from_buffer,
    ("multiarray", "_reconstruct"): _Array,
    ("multiarray", "scalar"): _scalar,
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Kind,
    ("_codecs", "encode"): lambda text, _: text.encode("latin1"),
    ("__builtin__", "bytes"): lambda: b"",
}
_MODULES = r"numpy(\._?core\.(multiarray|numeric))?|_codecs|__builtin__"


class _Unpickler(pickle._Unpickler):
    """Makes nothing but the above. In Python: C's takes memory for what a file claims."""

    def find_class(self, module: str, name: str) -> Any:
        known = _KNOWN.get((module.rpartition(".")[2], name))
        if known is None or not re.fullmatch(_MODULES, module):
            raise pickle.UnpicklingError(f"{module}.{name}")
        return known
