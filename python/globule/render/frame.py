"""Pictures of a scene."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from .. import _core
from .._base.arrays import to_host
from .._base.checks import number, three, whole
from .._base.files import atomic_write
from .._base.fixed import Fixed
from ..scene.scene import Scene
from ..scene.thesis import Thesis, check_tracing
from .camera import Camera
from .clips import ClipBox, ClipPlane, ClipSphere
from .lights import (
    MAX_LIGHTS,
    DirectionalLight,
    Environment,
    Ground,
    Headlight,
    PointLight,
    Sky,
    uniform_sky,
)
from .materials import Material

MAX_PIXELS = 2**28
MAX_LAYERS = 4
MAX_SAMPLES = 65536
# How far from a particle, in supports, the surface may lie: where b is an eighth of the default
# threshold, so that it takes eight particles at one place to reach that.
REACH = {
    "murakami": 0.85,
    "nishimura": 0.78,
    "wyvill": 0.82,
    "blinn": 0.47,
    "cubic_spline": 0.67,
    "wendland_c2": 0.62,
    "solid": 0.69,
}


@dataclass(frozen=True)
class RenderSettings(Fixed):
    """How hits are turned into light. Colours and radiances are linear, [0, 1] for white.

    lights: up to 8
    ambient: light from everywhere: a colour, or "sky" for the sky's own
    background: behind the scene, where `sky` is None
    material: of every scene that has none of its own
    specular, shininess: highlight of the lights, where the material says nothing
    exposure: factor of the picture's light
    shadows: whether directional and point lights throw them
    ambient_rays: rays per sample that look how open a place is (ambient occlusion); 0: none
    ambient_distance: how far they look, world; None: a tenth of the scene
    sky: `Sky` or `Environment`; also seen behind the scene. None: the background all around
    ground: a plane under the scene
    depth: mirrored and transmitted generations that are followed, at most
    cutoff: a ray that carries less than this share of a pixel's light ends in the sky
    samples: rays per pixel; the first goes through its centre, the others anywhere in it
    """

    lights: Sequence[Headlight | DirectionalLight | PointLight] = (Headlight(), DirectionalLight())
    ambient: Any = (0.16, 0.18, 0.21)
    background: Any = (0.93, 0.94, 0.96)
    material: Material = Material()
    specular: float = 0.22
    shininess: float = 60.0
    exposure: float = 1.0
    shadows: bool = False
    ambient_rays: int = 0
    ambient_distance: float | None = None
    sky: Sky | Environment | None = None
    ground: Ground | None = None
    depth: int = 4
    cutoff: float = 1 / 32
    samples: int = 1

    @cached_property
    def _packed(self) -> Any:
        """What the core takes; how far ambient rays look in no scene in particular: 0."""
        lights = _items("lights", self.lights, "a list of lights")
        if len(lights) > MAX_LIGHTS:
            raise ValueError(f"lights: expected at most {MAX_LIGHTS}, got {len(lights)}")
        for light in lights:
            if not isinstance(light, (Headlight, DirectionalLight, PointLight)):
                raise TypeError(
                    f"lights: expected Headlight, DirectionalLight or PointLight, got {light!r}"
                )
        if not isinstance(self.sky, (Sky, Environment, type(None))):
            raise TypeError(f"sky: expected Sky or Environment, got {self.sky!r}")
        if not isinstance(self.ground, (Ground, type(None))):
            raise TypeError(f"ground: expected Ground, got {self.ground!r}")
        sky_light = isinstance(self.ambient, str)
        if sky_light and self.ambient != "sky":
            raise ValueError(f'ambient: expected a colour or "sky", got {self.ambient!r}')
        rays = whole("ambient_rays", self.ambient_rays, 0, 256)
        far = 0.0 if self.ambient_distance is None else self.ambient_distance
        distance = number("ambient_distance", far, 0.0)
        background = three("background", self.background, 0.0)
        return _core.Look(
            {
                "lights": [light._pack() for light in lights],
                "ambient": [0.0, 0.0, 0.0] if sky_light else three("ambient", self.ambient, 0.0),
                "sky_light": sky_light,
                "background": background,
                "exposure": number("exposure", self.exposure, 0.0),
                "shadows": bool(self.shadows),
                "ambient_rays": rays,
                "ambient_distance": distance,
                "sky": (self.sky or uniform_sky(background))._pack(),
                "show_sky": self.sky is not None,
                "ground": self.ground._pack() if self.ground else None,
                "depth": whole("depth", self.depth, 0, 32),
                "cutoff": number("cutoff", self.cutoff, 0.0, 1.0),
                "specular": number("specular", self.specular, 0.0),
                "shininess": number("shininess", self.shininess, 0.0),
            }
        )

    def _look(self, scene: Scene) -> Any:
        """What the core takes for a picture of `scene`."""
        if self.ambient_distance is None and self.ambient_rays:
            return self._packed.reaching(0.1 * scene.octree.extent)
        return self._packed


_DEFAULT = RenderSettings()


@dataclass(frozen=True)
class Layer:
    """One scene of a picture that shows several, with its own material and cuts.

    A ray may be inside several at once: vessels in translucent tissue, each its own scene.
    """

    scene: Scene
    material: Material | None = None
    clips: Sequence[ClipPlane | ClipBox | ClipSphere] = ()


@dataclass(frozen=True)
class Picked:
    """What a pixel shows: `position` and `normal` (3,) world, `depth` along the ray, the scene's
    `layer`, the nearest `particle` and its attributes."""

    position: np.ndarray
    normal: np.ndarray
    depth: float
    layer: int
    particle: int
    attributes: dict[str, Any]


@dataclass
class Frame:
    """A finished picture. Its images stay on the device until asked for, then are NumPy arrays.

    `color` (H, W, 3) float32 linear, `picture` (H, W, 3) uint8 sRGB, `depth` (H, W) float32 along
    the ray, infinite where missed, `position` and `normal` (H, W, 3) float32 world (position NaN
    and normal 0 where missed), `albedo` (H, W, 3) blended colour, `mask` (H, W) bool.
    """

    size: tuple[int, int]
    _frame: Any = field(repr=False)
    _layers: tuple[Layer, ...] = field(repr=False)
    _more: Any = field(repr=False)

    @property
    def _scene(self) -> Scene:
        return self._layers[0].scene

    @property
    def samples(self) -> int:
        """Rays per pixel so far."""
        return self._frame.passes()

    def refine(self, samples: int = 1) -> Frame:
        """Add samples to each pixel: edges, soft shadows and rough mirrors get smooth.

        The images that follow are of all samples; arrays taken before stay as they are. Depth,
        normals and positions stay those of the pixels' centres. Returns the frame itself.
        Raises ValueError where the scene has changed since the frame was rendered.
        """
        if self.samples + whole("samples", samples, 1, MAX_SAMPLES) > MAX_SAMPLES:
            raise ValueError(f"samples: expected at most {MAX_SAMPLES} in all, got {samples} more")
        self._frame = self._more(samples, self._frame)
        return self

    def pick(self, column: int, row: int) -> Picked | None:
        """What is seen at a pixel; None where nothing is, or the ground."""
        column = whole("column", column, 0, self.size[0] - 1)
        row = whole("row", row, 0, self.size[1] - 1)
        position, normal = self.position[row, column], self.normal[row, column]
        layer = int(self._layer[row, column])
        if not np.isfinite(position).all() or layer >= len(self._layers):
            return None
        scene = self._layers[layer].scene
        particles = scene.particles
        reach = float(np.max(to_host(scene.support), initial=0.0))
        _, near = scene.neighbors(position[None], reach)
        if len(near) == 0:  # so far from the eye that the position is rounded off the surface
            return None
        away = to_host(particles.positions)[near] - position
        if particles.anisotropy is None:
            support = np.broadcast_to(to_host(scene.support), len(scene))[near]
            away = away / np.maximum(support, 1e-30)[:, None]
        else:
            away = np.einsum("nij,nj->ni", particles.anisotropy[near], away)
        particle = int(near[np.argmin(np.linalg.norm(away, axis=1))])
        attributes = {n: to_host(a)[particle] for n, a in particles.attributes.items()}
        return Picked(position, normal, float(self.depth[row, column]), layer, particle, attributes)

    def _take(self, name: str) -> np.ndarray:
        return getattr(self._frame, name)(self.size[1], self.size[0])

    @property
    def color(self) -> np.ndarray:
        return self._take("color")

    @property
    def picture(self) -> np.ndarray:
        return self._take("picture")

    @property
    def depth(self) -> np.ndarray:
        return self._take("depth")

    @property
    def position(self) -> np.ndarray:
        return self._take("position")

    @property
    def normal(self) -> np.ndarray:
        return self._take("normal")

    @property
    def albedo(self) -> np.ndarray:
        return self._take("albedo")

    @property
    def _layer(self) -> np.ndarray:
        """(H, W) uint8, what was hit: a layer's number, or a larger one for the ground."""
        return self._take("layer")

    @property
    def mask(self) -> np.ndarray:
        return np.isfinite(self.depth)

    @property
    def trace_seconds(self) -> float:
        """Device time from the first ray to the shaded picture."""
        return self._frame.trace_seconds()

    def attribute(self, values: Any) -> np.ndarray:
        """Per-particle values (N,) or (N, K) of the first scene, blended wherever that is seen:
        (H, W[, K]), else NaN."""
        points = self.position.reshape(-1, 3)
        hit = np.isfinite(points[:, 0]) & (self._layer.reshape(-1) == 0)
        blended = self._scene.blend(points[hit], values)
        out = np.full((len(points),) + blended.shape[1:], np.nan, np.float32)
        out[hit] = blended
        return out.reshape((self.size[1], self.size[0]) + blended.shape[1:])

    def save(self, path: Any) -> None:
        """Write the picture (.png) or every image (.npz, .exr); whole or not at all."""
        name = str(path).lower()
        if name.endswith(".png"):
            save_png(path, self.picture)
        elif name.endswith(".npz"):
            images = {
                k: getattr(self, k)
                for k in ("color", "depth", "position", "normal", "albedo", "mask")
            }
            with atomic_write(path) as file:
                np.savez_compressed(file, **images)
        elif name.endswith(".exr"):
            from ..formats.pictures.exr import frame_channels, write_exr

            write_exr(path, frame_channels(self))
        else:
            raise ValueError(f"{path}: expected a name ending in .png, .npz or .exr")


