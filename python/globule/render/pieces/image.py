"""Images of scenes in pieces: traced piece by piece, composited, shaded once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ..._base.memory import trim
from ...pieces.pieces import Pieces
from ...scene.scene import SceneBase
from ..camera import Camera
from ..fit import along_normal
from ..frame import Frame
from ..layers import Layer
from ..materials import Material
from ..settings import SMOOTH_EDGES, RenderSettings
from ..trace import trace
from .hits import NOTHING, Hits, first_hits, nearest
from .light import render_light, turns
from .shading import SOME, edges, finished, light_of, rays_of, shade
from .wavefront import skip_empty
from .whole_images import take_all

Rays = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # of numbers: origins, directions
KEPT = ("depth", "normal", "albedo", "color", "picture", "layer")  # of a frame: its position comes from the depth
SAMPLES_AT_ONCE = 4  # per visit of the pieces: their hits are in memory together


@dataclass(repr=False)
class PiecesFrame(Frame):
    """A finished image of a scene in pieces: a `Frame` on rank 0; on other ranks without hits.

    `refine`, `pick` and `attribute` need all particles and raise ValueError.
    """

    _alpha: Any = field(default=None, repr=False)  # None: one ray a pixel

    @property
    def alpha(self) -> np.ndarray:
        """(H, W) float32: the share of the pixel's rays that hit a surface or a cut."""
        if self._alpha is None:
            return np.isfinite(self.distance).astype(np.float32)
        return self._alpha.reshape(self.size[1], self.size[0])

    def refine(self, samples: int = 1, progress: Any = None) -> Frame:
        """Not for scenes in pieces: render with more `samples`."""
        raise ValueError("refine: expected one scene, got pieces; render them with more samples")

    def pick(self, column: int, row: int) -> Any:
        """Not for scenes in pieces."""
        raise ValueError("pick: expected one scene, got pieces; frame.position has the places of the hits")

    def attribute(self, values: Any) -> np.ndarray:
        """Not for scenes in pieces: give `color_by` to `Pieces`."""
        raise ValueError("attribute: expected one scene, got pieces; give color_by to Pieces")


class Images:
    """The arrays of a finished image, as the core's frame has them."""

    def __init__(self, hits: Hits, rays: Any, color: Any, picture: Any, samples: int):
        self._hits, self._rays, self._samples = hits, rays, samples
        self._color, self._picture = color, picture

    def passes(self) -> int:
        """Rays per pixel, at edges left out."""
        return self._samples

    def trace_seconds(self) -> float:
        """Not measured: pieces are read and built in between."""
        return float("nan")

    def color(self, height: int, width: int) -> np.ndarray:
        """(H, W, 3) float32, linear."""
        return self._color.reshape(height, width, 3)

    def picture(self, height: int, width: int) -> np.ndarray:
        """(H, W, 3) uint8, sRGB."""
        return self._picture.reshape(height, width, 3)

    def depth(self, height: int, width: int) -> np.ndarray:
        """(H, W) float32, world units."""
        return self._hits.t.reshape(height, width)

    def position(self, height: int, width: int) -> np.ndarray:
        """(H, W, 3) float32, world."""
        o, d = self._rays()
        with np.errstate(invalid="ignore"):
            at = np.where(np.isfinite(self._hits.t)[:, None], o + self._hits.t[:, None] * d, np.nan)
        return at.astype(np.float32).reshape(height, width, 3)

    def normal(self, height: int, width: int) -> np.ndarray:
        """(H, W, 3) float32."""
        return np.require(self._hits.normal, requirements="W").reshape(height, width, 3)

    def albedo(self, height: int, width: int) -> np.ndarray:
        """(H, W, 3) float32, linear."""
        return np.require(self._hits.albedo, requirements="W").reshape(height, width, 3)

    def layer(self, height: int, width: int) -> np.ndarray:
        """(H, W) uint8."""
        return self._hits.layer.reshape(height, width)


