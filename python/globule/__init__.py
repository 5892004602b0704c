"""Mesh-free visualization: particles in, smooth exact surfaces out."""

import os

from .starting import quiet_interrupts

quiet_interrupts()  # before what takes a while to load

# OpenMP threads that spin while they wait slow down whatever runs beside them; the runtime reads
# this once, when the core is loaded.
_set = "OMP_WAIT_POLICY" not in os.environ
if _set:
    os.environ["OMP_WAIT_POLICY"] = "passive"
from . import _core  # noqa: E402, F401

if _set:
    del os.environ["OMP_WAIT_POLICY"]

from . import phantoms  # noqa: E402
from .camera import Camera  # noqa: E402
from .camera_path import CameraPath, orbit  # noqa: E402
from .clips import ClipBox, ClipPlane, ClipSphere  # noqa: E402
from .cpp import cmake_dir, include_dir  # noqa: E402
from .environment import read_environment  # noqa: E402
from .formats import (  # noqa: E402
    FormatError,
    mesh_particles,
    read,
    tomography_particles,
    write,
)
from .layers import layers_by  # noqa: E402
from .legend import add_legend  # noqa: E402
from .lights import (  # noqa: E402
    DirectionalLight,
    Environment,
    Ground,
    Headlight,
    PointLight,
    Sky,
)
from .materials import Material  # noqa: E402
from .octree import field, gradient, intersect  # noqa: E402
from .particles import Particles  # noqa: E402
from .plus import reconstruct_plus  # noqa: E402
from .presets import preset  # noqa: E402
from .reconstruct import reconstruct  # noqa: E402
from .reconstructor import Reconstructor  # noqa: E402
from .render import Frame, Layer, Picked, RenderSettings, render  # noqa: E402
from .scene import Scene  # noqa: E402
from .sequence import read_ahead, render_sequence, value_range  # noqa: E402
from .simulate import Phase, Simulation, StepReport  # noqa: E402
from .smoothing import anisotropy, without_strays  # noqa: E402
from .spacing import local_spacing  # noqa: E402
from .sweep import Sweep  # noqa: E402
from .sweep_io import read_sweep, write_sweep  # noqa: E402
from .thesis import Thesis  # noqa: E402
from .viewer import view  # noqa: E402
from .volume import Volume  # noqa: E402
from .volume_io import read_volume, write_volume  # noqa: E402

__version__ = _core.version
__all__ = [
    "Camera",
    "CameraPath",
    "ClipBox",
    "ClipPlane",
    "ClipSphere",
    "DirectionalLight",
    "Environment",
    "FormatError",
    "Frame",
    "Ground",
    "Headlight",
    "Layer",
    "Material",
    "Particles",
    "Picked",
    "Phase",
    "PointLight",
    "Reconstructor",
    "RenderSettings",
    "Scene",
    "Simulation",
    "Sky",
    "StepReport",
    "Sweep",
    "Thesis",
    "Volume",
    "add_legend",
    "anisotropy",
    "cmake_dir",
    "field",
    "gradient",
    "include_dir",
    "intersect",
    "layers_by",
    "local_spacing",
    "mesh_particles",
    "orbit",
    "phantoms",
    "preset",
    "read",
    "read_ahead",
    "read_environment",
    "read_sweep",
    "read_volume",
    "reconstruct",
    "reconstruct_plus",
    "render",
    "render_sequence",
    "tomography_particles",
    "value_range",
    "view",
    "without_strays",
    "write",
    "write_sweep",
    "write_volume",
]
