"""Files that other packages read where they are installed: laser scans, molecules, and snapshots of
cosmology."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from .._base.checks import optional
from ..data.particles import Particles
from .contents import Box, Contents, frame_index
from .errors import FormatError, bad
from .fields import particles_from
from .objects import particles_of
from .size import check_size


@contextlib.contextmanager
def _by(package: str, path: Any) -> Iterator[None]:
    """What a package raises is said of its file, but for what the system says of it."""
    try:
        yield
    except (FormatError, MemoryError):
        raise
    except OSError as error:
        if error.errno is not None:
            raise
        raise bad(path, "", f"{package}: {error}") from None
    except ValueError as error:
        if str(error).startswith("frame: "):
            raise
        raise bad(path, "", f"{package}: {error}") from None
    except Exception as error:
        raise bad(path, "", f"{package}: {type(error).__name__}: {error}") from None


def read_las(path: str | os.PathLike[str]) -> Particles:
    """A laser scan (.las; .laz with lazrs): points, their colors and dimensions."""
    laspy = optional("laspy", "formats")
    with open(path, "rb") as file, _by("laspy", path), laspy.open(file, closefd=False) as scan:
        n, size = scan.header.point_count, scan.header.point_format.size
        held = os.path.getsize(path)
        if not scan.header.are_points_compressed and n * size > held:
            raise bad(path, "header", f"expected points that the file has, got {n:,}")
        check_size(path, "header", n * size, held, 3.0)
        found = scan.read()
    names = [d.name for d in found.point_format.dimensions]
    taken = {"X", "Y", "Z", "red", "green", "blue"}
    arrays = {k: np.asarray(found[k]) for k in names if k not in taken}
    if {"red", "green", "blue"} <= {*names}:
        color = np.stack([np.asarray(found[k]) for k in ("red", "green", "blue")], axis=1)
        # Some writers fill the lower byte alone.
        full = 255 if color.size and color.max() < 256 else 65535
        arrays["color"] = np.round(color * (255 / full)).astype(np.uint8)
    return particles_from(path, np.stack([found.x, found.y, found.z], axis=1), arrays)


def read_molecule(path: str | os.PathLike[str], frame: int = 0) -> Contents:
    """Atoms of a .pdb or .gro, in Å, with the radii and colors of their elements."""
    name = os.fspath(path)
    form = "GRO" if name.lower().endswith(".gro") else "PDB"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what the file does not say
        try:
            import MDAnalysis
        except ImportError:
            return _molecule_of_ase(path, form, frame)
        with _by("MDAnalysis", path):
            world = MDAnalysis.Universe(name, topology_format=form, format=form)
            n = len(world.trajectory)
            world.trajectory[frame_index(path, frame, n)]
            if not hasattr(world.atoms, "elements") or not any(world.atoms.elements):
                world.guess_TopologyAttrs(to_guess=["elements"])
            edges = world.trajectory.ts.triclinic_dimensions
            particles = particles_of(world)
    return _molecule(path, particles, edges, n)


def _molecule_of_ase(path: Any, form: str, frame: int) -> Contents:
    ase = optional("ase.io", "programs", "MDAnalysis")
    kind = {"PDB": "proteindatabank", "GRO": "gromacs"}[form]
    with _by("ase", path):
        frames: Any = ase.read(os.fspath(path), index=":", format=kind)
    frames = [atoms for atoms in frames if len(atoms)] or frames[:1]
    atoms = frames[frame_index(path, frame, len(frames))]
    edges = np.asarray(atoms.cell) if atoms.cell.rank == 3 else None
    return _molecule(path, particles_of(atoms), edges, len(frames))


def _molecule(path: Any, particles: Particles | None, edges: Any, n_frames: int) -> Contents:
    if particles is None or not len(particles):
        raise bad(path, "", "expected atoms, got none")
    box = None
    if edges is not None and np.isfinite(edges).all() and np.linalg.det(edges) > 0:
        box = Box(np.zeros(3), np.asarray(edges, np.float64), (True, True, True))
    units = {"positions": "Å", "radius": "Å"}
    return Contents(particles, box, units=units, n_frames=n_frames)


def read_snapshot(path: str | os.PathLike[str]) -> Particles:
    """A snapshot of Gadget 1 and 2 or of Tipsy: its gas, or else all particles, in its units."""
    pynbody = optional("pynbody", "programs")
    with warnings.catch_warnings(), _by("pynbody", path):
        warnings.simplefilter("ignore")  # of parameters in other files
        found = particles_of(pynbody.load(os.fspath(path)))
    assert found is not None
    return found
