"""Images of a scene."""

from __future__ import annotations

import inspect
import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.arrays import on_gpu, to_host
from .._base.checks import image_size, shown, whole
from .._base.device import Device
from .._base.files import atomic_write
from .._base.old_names import old_attribute, renamed
from ..scene import attributes
from ..scene.fluid import shown_scene, shows_flat
from ..scene.mesh import Mesh
from ..scene.particles import Particles
from ..scene.scene import Scene
from ..scene.sources import as_particles
from ..scene.thesis import Thesis, check_tracing
from .annotate import Annotation, corners_to_fit, drawing, room, traced_size
from .camera import Camera
from .clips import ClipBox, ClipPlane, ClipSphere
from .display import displayed, straight, with_values
from .legend import strip_width
from .materials import Material
from .settings import (
    MAX_SAMPLES,
    NAMES,
    RenderSettings,
    as_settings,
    for_flat_data,
    for_values,
    items,
)
from .share import Share

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

SIZE = (1024, 782)  # of an image, where none is asked for
MAX_LAYERS = 4
# How scenes in pieces are rendered; the room `pieces`, which comes after this one, puts it here.
beyond: list[Callable[..., Any]] = []
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


FROM_ABOVE: dict[str, Any] = {"direction": (0, 0, 1), "up": (0, 1, 0), "orthographic": True}


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
        clips: cuts through this layer alone.

    Raises TypeError and ValueError naming the field, the expected and the given value.
    """

    scene: Any  # a Scene or a Mesh
    material: Material | None = None
    clips: Sequence[ClipPlane | ClipBox | ClipSphere] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "scene", as_scene(self.scene))
        if not isinstance(self.material, (Material, type(None))):
            raise TypeError(f"material: expected Material, got {shown(self.material)}")
        object.__setattr__(self, "clips", _clips(self.clips))


@dataclass(frozen=True)
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

    depth = old_attribute("depth", "distance")


@dataclass(repr=False)
class Frame:
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
    _values: Any = field(default=None, repr=False)  # as `display.with_values` takes them
    _finish: Any = field(default=None, repr=False)  # draws annotations into the image

    depth = old_attribute("depth", "distance")

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
        return _device_of(self._layers)

    @property
    def samples(self) -> int:
        """Rays per pixel so far."""
        return self._frame.passes()

    def refine(
        self, samples: int = 1, progress: Callable[[int, int], object] | None = None
    ) -> Frame:
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
        """The data behind a pixel, counted from the top left; None: background or ground."""
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
        if self._values is not None and settings.is_flat:
            image = displayed(with_values(self, self.color, self._values))
        else:
            image = self._take("picture") if settings.tone else displayed(self.color)
        if settings.transparent:
            image = straight(self, image, settings.exposure, settings.tone)
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
        """Values of the first particles' scene, blended at each pixel that shows that scene.

        Args:
            values: (N,) or (N, K) numbers, one row a particle.

        Returns:
            (H, W) or (H, W, K) float32; NaN elsewhere.
        """
        scenes = [(k, x.scene) for k, x in enumerate(self._layers) if isinstance(x.scene, Scene)]
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

        A .npz has `color`, `distance`, `position`, `normal`, `albedo` and `mask`; `depth` is the
        old name of `distance`, for one version. Raises ValueError for another ending.
        """
        name = str(path).lower()
        if name.endswith(".png"):
            save_png(path, self.image)
        elif name.endswith(".npz"):
            names = ("color", "distance", "position", "normal", "albedo", "mask")
            arrays = {name: getattr(self, name) for name in names}
            with atomic_write(path) as file:
                np.savez_compressed(file, depth=arrays["distance"], **arrays)
        elif name.endswith(".exr"):
            from ..formats.pictures.exr import frame_channels, write_exr

            write_exr(path, frame_channels(self))
        else:
            raise ValueError(f"{path}: expected a name ending in .png, .npz or .exr")


