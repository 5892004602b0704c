"""Mesh-free visualization: particles in, smooth exact surfaces out."""

import os

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
from .formats import FormatError, read, write  # noqa: E402
from .octree import field, gradient, intersect  # noqa: E402
from .particles import Particles  # noqa: E402
from .plus import reconstruct_plus  # noqa: E402
from .reconstruct import reconstruct  # noqa: E402
from .reconstructor import Reconstructor  # noqa: E402
from .render import DirectionalLight, Frame, Headlight, PointLight, RenderSettings, render  # noqa: E402
from .scene import Scene  # noqa: E402
from .sweep import Sweep  # noqa: E402
from .sweep_io import read_sweep, write_sweep  # noqa: E402
from .volume import Volume  # noqa: E402
from .volume_io import read_volume, write_volume  # noqa: E402

__version__ = "0.1.0"
__all__ = [
    "Camera",
    "DirectionalLight",
    "FormatError",
    "Frame",
    "Headlight",
    "Particles",
    "PointLight",
    "Reconstructor",
    "RenderSettings",
    "Scene",
    "Sweep",
    "Volume",
    "field",
    "gradient",
    "intersect",
    "phantoms",
    "read",
    "read_sweep",
    "read_volume",
    "reconstruct",
    "reconstruct_plus",
    "render",
    "write",
    "write_sweep",
    "write_volume",
]
