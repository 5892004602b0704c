"""Arguments that replace particles: `Particles`, positions, a file's name, or an object with
particles, of globule or of another package."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from .. import _core
from .._base.arrays import ABSENT, View, on_gpu, to_host, view
from .._base.checks import corners
from ..data.particles import FIELDS, Particles

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# What to call for objects of later rooms and for likely mistakes, by the name of their type.
_INSTEAD = {
    "Volume": "; globule.volumes.extract_iso_surface(volume).particles are those of its surface",
    "Sweep": "; globule.ultrasound.reconstruct(sweep) makes a volume, globule.volumes.extract_iso_surface its surface",
    "Layer": "; globule.render(layer) shows it",
    "dict": "; globule.Particles(**fields) takes a dict of fields",
}


class HasParticles(Protocol):
    """An object with particles, such as a simulation."""

    @property
    def particles(self) -> Particles:
        """The particles as they are now."""


ParticlesLike: TypeAlias = "Particles | ArrayLike | str | os.PathLike[str] | HasParticles"
MAX_SUPPORT: float = _core.limits["support"]  # past it squares overflow float32
MAX_RATIO: float = _core.limits["ratio"]  # between the largest and the smallest support
_EXPECTED = "a Scene, Particles, positions (N, 3) or a file's name"


def as_particles(name: str, value: Any) -> Particles:
    """The particles that `value` stands for.

    Args:
        name: of the argument, for errors.
        value: `Particles`; (N, 3) positions, world; the name of a file that `globule.read` reads;
            an object whose `particles` are `Particles`, such as a simulation; or an object of
            VTK, PyVista, ASE, MDAnalysis, yt, pynbody, pandas, polars, pyarrow or xarray.

    Raises TypeError and ValueError for anything else, FormatError and OSError for the file.
    """
    if isinstance(value, Particles):
        return value
    if isinstance(value, (str, os.PathLike)):
        return _read(name, os.fspath(value))
    own = getattr(value, "particles", None)
    if isinstance(own, Particles):
        return own
    if not isinstance(value, (np.ndarray, list, tuple, dict, int, float)) and not on_gpu(value):
        from ..formats.objects import particles_of

        found = particles_of(value)
        if found is not None:
            return found
    kind = type(value).__name__
    array = hasattr(value, "__len__") or hasattr(value, "__array__") or on_gpu(value)
    if kind in _INSTEAD or not array:
        got = kind if kind in _INSTEAD else " ".join(repr(value)[:80].split())
        raise TypeError(f"{name}: expected {_EXPECTED}, got {got}{_INSTEAD.get(kind, '')}")
    return Particles(value)


def _read(name: str, path: str) -> Particles:
    if any(mark in path for mark in "*?%") and not os.path.exists(path):
        raise ValueError(
            f"{name}: expected one file, got the pattern {path!r}; "
            "globule.render_sequence renders every file of a pattern"
        )
    from ..formats import read  # formats are loaded when they are needed

    return read(path)


def field_of(name: str, value: Any, columns: int | None, n: int) -> tuple[View, Any]:
    """A particle field as (array, None) or (ABSENT, one value for all)."""
    if value is None:
        return ABSENT, None
    shape = getattr(value, "shape", ())
    if shape == () or (columns is not None and shape == (columns,)):
        return ABSENT, value
    v = view(name, value, columns)
    if v.shape[0] != n:
        raise ValueError(f"{name}: expected {n} particles, got {v.shape[0]}")
    return v, None


def in_spacing(p: Particles, spacing: float | None) -> Any:
    """Weights for kernels of a spacing. A particle's own weight is for its own support: 1 stands for a
    volume of half the support, cubed."""
    if not spacing or p.support is None or np.ndim(p.weight) == 0:
        return p.weight
    return np.float32(to_host(p.weight) * (to_host(p.support) / (2.0 * spacing)) ** 3)


def values_of_particles(values: Any, n: int) -> tuple[View, np.ndarray, np.ndarray]:
    """Values (N,) or (N, K) of particles; where n rows of them are written, and how these are given
    back."""
    shape = np.shape(values)
    flat = len(shape) == 1
    v = view("values", values, None if flat else shape[-1] if shape else 1)
    out = np.empty((n, 1 if flat else v.shape[1]), np.float32)
    return v, out, out[:, 0] if flat else out


def space_of(bounds: Any) -> list[float]:
    """The six numbers of an octree's space; none of what the particles tell."""
    return [] if bounds is None else [float(x) for x in corners("bounds", bounds, np.float32).ravel()]


def check_supports(support: np.ndarray) -> None:
    """Rays are walked in steps of the supports nearby, so those must be of comparable size."""
    largest = float(np.max(support, initial=0.0))
    smallest = float(np.min(support, initial=np.inf, where=support > 0))
    if largest > MAX_SUPPORT:
        raise ValueError(f"support: expected at most {MAX_SUPPORT:g}, got {largest:g}")
    if largest > MAX_RATIO * smallest:
        raise ValueError(f"support: expected all within a factor of {MAX_RATIO:g}, got {smallest:g} to {largest:g}")


def check_update(particles: Any, fields: Iterable[str]) -> None:
    """Raise TypeError for arguments of `update` that are not particles, or known fields, alone."""
    if particles is not None and fields:
        raise TypeError("update: expected particles or fields, got both")
    if unknown := set(fields) - set(FIELDS):
        raise TypeError(f"update: unknown field {sorted(unknown)[0]!r}, expected {', '.join(FIELDS)}")
