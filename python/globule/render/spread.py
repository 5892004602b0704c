"""Layers of scenes that are in pieces or on ranks, made ready for an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..pieces.gathered import replicated_bytes
from ..pieces.scene import SceneInPieces, SceneOnRanks
from .layers import Layer
from .pieces.light import turns
from .settings import RenderSettings


def settled(
    first: SceneInPieces | SceneOnRanks, layers: Sequence[Layer], settings: RenderSettings, comm: Any, whole: bool
) -> tuple[tuple[Layer, ...], Any]:
    """The layers with pieces or scenes of all particles in the place of those in pieces or on
    ranks, and the ranks that share out the pixels of the latter.

    Args:
        first: of these scenes.
        whole: the image needs all particles in one scene, whatever the light.
    """
    if isinstance(first, SceneInPieces):
        return in_pieces(first, layers, comm, whole), None
    return on_ranks(first, layers, settings, comm, whole)


def in_pieces(first: SceneInPieces, layers: Sequence[Layer], comm: Any, whole: bool) -> tuple[Layer, ...]:
    """The layers with pieces in the place of scenes in pieces."""
    if comm is not None:
        raise ValueError(
            "comm: expected None with a scene in pieces, got one; "
            "globule.Scene(particles, comm=...) shares particles out among the ranks"
        )
    if whole:
        raise ValueError(f"annotate: expected None with a scene in pieces: {first.why()}")
    if any(isinstance(x.scene, SceneOnRanks) for x in layers):
        raise ValueError("scene: expected all layers on the same ranks")
    return tuple(
        Layer(x.scene.pieces, x.material, x.clips) if isinstance(x.scene, SceneInPieces) else x for x in layers
    )


def on_ranks(
    first: SceneOnRanks, layers: Sequence[Layer], settings: RenderSettings, comm: Any, whole: bool
) -> tuple[tuple[Layer, ...], Any]:
    """The layers with pieces, or scenes of all particles, in the place of scenes on ranks."""
    if comm is not None:
        raise ValueError("comm: expected None with a scene on ranks, which has its own")
    own = [x.scene for x in layers if isinstance(x.scene, SceneOnRanks)]
    if any(x.scene.ranks.size != first.ranks.size for x in layers
           if isinstance(x.scene, SceneOnRanks)):  # fmt: skip
        raise ValueError("scene: expected all layers on the same ranks")
    replicate = first.mode == "replicate" or (whole and first.mode == "auto")
    if first.mode == "auto" and (whole or turns(layers, settings)):
        need = sum(replicated_bytes(len(scene), scene.surface) for scene in own)
        free = float(first.ranks.least(np.float64(first.room())))
        if whole and need > free:
            raise MemoryError(
                "scene: expected memory for all particles on every rank, which annotations "
                f"need, {need / 1e9:.3g} GB, got {free / 1e9:.3g} GB; leave them out, or "
                "start fewer ranks on each computer"
            )
        replicate = need <= free
    found = [x if not isinstance(x.scene, SceneOnRanks) else
             Layer(x.scene.used(replicate), x.material, x.clips) for x in layers]  # fmt: skip
    return tuple(found), first.ranks if replicate else None
