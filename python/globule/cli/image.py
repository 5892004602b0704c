"""One image of `globule render`: read, built, traced, written and reported."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from .._base.device import choose
from ..data.attributes import colormap_of, kinds_of, place_label
from ..data.particles import HERE, Particles
from ..formats.frames import FrameOf
from ..formats.kind import kind_of
from ..pieces.scene import Scene
from ..render.annotate import Colors
from ..render.camera import Camera
from ..render.frame import Frame
from ..render.render import render
from ..render.trace import points_of, values_of
from ..scene.mesh import Mesh
from ..scene.thesis import Thesis
from . import annotation, camera_facts, light, look, meshes, sequence, surfaces, tracing
from .shared import Progress, UserError, count, doubled, left_out, mistakes, need_particles, none_of, said_threads

SAMPLES = 20_000  # particles at which the highest field is looked for
FEW = 0.005  # share of the pixels below which a fitted image shows almost nothing
MOST = 0.9  # of the particles that a crop keeps
APART = 0.2  # size of the box of 99 % of the particles by that of all, where some lie far away


class Subject(NamedTuple):
    """What an image shows of its file."""

    scene: Scene | Mesh
    kept: np.ndarray  # indices in the file of the particles that are left
    particles: Particles | None
    ends: tuple[float, float] | None  # values at the ends of the color map
    n: int  # particles in the file
    build_seconds: Callable[[], float]


def picture(
    options: argparse.Namespace,
    lit: light.Light,
    notes: annotation.Pictures,
    thesis: Thesis | None,
    progress: Progress,
    series: sequence.Series,
    i: int,
    path: str,
    image: str,
    aov: str | None,
    cameras: Callable[[Any, Any], list[Camera]],
    comm: Any = None,
) -> dict[str, Any] | None:
    """Make the image of one file, and return its report; None if the image is there already, or
    another rank of comm has it.

    cameras: of a scene and the points around, those of all views.
    """
    start = time.perf_counter()
    progress.step(f"reading {path}")
    shape, found = series.read()
    messages = list(found)
    read_seconds = time.perf_counter() - start
    progress.step(f"building {path}")

    def made(scene: Scene | Mesh) -> None:
        """What all images share follows from the frame that leads."""
        lit.begin(scene)
        lit.place(path, i)
        series.look(scene, cameras)

    with mistakes():
        if isinstance(shape, Mesh):
            subject = _mesh(options, path, shape, messages)
            made(shape)
        else:
            subject = _particles(options, series, path, shape, messages, made)
        scene = subject.scene
        lit.place(path, i)
        views = series.cameras(i)
    if series.finished(image, aov):
        return None
    frames, trace_seconds = _traced(options, lit, notes, progress, path, scene, views, thesis, comm)
    if comm is not None and comm.rank:
        return None
    hits = sum(int(frame.mask.sum()) for frame in frames)
    n_pixels = sum(frame.mask.size for frame in frames)
    messages += lit.messages
    messages += _notices(options, lit, thesis, subject, hits, n_pixels, lit.hiding(frames))
    progress.step(f"writing {image}")
    written = time.perf_counter()
    with mistakes():
        colors = None
        if options.color_by:
            assert subject.ends is not None
            name, points = options.color_by, points_of(scene)
            kinds = kinds_of(points, name, options.colormap)
            colormap = colormap_of(name, options.colormap)
            colors = Colors(colormap, *subject.ends, place_label(name, points.origin), kinds)
            if subject.particles is not None and lit.settings(scene).is_flat:
                ends = subject.ends
                shown = values_of(subject.particles, name, options.colormap, ends)
                for one in frames:
                    one._values = shown[:4]
        series.prepare()
        if aov:
            frames[0].save(aov)
        notes.write(image, i, frames, views, colors, series.box)
    end = time.perf_counter()
    series.warn(messages, progress)
    times = {
        "read": read_seconds, "build": subject.build_seconds(), "trace": trace_seconds,
        "write": end - written, "total": end - start,
    }  # fmt: skip
    of_file = {"frame": path.frame} if isinstance(path, FrameOf) else {}
    report = {
        "input": path, **of_file, "images": [image], "aov": aov, "size": options.size,
        "samples": frames[0].samples, "times": times, "warnings": messages,
        **_facts(options, subject, hits),
    }  # fmt: skip
    seen = [camera_facts.facts(view) for view in views]
    report |= {"cameras": seen} if options.views else {"camera": seen[0]}
    if options.pick:
        report["picked"] = lit.picked(frames[0], subject.kept)
    return report


def _particles(
    options: argparse.Namespace,
    series: sequence.Series,
    path: str,
    particles: Particles,
    messages: list[str],
    made: Callable[[Scene], object],
) -> Subject:
    """The scene of a file's particles that have a position, in their colors. made: as for
    `KeptScene.show`."""
    finite = np.isfinite(particles.positions).all(axis=1)
    n = len(particles)
    if len(set(options.particles)) == 1:  # a sequence may have empty frames
        need_particles(path, int(finite.sum()))
    if n == 0:
        messages.append(none_of(path, options))
    messages += left_out(path, particles, far=False)  # the octree tells those
    messages += doubled(path, particles)
    if not finite.all():
        particles = particles[finite]
    ends = None
    if options.color_by:
        particles.color, ends = look.color_by(options, path, particles, messages)
    if options.anisotropic:
        particles = look.stretched(options, particles)
    try:
        scene = series.scene(particles, functools.partial(_scene, options), made)
    except UserError as error:
        if options.support is None and str(error).startswith("support:"):  # the file's own
            raise UserError(f"{path}: {error}") from error
        raise
    kept = np.flatnonzero(finite)
    return Subject(scene, kept, particles, ends, n, lambda: scene.octree.build_seconds)


def _mesh(options: argparse.Namespace, path: str, mesh: Mesh, messages: list[str]) -> Subject:
    """A file's triangles, on the device."""
    start = time.perf_counter()
    ends = None
    if options.color_by:
        ends = look.color_mesh(options, path, mesh, messages)
    mesh.build(choose(options.device))
    seconds = time.perf_counter() - start
    return Subject(mesh, np.empty(0, np.int64), None, ends, 0, lambda: seconds)


