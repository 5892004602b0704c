"""Particles: positions with optional per-particle properties."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .._base.arrays import dtype_name, extent, gpu_shape, on_gpu, to_host
from .._base.checks import named, shown, unit
from .._base.fixed import Checked
from .._base.terminal import place_text

SCALAR_FIELDS = ("support", "weight", "reflection", "refraction", "rigidity")
FIELDS = ("positions", *SCALAR_FIELDS, "color", "anisotropy")


FARTHEST = np.float32(1e18)  # past it a coordinate's square overflows float32
MOST_ROUNDING = 0.2  # step of float32 by the spacing of particles: half of it moves them
FINE_ROUNDING = 1e-3  # the same, where an origin is to be had
HERE = (0.0, 0.0, 0.0)
UP, Z_UP = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class Attributes(Checked):
    """Named values of n particles; each assignment is checked."""

    def __init__(self, given: Mapping[str, Any] | Iterable[tuple[str, Any]] = (), n: int = -1):
        super().__init__()
        self._n = n
        try:
            given = dict(given)
        except (TypeError, ValueError, NotImplementedError):
            raise TypeError(f"attributes: expected a dict of arrays, got {shown(given)}") from None
        self.update(given)

    def __setitem__(self, name: str, value: Any) -> None:
        super().__setitem__(name, _attribute(name, value, self._n))

    def __reduce__(self) -> tuple:
        return Attributes, (dict(self), self._n)


@named
@dataclass(eq=False, repr=False)
class Particles:
    """A set of N particles.

    Arrays may be anything that NumPy understands, or GPU arrays (`__cuda_array_interface__`, or
    DLPack with a GPU device). Host data become C-contiguous float32, without a copy if the data
    already have this form. GPU arrays must be C-contiguous float32 and are not copied.

    Args:
        positions: (N, 3) float32, world; (N, 2) become (N, 3) with z = 0. A particle whose position
            is not finite has no influence.
        support: radius at which a particle's kernel vanishes: float or (N,) float32, world, >= 0.
        weight: factor of the kernel: float or (N,) float32; may be negative.
        anisotropy: (N, 3, 3) float32, 1 / world: symmetric positive definite matrices G that make
            the kernel b(|G (x - position)|), in place of the support; `anisotropy` finds them.
        color: (3,) or (N, 3) float32, linear RGB in [0, 1]; uint8 input is divided by 255.
        reflection, refraction, rigidity: float or (N,) float32.
        attributes: name -> (N,) or (N, k) array of any real numeric dtype.
        origin: (x, y, z) float64, world: the place from which the positions are given, for
            coordinates that float32 could not tell apart; `relative` finds one.
        names: name of an attribute of whole numbers -> value -> name, such as that of a type;
            legends show them. A column of words in the file, which is left out, has none.
        up: (x, y, z) of unit length, world: upwards in images; y, unless the format of the file
            that was read has z there.

    None means "not given". A program may assign fields later; the assignment checks the value. The
    length N cannot change while any field has one value per particle.

    Raises TypeError for data that are not numeric, or not float32 on the GPU, and ValueError for a
    wrong shape or value; both name the argument, the expected and the given value.
    """

    positions: Any
    support: Any = None
    weight: Any = None
    color: Any = None
    reflection: Any = None
    refraction: Any = None
    rigidity: Any = None
    anisotropy: Any = None
    attributes: dict[str, Any] = field(default_factory=dict)
    origin: tuple[float, float, float] = HERE
    up: tuple[float, float, float] = UP
    names: dict[str, dict[int, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check({})
        self.attributes = Attributes(self.attributes, len(self))

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "origin":
            value = as_origin(value)
        elif name == "up":
            value = tuple(unit("up", value))
        elif name == "names":
            value = {str(key): dict(words) for key, words in dict(value).items()}
        elif name not in FIELDS and name != "attributes":
            known = ", ".join((*FIELDS, "attributes"))
            raise AttributeError(
                f"Particles: expected one of {known}, got {name}; values of your own go to attributes[{name!r}]"
            )
        elif isinstance(vars(self).get("attributes"), Attributes):  # else it is still being made
            value = self._checked(name, value)
        object.__setattr__(self, name, value)

    def _checked(self, name: str, value: Any) -> Any:
        """A field that replaces another one."""
        if name == "attributes":
            return Attributes(value, len(self))
        if name != "positions":
            return None if value is None else _CHECKS[name](name, value, len(self))
        positions, n = _positions(value), len(self)
        if len(positions) != n:
            each = self._each()
            if each or self.attributes:
                raise ValueError(
                    f"positions: expected shape ({n}, 3), as {(*each, *self.attributes)[0]} has "
                    f"{n} rows, got {tuple(positions.shape)}; make new Particles instead"
                )
            object.__setattr__(self, "attributes", Attributes({}, len(positions)))
        return positions

    def _each(self) -> list[str]:
        """The fields with one value a particle."""
        return [f for f in (*SCALAR_FIELDS, "color", "anisotropy") if self._of_each(f)]

    def _of_each(self, name: str) -> bool:
        """Whether a field has one value a particle, rather than one for all or none."""
        shape = getattr(getattr(self, name), "shape", ())
        return len(shape) > (1 if name == "color" else 0)

    def _check(self, known: dict[str, Any]) -> None:
        """Check all fields, but those that are the very objects in `known`, which passed."""
        object.__setattr__(self, "positions", _positions(self.positions))
        n = len(self)
        if known and n != known["positions"].shape[0]:
            known = {}
        for name, check in _CHECKS.items():
            value = getattr(self, name)
            if value is not None and value is not known.get(name):
                object.__setattr__(self, name, check(name, value, n))

    def _with(self, fields: dict[str, Any], known: dict[str, Any]) -> Particles:
        """With other arrays for some fields, and without attributes; `known` as for `_check`."""
        n = len(self)
        stay = [f for f in self._each() if f not in fields]
        shape = getattr(fields.get("positions"), "shape", (n, 3))
        if stay and len(shape) == 2 and shape[1] == 3 and shape[0] != n:
            raise ValueError(
                f"positions: expected {n:,} rows, as {stay[0]} has, got {shape[0]:,}; "
                f"give {' and '.join(stay)} too, or new Particles"
            )
        new = object.__new__(Particles)
        vars(new).update(vars(self), attributes={})
        vars(new).update(fields)
        new._check(known)
        vars(new)["attributes"] = Attributes({}, len(new))
        return new

    def __len__(self) -> int:
        return int(self.positions.shape[0])

    def __repr__(self) -> str:
        parts = [f"{len(self)}"]
        for name in (*SCALAR_FIELDS, "color", "anisotropy"):
            value = getattr(self, name)
            if isinstance(value, float):
                parts.append(f"{name}={value:g}")
            elif value is not None:
                parts.append(f"{name} {tuple(value.shape)}")
        parts += [f"{name} {tuple(array.shape)}" for name, array in self.attributes.items()]
        return f"Particles({', '.join(parts)})"

    def __getitem__(self, index: Any) -> Particles:
        """The particles selected by an integer, slice, integer array or boolean mask."""
        if isinstance(index, (int, np.integer)):
            i = range(len(self))[index]
            index = slice(i, i + 1)

        picked = {}
        for name in (*SCALAR_FIELDS, "color", "anisotropy"):
            value = getattr(self, name)
            picked[name] = value[index] if self._of_each(name) else value
        attributes = {name: array[index] for name, array in self.attributes.items()}
        return Particles(self.positions[index], **picked, attributes=attributes,
                         origin=self.origin, up=self.up, names=self.names)  # fmt: skip

    def world_positions(self) -> np.ndarray:
        """(N, 3) positions, world: float64 where there is an origin, else float32."""
        positions = to_host(self.positions)
        return positions if self.origin == HERE else positions + np.asarray(self.origin)

    def at(self, origin: Iterable[float]) -> Particles:
        """The same particles with positions given from another origin; warns where float32 does not
        keep them."""
        origin = as_origin(origin)
        if origin == self.origin:
            return self
        moved = to_host(self.positions) + np.subtract(self.origin, origin)
        if lost := lost_precision(moved):
            warnings.warn(lost, stacklevel=2)
        return replace(self, positions=moved.astype(np.float32), origin=origin)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lowest, highest) corner of the finite positions: two (3,) float32, world.

        Coordinates beyond 1e18 count as infinite, as in the octree. Raises ValueError if no
        position is finite.
        """
        finite = self.finite_positions()
        if len(finite) == 0:
            raise ValueError(f"bounds: expected a finite position, got none in {len(self)}")
        return extent(finite)

    def n_missing(self) -> int:
        """How many particles on the host have NaN or inf in a coordinate: they are not drawn."""
        if not len(self) or on_gpu(self.positions) or np.isfinite(extent(self.positions)).all():
            return 0
        return int((~np.isfinite(self.positions).all(axis=1)).sum())

    def finite_positions(self) -> np.ndarray:
        """The positions inside the octree: (M, 3) float32, M <= N, a NumPy array; where all are
        inside, the particles' own."""
        positions = to_host(self.positions)
        if len(positions) and (np.abs(extent(positions)) <= FARTHEST).all():
            return positions
        return positions[(np.abs(positions) <= FARTHEST).all(axis=1)]