@renamed(picture="image")
def save_png(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Write an image (H, W, 3) or, with alpha, (H, W, 4) uint8 sRGB as PNG; whole or not at all."""
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4):
        got = f"{image.dtype} {image.shape}"
        raise ValueError(f"image: expected (H, W, 3) or (H, W, 4) uint8, got {got}")
    with atomic_write(path) as file:
        _write_png(file, image)


def _write_png(file: Any, image: np.ndarray) -> None:
    from PIL import Image

    Image.fromarray(image).save(file, format="PNG", compress_level=4)


def render(
    scene: Any,
    camera: Camera | tuple[int, int] | None = None,
    size: tuple[int, int] | Camera | RenderSettings | Mapping[str, Any] = SIZE,
    settings: RenderSettings | Mapping[str, Any] | None = None,
    clips: Sequence[ClipPlane | ClipBox | ClipSphere] = (),
    thesis: Thesis | None = None,
    *,
    color_by: str | None = None,
    colormap: str = "viridis",
    range: tuple[float, float] | None = None,
    annotate: Annotation | None = None,
    progress: Callable[[int, int], object] | None = None,
    comm: Any = None,
    **others: Any,
) -> Frame:
    """Render an image: for each pixel, the light from the first point where the field is the
    threshold, and from where that light is reflected and refracted.

        render("splash.vtk").save("splash.png")
        render(particles, (640, 480), settings={"shadows": True}, color_by="speed")

    Args:
        scene: a `Scene`; a `Mesh`; an argument of `Scene`, i.e. `Particles`, (N, 3) positions or a
            file's name (a file with faces is drawn as its triangles); a simulation; or a list of up
            to 4 of these or of `Layer`s for one image. 2-D data (at least 100 particles of equal z)
            are shown as spheres of half a spacing, in flat colors where the settings leave the
            lights at their default.
        camera: default: `Camera.fit` of the first scene; of 2-D data from above, orthographic. A
            size may replace the camera; settings may follow it.
        size: (width, height) pixels.
        settings: `RenderSettings`, or a dict of its fields.
        clips: cuts through every scene.
        thesis: trace the camera's rays as the source thesis does, with these choices; default:
            exactly.
        color_by: color the particles, or a mesh's vertices, by a field or attribute, instead of
            their own colors and the material's: x, y, z, support, an attribute (a vector's length),
            or NAME:0 … for a component. A `Scene` or `Mesh` keeps these colors. Where the settings
            leave the lights at their default, white and diffuse light keeps the colors' hue.
        colormap: of `color_by`: viridis, magma, inferno, plasma, cividis, turbo, coolwarm or gray.
        range: (lo, hi), values of the map's ends; default: the lowest and highest finite value.
        annotate: `Annotation`, drawn into the frame's `image`.
        progress: called as progress(done, total) after each sample per pixel; may raise to stop.
        comm: an mpi4py communicator whose ranks all have this scene and make this call: each
            traces its share of the pixels, and rank 0 has the image, with the same bits as one rank
            alone. Other ranks' frames have no hits. All ranks call `refine`, and `alpha` after it.
            (`Scene(..., comm=...)` is for particles that are distributed over the ranks.)

    Raises:
        TypeError, ValueError: naming the argument, the expected and the given value.
        FormatError, OSError: a file cannot be read.
        MissingPackageError: `comm` without mpi4py.
    """
    if others:
        raise TypeError(f"render: {_instead(next(iter(others)))}")
    if settings is None and isinstance(size, (RenderSettings, Mapping)):
        settings, size = size, SIZE  # after a size in the camera's place
    camera, total = camera_and_size(camera, size)
    size = traced_size(annotate, total)
    settings = as_settings(settings)
    layers = _layers(scene, clips, (color_by, colormap, range))
    spread = next((x.scene for x in layers if hasattr(x.scene, "settled")), None)
    if spread is not None:
        if color_by is not None:
            if annotate is not None:
                raise ValueError("annotate: expected no color_by with it for a scene on ranks")
            settings, color_by = for_values(settings), None
        layers, comm = spread.settled(layers, settings, comm, annotate is not None)
    first = layers[0].scene
    if any(_in_pieces(layer.scene) for layer in layers):
        if thesis is not None or annotate is not None or color_by is not None:
            raise ValueError(
                "scene: expected no thesis, annotate and color_by with pieces; "
                "Pieces(..., color_by=...) colors them"
            )
        if comm is not None:
            raise ValueError("comm: expected None with pieces, which have their own, got one")
        return beyond[0](layers, camera, size, settings, progress)
    if shows_flat(first):
        settings = for_flat_data(settings)
    if color_by is not None:
        settings = for_values(settings)
    if thesis is not None and any(layer.clips for layer in layers):
        raise ValueError("clips: expected none with the thesis's tracing, which knows no cuts")
    if camera is None:
        camera = fitted(first, size, annotate)
    scenes = [layer.scene for layer in layers]
    view, look = camera._view(size), settings._look(scenes)
    share = None
    if comm is not None:
        if thesis is not None:
            raise ValueError("comm: expected None with the thesis's tracing, got one")
        share = Share(comm, camera, size, settings._mixes(scenes))
        view = share.view
    device = _device_of(layers)
    kinds = [
        ((layer.material or settings.material)._packed, [c._packed for c in layer.clips])
        for layer in layers
    ]
    for layer in layers:
        if isinstance(layer.scene, Scene):
            check_tracing(layer.scene, thesis)
        elif thesis is not None:
            raise ValueError(
                "thesis: expected particles alone with the thesis's tracing, got a mesh"
            )
    way = None if thesis is None else thesis._packed

    def surfaces() -> list[tuple[int, float]]:
        """Kernel and threshold of each layer."""
        scenes = (layer.scene for layer in layers)
        return [(s._kernel, s.threshold) if isinstance(s, Scene) else (0, 1.0) for s in scenes]

    rendered = surfaces()
    # Of scenes whose particles lie in pieces others say what rays meet.
    answers = [getattr(layer.scene, "answers", None) for layer in layers]
    wavefront = next((a.wavefront for a in answers if a is not None), None)

    def trace(passes: int, before: Any, look: Any = look) -> Any:
        if before and rendered != surfaces():
            raise ValueError("refine: expected the scene as it was rendered, got another threshold")
        scenes = [_core_scene(layer.scene, device) for layer in layers]
        packed = [
            (scene, *surface, *kind, who)
            for scene, surface, kind, who in zip(scenes, surfaces(), kinds, answers, strict=True)
        ]
        core = packed[0][0]
        if share is not None and before:
            before = before.own

        def made() -> Any:
            return core.render(packed, view, look, way, passes, before)

        own = made() if wavefront is None else wavefront.run(made)
        return own if share is None else share.whole(own)

    def behind(light: float, passes: int) -> Any:
        """The same rays in front of another light."""
        if share is not None and not settings.transparent:
            raise ValueError("alpha: expected settings with transparent=True for several ranks")
        return trace(passes, None, settings._look(scenes, light))

    values = None
    if color_by is not None and (settings.is_flat or annotate is not None):
        values = values_of(points_of(first), color_by, colormap, range)
    finish = None
    if annotate is not None and annotate.draws:
        finish = drawing(annotate, camera, [layer.scene for layer in layers], values, total)
    n = settings.samples
    if progress is None or n == 1:
        first_pass = trace(n, None)
    else:
        first_pass = trace(1, None, replace(settings, edge_samples=0)._look(scenes))
    blended = values[:4] if values and isinstance(first, Scene) else None
    frame = Frame(size, first_pass, layers, trace, settings, behind, blended, finish)
    if progress is not None:
        progress(1, n)
        if n > 1:
            frame.refine(n - 1, lambda done, _: progress(1 + done, n))
    if share is not None and settings.transparent:
        frame.alpha  # noqa: B018  found by all ranks together
    return frame


def points_of(scene: Scene | Mesh) -> Particles:
    """What `color_by` colors: the particles, or a mesh's vertices."""
    return scene.points if isinstance(scene, Mesh) else scene.particles


