"""The field and blended attributes of a scene on planes, lines, grids and at points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import to_host
from .._base.checks import array_of_numbers, shown
from ..data.attributes import attribute_values
from ..pieces.scene import Scene
from .places import SampleGrid, SampleLine, SamplePlane
from .samples import Samples
from .surface import in_blocks, surface_scene

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

OF_THE_FIELD = ("field", "inside", "gradient")
_MOST_COLUMNS = 64  # of values that are blended at once


def sample(
    scene: Any,
    where: SamplePlane | SampleLine | SampleGrid | ArrayLike,
    values: Sequence[str] | str | None = None,
    device: str = "auto",
    threads: int = 0,
) -> Samples:
    """Values of a scene at places.

    Args:
        scene: a Scene; or Particles, positions (N, 3), or the name of a file, of which a Scene
            with all defaults is made.
        where: a SamplePlane, SampleLine or SampleGrid; or points (M, 3), world.
        values: names. "field": the summed field, which is the scene's threshold at the surface.
            "inside": whether the field is at least the threshold. "gradient": of the field, (3,),
            per world unit; it points inwards. Any other name: x, y, z, a field or an attribute of
            the particles, blended with the weights of the field (`Scene.blend`); vectors stay
            vectors, NAME:0 is one component. Default: "field", "inside" and every attribute.
        device, threads: as for `Scene`, if a scene must be made.

    Returns:
        `Samples`; float32, "inside" bool. Blended values are NaN where no particle reaches.
    """
    scene = surface_scene(scene, device=device, threads=threads)
    names = names_of(scene, values)
    if not names:
        raise ValueError("values: expected at least one name, got none")
    if isinstance(where, (SamplePlane, SampleLine, SampleGrid)):
        lattice = where.lattice(scene)
        points, dims, steps = lattice.points(), lattice.dims, lattice.steps
        coords = dict(zip(dims, lattice.coords, strict=True))
    else:
        points, dims, steps = _points(where), ("point",), np.empty((0, 3))
        coords = {"point": np.arange(len(points))}
    return Samples(points, values_at(scene, points, names), dims, coords, steps, scene.origin)


def values_at(scene: Scene, points: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Name -> values at points (*shape, 3) float32, as `sample` has them."""
    shape, flat = points.shape[:-1], points.reshape(-1, 3)
    found: dict[str, np.ndarray] = {}
    if "field" in names or "inside" in names:
        found["field"] = in_blocks(scene.field, flat)
        found["inside"] = found["field"] >= np.float32(scene.threshold)
    if "gradient" in names:
        found["gradient"] = in_blocks(scene.gradient, flat)
    found |= _blended(scene, flat, [name for name in names if name not in OF_THE_FIELD])
    return {name: found[name].reshape(*shape, *found[name].shape[1:]) for name in names}


def _blended(scene: Scene, points: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Name -> blended values; several at once, since the weights of all are the same."""
    arrays = [_less_middle(scene, name) for name in names]
    found: dict[str, np.ndarray] = {}
    while arrays:
        n = 1
        while n < len(arrays) and sum(_columns(less) for less, _ in arrays[: n + 1]) <= _MOST_COLUMNS:
            n += 1
        some, arrays = arrays[:n], arrays[n:]
        ends = np.cumsum([_columns(less) for less, _ in some])
        together = np.column_stack([less for less, _ in some]) if n > 1 else some[0][0]
        values = in_blocks(lambda p, v=together: scene.blend(p, v), points).reshape(len(points), ends[-1])
        for (less, middle), part in zip(some, np.split(values, ends[:-1], axis=1), strict=True):
            name = names[len(found)]
            found[name] = (part.reshape(len(points), *less.shape[1:]) + middle).astype(np.float32)
    return found


def _columns(array: np.ndarray) -> int:
    return int(np.prod(array.shape[1:]))


def _less_middle(scene: Scene, name: str) -> tuple[np.ndarray, Any]:
    """Values of the particles less their middle, and the middle: the blend's sums are float32, and a
    pressure of 101,325 Pa varies little."""
    array = scene.particles.attributes.get(name)
    if array is None or len(array.shape) == 1:
        array = attribute_values(scene.particles, name)
    array = np.asarray(to_host(array), np.float64)
    finite = np.where(np.isfinite(array), array, np.nan)
    with np.errstate(all="ignore"):
        middle: Any = np.zeros(array.shape[1:])
        if np.isfinite(finite).any():
            middle = (np.fmax.reduce(finite) + np.fmin.reduce(finite)) / 2
            middle = np.where(np.isfinite(middle), middle, 0.0)
    return array - middle, middle


def names_of(scene: Scene, values: Any) -> list[str]:
    """The names that `values` gives, checked; None stands for all."""
    if values is None:
        return ["field", "inside", *scene.particles.attributes]
    names = different_names(values)
    for name in names:
        if name in OF_THE_FIELD or name in scene.particles.attributes:
            continue
        try:
            attribute_values(scene.particles, name)
        except ValueError as error:
            known = str(error).replace("one of ", f"one of {', '.join(OF_THE_FIELD)}, ", 1)
            raise ValueError(f"values: {known}") from None
    return names


def different_names(values: Any) -> list[str]:
    """One name or several, each once."""
    names = [values] if isinstance(values, str) else values
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise TypeError(f"values: expected names, got {shown(values)}")
    return list(dict.fromkeys(names))


def _points(where: Any) -> np.ndarray:
    points = array_of_numbers(to_host(where), np.float32)
    expected = "a SamplePlane, SampleLine, SampleGrid or points (M, 3)"
    if points.ndim != 2 or points.shape[1] != 3:
        raise TypeError(f"where: expected {expected}, got {shown(where)}")
    if not np.isfinite(points).all():
        first = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise ValueError(f"where: expected finite points, got {points[first]} (point {first})")
    return points
