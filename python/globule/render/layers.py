"""The layers of an image: scenes, each with its own material and cuts."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from inspect import getattr_static
from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import on_gpu, to_host
from .._base.checks import named, shown
from .._base.device import Device
from ..data import attributes
from ..data.particles import Particles
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene, unless_divided
from ..scene.mesh import Mesh
from ..scene.scene import SceneBase
from ..scene.sources import as_particles
from .clips import CLIPS, Clip
from .materials import Material

MAX_LAYERS: int = _core.limits["layers"]


@named
@dataclass(frozen=True)
class Layer:
    """One of several scenes in an image, with its own material and clips.

    A ray may be inside several layers at once: vessels in translucent tissue, each its own scene.
    Where a solid mesh and a fluid overlap, the mesh counts: water whose particles reach into the
    glass of a tank touches the glass without a gap.

    Args:
        scene: a `Scene` or a `Mesh`; or an argument of `Scene`: `Particles`, positions or a file's
            name.
        material: default: the material of the settings.
        clips: cuts through this layer alone, or a single one.
    """

    scene: Any  # a Scene or a Mesh
    material: Material | None = None
    clips: Sequence[Clip] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", as_scene(self.scene))
        if not isinstance(self.material, (Material, type(None))):
            raise TypeError(f"material: expected Material, got {shown(self.material)}")
        object.__setattr__(self, "clips", _clips(self.clips))


def split_layers(
    particles: Particles, name: str, materials: Mapping[Any, Material | None], **options: Any
) -> list[Layer]:
    """Divide particles by the values of an attribute. Each part is a layer for `render`.

        render(split_layers(particles, "phase", {0: water, 1: oil}), settings=…)

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


def as_scene(value: Any) -> SceneBase | Mesh:
    """The scene that `value` stands for: a `Scene` or `Mesh`, an object with a scene, what `Scene`
    takes, or the name of a file with faces."""
    if in_pieces(value):
        return value
    mesh = _mesh_of(value)
    if mesh is not None:
        return mesh
    own = _own_scene(value)
    return shown_scene(value) if own is None else own


def _mesh_of(value: Any) -> Mesh | None:
    """A mesh, or that of a file with faces."""
    if isinstance(value, (str, os.PathLike)):
        from ..formats.triangles import part_has_faces  # formats are loaded when they are needed

        return Mesh(value) if part_has_faces(value) else None
    return value if isinstance(value, Mesh) else None


def in_pieces(value: Any) -> bool:
    """Whether particles of which no process has all."""
    return getattr(value, "in_pieces", False) is True


def core_scene(scene: SceneBase | Mesh, device: Device) -> Any:
    """The core's own object."""
    return scene.build(device) if isinstance(scene, Mesh) else scene._scene


def device_of(layers: Sequence[Layer]) -> Device:
    """The device of the particles; of meshes alone, that of the first one."""
    scenes = [x.scene for x in layers]
    return next((s for s in scenes if isinstance(s, SceneBase)), scenes[0]).device


def layers_of(scene: Any, clips: Any, color: tuple) -> tuple[Layer, ...]:
    """Layers of an image, each with its own clips and those of all."""
    given, everywhere = _several(scene), _clips(clips)
    if not 1 <= len(given) <= MAX_LAYERS:
        raise ValueError(f"scene: expected 1 to {MAX_LAYERS} layers, got {len(given)}")
    if color[0] is not None and len(given) > 1:
        raise ValueError(
            f"color_by: expected one scene, got {len(given)} layers; "
            "globule.color_by(particles, name) colors the particles of one"
        )
    layers: list[Layer] = []
    for item in given:
        own = item if isinstance(item, Layer) else Layer(_colored(item, color))
        if own is item and color[0] is not None:
            _colored(own.scene, color)
        if isinstance(own.scene, SceneBase) and own.scene.device != device_of(layers or [own]):
            scenes = [x.scene for x in layers if isinstance(x.scene, SceneBase)]
            if scenes:
                raise ValueError(f"scene: expected all layers on {scenes[0].device.name}, got {own.scene.device.name}")
        layers.append(Layer(own.scene, own.material, (*own.clips, *everywhere)))
    # Last, so that the layers that were given keep their numbers.
    layers += [Layer(s, x.material, x.clips) for x in layers for s in beside(x.scene)]
    need_one_origin(layers)
    if len(layers) > MAX_LAYERS:
        raise ValueError(
            f"scene: expected at most {MAX_LAYERS} layers, got {len(layers)}: a simulation's "
            "tissue, fluids and other things that are shown are one each"
        )
    return tuple(layers)


