"""`globule render` of what does not fit into the memory (--memory), or on the ranks of mpiexec."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from .._base.checks import MissingPackageError
from .._base.device import choose
from .._base.memory import GIGABYTE, resident_bytes, room
from ..data.attributes import colormap_of, place_label
from ..data.particles import FARTHEST
from ..formats import FormatError
from ..formats.kind import kind_of
from ..formats.ranges import NAMES, counted_rows, has_ranges, ranges
from ..pieces.pieces import BYTES, Pieces
from ..pieces.store import Source, source_of
from ..render.annotate import Colors, corners_to_fit
from ..render.camera import Camera
from ..render.fit import with_room
from ..render.frame import save_png
from ..render.layers import Layer
from ..render.pieces.image import fit
from ..render.render import render
from ..scene.fitting import lacking
from . import annotation, camera_facts, light, surfaces
from .meshes import is_mesh
from .shared import (
    UserError,
    count,
    mistakes,
    need_particles,
    print_json,
    read_particles,
    reading,
    said_threads,
    say,
    warn,
)

# Flags that need all particles in one scene; with the values that leave them out.
NOT_WITH_PIECES: dict[str, Any] = {
    "views": None, "anisotropic": False, "state": None, "preset": None, "beside": [], "pick": None,
    "octree": "sparse", "depth": None, "root": "exact", "camera_path": None, "turntable": None,
    "meshes": [], "spheres": [], "lines": [],
}  # fmt: skip
_SIZES = {"": 1, "K": 1e3, "M": 1e6, "G": GIGABYTE, "T": 1e12}


def ground_needs_all(options: argparse.Namespace) -> bool:
    """Whether the ground lies where the surface ends, which pieces do not tell."""
    given = options.ground
    return given not in (None, "none") and (isinstance(given, str) or not np.isfinite(given))


def needs_all(options: argparse.Namespace) -> bool:
    """Whether an option is not for pieces."""
    if any(getattr(options, k, v) not in (v, None, []) for k, v in NOT_WITH_PIECES.items()):
        return True
    return ground_needs_all(options)


def memory(text: str) -> float:
    """Bytes: a number with K, M, G or T behind, of 1000 each."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?) ?([KMGT]?)B?", text.strip(), re.IGNORECASE)
    value = float(match[1]) * _SIZES[match[2].upper()] if match else 0.0
    if value <= 0:
        raise argparse.ArgumentTypeError(f"expected a size such as 8G or 500M, got {text!r}")
    return value


def wanted(options: argparse.Namespace) -> bool:
    """Whether the image is made of pieces since memory does not suffice for one scene."""
    if len(options.particles) == 1:
        return _wanted(options, options.particles[0])
    if options.memory is not None:
        for path in dict.fromkeys(options.particles):
            if _is_whole(path, options) and _wanted(options, path):
                n = count(len(options.particles), "image")
                raise UserError(
                    f"--memory: expected one image where a file is read in pieces, as {path} "
                    f"would be, got {n}; make them one by one, or give more memory"
                )
    return False


def _is_whole(path: str, options: argparse.Namespace) -> bool:
    """Whether a file can be read; what is wrong with an image's file shows when its turn comes."""
    given = reading(options)
    try:
        return not has_ranges(path, given) or ranges(path, **given).n >= 0
    except (ValueError, OSError, MissingPackageError):
        return False


def _wanted(options: argparse.Namespace, path: str) -> bool:
    if kind_of(path).kind != "particles" or is_mesh(path, options):
        return False
    given = reading(options)
    if options.memory is None:
        found = None if needs_all(options) else counted_rows(path, **given)
        if found is None:
            return False
        surface = options.surface if options.surface in BYTES else "smooth"
        n, row = found
        return lacking(n, n * row, surface, 32, choose(options.device)) is not None
    held = os.path.getsize(path)
    if not has_ranges(path, given):
        if 3 * held > options.memory:
            beside = "".join(f" with --{name}" for name in given if has_ranges(path))
            raise UserError(
                f"--memory: expected {NAMES}, whose ranges can be read, got {path}{beside}; globule convert writes .npz"
            )
        return False
    with mistakes():
        n = ranges(path, **given).n
    # Smooth surfaces take most; the file's own arrays are read besides.
    return resident_bytes() + held + n * BYTES["smooth"] > options.memory


