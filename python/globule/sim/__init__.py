"""Fluids, tissue and the knife: simulations whose octree is also traced."""

from .instruments import Instrument, Key
from .scene_bodies import Boundary, Fluid, Relaxation, Rigid, Solid
from .scene_file import Domain, Emitter, Foam, Output, SceneFile, Sink, Solver, Vessel, View
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