def need_one_origin(layers: Sequence[Layer]) -> None:
    """Refuse layers whose places are given from several origins."""
    shown = [x.scene for x in layers if isinstance(x.scene, (Mesh, SceneBase)) and len(x.scene)]
    origins = list(dict.fromkeys(s.origin for s in shown if s.origin is not None))
    if len(origins) > 1:
        raise ValueError(
            f"scene: expected layers with one origin, got {origins[0]} and {origins[1]}: read "
            f"each with origin={origins[0]}, or give Particles.at({origins[0]})"
        )


def beside(scene: Any) -> tuple[SceneBase, ...]:
    """What a simulation shows in scenes of their own; nothing of other scenes."""
    return getattr(scene, "beside", ())


_ONE = (str, os.PathLike, Layer, SceneBase, Mesh, Particles)


def _several(scene: Any) -> tuple:
    """The scenes of a list of them, or the one scene."""
    single = isinstance(scene, (*_ONE, Mapping, np.ndarray)) or in_pieces(scene)
    has_particles = getattr_static(scene, "particles", None) is not None  # not read: they are all of a simulation
    if single or on_gpu(scene) or has_particles or not hasattr(scene, "__iter__"):
        return (scene,)
    given = tuple(scene)
    named = given and (isinstance(given[0], _ONE) or in_pieces(given[0]))
    positions = given and not named and hasattr(given[0], "__len__")
    return (given,) if positions else given


def _own_scene(item: Any) -> SceneBase | None:
    own = item if isinstance(item, SceneBase) else getattr(item, "scene", None)
    return own if isinstance(own, SceneBase) else None


def _colored(item: Any, color: tuple) -> SceneBase | Mesh:
    """The scene of an item, colored by (name, colormap, range) where a name is given."""
    if color[0] is None:
        return as_scene(item)
    mesh = _mesh_of(item)
    if mesh is not None:
        try:
            mesh.color_by(*color)
        except ValueError as error:
            prefix = "color_by: " if str(error).startswith("expected") else ""
            raise ValueError(f"{prefix}{error}") from None
        return mesh
    own = _own_scene(item)
    if own is not None and own is item:
        own._color_by(*color)
        return own
    if own is None:
        item, divided = unless_divided(item, color)
        if divided is not None:
            return divided
    particles = attributes.color_by(as_particles("scene", own or item), *color)
    # A simulation's scene is updated by nobody else.
    return shown_scene(particles) if own is None else scene_like(own, particles)


def scene_like(scene: SceneBase, particles: Particles) -> Scene:
    """A new scene of these particles with the surface of another one."""
    options: dict[str, Any] = {"device": scene.device.name}
    if beside(scene):  # of different things no one surface is smooth
        return Scene(particles, scene.kernel, **options)
    if scene.surface == "smooth":
        if particles.weight is not None and np.ndim(particles.weight):
            particles = particles[np.flatnonzero(to_host(particles.weight) > 0)]
        options |= {"surface": "smooth", "spacing": scene.spacing}
    return Scene(particles, scene.kernel, scene.threshold, **options)


def _clips(clips: Any) -> tuple[Clip, ...]:
    if isinstance(clips, CLIPS):
        return (clips,)
    try:
        found = tuple(clips)
    except (TypeError, NotImplementedError):  # the latter: a memoryview
        expected = "a list of ClipPlane, ClipBox or ClipSphere"
        raise TypeError(f"clips: expected {expected}, got {shown(clips)}") from None
    for clip in found:
        if not isinstance(clip, CLIPS):
            raise TypeError(f"clips: expected ClipPlane, ClipBox or ClipSphere, got {shown(clip)}")
    return found
