"""The layers of a source by name, and which of them are hidden."""

from __future__ import annotations

from typing import Any

from ..scene.mesh import Mesh
from .state import State


def layer_names(source: Any) -> list[tuple[str, str]]:
    """Name and kind ("particles" or "mesh") of each layer, in their order."""
    first = "mesh" if getattr(source, "is_mesh", False) else "particles"
    kinds = [first, *("mesh" if isinstance(x.scene, Mesh) else "particles" for x in source.beside)]
    if len(kinds) == 1:
        return [(source.name, first)] + [("foam", "particles")] * source.has_foam
    return [(f"{i + 1} {kind}", kind) for i, kind in enumerate(kinds)]


def hidden(state: State) -> set[int]:
    """The numbers of the hidden layers, from 0."""
    words = state.layers.hidden.replace(",", " ").split()
    return {int(word) - 1 for word in words if word.isdecimal()}


def visible(layers: list[Any], state: State) -> list[Any]:
    """The layers that are not hidden; at least one stays."""
    gone = hidden(state)
    return [layer for i, layer in enumerate(layers) if i not in gone] or layers[:1]
