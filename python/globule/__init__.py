"""Mesh-free visualization: particles in, smooth exact surfaces out."""

from .camera import Camera
from .formats import FormatError, read, write
from .octree import field, gradient, intersect
from .particles import Particles
from .render import DirectionalLight, Frame, Headlight, PointLight, RenderSettings, render
from .scene import Scene

__version__ = "0.1.0"
__all__ = [
    "Camera",
    "DirectionalLight",
    "FormatError",
    "Frame",
    "Headlight",
    "Particles",
    "PointLight",
    "RenderSettings",
    "Scene",
    "field",
    "gradient",
    "intersect",
    "read",
    "render",
    "write",
]