def _positions(value: Any) -> Any:
    if on_gpu(value):
        shape = gpu_shape(value)
        if len(shape) != 2 or shape[1] != 3:
            raise ValueError(f"positions: expected shape (N, 3), got {shape}")
        return _checked_on_gpu("positions", value, shape)
    array = _numbers("positions", value)
    if array.shape == (0,):
        array = array.reshape(0, 3)
    if array.ndim == 2 and array.shape[1] == 2:  # 2-D data: z is 0
        array = np.concatenate([array, np.zeros((len(array), 1), array.dtype)], axis=1)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"positions: expected shape (N, 3), got {array.shape}")
    if array.itemsize > 4 and (lost := lost_precision(array)):
        warnings.warn(lost, stacklevel=6)
    return _float32(array)


def lost_precision(positions: np.ndarray) -> str:
    """What to say of positions (N, 3) float64 so far from the origin that float32 cannot tell them
    apart, or moves them by a good part of their distance; "" where float32 keeps them."""
    farthest, step, spacing, origin = _rounding(positions, 9)  # fewer may be a box's corners
    if step <= MOST_ROUNDING * spacing:
        return ""
    return (
        f"positions: near {farthest:.6g} float32 has steps of {step:.3g}, and the particles are "
        f"about {spacing:.2g} apart: it cannot tell them apart; subtract an origin, such as "
        f"{place_text(origin)}, from the float64 positions"
    )


