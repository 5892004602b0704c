"""Opens everything that can be shown as a source of frames."""

from __future__ import annotations

import functools
import os
import re
from typing import Any

import numpy as np

from .._base.arrays import on_gpu, to_host
from ..data.particles import HERE, Particles
from ..formats import read
from ..formats.triangles import has_faces
from ..pieces.scene import Scene
from ..render.layers import Layer
from ..scene.mesh import Mesh
from ..sim.scene_read import SHIPPED
from ..ultrasound.setup import Setup
from ..ultrasound.sweep import Sweep
from ..volumes.volume import Volume
from .sequence_source import SequenceSource
from .simulation_source import SimulationSource
from .source import SceneSource, Source
from .state import FAR
from .sweep_source import SweepSource, played, received
from .volume_source import VolumeSource

EXPECTED = (
    "a file or several, Particles, positions (N, 3), a Scene, a Mesh, layers, a list of "
    "Particles, a Volume, a Sweep, a simulation or its scene's name"
)


def open_source(what: Any, device: str = "auto", threads: int = 0, **reading: Any) -> Source:
    """The source of frames for an object, a file, or a name.

    Args:
        what: a path, several paths (a sequence), the name of a shipped simulation, a scene's .toml,
            igtl://host:port, or an object.
        device, threads: as for `Scene`.
        reading: keywords of `globule.read` (level, labels, spacing) or
            `globule.ultrasound.read_sweep`.

    Raises:
        MissingPackageError: a live stream without the extra `live`.
        TypeError, ValueError, FormatError, OSError: the message names what cannot be shown.
    """
    common: dict[str, Any] = {"device": device, "threads": threads}
    if isinstance(what, (str, os.PathLike)):
        return _open_name(os.fspath(what), common, reading)
    if isinstance(what, Mesh):
        return SceneSource(f"{len(what):,} triangles", what, **common)
    if isinstance(what, (Particles, Scene)):
        return SceneSource(f"{len(what):,} particles", what, **common)
    if isinstance(what, Volume):
        return VolumeSource("volume", what, **common)
    if isinstance(what, Sweep):
        return _sweep("sweep", what, common)
    if isinstance(what, tuple) and len(what) == 2 and isinstance(what[0], Volume):
        return VolumeSource("volume", *what, **common)
    if hasattr(what, "step") and hasattr(what, "particles"):
        return SimulationSource("simulation", what, **common)
    if on_gpu(what) or isinstance(what, np.ndarray):
        return SceneSource("particles", Particles(what), **common)
    if not hasattr(what, "__iter__"):
        raise TypeError(f"view: expected {EXPECTED}, got {type(what).__name__}")
    items = list(what)
    if items and all(isinstance(item, (str, os.PathLike)) for item in items):
        return _open_files([os.fspath(item) for item in items], common, reading)
    if items and all(isinstance(item, Particles) for item in items):
        return SequenceSource(f"{len(items)} frames", items, **common)
    if items and all(isinstance(item, (Layer, Scene, Mesh)) for item in items):
        return SceneSource(f"{len(items)} layers", items, **common)
    raise TypeError(f"view: expected {EXPECTED}, got {what!r:.80}")


def _open_files(names: list[str], common: dict[str, Any], reading: dict[str, Any]) -> Source:
    from ..render.sequence import find_files, with_frames

    if len(names) == 1:
        return _open_name(names[0], common, reading)
    files = find_files(names)
    if "frame" not in reading:
        files = with_frames(files, **reading)
    pattern = re.sub(r"\d+(?=\D*$)", "*", os.path.basename(files[0]))
    name = f"{pattern}, {len(files)} frames"
    source = SequenceSource(name, files, **common, read_frame=lambda path: read(path, **reading))
    source.reading = _settled(reading, source)
    return source


def _open_name(name: str, common: dict[str, Any], reading: dict[str, Any]) -> Source:
    title = os.path.basename(os.path.normpath(name))
    source: Source | None
    if name.startswith("igtl://"):
        setup = Setup(**reading)
        source = SweepSource(name, received(name, setup.edges, setup.temporal_offset), **common)
        source.files, source.reading = [name], reading
        return source
    if simulation_name(name):
        from ..sim.simulation import Simulation

        source = SimulationSource(title, Simulation(name, **common), **common)
        source.files = [name]
        return source
    if not os.path.exists(name):
        from ..render.sequence import find_files

        files = find_files([name])  # a pattern; the reader reports a missing file
        if files != [name]:
            return _open_files(files, common, reading)
    source = _medical(name, common, reading)
    if source is None and not reading and has_faces(name):
        source = SceneSource(title, Mesh(name), **common)
    if source is None and "frame" not in reading:
        from ..render.sequence import with_frames

        frames = with_frames([name], **reading)
        if len(frames) > 1:
            title = f"{title}, {len(frames):,} frames"
            reader = functools.partial(read, **reading)
            source = SequenceSource(title, frames, **common, read_frame=reader)
    if source is None:
        particles = read(name, **reading)
        places = to_host(particles.positions)
        if not (np.abs(places) < FAR).all(axis=1).any():  # False for NaN, too
            got = f"{len(places):,} with others" if len(places) else "none"
            raise ValueError(
                f"{name}: nothing to show: expected particles with finite positions below {FAR:g}, got {got}"
            )
        source = SceneSource(title, particles, **common)
    if not isinstance(source, SequenceSource):
        source.files = [name]
    source.reading = _settled(reading, source)
    return source


def _settled(reading: dict[str, Any], source: Source) -> dict[str, Any]:
    """How each frame alone is read to stand where the source shows it."""
    origin = source.together.origin if isinstance(source, SequenceSource) else None
    return reading if origin in (None, HERE) else {**reading, "origin": origin}


def _medical(name: str, common: dict[str, Any], reading: dict[str, Any]) -> Source | None:
    """The source of a sweep or a volume.

    None for other files.
    """
    from ..formats.kind import kind_or_none
    from ..ultrasound.files import read_sweep
    from ..volumes.files import read_volume
    from ..volumes.tomography import sample_tomography

    title = os.path.basename(os.path.normpath(name))
    found = kind_or_none(name) if os.path.exists(name) else None
    kind = found.kind if found else None
    if kind == "sweep":
        return _sweep(title, read_sweep(name, **reading), common)
    if kind == "volume" and reading:
        source = SceneSource(title, sample_tomography(name, **reading), **common)
        source.maker.fluids = False  # voxels
        return source
    if kind == "volume":
        return VolumeSource(title, read_volume(name), **common)
    return None


def _sweep(name: str, sweep: Sweep, common: dict[str, Any]) -> SweepSource:
    lo, hi = sweep.bounds()
    spacing = max(2 * float(np.mean(sweep.spacing)), float(np.max(hi - lo)) / 200)
    return SweepSource(name, played(sweep), round(spacing, 3), sweep=sweep, **common)


def simulation_name(name: str) -> bool:
    """Whether a name is a scene of a simulation: a .toml, or the name of a shipped scene."""
    if name.lower().endswith(".toml"):
        return True
    return name in SHIPPED and not os.path.exists(name)