def render_pieces(
    layers: Sequence[Layer],
    camera: Camera | None,
    size: tuple[int, int],
    settings: RenderSettings,
    progress: Callable[[int, int], object] | None = None,
) -> Frame:
    """The image of layers of which some are `Pieces`; as `render`, to which it belongs."""
    job = Job(layers, camera, size, settings)
    if turns(layers, settings):
        return render_light(layers, job.camera, size, settings, job.ranks, progress)
    n, root = size[0] * size[1], job.ranks.rank == 0
    own = job.shaded_here()
    if own is not None and take_all(job.ranks, own, KEPT, size)[0]:
        if progress is not None:
            progress(1, 1)
        black = np.zeros((n, 3), np.float32), np.zeros((n, 3), np.uint8)
        nothing = Images(Hits(n), lambda: job.rays(np.arange(n), 0), *black, samples=1)
        return PiecesFrame(size, own if root else nothing, tuple(layers), None, settings)
    hits = job.nearest_centers()
    if root:
        color, shown = job.shaded(hits, np.arange(n), 0)
    else:
        color, shown = (np.zeros((n, 3), np.float32) for _ in "ab")
    alpha = (hits.layer != NOTHING).astype(np.float32)
    if progress is not None:
        progress(1, settings.samples)
    if settings.samples > 1:
        pixels, more = np.arange(n), settings.samples - 1
    else:
        more = job.edge_samples
        pixels = np.empty(0, np.int64)
        if more and root:
            plain = len(layers) == 1 and not layers[0].clips
            contrast = not plain and not settings.transparent
            pixels = edges(hits, job.camera, size, finished(shown) if contrast else None)
        pixels = job.ranks.from_root(pixels)
    for first in range(1, more + 1 if len(pixels) else 1, SAMPLES_AT_ONCE):
        some = range(first, min(first + SAMPLES_AT_ONCE, more + 1))
        found = job.nearest([job.rays(pixels, k) for k in some])
        for k, one in zip(some, found, strict=True):
            if root:
                light, displayed = job.shaded(one, pixels, k)
                color[pixels] += light
                shown[pixels] += displayed
                alpha[pixels] += one.layer != NOTHING
            if progress is not None and settings.samples > 1:
                progress(1 + k, settings.samples)
    if len(pixels):
        for array in (color, shown, alpha):
            array[pixels] /= np.float32(more + 1)
    picture = finished(shown) if root else np.zeros((n, 3), np.uint8)
    images = Images(hits, lambda: job.rays(np.arange(n), 0), color, picture, settings.samples)
    return PiecesFrame(size, images, tuple(layers), None, settings, _alpha=alpha)