def save_png(path: Any, picture: np.ndarray) -> None:
    """Write a picture (H, W, 3) uint8 sRGB; whole or not at all."""
    from PIL import Image

    with atomic_write(path) as file:
        Image.fromarray(picture).save(file, format="PNG", compress_level=4)


def render(
    scene: Scene | Sequence[Layer | Scene],
    camera: Camera | None = None,
    size: tuple[int, int] = (1024, 782),
    settings: RenderSettings | None = None,
    clips: Sequence[ClipPlane | ClipBox | ClipSphere] = (),
    thesis: Thesis | None = None,
) -> Frame:
    """Trace rays through each pixel to the first point where the field is the threshold, and on.

    Args:
        scene: what to see; or up to 4 layers, scenes of one device in one picture.
        camera: default: `Camera.fit` of the first scene.
        size: (width, height) pixels.
        clips: cuts through every scene.
        thesis: trace the camera's rays the source thesis's way, with these choices; default:
            exactly.
    """
    try:
        width, height = (operator.index(v) for v in size)
    except (TypeError, ValueError):
        raise TypeError(f"size: expected (width, height), got {size!r}") from None
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ValueError(f"size: expected 1 to {MAX_PIXELS:,} pixels, got {width}x{height}")
    settings = _DEFAULT if settings is None else settings
    if not isinstance(settings, RenderSettings):
        raise TypeError(f"settings: expected RenderSettings, got {settings!r}")
    layers = _layers(scene, clips, settings.material)
    if thesis is not None and any(layer.clips for layer in layers):
        raise ValueError("clips: expected none with the thesis's tracing, which knows no cuts")
    first = layers[0].scene
    if camera is None:
        camera = fit_camera(first, (width, height))
    elif not isinstance(camera, Camera):
        raise TypeError(f"camera: expected Camera, got {camera!r}")
    view, look = camera._view((width, height)), settings._look(first)
    kinds = [(layer.material._packed, [c._packed for c in layer.clips]) for layer in layers]
    for layer in layers:
        check_tracing(layer.scene, thesis)
    way = None if thesis is None else thesis._packed
    thresholds = [layer.scene.threshold for layer in layers]

    def trace(passes: int, before: Any) -> Any:
        if before and thresholds != [layer.scene.threshold for layer in layers]:
            raise ValueError("refine: expected the scene as it was rendered, got another threshold")
        packed = [
            (layer.scene._scene, layer.scene._kernel, layer.scene.threshold, *kind)
            for layer, kind in zip(layers, kinds, strict=True)
        ]
        return packed[0][0].render(packed, view, look, way, passes, before)

    frame = trace(whole("samples", settings.samples, 1, MAX_SAMPLES), None)
    return Frame((width, height), frame, layers, trace)


