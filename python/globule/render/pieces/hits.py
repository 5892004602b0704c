"""What rays meet: the hits of one piece, and the nearest of all pieces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ... import _core
from ..._base.ranks import Alone
from ...scene.scene import SceneBase
from ..clips import ClipBox, ClipPlane, ClipSphere

NOTHING = 255


class Hits:
    """What n rays meet first.

    t       (n,) float32, distance along the ray, world units; infinite where missed
    normal  (n, 3) float32; 0 where missed
    albedo  (n, 3) float32, linear RGB
    layer   (n,) uint8; 255 where missed
    """

    def __init__(self, n: int):
        self.clear(n)

    def clear(self, n: int) -> None:
        """n rays that meet nothing; until one does, all have the same 0."""
        self.t = np.full(n, np.inf, np.float32)
        self.layer = np.full(n, NOTHING, np.uint8)
        self.normal: np.ndarray = np.broadcast_to(np.float32(0), (n, 3))
        self.albedo: np.ndarray = self.normal

    def _make_room(self) -> None:
        if not self.normal.flags.writeable:
            self.normal, self.albedo = (np.zeros(self.normal.shape, np.float32) for _ in "na")

    def __getitem__(self, some: slice) -> Hits:
        """Those of some rays: the same memory."""
        part = object.__new__(Hits)
        part.t, part.normal = self.t[some], self.normal[some]
        part.albedo, part.layer = self.albedo[some], self.layer[some]
        return part

    def put(self, rays: np.ndarray, t: Any, normal: Any, albedo: Any, layer: Any) -> None:
        """Keep hits of rays (K,) that are nearer than those so far; of equal ones the first."""
        self._make_room()
        nearer = t < self.t[rays]
        at = rays[nearer]
        self.t[at], self.normal[at], self.albedo[at] = t[nearer], normal[nearer], albedo[nearer]
        self.layer[at] = layer if np.ndim(layer) == 0 else layer[nearer]

    def put_all(self, t: np.ndarray, normal: np.ndarray, albedo: np.ndarray, layer: int) -> None:
        """`put` of all rays, infinite t where none. The first takes the arrays as they are."""
        if (self.layer == NOTHING).all():
            missed = t == np.inf
            normal[missed], albedo[missed] = 0, 0
            self.t, self.normal, self.albedo = t, normal, albedo
            self.layer[~missed] = layer
            return
        rays = np.flatnonzero(t < self.t)
        self.put(rays, t[rays], normal[rays], albedo[rays], layer)

    def packed(self, first: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """The rays that hit, (K,) int64, and rows (K, 9) float32: the ray's number, counted from
        `first`, as the bits of an int32; t, normal, albedo, layer."""
        rays = np.flatnonzero(self.t < np.inf)
        rows = np.empty((len(rays), 9), np.float32)
        if len(rays):
            _core.pack_hits(rays, first, *self._flat(), rows.reshape(-1))
        return rays, rows

    def put_rows(self, rows: np.ndarray, first: int = 0) -> None:
        """`put` for what `packed` has made, once or several times, one after the other."""
        if len(rows):
            self._make_room()
            _core.put_hits(rows.reshape(-1), first, *self._flat())

    def _flat(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return self.t, self.normal.reshape(-1), self.albedo.reshape(-1), self.layer


def nearest(ranks: Alone, hits: Hits) -> Hits:
    """The nearest of all ranks' hits, on rank 0, added to its own; elsewhere none. Each rank sends
    its hits in a stripe of the image to the stripe's rank (direct-send), which keeps the nearest
    and sends them on."""
    if ranks.size == 1:
        return hits
    n = len(hits.t)
    bounds = n * np.arange(ranks.size + 1) // ranks.size
    rays, rows = hits.packed()
    if ranks.rank:
        hits.clear(n)  # what has been packed is not needed twice
    rows = ranks.exchange(rows, np.diff(np.searchsorted(rays, bounds)))
    begin = int(bounds[ranks.rank])
    best = Hits(int(bounds[ranks.rank + 1]) - begin)
    best.put_rows(rows, begin)
    rays, rows = best.packed(begin)
    everything = np.zeros(ranks.size, np.int64)
    everything[0] = len(rays)
    rows = ranks.exchange(rows, everything)
    if ranks.rank == 0:
        hits.put_rows(rows)
    return hits


def first_hits(
    scene: SceneBase,
    origins: np.ndarray,
    directions: np.ndarray,
    clips: Sequence[ClipPlane | ClipBox | ClipSphere] = (),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First points of rays where what the clips keep of a scene begins, or ends if the ray begins
    inside: of the surface or of a cut face.

    Args:
        origins, directions: (M, 3) float32, world; unit directions.

    Returns:
        t (M,), normal (M, 3), albedo (M, 3), float32; t infinite where missed.
    """
    if not clips:
        found = scene.intersect(origins, directions)
        return found[0], found[1], found[2]
    n = len(origins)
    t, normal = np.full(n, np.inf, np.float32), np.zeros((n, 3), np.float32)
    albedo = np.zeros((n, 3), np.float32)
    start, going = np.zeros(n), np.arange(n)
    for _ in range(2 * len(clips) + 2):
        if not len(going):
            break
        o, d = origins[going].astype(np.float64), directions[going].astype(np.float64)
        begin, end, at_begin, at_end = kept(clips, o, d, start[going])
        there = np.isfinite(begin)
        going, o, d, begin = going[there], o[there], d[there], begin[there]
        end, at_begin, at_end = end[there], at_begin[there], at_end[there]
        points = (o + begin[:, None] * d).astype(np.float32)
        inside = scene.field(points) > scene.threshold
        face = inside & (begin > start[going])
        found = scene.intersect(points, directions[going])
        on = begin + found[0]
        hit = ~face & (on < end)
        leaves = ~face & ~hit & inside & np.isfinite(end)
        k = going[hit]
        t[k], normal[k], albedo[k] = on[hit], found[1][hit], found[2][hit]
        for caps, at, which in ((face, begin, at_begin), (leaves, end, at_end)):
            k = going[caps]
            if len(k):
                place = o[caps] + at[caps, None] * d[caps]
                t[k] = at[caps]
                normal[k] = _face_normals(clips, which[caps], place)
                albedo[k] = _blended(scene, place.astype(np.float32))
        start[going] = end
        going = going[~(face | hit | leaves) & np.isfinite(end)]
    return t, normal, albedo


