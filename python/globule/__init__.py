"""Mesh-free visualization: particles in, smooth exact surfaces out."""

import os
from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from ._base.starting import quiet_interrupts

quiet_interrupts()  # before what takes a while to load

# OpenMP threads that spin for long slow down whatever runs beside them, and those that sleep at
# once wake late: they check 400 times (some 5 µs) before they sleep. The runtime reads this once,
# when the core is loaded.
_waiting = {"OMP_WAIT_POLICY": "passive", "GOMP_SPINCOUNT": "400"}
if any(name in os.environ for name in _waiting):
    _waiting = {}
os.environ.update(_waiting)
try:
    from . import _core
finally:
    for _name in _waiting:
        del os.environ[_name]

from ._base.checks import MissingPackageError  # noqa: E402
from ._base.colormaps import colorize  # noqa: E402
from ._base.cpp import cmake_dir, include_dir  # noqa: E402
from ._base.memory import set_limits  # noqa: E402
from .data.attributes import color_by  # noqa: E402
from .data.particles import Particles  # noqa: E402
from .pieces.scene import Scene  # noqa: E402
from .render.annotate import Annotation  # noqa: E402
from .render.camera import Camera  # noqa: E402
from .render.clips import ClipBox, ClipPlane, ClipSphere  # noqa: E402
from .render.frame import Frame, Picked, save_png  # noqa: E402
from .render.layers import Layer, layers_by  # noqa: E402
from .render.lights import (  # noqa: E402
    DirectionalLight,
    Environment,
    Ground,
    Headlight,
    PointLight,
    Sky,
)
from .render.materials import Material  # noqa: E402
from .render.render import render  # noqa: E402
from .render.settings import RenderSettings  # noqa: E402
from .scene.mesh import Mesh  # noqa: E402
from .scene.query import blend, field, gradient, intersect, neighbors  # noqa: E402
from .scene.thesis import Thesis  # noqa: E402

if _TYPE_CHECKING:
    from .formats import FormatError, mesh_particles, read, write
    from .formats.pictures.environment import read_environment
    from .measure.gauge import gauge, height_map
    from .measure.mesh import SurfaceMeasure, SurfaceMesh, measure_surface, surface_mesh
    from .measure.places import SampleGrid, SampleLine, SamplePlane
    from .measure.project import project
    from .measure.sample import sample
    from .measure.samples import Samples
    from .measure.track import track_surface
    from .pieces.pieces import Pieces
    from .render.camera_path import CameraPath, orbit
    from .render.legend import add_legend
    from .render.presets import preset
    from .render.sequence import read_ahead, render_sequence, value_range
    from .render.views import Views, render_views
    from .scene.capsules import Lines, Spheres
    from .scene.fluid import fluid_like, surface_of
    from .scene.rigid_bodies import RigidBodies
    from .scene.smoothing import anisotropy, surface_kernels, without_strays
    from .scene.spacing import local_spacing
    from .sim.settings import Phase, StepReport
    from .sim.simulation import Simulation
    from .ultrasound import phantoms
    from .ultrasound.calibration import calibrate_point_target
    from .ultrasound.files import read_sweep, write_sweep
    from .ultrasound.plus.reconstruct import reconstruct_plus
    from .ultrasound.reconstruct import reconstruct
    from .ultrasound.reconstructor import Reconstructor
    from .ultrasound.sweep import Sweep
    from .viewer import view
    from .volumes.files import read_volume, write_volume
    from .volumes.iso_surface import iso_surface
    from .volumes.slices import reslice
    from .volumes.tomography import tomography_particles
    from .volumes.volume import Volume

# What is imported when it is first asked for, as above: `import globule` stays short.
_LATER = {
    "formats": "FormatError mesh_particles read write",
    "formats.pictures.environment": "read_environment",
    "scene.rigid_bodies": "RigidBodies",
    "measure.gauge": "gauge height_map",
    "measure.mesh": "SurfaceMeasure SurfaceMesh measure_surface surface_mesh",
    "measure.places": "SampleGrid SampleLine SamplePlane",
    "measure.project": "project",
    "measure.sample": "sample",
    "measure.samples": "Samples",
    "measure.track": "track_surface",
    "pieces.pieces": "Pieces",
    "render.camera_path": "CameraPath orbit",
    "render.legend": "add_legend",
    "render.presets": "preset",
    "render.sequence": "read_ahead render_sequence value_range",
    "render.views": "Views render_views",
    "scene.capsules": "Lines Spheres",
    "scene.fluid": "fluid_like surface_of",
    "scene.smoothing": "anisotropy surface_kernels without_strays",
    "scene.spacing": "local_spacing",
    "sim.settings": "Phase StepReport",
    "sim.simulation": "Simulation",
    "ultrasound": "phantoms",
    "ultrasound.calibration": "calibrate_point_target",
    "ultrasound.files": "read_sweep write_sweep",
    "ultrasound.plus.reconstruct": "reconstruct_plus",
    "ultrasound.reconstruct": "reconstruct",
    "ultrasound.reconstructor": "Reconstructor",
    "ultrasound.sweep": "Sweep",
    "viewer": "view",
    "volumes.files": "read_volume write_volume",
    "volumes.iso_surface": "iso_surface",
    "volumes.slices": "reslice",
    "volumes.tomography": "tomography_particles",
    "volumes.volume": "Volume",
}
_MODULE_OF = {name: module for module, names in _LATER.items() for name in names.split()}
_ROOMS = ("cli", "formats", "measure", "pyvista", "sim", "ultrasound", "viewer", "volumes")


def __getattr__(name: str) -> _Any:
    if name in _MODULE_OF:
        module = _import_module(f".{_MODULE_OF[name]}", __name__)
        value = getattr(module, name, None) or _import_module(f"{module.__name__}.{name}")
        globals()[name] = value
        return value
    if name in _ROOMS:
        return _import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__version__ = _core.version
__all__ = [
    "Annotation",
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
    "Lines",
    "Material",
    "Mesh",
    "MissingPackageError",
    "Particles",
    "Phase",
    "Picked",
    "Pieces",
    "PointLight",
    "Reconstructor",
    "RenderSettings",
    "RigidBodies",
    "SampleGrid",
    "SampleLine",
    "SamplePlane",
    "Samples",
    "Scene",
    "Simulation",
    "Sky",
    "Spheres",
    "StepReport",
    "SurfaceMeasure",
    "SurfaceMesh",
    "Sweep",
    "Thesis",
    "Views",
    "Volume",
    "add_legend",
    "anisotropy",
    "blend",
    "calibrate_point_target",
    "cmake_dir",
    "color_by",
    "colorize",
    "field",
    "fluid_like",
    "gauge",
    "gradient",
    "height_map",
    "include_dir",
    "intersect",
    "iso_surface",
    "layers_by",
    "local_spacing",
    "measure_surface",
    "mesh_particles",
    "neighbors",
    "orbit",
    "phantoms",
    "preset",
    "project",
    "read",
    "read_ahead",
    "read_environment",
    "read_sweep",
    "read_volume",
    "reconstruct",
    "reconstruct_plus",
    "render",
    "render_sequence",
    "render_views",
    "reslice",
    "sample",
    "save_png",
    "set_limits",
    "surface_kernels",
    "surface_mesh",
    "surface_of",
    "tomography_particles",
    "track_surface",
    "value_range",
    "view",
    "without_strays",
    "write",
    "write_sweep",
    "write_volume",
]
