"""Hits to light, once for all pieces: what the core does to an image without further turns of light
(src/trace/shade.hpp, edges.hpp), in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._base.checks import three
from ..camera import Camera
from ..display import displayed, shoulder
from ..lights import DirectionalLight, Headlight, PointLight
from ..materials import Material
from ..settings import RenderSettings
from .hits import NOTHING, Hits

CREASE, JUMP, CONTRAST = 0.6, 2.0, 24  # as in src/trace/edges.hpp
SOME = 1 << 13  # pixels at a time: in float64 their rays take a hundred bytes each


def rays_of(
    camera: Camera, size: tuple[int, int], pixels: np.ndarray, sample: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (K, 3) float32 of pixels' rays: through the centers, or a later
    sample anywhere in the pixel, at the same place as in the core (src/trace/camera.hpp)."""
    directions = np.empty((len(pixels), 3), np.float32)
    if camera.height is None:  # all from the eye
        eye = camera.frame(size)[0].astype(np.float32)
        origins = np.broadcast_to(eye, directions.shape)
    else:
        origins = np.empty_like(directions)
    for k in range(0, len(pixels), SOME):
        some = slice(k, k + SOME)
        begin, directions[some] = _core_rays(camera, size, pixels[some], sample)
        if camera.height is not None:
            origins[some] = begin
    return origins, directions


def _core_rays(camera: Camera, size: tuple[int, int], pixels: np.ndarray, sample: int) -> tuple[np.ndarray, np.ndarray]:
    """`rays_of` with the core's roundings, where it fuses products and sums (not in x86-64-v2)."""
    one, half, two = np.float32(1), np.float32(0.5), np.float32(2)
    column, row = (pixels % size[0]).astype(np.float32), (pixels // size[0]).astype(np.float32)
    if sample:
        u, v = _sample(pixels.astype(np.uint32), sample)
        column, row = column + (u - half), row + (v - half)
    eye, forward, right, up = camera.frame(size).astype(np.float32)
    x = _fused(column + half, two / np.float32(size[0]), -one)
    y = -_fused(row + half, two / np.float32(size[1]), -one)
    across = _fused(x[:, None], right, y[:, None] * up)
    if camera.height is not None:
        return eye + across, forward
    a, b, c = (forward + across).T
    length = np.sqrt(_fused(c, c, _fused(a, a, b * b)))
    return eye, (forward + across) * (one / length)[:, None]


def _fused(a: np.ndarray, b: Any, c: Any) -> np.ndarray:
    """a b + c of float32, rounded once."""
    return (a.astype(np.float64) * b + c).astype(np.float32)


def shade(
    hits: Hits, origins: np.ndarray, directions: np.ndarray, settings: RenderSettings, materials: Sequence[Material]
) -> tuple[np.ndarray, np.ndarray]:
    """Light (K, 3) float32, linear, and the same as displayed, i.e. with exposure and tone curve,
    before the transfer curve: (K, 3)."""
    behind = 0.0 if settings.transparent else settings.background
    color = np.empty((len(hits.t), 3), np.float32)
    color[:] = three("background", behind, 0.0)
    hit = np.flatnonzero(hits.layer != NOTHING)
    for k, material in enumerate(materials):
        at = hit[hits.layer[hit] == k]
        if len(at):
            d = directions[at]
            point = origins[at] + hits.t[at, None] * d
            color[at] = _surface(hits, at, d, point, settings, material)
    shown = color.copy()
    shown[hit] = shoulder(color[hit] * np.float32(settings.exposure))
    return color, shown


def _surface(
    hits: Hits, at: np.ndarray, d: np.ndarray, point: np.ndarray, s: RenderSettings, m: Material
) -> np.ndarray:
    n = hits.normal[at]
    behind = np.einsum("ij,ij->i", n, d) > 0
    n = np.where(behind[:, None], -n, n)
    albedo = hits.albedo[at] if m.color is None else np.array(three("color", m.color, 0.0), np.float32)
    specular = s.specular if m.specular is None else m.specular
    shininess = s.shininess if m.shininess is None else m.shininess
    light = np.array(three("ambient", s.ambient, 0.0), np.float32) * albedo * np.ones_like(n)
    for one in s.lights:
        if isinstance(one, Headlight):
            towards = -d
        elif isinstance(one, DirectionalLight):
            towards = np.broadcast_to(np.asarray(one.direction, np.float32), d.shape)
        else:
            assert isinstance(one, PointLight)
            towards = np.asarray(one.position, np.float32) - point
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = np.einsum("ij,ij->i", n, towards)
        half = towards - d
        half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-30)
        shine = specular * np.maximum(np.einsum("ij,ij->i", n, half), 0) ** np.float32(shininess)
        lit = np.array(three("radiance", one.radiance, 0.0), np.float32) * (albedo * cosine[:, None] + shine[:, None])
        light += np.where(cosine[:, None] > 0, lit, 0)
    if m.absorption is not None:
        through = np.exp(-np.array(three("absorption", m.absorption, 0.0), np.float32) * hits.t[at, None])
        light = np.where(behind[:, None], light * through, light)
    return light