def values_of(
    particles: Particles, name: str, colormap: str, range: tuple[float, float] | None
) -> tuple[np.ndarray, str, float, float, str]:
    """What an image of colors by value shows: the particles' values (N,), color map, values of the
    map's ends, name."""
    values = attributes.attribute_values(particles, name)
    if range is None:
        known = values[np.isfinite(values)]
        range = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    return values, colormap, *attributes.checked_range(range), name


def as_scene(value: Any) -> Scene | Mesh:
    """The scene that `value` stands for: a `Scene` or `Mesh`, an object with a scene, what `Scene`
    takes, or the name of a file with faces."""
    if _in_pieces(value):
        return value
    mesh = _mesh_of(value)
    if mesh is not None:
        return mesh
    own = _own_scene(value)
    return shown_scene(as_particles("scene", value)) if own is None else own


def _mesh_of(value: Any) -> Mesh | None:
    """A mesh, or that of a file with faces."""
    if isinstance(value, (str, os.PathLike)):
        from ..formats.triangles import has_faces  # formats are loaded when they are needed

        return Mesh(value) if has_faces(value) else None
    return value if isinstance(value, Mesh) else None


def _in_pieces(value: Any) -> bool:
    return getattr(value, "in_pieces", False) is True


def _core_scene(scene: Scene | Mesh, device: Device) -> Any:
    return scene.build(device) if isinstance(scene, Mesh) else scene._scene