def _notices(
    options: argparse.Namespace,
    lit: light.Light,
    thesis: Thesis | None,
    subject: Subject,
    hits: int,
    n_pixels: int,
    hiding: str,
) -> list[str]:
    """What a user should know about the image. hiding: what is seen instead of the particles."""
    scene, particles = subject.scene, subject.particles
    if isinstance(scene, Mesh):
        return [] if hits else [meshes.why_empty(scene)]
    assert particles is not None
    found = []
    if thesis:
        found += [tracing.why_cut(scene), tracing.why_dust(options, particles, scene)]
    n_inside = scene.octree.n_inside
    if n_outside := len(particles) - n_inside:
        found.append(f"{n_outside:,} of {count(subject.n)} outside the octree, left out")
    fits = not (options.eye or options.camera_path)
    if n_inside and (hiding or not hits):
        found.append(why_empty(scene, lit.clips, fits, hiding))
    elif n_inside and fits and not lit.clips and hits < FEW * n_pixels:
        found.append(spread(scene))
    return [message for message in found if message]


def _facts(options: argparse.Namespace, subject: Subject, hits: int) -> dict[str, Any]:
    """The part of the report that depends on the kind of file."""
    scene = subject.scene
    if isinstance(scene, Mesh):
        return {
            "device": said_threads(choose(options.device).description, options.threads),
            "closed": scene.closed,
            "origin": list(scene.origin or HERE),
            "counts": {"triangles": len(scene), "hits": hits},
        }
    tree = scene.octree
    facts: dict[str, Any] = {
        "device": said_threads(scene.device.description, options.threads),
        "root": options.root,
        "kernel": scene.kernel,
        "threshold": scene.threshold,
        "surface": scene.surface,
        "support": _one_number(scene.support),
        "spacing": scene.spacing or None,
        "origin": list(scene.origin),
        "memory": {"octree": tree.bytes},
        "counts": {
            "particles": subject.n,
            "inside": tree.n_inside,
            "outside": subject.n - tree.n_inside,
            "nodes": tree.n_nodes,
            "leaves": tree.n_leaves,
            "hits": hits,
        },
    }
    if options.json:
        facts["hashes"] = {"key_hash": tree.key_hash, "node_hash": tree.node_hash}
    return facts


