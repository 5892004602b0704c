"""Mesh-free visualization: particles in, smooth exact surfaces out.

A wrong argument or field is a TypeError or ValueError that names it, what was expected and what was
given."""

from ._base.starting import quiet_interrupts

quiet_interrupts()  # before what takes a while to load, which `typing` is already

import os  # noqa: E402
from importlib import import_module as _import_module  # noqa: E402
from typing import TYPE_CHECKING as _TYPE_CHECKING  # noqa: E402
from typing import Any as _Any  # noqa: E402

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
from .render.frame import Frame, save_png  # noqa: E402
from .render.layers import Layer, split_layers  # noqa: E402
from .render.lights import DirectionalLight, Environment, Ground, Headlight, PointLight, Sky  # noqa: E402
from .render.materials import Material  # noqa: E402
from .render.render import render  # noqa: E402
from .render.settings import RenderSettings  # noqa: E402
from .scene.mesh import Mesh  # noqa: E402

if _TYPE_CHECKING:
    from . import fluids, measure, sim, ultrasound, volumes
    from .formats import FormatError, read, write
    from .formats.mesh import sample_mesh
    from .render.camera_path import CameraPath, orbit
    from .render.image_sequence import render_sequence
    from .render.legend import add_legend
    from .render.paper import imshow
    from .render.presets import load_preset
    from .render.sequence import find_value_range, read_ahead, sequence
    from .render.views import render_views
    from .scene.capsules import Lines, Spheres
    from .scene.rigid_bodies import RigidBodies
    from .sim.simulation import Simulation
    from .viewer import view

# What is imported when it is first asked for, as above: `import globule` stays short.
_LATER = {
    "formats": "FormatError read write",
    "formats.mesh": "sample_mesh",
    "render.camera_path": "CameraPath orbit",
    "render.legend": "add_legend",
    "render.paper": "imshow",
    "render.presets": "load_preset",
    "render.image_sequence": "render_sequence",
    "render.sequence": "find_value_range read_ahead sequence",
    "render.views": "render_views",
    "scene.capsules": "Lines Spheres",
    "scene.rigid_bodies": "RigidBodies",
    "sim.simulation": "Simulation",
    "viewer": "view",
}
_MODULE_OF = {name: module for module, names in _LATER.items() for name in names.split()}
_SPACES = ("fluids", "measure", "sim", "ultrasound", "volumes")
_ROOMS = (*_SPACES, "cli", "formats", "pyvista", "viewer")


def __getattr__(name: str) -> _Any:
    if name in _MODULE_OF:
        module = _import_module(f".{_MODULE_OF[name]}", __name__)
        globals()[name] = value = getattr(module, name)
        return value
    if name in _ROOMS:
        return _import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__doc__", "__version__"])


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
    "PointLight",
    "RenderSettings",
    "RigidBodies",
    "Scene",
    "Simulation",
    "Sky",
    "Spheres",
    "add_legend",
    "cmake_dir",
    "color_by",
    "colorize",
    "find_value_range",
    "fluids",
    "imshow",
    "include_dir",
    "load_preset",
    "measure",
    "orbit",
    "read",
    "read_ahead",
    "render",
    "render_sequence",
    "render_views",
    "sample_mesh",
    "save_png",
    "sequence",
    "set_limits",
    "sim",
    "split_layers",
    "ultrasound",
    "view",
    "volumes",
    "write",
]