def _device_of(layers: Sequence[Layer]) -> Device:
    """The device of the particles; of meshes alone, that of the first one."""
    scenes = [x.scene for x in layers]
    return next((s for s in scenes if isinstance(s, Scene)), scenes[0]).device


def camera_and_size(camera: Any, size: Any) -> tuple[Camera | None, tuple[int, int]]:
    """Both, checked, in whichever order they come; the size may stand in the camera's place."""
    if isinstance(size, Camera):
        camera, size = size, SIZE if camera is None else camera
    elif isinstance(camera, (tuple, list)) and len(camera) == 2:
        if size != SIZE:
            raise TypeError(f"size: expected one, got {shown(camera)} and {shown(size)}")
        camera, size = None, camera
    if isinstance(camera, (RenderSettings, Mapping)):
        raise TypeError("camera: expected Camera, got settings; write settings=... for settings")
    if camera is not None and not isinstance(camera, Camera):
        raise TypeError(f"camera: expected Camera or a size (width, height), got {shown(camera)}")
    return camera, image_size(size)


def _instead(name: str) -> str:
    """What to write for an argument that `render` does not have."""
    if name in inspect.signature(Scene).parameters:
        return f"{name} belongs to the scene: globule.Scene(particles, {name}=...)"
    if name in NAMES:
        return f"{name} belongs to the settings: settings={{{name!r}: ...}}"
    if name in (f.name for f in fields(Camera)):
        return f"{name} belongs to the camera: camera=globule.Camera(..., {name}=...)"
    known = ", ".join(p for p in inspect.signature(render).parameters if p != "others")
    return f"expected {known}, got {name!r}"


def _layers(scene: Any, clips: Any, color: tuple) -> tuple[Layer, ...]:
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
        if isinstance(own.scene, Scene) and own.scene.device != _device_of(layers or [own]):
            scenes = [x.scene for x in layers if isinstance(x.scene, Scene)]
            if scenes:
                raise ValueError(
                    f"scene: expected all layers on {scenes[0].device.name}, "
                    f"got {own.scene.device.name}"
                )
        layers.append(Layer(own.scene, own.material, (*own.clips, *everywhere)))
    return tuple(layers)


_ONE = (str, os.PathLike, Layer, Scene, Mesh, Particles)


