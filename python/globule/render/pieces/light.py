"""Images of scenes in pieces whose light turns: made as one scene's, but pieces say what rays meet
(wavefront.py)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np

from ..._base.ranks import Alone
from ...pieces.pieces import Pieces
from ...scene.mesh import Mesh
from ...scene.scene import KERNELS, SceneBase
from ..camera import Camera
from ..frame import Frame
from ..layers import Layer
from ..materials import Material
from ..settings import RenderSettings
from ..trace import trace
from .wavefront import Answers, Spread, Wavefront


class Spokesman(SceneBase):
    """Stands for pieces in an image: a scene without particles, for which `answers` answers."""

    def __init__(self, pieces: Pieces, answers: Answers):
        low, high = pieces.bounds()
        super().__init__(np.empty((0, 3), np.float32), support=1.0, bounds=(low, high), **pieces._options)
        self.surface, self.kernel = pieces.surface, pieces.kernel
        self._kernel, self.threshold = KERNELS.index(pieces.kernel), pieces.threshold
        self.answers = answers

    def neighbors(self, *_: Any, **__: Any) -> NoReturn:
        """Not for scenes in pieces."""
        raise ValueError("pick: expected one scene, got pieces")

    def blend(self, *_: Any, **__: Any) -> NoReturn:
        """Not for scenes in pieces: give `color_by` to `Pieces`."""
        raise ValueError("attribute: expected one scene, got pieces; give color_by to Pieces")


def turns(layers: Sequence[Layer], settings: RenderSettings) -> bool:
    """Whether light goes on from what the camera's rays meet, or a layer is a mesh."""
    s = settings
    if s.shadows or s.ambient_rays or s.sky is not None or isinstance(s.ambient, str):
        return True
    if s.ground is not None or any(isinstance(x.scene, Mesh) for x in layers):
        return True
    return any(_reflects(x.scene, x.material or s.material) for x in layers)


def _reflects(scene: Any, material: Material) -> bool:
    own = material.reflection, material.transmission
    if any(own) or (material.index or 1) != 1:
        return True
    if None not in own or isinstance(scene, Mesh):
        return False
    factors = getattr(scene, "factors", None)  # of all pieces
    if factors is not None:
        return factors > 0
    return scene.particles.reflection is not None or scene.particles.refraction is not None


def shadows_alone(layers: Sequence[Layer], settings: RenderSettings) -> bool:
    """Whether light that goes on casts shadows and nothing else, and nothing is cut: one scene's
    core traces such shadows by tiles, and decides each exactly (src/trace/seen.hpp)."""
    s = settings
    if s.ambient_rays or any(x.clips for x in layers):
        return False
    if s.ground is not None and s.ground.reflection > 0 and s.bounces > 0:
        return False
    return not any(_reflects(x.scene, x.material or s.material) for x in layers)


def render_light(
    layers: Sequence[Layer],
    camera: Camera,
    size: tuple[int, int],
    settings: RenderSettings,
    ranks: Alone,
    progress: Callable[[int, int], object] | None,
) -> Frame:
    """The image of layers of which some are `Pieces`: every rank shades its squares of it."""
    wavefront = Wavefront(ranks)
    shown, opaque = [], shadows_alone(layers, settings)
    for k, layer in enumerate(layers):
        scene = layer.scene
        if isinstance(scene, Pieces):
            material = layer.material or settings.material
            clips = [c._packed for c in layer.clips]
            wavefront.layers[k] = Spread(scene, clips, material._packed, opaque)
            scene = Spokesman(scene, Answers(wavefront, k))
        shown.append(Layer(scene, layer.material, layer.clips))
    comm = ranks if ranks.size > 1 else None
    return trace(shown, camera, size, settings, comm=comm, progress=progress)
