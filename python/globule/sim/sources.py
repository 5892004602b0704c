"""Bodies of a scene from files: meshes, tomographies, particles, grids of distances."""

from __future__ import annotations

import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._base.checks import missing
from .._base.settings import Choice, Color, Each, Number, Problem, Table, Whole, same, setting
from ..data.attributes import velocity_name
from ..formats import read, triangles
from ..volumes.files import read_volume
from .sampling import MOST_PARTICLES
from .schema import NAME, PLACE, POSITIVE
from .shapes import Grid, Mesh

ATLASES = ("mni152",)
ATLAS_VOLUME = 197 * 233 * 189  # mm³, of its voxels


@dataclass(kw_only=True)
class Placed(Table):
    """A file in units of its own."""

    file: str = setting(NAME, help="path of the file")
    scale: float = setting(POSITIVE, 1.0, "size of a unit of the file", "m")
    move: tuple = setting(PLACE, (0.0, 0.0, 0.0), "displacement after scaling", "m")


@dataclass(kw_only=True)
class MeshFile(Placed):
    """A triangle mesh, closed but for boundaries (.obj .stl .glb .ply .vtk .vtp)."""

    def load(self) -> Mesh:
        """The mesh in m.

        Raises:
            FormatError, OSError: a file that cannot be read or has no triangles.
            MissingPackageError: trimesh is missing, for .obj, .stl and .glb.
        """
        vertices, faces, *_ = triangles.read(self.file)
        corners = np.asarray(vertices, np.float64)[faces]
        return Mesh(corners * self.scale + np.asarray(self.move))


@dataclass(kw_only=True)
class DistanceFile(Placed):
    """A grid of signed distances, negative inside (.nrrd .nii .mha .vti .npz)."""

    def load(self) -> Grid:
        """The grid in m; the errors are those of `read_volume`."""
        volume = read_volume(self.file)
        world_from_voxel = np.array(volume.world_from_voxel)
        world_from_voxel[:3] *= self.scale
        world_from_voxel[:3, 3] += self.move
        return Grid(np.transpose(volume.values, (2, 1, 0)) * self.scale, world_from_voxel)


@dataclass(kw_only=True)
class ParticleFile(Placed):
    """Particles of any format. A rigidity says what each particle is: 0 fluid, 1 fixed, tissue
    between."""

    def load(self) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Positions (N, 3) m; velocities (N, 3) m/s and rigidity (N,), or None where the file has
        none.

        Raises:
            ValueError: positions that are not finite, or rigidity outside of 0 to 1.
        """
        particles = read(self.file)
        positions = np.asarray(particles.positions, np.float64) * self.scale + np.asarray(self.move)
        if not np.isfinite(positions).all():
            raise ValueError(f"{self.file}: expected finite positions, got others")
        name = velocity_name(particles.attributes)
        velocities = None if name is None else particles.attributes[name]
        rigidity = particles.rigidity
        if rigidity is not None:
            rigidity = np.broadcast_to(rigidity, len(particles)).astype(np.float64)
            if (rigidity < 0).any() or (rigidity > 1).any():
                raise ValueError(f"{self.file}: expected rigidity from 0 to 1, got others")
        return positions, velocities, rigidity


@dataclass(kw_only=True)
class Tomography(Table):
    """Tissue of a tomography, resampled to the simulation's spacing: one particle per voxel."""

    file: str | None = setting(NAME, None, "path of a tomography")
    atlas: str | None = setting(Choice(*ATLASES), None, '"mni152", a brain, without `file`')
    level: float | None = setting(Number(), None, "iso-value, in the file's units")
    labels: list | None = setting(Each(Whole(-(2**31), 2**31)), None, "values to take, of labels")
    scale: float = same(Placed, "scale", default=0.001)
    center: tuple = setting(PLACE, (0.0, 0.0, 0.0), "new position of the tissue's middle", "m")
    white: tuple | None = setting(Color(), None, "color of white matter, which is then the phase "
        '"NAME white matter"')  # fmt: skip
    white_level: float | None = setting(Number(), None, "of a file: the least intensity of white "
        "matter")  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.file is None) == (self.atlas is None):
            raise ValueError("expected file or atlas, got both or none")
        if self.file and (self.white is None) != (self.white_level is None):
            raise ValueError("expected white and white_level of a file, got one of them")
        if self.atlas and self.white_level is not None:
            raise ValueError("white_level: expected none of an atlas, which knows its white matter")
        if self.labels is not None and self.white is not None:
            raise ValueError("white: expected none with labels, which have no intensity")

    def load(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) m on a cubic lattice of the spacing, m, and which are white matter,
        (N,) bool.

        Raises:
            ValueError: no voxel of tissue.
            MissingPackageError: an atlas without nilearn.
        """
        if self.atlas:
            positions, white = _atlas(spacing / self.scale)
        else:
            from ..volumes.tomography import tissue_voxels

            positions, values = tissue_voxels(self.file, self.level, self.labels, spacing / self.scale)
            least = np.inf if self.white_level is None else self.white_level
            white = values >= least
        if not len(positions):
            raise ValueError(f"{self.file or self.atlas}: expected tissue, got no voxel of it")
        middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
        white = white & (self.white is not None)
        return (positions - middle) * self.scale + np.asarray(self.center), white


def _atlas(millimeters: float) -> tuple[np.ndarray, np.ndarray]:
    """The MNI152 brain, where gray and white matter together are most of a voxel: mm, LPS; and
    where there is more white than gray matter. nilearn has the files; it is not imported."""
    from scipy import ndimage

    found = importlib.util.find_spec("nilearn")
    if found is None or found.origin is None:
        raise missing("nilearn", "atlas")
    if ATLAS_VOLUME / millimeters**3 > MOST_PARTICLES:
        least = (ATLAS_VOLUME / MOST_PARTICLES) ** (1 / 3)
        raise ValueError(f"atlas: expected at least {least:.2g} mm, got {millimeters:g} mm")
    parts = []
    for matter in ("gm", "wm"):
        (path,) = Path(found.origin).parent.glob(f"datasets/data/mni_icbm152_{matter}_*.nii.gz")
        volume = read_volume(path)  # in voxels of 1 mm
        part = volume.values.T.astype(np.float32) / volume.values.max()
        if millimeters > 1:  # means of the voxels that a larger one covers
            part = ndimage.gaussian_filter(part, millimeters / 2 / 2.3548)
        size = np.ceil((np.array(part.shape) - 1) / millimeters).astype(int) + 1
        scale = np.full(3, millimeters)
        parts.append(ndimage.affine_transform(part, scale, output_shape=tuple(size)))
    gray, white = parts
    index = np.argwhere(gray + white > 0.5)
    matrix = volume.world_from_voxel
    positions = millimeters * index @ matrix[:3, :3].T + matrix[:3, 3]
    return positions, (white > gray)[tuple(index.T)]


def check_files(table: Any, folder: str) -> None:
    """Make a table's `file` an absolute path; a file that does not exist is a Problem."""
    name = getattr(table, "file", None)
    if name is None:
        return
    path = os.path.join(folder, os.path.expanduser(name))
    if not os.path.exists(path):
        raise Problem(("file",), f"expected a file, got {path}, which is not there")
    table.file = os.path.abspath(path)