def _share(path: str, given: Mapping[str, Any], comm: Any) -> Source:
    """This rank's rows of a file; rank 0's are all where ranges cannot be read."""
    if has_ranges(path, given):
        n, read, origin = ranges(path, **given)
        whole = Source(n, read, origin=origin)
        if comm is None:
            return whole
        first, last = (whole.n * r // comm.size for r in (comm.rank, comm.rank + 1))
        return Source(last - first, lambda a, b: whole.read(first + a, first + b), whole.size, origin=origin)
    nothing = np.empty((0, 3), np.float32)
    return source_of(nothing if comm.rank else read_particles(path, **given))


def run(
    options: argparse.Namespace, lit: light.Light, notes: annotation.Notes, image: str,
    aov: str | None, comm: Any, towards: Mapping[str, Any],
) -> None:  # fmt: skip
    """Make the image of one file in pieces. towards: how the fitted camera looks."""
    for name, usual in NOT_WITH_PIECES.items():
        if getattr(options, name, usual) not in (usual, None, []):
            flags = {"beside": "with", "depth": "octree-level", "meshes": "mesh"}
            flag = flags.get(name, name.replace("_", "-"))
            raise UserError(f"--{flag}: expected none with a scene in pieces, got one")
    if ground_needs_all(options):
        raise UserError("--ground: expected a height with a scene in pieces, got none")
    start, path = time.perf_counter(), options.particles[0]
    root = comm is None or comm.rank == 0
    said: Callable[[str], None] = warn if root else (lambda _: None)
    limit = None if comm else options.memory or resident_bytes() + room()
    with mistakes(), _memory(options):
        try:
            source = _share(path, reading(options), comm)
            pieces = Pieces(
                source, memory=limit, comm=comm,
                color_by=options.color_by, colormap=options.colormap, range=options.range,
                kernel=options.kernel, threshold=options.threshold, support=options.support,
                surface=options.surface, spacing=options.particle_spacing,
                device=options.device, threads=options.threads,
            )  # fmt: skip
        except (FormatError, OSError) as error:
            text = str(error)
            raise UserError(text if path in text else f"{path}: {text}") from error
    with contextlib.closing(pieces):
        built = time.perf_counter()
        given = sum(comm.allgather(source.n)) if comm else source.n
        need_particles(path, len(pieces))
        if n_lost := given - len(pieces):
            has = f"{'have' if n_lost > 1 else 'has'} no finite position up to {FARTHEST:g}"
            said(f"{n_lost:,} of {count(given)} {has}, left out")
        n, where = pieces.partition.n, "on as many ranks" if comm else "one after the other"
        if root and not options.json:
            say(f"{count(len(pieces))} in {n} pieces, {where}")
        spheres = pieces.surface == "spheres"
        if root and spheres and pieces.support is None and options.surface == "auto":
            say(surfaces.OF_RADII)
        if options.said_up and not (spheres and pieces.normal is not None):
            say(options.said_up)
        with mistakes():
            camera = _camera(options, pieces, notes, towards)
            settings = lit.settings(pieces)  # type: ignore[arg-type]  # no preset asks it
            frame = render([Layer(pieces, clips=lit.clips)], camera, notes.size, settings)
            if not root:
                return
            colors = None
            if options.color_by:
                assert pieces.range is not None
                name = options.color_by
                colors = Colors(
                    colormap_of(name, options.colormap), *pieces.range, place_label(name, pieces.origin), pieces.kinds
                )
            if aov:
                frame.save(aov)
            save_png(image, notes.picture(0, [frame], [camera], colors, None))
    end = time.perf_counter()
    hits = int(frame.mask.sum())
    if not hits:
        said("no pixel hits the surface: the camera looks past it, or try --threshold")
    device = said_threads(pieces.device.description, options.threads)
    if not options.json:
        print(f"{image}: {count(len(pieces))}, read in {built - start:.2f} s, "
              f"{end - start:.2f} s in all on {device}")  # fmt: skip
        return
    print_json({
        "input": path, "images": [image], "aov": aov, "size": options.size,
        "samples": frame.samples, "times": {"read": built - start, "total": end - start},
        "device": device, "kernel": pieces.kernel,
        "threshold": pieces.threshold, "surface": pieces.surface, "support": pieces.support,
        "spacing": pieces.spacing, "origin": list(pieces.origin), "ranks": comm.size if comm else 1,
        "memory": {"limit": limit}, "camera": camera_facts.facts(camera),
        "counts": {"particles": len(pieces), "pieces": n, "hits": hits},
    })  # fmt: skip


@contextlib.contextmanager
def _memory(options: argparse.Namespace) -> Iterator[None]:
    try:
        yield
    except MemoryError as error:
        raise UserError(f"--{error}") from error


def _camera(options: argparse.Namespace, pieces: Pieces, notes: annotation.Notes, towards: Mapping[str, Any]) -> Camera:
    """The camera that the options ask for."""
    middle = options.look_at or (pieces.low + pieces.high) / 2
    if options.eye:
        if np.array_equal(middle, options.eye):
            middle = np.add(options.eye, (0, 0, -1))
        return Camera(options.eye, middle, options.up, towards["fov"], options.ortho)
    around = corners_to_fit(notes.annotation, pieces, None)
    flat = pieces.normal is not None
    base = with_room(notes.size, notes.annotation, flat, lambda size: fit(pieces, size, around, **towards))
    return Camera(base.eye, base.look_at, options.up, towards["fov"], options.ortho)
