"""Whether there is memory for the particles of a scene, which are counted before any is made."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .._base.memory import room
from .limits import n_places
from .schema import SceneError
from .shapes import Box, Plane

# Of main memory for each particle, measured at the peak of a first step.
BYTES = {"fluids": 1000, "solids": 2250, "rigids": 1000, "boundaries": 1000, "emitters": 1000}


def check_room(scene: Any, shapes: dict[int, Any]) -> None:
    """Refuse a scene whose particles do not fit in free memory.

    Args:
        scene: a `SceneFile`.
        shapes: of its tables by their `id`; files are loaded.

    Raises:
        SceneError: names the largest body, and a spacing that fits.
    """
    free = room()
    needs = list(_needs(scene, shapes, scene.spacing))
    if sum(size for size, _, _ in needs) <= free:
        return
    size, n, name = max(needs)
    spacing, widest = scene.spacing, np.subtract(scene.domain.hi, scene.domain.lo).min() / 2
    while spacing < widest and sum(size for size, _, _ in _needs(scene, shapes, spacing)) > free:
        spacing *= 1.05
    advice = "no spacing helps"
    if spacing < widest:
        advice = f"a spacing of {1.005 * spacing:.3g} m would fit"  # also once it is rounded
    raise SceneError(
        f"{name}: expected particles that fit in the {free / 2**30:.3g} GiB that are free or "
        f"allowed, got about {n:.3g} that need {size / 2**30:.3g} GiB; {advice}"
    )


def _needs(scene: Any, shapes: dict[int, Any], spacing: float) -> Iterator[tuple[float, float, str]]:
    """Bytes, number of particles and name, with another spacing, m, than the scene's own."""
    size = spacing / scene.spacing
    for kind, of_each in BYTES.items():
        for i, table in enumerate(getattr(scene, kind)):
            d = size * (scene.fluid_spacing if kind in ("fluids", "emitters") else scene.spacing)
            n = _brought(scene, table, d) if kind == "emitters" else 0.0
            shape = shapes.get(id(table))
            if isinstance(shape, Plane):
                n = math.dist(scene.domain.lo, scene.domain.hi) ** 2 / d**2
            elif shape is not None:
                n = shape.area() / d**2 if kind == "boundaries" else shape.volume() / d**3
            yield n * of_each, n, f"{kind}[{i}] ({table.name})"
    if scene.domain.walls:
        n = Box(scene.domain.lo, scene.domain.hi).area() / spacing**2
        yield n * BYTES["boundaries"], n, "domain.walls"


def _brought(scene: Any, emitter: Any, d: float) -> float:
    """How many particles an emitter brings while the scene runs, if nothing takes them away."""
    side_by_side = n_places(emitter.radius, d)
    if scene.sinks or any(tool.kind == "suction" for tool in scene.instruments):
        return side_by_side
    end = scene.seconds if emitter.end is None else min(emitter.end, scene.seconds)
    return max(side_by_side, emitter.rate * max(end - emitter.start, 0.0) / d**3)