def relative(positions: Any) -> tuple[Any, tuple[float, float, float]]:
    """Positions (N, 3) given from an origin, and the origin: 0, 0, 0 where the positions are not
    float64, or float32 keeps them; there they are what they were."""
    if not isinstance(positions, np.ndarray) or positions.dtype.kind not in "iuf":
        return positions, HERE
    if positions.itemsize < 8 or positions.ndim != 2 or positions.shape[1] not in (2, 3):
        return positions, HERE
    if positions.shape[1] == 2:
        positions = np.pad(positions, ((0, 0), (0, 1)))
    _, step, spacing, origin = _rounding(positions, 2)
    if step <= FINE_ROUNDING * spacing:
        return positions, HERE
    found = as_origin(origin)
    return positions - found, found


def as_origin(value: Any) -> tuple[float, float, float]:
    """(x, y, z), checked. Raises ValueError."""
    try:
        x, y, z = (float(v) + 0.0 for v in value)
    except (TypeError, ValueError):
        raise ValueError(f"origin: expected (x, y, z), got {shown(value)}") from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ValueError(f"origin: expected three finite numbers, got {shown(value)}")
    return x, y, z


def _rounding(positions: np.ndarray, least: int) -> tuple[float, float, float, np.ndarray]:
    """Of positions (N, 3): the farthest coordinate, float32's step there, the spacing of the
    particles, and an origin near them; a spacing of inf where fewer than `least` tell."""
    some = positions[:: 1 + len(positions) // 20_000]
    some = some[(np.abs(some) <= FARTHEST).all(axis=1)]
    if len(some) < least:
        return 0.0, 0.0, math.inf, np.zeros(3)
    lo, hi = np.percentile(some, (2, 98), axis=0)  # without strays
    extent = np.sort(hi - lo)[::-1]
    # As many particles a length, an area or a volume, whichever they fill.
    spacing = max(
        float(np.exp(np.log(np.maximum(extent[:d], 1e-300)).mean()) / len(positions) ** (1 / d)) for d in (1, 2, 3)
    )
    farthest = float(max(np.abs(lo).max(), np.abs(hi).max()))
    step = float(np.spacing(np.float32(farthest)))
    if not extent[0] > 0:
        return farthest, step, math.inf, np.zeros(3)
    power = 10.0 ** math.floor(math.log10(extent[0]))
    return farthest, step, spacing, np.floor(lo / power) * power


def _scalar_field(name: str, value: Any, n: int) -> Any:
    if on_gpu(value):
        return _checked_on_gpu(name, value, (n,))
    array = _numbers(name, value)
    if array.shape not in ((), (n,)):
        raise ValueError(f"{name}: expected a number or shape ({n},), got shape {array.shape}")
    result = _float32(array)
    _check_range(name, result, 0.0 if name == "support" else -math.inf, math.inf)
    return float(array) if array.ndim == 0 else result


def _color(name: str, value: Any, n: int) -> Any:
    if on_gpu(value):
        return _checked_on_gpu(name, value, (n, 3))
    array = _numbers(name, value)
    if array.shape not in ((3,), (n, 3)):
        raise ValueError(f"{name}: expected shape (3,) or ({n}, 3), got {array.shape}")
    if array.dtype == np.uint8:
        return array.astype(np.float32) / np.float32(255)
    result = _float32(array)
    _check_range(name, result, 0.0, 1.0)
    return result


def _anisotropy(name: str, value: Any, n: int) -> np.ndarray:
    array = _float32(_numbers(name, to_host(value) if on_gpu(value) else value))
    if array.shape != (n, 3, 3):
        raise ValueError(f"{name}: expected shape ({n}, 3, 3), got {array.shape}")
    good = np.isfinite(array).all(axis=(1, 2))
    size = np.abs(np.where(good[:, None, None], array, 1)).max(axis=(1, 2))
    good &= np.abs(array - array.transpose(0, 2, 1)).max(axis=(1, 2), initial=0) <= 1e-4 * size
    good[good] = np.linalg.eigvalsh(array[good])[:, 0] > 0
    if not good.all():
        raise ValueError(
            f"{name}: expected symmetric positive definite matrices, "
            f"got {array[np.argmin(good)].tolist()} (particle {np.argmin(good)})"
        )
    return array


_CHECKS: dict[str, Callable[[str, Any, int], Any]] = {
    **dict.fromkeys(SCALAR_FIELDS, _scalar_field), "color": _color, "anisotropy": _anisotropy,
}  # fmt: skip


def _attribute(name: Any, value: Any, n: int) -> Any:
    if not isinstance(name, str):
        raise TypeError(f"attributes: expected names of type str, got {type(name).__name__}")
    if name in FIELDS or not name:
        raise ValueError(f"attributes: expected a name of its own, got {name!r}")
    array = value if on_gpu(value) else _numbers(f"attributes[{name!r}]", value)
    shape = gpu_shape(array)
    n = shape[0] if n < 0 and shape else n  # of no particles in particular
    if len(shape) not in (1, 2) or shape[0] != n or 0 in shape[1:]:
        raise ValueError(f"attributes[{name!r}]: expected shape ({n},) or ({n}, k), got {shape}")
    if array is not value or isinstance(array, np.ndarray):
        array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))
    return array


