"""Fluids, tissue and the knife: simulations whose octree is also traced."""

from .instruments import Instrument, Key
from .scene_file import (
    Boundary,
    Domain,
    Emitter,
    Fluid,
    Foam,
    Output,
    Relaxation,
    Rigid,
    SceneFile,
    Sink,
    Solid,
    Solver,
    Vessel,
    View,
)
from .schema import SceneError
from .settings import Phase, StepReport
from .shapes import Box, Cylinder, Plane, Sphere
from .sources import MeshFile, ParticleFile, Tomography
from .tissue import Tissue

__all__ = [
    "Boundary",
    "Box",
    "Cylinder",
    "Domain",
    "Emitter",
    "Fluid",
    "Foam",
    "Instrument",
    "Key",
    "MeshFile",
    "Output",
    "ParticleFile",
    "Phase",
    "Plane",
    "Relaxation",
    "Rigid",
    "SceneError",
    "SceneFile",
    "Sink",
    "Solid",
    "Solver",
    "Sphere",
    "StepReport",
    "Tissue",
    "Tomography",
    "Vessel",
    "View",
]
