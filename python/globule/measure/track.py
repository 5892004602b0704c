"""The surface of a sequence, measured frame by frame."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from typing import Any

import numpy as np

from .._base.checks import positive
from ..render.image_sequence import KeptScene
from ..render.sequence import all_frames, leader
from .mesh import in_closed_form, measured, mesh_surface
from .surface import default_spacing, measured_particles, spheres_of, surface_scene


def track_surface(
    frames: str | os.PathLike[str] | Sequence[Any] | Iterable[Any],
    spacing: float | None = None,
    device: str = "auto",
    threads: int = 0,
    progress: Callable[[int, int], object] | None = None,
) -> dict[str, np.ndarray]:
    """The enclosed volume, area and extent of the surface in each frame of a sequence.

    The extent follows fronts: "x_max" is the place of a front that moves along x, "y_max" the
    greatest height where y points up. It includes spray.

    Args:
        frames: names of files, a pattern such as "frame_*.vtk", a file with several frames,
            Particles, or arrays of positions.
        spacing: as for `mesh_surface`; default, for all: that of the largest file or list of
            particles, unless the first is about as large; of other iterables, that of the first.
        device, threads: as for `Scene`.
        progress: called as progress(done, total), where the number of frames is known; may raise
            to stop.

    Returns:
        name -> (F,) float64: "frame" (its number, from 0), "volume", "volume_error", "area" and
        "area_error" as in `measure_surface`, "x_min", "x_max" … "z_max" in world units, NaN for a
        frame without surface; "particles", their number, and "particle_volume", which knows
        nothing of the surface: of a smooth surface the number times the cube of the spacing, which
        is the one of all frames, and of spheres the sum of theirs; else NaN.

    Raises as `mesh_surface` does, and ValueError for a pattern without files.
    """
    every = all_frames(frames)
    total = len(every) if isinstance(every, Sized) else 0
    spacing = None if spacing is None else positive("spacing", spacing)
    lead = None
    if isinstance(every, Sequence) and (at := leader(every)):
        lead = functools.partial(measured_particles, "frames", every[at])
    scenes = KeptScene(lead, grows=not isinstance(every, Sequence))
    rows = []

    def made(scene: Any) -> None:
        nonlocal spacing
        if spacing is None and scene.octree.n_inside:
            spacing = default_spacing(scene)

    for number, frame in enumerate(every):
        particles = measured_particles("frames", frame)
        scene = scenes.show(particles, lambda p: surface_scene(p, device=device, threads=threads), made)
        rows.append({"frame": number} | facts(scene, spacing))
        if progress and total:
            progress(number + 1, total)
    names = list(rows[0]) if rows else []
    return {name: np.array([row[name] for row in rows], np.float64) for name in names}


def facts(scene: Any, spacing: float | None = None) -> dict[str, float]:
    """Volume, area and extent of a scene's surface, and the number and volume of its particles;
    spacing: as for `measure_surface`."""
    lo, hi = np.full((2, 3), np.nan)
    found = in_closed_form(scene)
    if found is None:
        mesh = mesh_surface(scene, spacing)
        found = measured(scene, mesh)
        if len(mesh.vertices):
            lo, hi = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    spheres = spheres_of(scene)
    if spheres is not None and len(spheres[0]):
        centers, radii = (a.astype(np.float64) for a in spheres)
        lo = (centers - radii[:, None]).min(axis=0)
        hi = (centers + radii[:, None]).max(axis=0)
    n = scene.octree.n_inside
    own = np.nan if n else 0.0
    if spheres is not None:
        own = float((4 / 3 * np.pi * spheres[1].astype(np.float64) ** 3).sum())
    elif n and scene.surface == "smooth":
        own = n * scene.spacing**3
    return found._asdict() | dict(_extent(lo, hi)) | {"particles": n, "particle_volume": own}


def _extent(lo: np.ndarray, hi: np.ndarray) -> Iterator[tuple[str, float]]:
    for i, axis in enumerate("xyz"):
        yield f"{axis}_min", float(lo[i])
        yield f"{axis}_max", float(hi[i])
