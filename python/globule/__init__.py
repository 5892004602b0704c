"""Mesh-free visualization: particles in, smooth exact surfaces out."""

import os

from ._base.old_paths import install
from ._base.starting import quiet_interrupts

quiet_interrupts()  # before what takes a while to load
install()

# OpenMP threads that spin while they wait slow down whatever runs beside them; the runtime reads
# this once, when the core is loaded.
_set = "OMP_WAIT_POLICY" not in os.environ
if _set:
    os.environ["OMP_WAIT_POLICY"] = "passive"
from . import _core  # noqa: E402

if _set:
    del os.environ["OMP_WAIT_POLICY"]

from ._base.checks import MissingPackageError  # noqa: E402
from ._base.colormaps import colorize  # noqa: E402
from ._base.cpp import cmake_dir, include_dir  # noqa: E402
from .formats import (  # noqa: E402
    FormatError,
    mesh_particles,
    read,
    tomography_particles,
    write,
)
from .formats.pictures.environment import read_environment  # noqa: E402
from .render.camera import Camera  # noqa: E402
from .render.camera_path import CameraPath, orbit  # noqa: E402
from .render.clips import ClipBox, ClipPlane, ClipSphere  # noqa: E402
from .render.frame import Frame, Layer, Picked, RenderSettings, render, save_png  # noqa: E402
from .render.layers import layers_by  # noqa: E402
from .render.legend import add_legend  # noqa: E402
from .render.lights import (  # noqa: E402
    DirectionalLight,
    Environment,
    Ground,
    Headlight,
    PointLight,
    Sky,
)
from .render.materials import Material  # noqa: E402
from .render.presets import preset  # noqa: E402
from .render.sequence import read_ahead, render_sequence, value_range  # noqa: E402
from .scene.particles import Particles  # noqa: E402
from .scene.query import field, gradient, intersect  # noqa: E402
from .scene.scene import Scene  # noqa: E402
from .scene.smoothing import anisotropy, without_strays  # noqa: E402
from .scene.spacing import local_spacing  # noqa: E402
from .scene.thesis import Thesis  # noqa: E402
from .sim.simulation import Phase, Simulation, StepReport  # noqa: E402
from .ultrasound import phantoms  # noqa: E402
from .ultrasound.calibration import calibrate_point_target  # noqa: E402
from .ultrasound.files import read_sweep, write_sweep  # noqa: E402
from .ultrasound.plus.reconstruct import reconstruct_plus  # noqa: E402
from .ultrasound.reconstruct import reconstruct  # noqa: E402
from .ultrasound.reconstructor import Reconstructor  # noqa: E402
from .ultrasound.sweep import Sweep  # noqa: E402
from .viewer import view  # noqa: E402
from .volumes.files import read_volume, write_volume  # noqa: E402
from .volumes.iso_surface import iso_surface  # noqa: E402
from .volumes.slices import reslice  # noqa: E402
from .volumes.volume import Volume  # noqa: E402

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
    "MissingPackageError",
    "Particles",
    "Phase",
    "Picked",
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
    "calibrate_point_target",
    "cmake_dir",
    "colorize",
    "field",
    "gradient",
    "include_dir",
    "intersect",
    "iso_surface",
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
    "reslice",
    "save_png",
    "tomography_particles",
    "value_range",
    "view",
    "without_strays",
    "write",
    "write_sweep",
    "write_volume",
]
