"""One image of several phases, each with its own material."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.arrays import to_host
from ..scene.particles import Particles
from ..scene.scene import Scene
from .frame import MAX_LAYERS, Layer
from .materials import Material


def layers_by(
    particles: Particles, name: str, materials: Mapping[Any, Material | None], **options: Any
) -> list[Layer]:
    """Divide particles by the values of an attribute. Each part is a layer for `render`.

        render(layers_by(particles, "phase", {0: water, 1: oil}), settings=…)

    Each part is a scene of its own, and the fields of two phases do not add up. Where phases touch,
    both surfaces reach beyond their outermost particles. All parts have the same support: the
    support of the particles, or a support measured on all particles.

    Args:
        particles: with an attribute `name`, (N,) numbers.
        materials: value -> `Material`, or None for the settings'; 1 to 4. The function omits
            particles with other values.
        options: options of every `Scene`.

    Returns:
        Layers in the order of `materials`; if no particle has a value, the layer of the value is
        empty.

    Raises ValueError naming the argument, the expected and the given value.
    """
    if name not in particles.attributes:
        known = ", ".join(particles.attributes) or "none"
        raise ValueError(f"name: expected an attribute ({known}), got {name!r}")
    values = to_host(particles.attributes[name])
    if values.ndim != 1:
        raise ValueError(f"name: expected an attribute (N,), got {name!r} {values.shape}")
    if not 1 <= len(materials) <= MAX_LAYERS:
        raise ValueError(f"materials: expected 1 to {MAX_LAYERS}, got {len(materials)}")
    if particles.support is None and "support" not in options:
        options = {**options, "support": Scene(particles, **options).support}
    parts = ((particles[np.flatnonzero(values == value)], m) for value, m in materials.items())
    return [Layer(Scene(part, **options), material) for part, material in parts]