def _several(scene: Any) -> tuple:
    """The scenes of a list of them, or the one scene."""
    single = isinstance(scene, (*_ONE, Mapping, np.ndarray)) or _in_pieces(scene)
    if single or on_gpu(scene) or hasattr(scene, "particles") or not hasattr(scene, "__iter__"):
        return (scene,)
    given = tuple(scene)
    named = given and (isinstance(given[0], _ONE) or _in_pieces(given[0]))
    positions = given and not named and hasattr(given[0], "__len__")
    return (given,) if positions else given


def _own_scene(item: Any) -> Scene | None:
    own = item if isinstance(item, Scene) else getattr(item, "scene", None)
    return own if isinstance(own, Scene) else None


def _colored(item: Any, color: tuple) -> Scene | Mesh:
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
    particles = attributes.color_by(as_particles("scene", own or item), *color)
    # A simulation's scene is updated by nobody else.
    return shown_scene(particles) if own is None else scene_like(own, particles)


def scene_like(scene: Scene, particles: Particles) -> Scene:
    """A new scene of these particles with the surface of another one."""
    options: dict[str, Any] = {"device": scene.device.name}
    if scene.surface == "smooth":
        if particles.weight is not None and np.ndim(particles.weight):
            particles = particles[np.flatnonzero(to_host(particles.weight) > 0)]
        options |= {"surface": "smooth", "spacing": scene.spacing}
    return Scene(particles, scene.kernel, scene.threshold, **options)


def _clips(clips: Any) -> tuple[ClipPlane | ClipBox | ClipSphere, ...]:
    found = items("clips", clips, "a list of ClipPlane, ClipBox or ClipSphere")
    for clip in found:
        if not isinstance(clip, (ClipPlane, ClipBox, ClipSphere)):
            raise TypeError(f"clips: expected ClipPlane, ClipBox or ClipSphere, got {shown(clip)}")
    return found


def fit_camera(
    scene: Scene | Mesh, size: tuple[int, int], around: ArrayLike | None = None, **options: Any
) -> Camera:
    """`Camera.fit` with room for the surface around the particles, or around the points (M, 3)."""
    if isinstance(scene, Mesh):
        return Camera.fit(corners_of(scene) if around is None else around, size=size, **options)
    if shows_flat(scene):
        options = FROM_ABOVE | options
    seen = scene.particles if around is None else around
    return Camera.fit(seen, size=size, margin=surface_reach(scene), **options)


def surface_reach(scene: Scene) -> float:
    """How far the surface may be from the outermost particles, world units."""
    reach = REACH[scene.kernel] * float(np.max(to_host(scene.support), initial=0.0))
    return reach if np.isfinite(reach) else 0.0


def corners_of(mesh: Mesh) -> np.ndarray:
    """(8, 3), the corners of the mesh's box, world."""
    lo, hi = mesh.bounds()
    return np.array([[(lo, hi)[i >> k & 1][k] for k in range(3)] for i in range(8)])


def fitted(
    scene: Scene | Mesh,
    size: tuple[int, int],
    annotation: Annotation | None,
    around: ArrayLike | None = None,
    **options: Any,
) -> Camera:
    """`fit_camera` with room for an annotation and its box."""
    around = corners_to_fit(annotation, scene, around)
    legend, more = annotation and annotation.legend, room(annotation)
    strip = strip_width(size) if legend and legend != "outside" and shows_flat(scene) else 0
    camera = fit_camera(scene, (max(1, size[0] - strip), size[1]), around, **options)
    if strip and camera.height is not None:  # 2-D data fill the image: a legend stands beside them
        aside = -1 if str(legend).endswith("left") else 1
        right = camera.frame((1, 1))[2] * aside * strip / size[1]
        eye, middle = (tuple((v + right).tolist()) for v in (camera.eye, camera.look_at))
        camera = replace(camera, eye=eye, look_at=middle)
    if camera.height is not None:
        return replace(camera, height=more * camera.height)
    eye = camera.look_at + more * np.subtract(camera.eye, camera.look_at)
    return replace(camera, eye=tuple(eye.tolist()))