def _traced(
    options: argparse.Namespace,
    lit: light.Light,
    notes: annotation.Pictures,
    progress: Progress,
    path: str,
    scene: Scene | Mesh,
    views: Sequence[Camera],
    thesis: Thesis | None,
    comm: Any,
) -> tuple[list[Frame], float]:
    """A frame for each view of a scene with all that the options put beside it, and the device's
    seconds."""
    progress.step(f"tracing {path}")
    with mistakes():
        settings = lit.settings(scene)
        first = dataclasses.replace(settings, samples=1)
        if settings.samples > 1:
            first = dataclasses.replace(first, edge_samples=0)
        layers = lit.layers(scene)
        frames = [render(layers, view, notes.size, first, thesis=thesis, comm=comm) for view in views]
        seconds = sum(frame.trace_seconds for frame in frames)
        for k in range(2, settings.samples + 1):  # one by one, for progress and Ctrl-C
            progress.show(f"tracing {path}: sample {k} of {settings.samples}")
            seconds += sum(frame.refine().trace_seconds for frame in frames)
        if comm is not None and settings.transparent:
            for frame in frames:
                frame.alpha  # noqa: B018  found by all ranks together
    return frames, seconds


def _scene(options: argparse.Namespace, particles: Particles) -> Scene:
    """The scene of the particles, as the options ask for."""
    support, depth = tracing.support_and_depth(options, particles)
    if options.anisotropic:
        support = None
    volume = any(kind_of(path).kind == "volume" for path in options.particles)
    as_balls = volume or options.preset == "thesis"  # voxels; the source's balls
    asked = {
        "kernel": options.kernel, "threshold": options.threshold, "support": support,
        "key_bits": options.key_bits, "level": depth, "octree": options.octree,
        "device": options.device, "threads": options.threads,
    }  # fmt: skip
    with tracing.octree_mistakes():
        return surfaces.scene_of(options, particles, as_balls, **asked)


def _one_number(support: Any) -> Any:
    """The support of all particles, or the smallest and the largest."""
    if np.ndim(support) == 0:
        return float(support)
    return [float(support.min()), float(support.max())] if len(support) else None


def spread(scene: Scene) -> str:
    """What to say where a few particles far away make the others small in a fitted image; "" where
    none are."""
    positions = scene.particles.finite_positions().astype(np.float64)
    lo, hi = positions.min(axis=0), positions.max(axis=0)
    inner_lo = np.percentile(positions, 1 / 6, axis=0, method="higher")
    inner_hi = np.percentile(positions, 100 - 1 / 6, axis=0, method="lower")
    size = float((inner_hi - inner_lo).max())
    within = ((positions >= inner_lo) & (positions <= inner_hi)).all(axis=1).mean()
    if not size < APART * float((hi - lo).max()) or within < MOST:
        return ""
    room = 0.05 * size + 1e-6 * float(np.abs(inner_hi).max())
    crop = ",".join(f"{v:.6g}" for v in (*(inner_lo - room), *(inner_hi + room)))
    return (
        f"almost nothing shows: the particles spread over {float((hi - lo).max()):.4g}, "
        f"but {100 * within:.4g} % of them lie in a box of {size:.4g}; try --crop={crop}"
    )


def why_empty(scene: Scene, clips: Sequence[Any], fits: bool = False, hiding: str = "") -> str:
    """Why the image shows no surface, and how to fix that."""
    positions = scene.particles.positions
    taken: np.ndarray = np.zeros(len(positions), bool)
    for clip in clips:
        taken |= clip.takes(positions)
    if taken.all():
        return "no pixel hits the surface: the cuts take all particles away"
    values = scene.field(positions[:: 1 + len(positions) // SAMPLES])
    highest = float(values.max())
    if highest > scene.threshold and hiding:
        return hiding
    if highest > scene.threshold:
        if not fits:
            return "no pixel hits the surface: the camera looks past it, try --fit"
        small = "no pixel hits the surface: it is smaller than a pixel; try --eye and --look-at"
        return (not clips and spread(scene)) or small
    problem = (
        f"no pixel hits the surface: threshold {scene.threshold:g} is above the highest field "
        f"at the particles, {highest:.3g}"
    )
    if highest <= 0:
        return f"{problem}; the weights leave no field above 0"
    return f"{problem}; try --threshold {0.5 * float(np.median(values[values > 0])):.2g}"
