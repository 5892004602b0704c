"""Small files as the programs of many origins write them: `KINDS`, each with what must be read."""

from kinds import atoms, hdf5, meshes, others, points, tables, vtk  # noqa: F401  they add theirs
from kinds.base import CENTERS, KINDS, RADII, Kind

__all__ = ["CENTERS", "KINDS", "RADII", "Kind"]
