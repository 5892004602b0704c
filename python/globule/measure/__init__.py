"""Measured from the field: samples, gauges, meshes, volumes and areas, projections."""

from .gauge import gauge, map_heights
from .mesh import SurfaceMeasure, SurfaceMesh, measure_surface, mesh_surface
from .places import SampleGrid, SampleLine, SamplePlane
from .project import project
from .sample import sample
from .samples import Samples
from .track import track_surface

__all__ = [
    "SampleGrid",
    "SampleLine",
    "SamplePlane",
    "Samples",
    "SurfaceMeasure",
    "SurfaceMesh",
    "gauge",
    "map_heights",
    "measure_surface",
    "mesh_surface",
    "project",
    "sample",
    "track_surface",
]