def edges(hits: Hits, camera: Camera, size: tuple[int, int], picture: np.ndarray | None) -> np.ndarray:
    """Pixels beside a jump of distance, normal, layer or color: their numbers (K,).

    picture: (n, 3) uint8 where contrasts count; None: they do not.
    """
    width, height = size
    pixels = np.arange(width * height)
    origins, directions = rays_of(camera, size, pixels)
    marked = np.zeros((height, width), bool)
    grid = pixels.reshape(height, width)
    for a, b in ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])):
        for i, j in ((a.ravel(), b.ravel()), (b.ravel(), a.ravel())):  # as each of the two sees it
            found = _differ(hits, origins, directions, i, j)
            if picture is not None:
                apart = np.abs(picture[i].astype(int) - picture[j].astype(int))
                found |= (apart > CONTRAST).any(axis=1)
            marked.ravel()[i[found]] = True
    return np.flatnonzero(marked.ravel())


def _differ(hits: Hits, o: np.ndarray, d: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    found = hits.layer[i] != hits.layer[j]
    both = np.flatnonzero((hits.layer[i] != NOTHING) & (hits.layer[j] != NOTHING))
    p, q = i[both], j[both]
    n, m = hits.normal[p], hits.normal[q]
    a, b = o[p] + hits.t[p, None] * d[p], o[q] + hits.t[q, None] * d[q]
    apart, beside = b - a, o[q] + hits.t[p, None] * d[q] - a
    dots = [np.abs(np.einsum("ij,ij->i", apart, v)) for v in (n, m)]
    off = np.maximum(*dots) ** 2 > JUMP**2 * np.einsum("ij,ij->i", beside, beside)
    found[both] |= off | (np.einsum("ij,ij->i", n, m) < CREASE)
    return found


def finished(shown: np.ndarray) -> np.ndarray:
    """sRGB (N, 3) uint8 of light as displayed."""
    out = np.empty(shown.shape, np.uint8)
    for k in range(0, len(shown), SOME):
        out[k : k + SOME] = displayed(np.maximum(shown[k : k + SOME], 0).astype(np.float32))
    return out


def _sample(pixel: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
    """The place of a pixel's sample in the pixel, (K,) each in [0, 1); src/trace/random.hpp."""
    with np.errstate(over="ignore"):
        a = _hash(pixel ^ _hash(np.zeros(1, np.uint32)))
        at = _shuffled(np.full(len(pixel), k, np.uint32), _hash(_hash(a)))
        b = _hash(a)
        u = (a + at * np.uint32(3242174889)) >> np.uint32(8)
        v = (b + at * np.uint32(2447445414)) >> np.uint32(8)
    return u.astype(np.float32) * np.float32(2**-24), v.astype(np.float32) * np.float32(2**-24)


def _hash(v: np.ndarray) -> np.ndarray:
    v = v * np.uint32(747796405) + np.uint32(2891336453)
    v = ((v >> ((v >> np.uint32(28)) + np.uint32(4))) ^ v) * np.uint32(277803737)
    return (v >> np.uint32(22)) ^ v


def _reversed(v: np.ndarray) -> np.ndarray:
    for shift, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
        s, m = np.uint32(shift), np.uint32(mask)
        v = ((v >> s) & m) | ((v & m) << s)
    return (v >> np.uint32(16)) | (v << np.uint32(16))


def _shuffled(k: np.ndarray, seed: np.ndarray) -> np.ndarray:
    k = _reversed(k) + seed
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        k = k ^ (k * np.uint32(factor))
    return _reversed(k)


def light_of() -> RenderSettings:
    """Settings that make the core trace the pixels' centers and nothing else."""
    return RenderSettings(
        lights=(), ambient=0.0, background=0.0, samples=1, edge_samples=0, bounces=0,
        material=Material(reflection=0.0, transmission=0.0),
    )  # fmt: skip