def kept(
    clips: Sequence[Any], o: np.ndarray, d: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The first interval at or after `start` that all clips keep, as in src/trace/clip.hpp: begin
    and end (M,), the clips there, -1 for none; begin is infinite where there is no interval."""
    spans = [_inside(c, o, d) for c in clips]
    begin, at_begin = np.array(start, np.float64), np.full(len(o), -1)
    for _ in range(2 * len(clips) + 2):
        moved = np.zeros(len(o), bool)
        for k, ((into, out), clip) in enumerate(zip(spans, clips, strict=True)):
            to = begin.copy()
            if _keeps(clip):
                to = np.maximum(begin, into)
                to[(into > out) | (begin >= out)] = np.inf
            else:
                within = (into < out) & (begin >= into) & (begin < out)
                to[within] = out[within]
            later = to > begin
            begin[later], at_begin[later] = to[later], k
            moved |= later & np.isfinite(to)
        if not moved.any():
            break
    end, at_end = np.full(len(o), np.inf), np.full(len(o), -1)
    for k, ((into, out), clip) in enumerate(zip(spans, clips, strict=True)):
        stop = out if _keeps(clip) else np.where((into < out) & (into > begin), into, np.inf)
        nearer = stop < end
        end[nearer], at_end[nearer] = stop[nearer], k
    return begin, end, at_begin, at_end


def _keeps(clip: Any) -> bool:
    return not isinstance(clip, ClipPlane) and clip.keep


def _inside(clip: Any, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of rays inside the shape that is taken away, or kept; into > out: none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(clip, ClipPlane):
            normal = np.asarray(clip.normal, np.float64)
            length = np.linalg.norm(normal)
            speed, height = d @ (normal / length), o @ (normal / length) - clip.offset / length
            at = -height / speed
            into = np.where(speed > 0, at, np.where((speed == 0) & (height <= 0), np.inf, -np.inf))
            out = np.where(speed < 0, at, np.where((speed == 0) & (height <= 0), -np.inf, np.inf))
            return into, out
        if isinstance(clip, ClipBox):
            p, q = (np.asarray(clip.lo) - o) / d, (np.asarray(clip.hi) - o) / d
            within = (o >= clip.lo) & (o <= clip.hi)
            p = np.where(d == 0, np.where(within, -np.inf, np.inf), p)
            q = np.where(d == 0, np.where(within, np.inf, -np.inf), q)
            return np.minimum(p, q).max(axis=1), np.maximum(p, q).min(axis=1)
    v = o - np.asarray(clip.center)
    along = np.einsum("ij,ij->i", v, d)
    square = clip.radius**2 - np.square(v - d * along[:, None]).sum(axis=1)
    half = np.sqrt(np.maximum(square, 0))
    none = square <= 0
    return np.where(none, np.inf, -along - half), np.where(none, -np.inf, -along + half)


def _face_normals(clips: Sequence[Any], which: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Outward normals (M, 3) of the kept part at points of the clips' surfaces."""
    normals = np.zeros((len(p), 3))
    for k, clip in enumerate(clips):
        at = which == k
        if not at.any():
            continue
        if isinstance(clip, ClipPlane):
            normal = np.asarray(clip.normal, np.float64)
            normals[at] = normal / np.linalg.norm(normal)
            continue
        if isinstance(clip, ClipSphere):
            away = p[at] - np.asarray(clip.center)
            own = away / np.linalg.norm(away, axis=1, keepdims=True)
        else:
            lo, hi = np.asarray(clip.lo, np.float64), np.asarray(clip.hi, np.float64)
            away = (p[at] - (lo + hi) / 2) / ((hi - lo) / 2)
            axis = np.argmax(np.abs(away), axis=1)
            own = np.zeros_like(away)
            rows = np.arange(len(away))
            own[rows, axis] = np.sign(away[rows, axis])
        normals[at] = own if clip.keep else -own
    return normals


def _blended(scene: SceneBase, points: np.ndarray) -> np.ndarray:
    """Blended colors (M, 3) at points."""
    color = scene.particles.color
    if np.ndim(color) == 2:
        return scene.blend(points, color)
    from ...scene.scene import DEFAULT_COLOR

    one = DEFAULT_COLOR if color is None else color
    return np.broadcast_to(np.asarray(one, np.float32), points.shape)