class Job:
    """One image: which rays go through which pieces."""

    def __init__(self, layers: Sequence[Layer], camera: Camera | None, size: tuple[int, int], settings: RenderSettings):
        self.layers, self.size, self.settings = layers, size, settings
        pieces = [x.scene for x in layers if isinstance(x.scene, Pieces)]
        self.ranks = next((p.ranks for p in pieces if p.ranks.size > 1), pieces[0].ranks)
        if any(p.ranks.size != self.ranks.size for p in pieces):
            raise ValueError("scene: expected all pieces on the same ranks")
        self.ranks.same(size=tuple(size))
        first = layers[0].scene
        self.camera = camera or fit(first if isinstance(first, Pieces) else pieces[0], size)
        self.materials: list[Material] = [x.material or settings.material for x in layers]
        smooth = any(getattr(x.scene, "surface", "balls") != "balls" for x in layers)
        own = settings.edge_samples
        self.edge_samples = (SMOOTH_EDGES if smooth else 0) if own is None else own

    def rays(self, pixels: np.ndarray, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions of a sample of pixels."""
        return rays_of(self.camera, self.size, pixels, sample)

    def shaded(self, hits: Hits, pixels: np.ndarray, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """`shade` of hits of a sample of pixels."""
        n = len(pixels)
        color, shown = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        for first in range(0, n, SOME):
            some = slice(first, first + SOME)
            rays = self.rays(pixels[some], sample)
            color[some], shown[some] = shade(hits[some], *rays, self.settings, self.materials)
        return color, shown

    def shaded_here(self) -> Any:
        """The core's frame of this rank's piece, where the nearest of all ranks' is the image: one ray a pixel, no
        cuts, no negative weights and an eye outside. No rank's hit is nearer than the whole scene's, and who owns that
        one has it (docs/design/pieces.md). None: the image is made another way, on all ranks.
        """
        (layer, *more), settings = self.layers, self.settings
        if more or layer.clips or self.ranks.size == 1 or settings.samples > 1 or self.edge_samples:
            return None
        scene = layer.scene
        if scene.surface == "spheres":  # a piece of them may lie in a plane, and would have other light
            return None
        if scene.negative or self._inside(scene, (), self._starts()).any():
            return None
        ((_, part),) = scene.visit()
        return self.ranks.together(
            lambda: trace([Layer(part, layer.material)], self.camera, self.size, settings)._frame
        )

    def nearest_centers(self) -> Hits:
        """What the rays through the pixels' centers meet, on rank 0: the core makes them."""
        n = self.size[0] * self.size[1]
        hits = Hits(n)
        centers = partial(self.rays, sample=0)
        for k, layer in enumerate(self.layers):
            scene, clips = layer.scene, layer.clips
            if isinstance(scene, SceneBase):
                if self.ranks.rank == 0:
                    hits.put(np.arange(n), *self._frame(scene, clips), k)
            elif scene.negative or self._inside(scene, clips, self._starts()).any():
                hits.put(np.arange(n), *in_turn(scene, *centers(np.arange(n)), clips), k)
            else:
                self.ranks.together(partial(self._put_centers, hits, layer, centers, k))
        trim()  # before others' hits come
        return nearest(self.ranks, hits)

    def _starts(self) -> np.ndarray:
        """Where the rays of the pixels' centers begin: in one point, or all of them."""
        n = 1 if self.camera.height is None else self.size[0] * self.size[1]
        return self.rays(np.arange(n), 0)[0]

    def _put_centers(self, hits: Hits, layer: Layer, centers: Rays, k: int) -> None:
        for piece, part in layer.scene.visit():
            put_owned(hits, layer.scene, piece, centers, self._frame(part, layer.clips), k)

    def _frame(self, scene: SceneBase, clips: Sequence[Any]) -> tuple[Any, Any, Any]:
        frame = trace([Layer(scene, None, clips)], self.camera, self.size, light_of())
        n = self.size[0] * self.size[1]
        return frame.distance.ravel(), frame.normal.reshape(n, 3), frame.albedo.reshape(n, 3)

    def nearest(self, rays: list[tuple[np.ndarray, np.ndarray]]) -> list[Hits]:
        """What several sets of rays meet, on rank 0; every piece is visited once."""
        found = [Hits(len(o)) for o, _ in rays]
        for k, layer in enumerate(self.layers):
            scene, clips = layer.scene, layer.clips
            if isinstance(scene, SceneBase):
                for hits, (o, d) in zip(found, rays, strict=True):
                    if self.ranks.rank == 0:
                        hits.put(np.arange(len(o)), *first_hits(scene, o, d, clips), k)
                continue
            hard = [scene.negative or self._inside(scene, clips, o).any() for o, _ in rays]
            for hits, (o, d), inside in zip(found, rays, hard, strict=True):
                if inside:
                    hits.put(np.arange(len(o)), *in_turn(scene, o, d, clips), k)
            for piece, part in scene.visit() if not all(hard) else ():
                for hits, (o, d), inside in zip(found, rays, hard, strict=True):
                    if not inside:
                        of = partial(_some, o, d)
                        put_owned(hits, scene, piece, of, first_hits(part, o, d, clips), k)
        return [nearest(self.ranks, hits) for hits in found]

    def _inside(self, scene: Pieces, clips: Sequence[Any], o: Any) -> np.ndarray:
        """Which rays that begin at o (M, 3) begin inside what the clips keep of the medium."""
        inside = np.zeros(len(o), bool)
        one_eye = len(o) > 0 and bool((o == o[0]).all())
        starts = o[:1] if one_eye else o
        space = scene.space
        near = ((starts >= space.low) & (starts <= space.low + space.extent)).all(axis=1)
        for clip in clips:
            near &= ~clip.takes(starts.astype(np.float64))
        if not near.any():
            return inside
        field = np.zeros(len(starts), np.float32)
        owner = scene.partition.owner(starts)
        for piece, part in scene.visit():
            mine = np.flatnonzero(near & (owner == piece))
            if len(mine):
                field[mine] = part.field(starts[mine])
        found = scene.ranks.most(field) > scene.threshold
        return np.broadcast_to(found, len(o)) if one_eye else found


def put_owned(hits: Hits, scene: Pieces, piece: int, rays: Rays, found: tuple[Any, Any, Any], layer: int) -> None:
    """Keep a piece's hits in its own cells: for rays that begin outside of the medium and weights
    of at least 0 the first of all pieces' is the whole scene's. rays(numbers): their origins and
    directions; `found` is the caller's no more."""
    t, normal, albedo = found
    for first in range(0, len(t), SOME):  # a hit's cell takes a hundred bytes while it is found
        hit = first + np.flatnonzero(np.isfinite(t[first : first + SOME]))
        o, d = rays(hit)
        other = hit[~scene.partition.knows(piece, o + t[hit, None] * d)]
        t[other] = np.inf
    hits.put_all(t, normal, albedo, layer)


def _some(o: np.ndarray, d: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return o[rays], d[rays]


def in_turn(
    scene: Pieces, o: np.ndarray, d: np.ndarray, clips: Sequence[Any]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First hits of rays that go from piece to piece, each through its own cells only: for
    negative weights, and rays that begin inside the medium. Every rank has those of its piece.

    Returns:
        t (M,), normal (M, 3), albedo (M, 3), float32; t infinite where missed.
    """
    partition, n = scene.partition, len(o)
    t, normal = np.full(n, np.inf, np.float32), np.zeros((n, 3), np.float32)
    albedo = np.zeros((n, 3), np.float32)
    start, last = partition.enter(o, d)
    waiting = np.where(start <= last, partition.owner(o + start[:, None] * d), -1)
    margin = partition.space.margin
    skip_empty(partition, scene.held, o, d, start, last, waiting)
    while (waiting >= 0).any():
        moved: list[tuple[np.ndarray, np.ndarray]] = []
        for piece, part in scene.visit():
            mine = np.flatnonzero(waiting == piece)
            if not len(mine):
                continue
            leave = partition.leave(o[mine], d[mine], start[mine])
            at = (o[mine] + start[mine, None] * d[mine]).astype(np.float32)
            found = first_hits(part, at, d[mine], clips)
            far = start[mine] + found[0]
            hit = far <= leave + margin / 2
            k = mine[hit]
            t[k], normal[k], albedo[k] = far[hit], found[1][hit], found[2][hit]
            waiting[k] = -1
            k, on = mine[~hit], leave[~hit] + margin / 4
            start[k] = on
            waiting[k] = -1
            going = np.isfinite(on) & (on <= last[k])
            k = k[going]
            waiting[k] = partition.owner(o[k] + start[k, None] * d[k])
            moved.append((mine, np.stack([start[mine], waiting[mine].astype(np.float64)], axis=1)))
        if scene.ranks.size > 1:
            for parts in scene.ranks.all(moved):
                for rays, rows in parts:
                    start[rays], waiting[rays] = rows[:, 0], rows[:, 1].astype(waiting.dtype)
        skip_empty(partition, scene.held, o, d, start, last, waiting)
    return t, normal, albedo


def fit(scene: Pieces, size: tuple[int, int], around: Any = None, **options: Any) -> Camera:
    """The camera of one scene with all particles, or for points (M, 3), with room for the surface."""
    if scene.normal is not None and not options:
        options = along_normal(scene.normal)
    options = {"up": scene.up} | options
    return Camera.fit(scene.outline() if around is None else around, size=size, margin=scene.outside, **options)