def _layers(scene: Any, clips: Any, material: Any) -> tuple[Layer, ...]:
    """Layers of a picture, each with a material, and with its own clips and those of all."""
    if isinstance(scene, (Scene, Layer)):
        scene = (scene,)
    given = _items("scene", scene, "Scene, Layer or several")
    layers = [item if isinstance(item, Layer) else Layer(item) for item in given]
    if not 1 <= len(layers) <= MAX_LAYERS:
        raise ValueError(f"scene: expected 1 to {MAX_LAYERS} layers, got {len(layers)}")
    for layer in layers:
        if not isinstance(layer.scene, Scene):
            raise TypeError(f"scene: expected Scene or Layer, got {layer.scene!r}")
        if layer.scene.device != layers[0].scene.device:
            raise ValueError(
                f"scene: expected all layers on {layers[0].scene.device.name}, "
                f"got {layer.scene.device.name}"
            )
        kind = layer.material if layer.material is not None else material
        if not isinstance(kind, Material):
            raise TypeError(f"material: expected Material, got {kind!r}")
        expected = "a list of ClipPlane, ClipBox or ClipSphere"
        for clip in (*_items("clips", layer.clips, expected), *_items("clips", clips, expected)):
            if not isinstance(clip, (ClipPlane, ClipBox, ClipSphere)):
                raise TypeError(f"clips: expected ClipPlane, ClipBox or ClipSphere, got {clip!r}")
    return tuple(
        Layer(
            item.scene, material if item.material is None else item.material, (*item.clips, *clips)
        )
        for item in layers
    )


def _items(name: str, value: Any, expected: str) -> tuple:
    try:
        return tuple(value)
    except TypeError:
        raise TypeError(f"{name}: expected {expected}, got {value!r}") from None


def fit_camera(scene: Scene, size: tuple[int, int], around: Any = None, **options: Any) -> Camera:
    """`Camera.fit` with room for the surface around the particles, or around the points (M, 3)."""
    support = scene.support
    largest = support if np.isscalar(support) else np.max(to_host(support), initial=0.0)
    margin = REACH[scene.kernel] * float(largest)
    seen = scene.particles if around is None else around
    return Camera.fit(seen, size=size, margin=margin if np.isfinite(margin) else 0.0, **options)
