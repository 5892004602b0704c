"""A finished image, and the data behind its pixels."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import to_host
from .._base.checks import as_image, whole
from .._base.colormaps import CATEGORICAL
from .._base.device import Device
from .._base.files import atomic_write
from .._base.owner import Owner
from ..data.particles import HERE
from ..scene.mesh import Mesh
from ..scene.scene import SceneBase
from .display import displayed, straight, with_values
from .layers import Layer, device_of
from .settings import MAX_SAMPLES, RenderSettings

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False)
class Picked:
    """The data behind a pixel.

    position    (3,) float32, world
    normal      (3,) float32, unit length
    distance    along the ray, world units
    layer       number of the layer, from 0
    particle    index of the particle with the most influence there; None on a mesh
    attributes  that particle's attributes
    face        index of the triangle there; None on particles
    """

    position: np.ndarray
    normal: np.ndarray
    distance: float
    layer: int
    particle: int | None
    attributes: dict[str, Any]
    face: int | None = None


@dataclass(repr=False, eq=False)
class Frame(Owner):
    """A finished image. Arrays stay on the device until the program reads them; then they are NumPy
    arrays.

    A notebook shows a frame as its image. `color`, `image`, `distance`, `position`, `normal`,
    `albedo` and `mask` are arrays with one entry per pixel; `size` is (width, height).
    """

    size: tuple[int, int]
    _frame: Any = field(repr=False)
    _layers: tuple[Layer, ...] = field(repr=False)
    _more: Any = field(repr=False)
    _settings: RenderSettings = field(default_factory=RenderSettings, repr=False)
    _behind: Any = field(default=None, repr=False)  # traces again in front of another light
    # Of the first scene's particles (N,), color map, and values of the map's ends.
    _values: tuple[Any, str, float, float] | None = field(default=None, repr=False)
    _finish: Any = field(default=None, repr=False)  # draws annotations into the image
    _camera: Any = field(default=None, repr=False)  # `Camera`; None of a scene in pieces
    _asked: Any = field(default=None, repr=False)  # color_by, colormap, range; None: no values

    def __repr__(self) -> str:
        n = len(self._layers)
        layers = "" if n == 1 else f", {n} layers"
        samples = "1 sample" if self.samples == 1 else f"{self.samples} samples"
        width, height = self.size
        return f"Frame({width} x {height}, {samples} a pixel{layers}, {self._device.name})"

    def _repr_png_(self) -> bytes:
        """The image as PNG, for notebooks."""
        file = io.BytesIO()
        _write_png(file, self.image)
        return file.getvalue()

    @property
    def _device(self) -> Device:
        return device_of(self._layers)

    @property
    def samples(self) -> int:
        """Rays per pixel so far."""
        return self._frame.passes()

    def refine(self, samples: int = 1, progress: Callable[[int, int], object] | None = None) -> Frame:
        """Add samples to each pixel: edges, soft shadows and rough reflections become smooth.

        Arrays that the program reads afterwards include all samples; arrays read before do not
        change. Distances, normals and positions always belong to the pixels' centers.

        Args:
            samples: number of additional rays per pixel; at most 65536 in all.
            progress: called as progress(done, total) after each sample; may raise to stop.

        Returns the frame itself. Raises ValueError if the scene changed after the rendering of the
        frame.
        """
        if self.samples + whole("samples", samples, 1, MAX_SAMPLES) > MAX_SAMPLES:
            raise ValueError(f"samples: expected at most {MAX_SAMPLES} in all, got {samples} more")
        if progress is None:
            self._frame = self._more(samples, self._frame)
            return self
        for done in range(1, samples + 1):
            self._frame = self._more(1, self._frame)
            progress(done, samples)
        return self

    def pick(self, column: int, row: int) -> Picked | None:
        """The data behind a pixel, counted from the top left; None: background or ground.

        Position, normal and distance are the image's; particle and attributes those of the scene
        as it is now, nearest to that position (`Scene.update` may have moved it since).
        """
        column = whole("column", column, 0, self.size[0] - 1)
        row = whole("row", row, 0, self.size[1] - 1)
        position, normal = self.position[row, column], self.normal[row, column]
        layer = int(self._layer[row, column])
        if not np.isfinite(position).all() or layer >= len(self._layers):
            return None
        scene = self._layers[layer].scene
        distance = float(self.distance[row, column])
        if isinstance(scene, Mesh):
            back = position + np.float32(1e-3 * distance) * normal
            face = scene.intersect(back[None], -normal[None]).face
            return Picked(position, normal, distance, layer, None, {}, int(face[0]))
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
        return Picked(position, normal, distance, layer, particle, attributes)

    def _take(self, name: str) -> np.ndarray:
        return getattr(self._frame, name)(self.size[1], self.size[0])

    @property
    def color(self) -> np.ndarray:
        """(H, W, 3) float32, linear RGB; of a transparent image, the light of the hits alone."""
        return self._take("color")

    @property
    def image(self) -> np.ndarray:
        """(H, W, 3) uint8, sRGB; (H, W, 4) with straight alpha where the settings say
        `transparent`. Annotations that were given to `render` are drawn in."""
        settings = self._settings
        shown = settings.is_flat and self._values
        if shown and shown[1] not in CATEGORICAL:
            own, colormap, lo, hi = shown
            blended = self.attribute(own)
            flat = with_values(self.color, blended, self._mixed, colormap, lo, hi)
            image = displayed(flat)
        else:
            image = self._take("picture") if settings.tone else displayed(self.color)
        if settings.transparent:
            image = straight(image, self.color, self.alpha, settings.exposure, settings.tone)
        return image if self._finish is None else self._finish(image, self)

    @property
    def alpha(self) -> np.ndarray:
        """(H, W) float32: the share of the pixel's rays that hit a surface, a cut or the ground.

        With several samples, the rays are traced again when `alpha` is first read: the scene must
        not have changed since the frame was rendered.
        """
        if not self._mixed:
            return self.mask.astype(np.float32)
        kept = vars(self).get("_alpha")
        if kept is None or kept[0] != self.samples:
            # Where a ray hits nothing, a light behind the scene adds to the pixel.
            lit, dark = (self._behind(light, self.samples) for light in (1.0, 0.0))
            width, height = self.size
            through = lit.color(height, width)[..., 0] - dark.color(height, width)[..., 0]
            kept = self.samples, np.clip(1 - through, 0, 1)
            vars(self)["_alpha"] = kept
        return kept[1]

    @property
    def _mixed(self) -> bool:
        """Whether the color of a pixel at an edge may be a mixture."""
        return self.samples > 1 or self._settings._mixes([x.scene for x in self._layers])

    @property
    def picture(self) -> np.ndarray:
        """The same as `image`."""
        return self.image

    @property
    def distance(self) -> np.ndarray:
        """(H, W) float32 along the ray, world units; infinite where the ray misses."""
        return self._take("depth")

    @property
    def position(self) -> np.ndarray:
        """(H, W, 3) float32, world; NaN where the ray misses."""
        return self._take("position")

    @property
    def normal(self) -> np.ndarray:
        """(H, W, 3) float32, unit length, world; 0 where the ray misses."""
        return self._take("normal")

    @property
    def albedo(self) -> np.ndarray:
        """(H, W, 3) float32, linear RGB: the blended color before any light."""
        return self._take("albedo")

    @property
    def _layer(self) -> np.ndarray:
        """(H, W) uint8, what was hit: a layer's number, or a larger one for the ground."""
        return self._take("layer")

    @property
    def mask(self) -> np.ndarray:
        """(H, W) bool: whether the ray hits a surface, a cut or the ground."""
        return np.isfinite(self.distance)

    @property
    def trace_seconds(self) -> float:
        """Device time from the first ray to the shaded image, s; after `refine`, the time of the
        last pass."""
        return self._frame.trace_seconds()

    def attribute(self, values: ArrayLike) -> np.ndarray:
        """Values of the first particles' scene, as it is now, blended at each pixel that shows it.

        Args:
            values: (N,) or (N, K) numbers, one row a particle.

        Returns:
            (H, W) or (H, W, K) float32; NaN elsewhere.
        """
        scenes = [(k, x.scene) for k, x in enumerate(self._layers) if isinstance(x.scene, SceneBase)]
        if not scenes:
            raise ValueError("attribute: expected a layer of particles, got meshes alone")
        (first, scene), points = scenes[0], self.position.reshape(-1, 3)
        hit = np.isfinite(points[:, 0]) & (self._layer.reshape(-1) == first)
        blended = scene.blend(points[hit], values)
        out = np.full((len(points),) + blended.shape[1:], np.nan, np.float32)
        out[hit] = blended
        return out.reshape((self.size[1], self.size[0]) + blended.shape[1:])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the image (.png) or every array (.npz, .exr); whole or not at all.

        A .npz has `color`, `distance`, `position`, `normal`, `albedo` and `mask`; positions become
        world coordinates, float64 where there is an origin. Raises ValueError for another ending.
        """
        name = str(path).lower()
        if name.endswith(".png"):
            save_png(path, self.image)
        elif name.endswith(".npz"):
            from ..formats.numpy_format import write_arrays

            names = ("color", "distance", "position", "normal", "albedo", "mask")
            arrays = {name: getattr(self, name) for name in names}
            origin = next((o for x in self._layers if (o := getattr(x.scene, "origin", HERE) or HERE) != HERE), HERE)
            if origin != HERE:
                arrays["position"] = arrays["position"] + np.asarray(origin)
            write_arrays(path, arrays, packed=True)
        elif name.endswith(".exr"):
            from ..formats.pictures.exr import frame_channels, write_exr

            write_exr(path, frame_channels(self))
        else:
            raise ValueError(f"{path}: expected a name ending in .png, .npz or .exr")


def save_png(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Write an image (H, W, 3) or, with alpha, (H, W, 4) uint8 sRGB as PNG; whole or not at all."""
    image = as_image(image)
    with atomic_write(path) as file:
        _write_png(file, image)


def _write_png(file: Any, image: np.ndarray) -> None:
    from PIL import Image

    Image.fromarray(image).save(file, format="PNG", compress_level=4)