_NUMPY_READS = ("__array__", "__array_interface__", "__array_struct__")


def _numbers(name: str, value: Any) -> np.ndarray:
    """A host array of real numbers, in whatever dtype it came."""
    # Warp's DLPack capsules must not outlive Warp at the interpreter's end, so that DLPack is last.
    if hasattr(value, "__dlpack__") and not any(hasattr(value, name) for name in _NUMPY_READS):
        array = np.from_dlpack(value)
    else:
        try:
            array = np.asarray(value)
        except ValueError as error:  # ragged lists
            raise TypeError(f"{name}: expected an array of numbers, got {error}") from None
    if array.dtype.kind not in "biuf":
        raise TypeError(f"{name}: expected numbers, got dtype {array.dtype}")
    return array


def _float32(array: np.ndarray) -> np.ndarray:
    if array.dtype == np.float32 and array.flags.c_contiguous:
        return array
    with np.errstate(over="ignore", invalid="ignore"):  # too large becomes inf, checked after
        return np.asarray(array, dtype=np.float32, order="C")


def _check_range(name: str, array: np.ndarray, least: float, most: float) -> None:
    good = np.isfinite(array) & (array >= least) & (array <= most)
    if good.all():
        return
    if math.isinf(least):
        expected = "finite numbers"
    else:
        expected = f"numbers >= {least:g}" if math.isinf(most) else f"[{least:g}, {most:g}]"
    first = np.argmin(good.reshape(-1))
    got = array.reshape(-1)[first]
    where = f" (particle {first // max(1, array.shape[-1] if array.ndim == 2 else 1)})"
    raise ValueError(f"{name}: expected {expected}, got {got:g}{where if array.ndim else ''}")


def _checked_on_gpu(name: str, array: Any, shape: tuple[int, ...]) -> Any:
    """GPU memory is used where it lies, so that it must have the final layout already."""
    interface = getattr(array, "__cuda_array_interface__", None)
    if interface is None:
        dtype, strides = str(array.dtype), None
    else:
        dtype, strides = dtype_name(interface["typestr"]), interface.get("strides")
    if not dtype.endswith("float32"):
        raise TypeError(f"{name}: expected float32 on the GPU, got {dtype}")
    if (found := gpu_shape(array)) != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {found}")
    packed = (12, 4) if len(shape) == 2 else (4,)
    if strides is not None and tuple(strides) != packed and 0 not in shape:
        raise TypeError(f"{name}: expected a C-contiguous array on the GPU, got strides {strides}")
    return array
