"""Which surface shows a fluid's particles, and what makes it smoother."""

from .likeness import Likeness, assess_fluid, choose_surface
from .smoothing import Anisotropy, SurfaceKernels, find_anisotropy, find_surface_kernels, remove_strays
from .spacing import measure_spacing

__all__ = [
    "Anisotropy",
    "Likeness",
    "SurfaceKernels",
    "assess_fluid",
    "choose_surface",
    "find_anisotropy",
    "find_surface_kernels",
    "measure_spacing",
    "remove_strays",
]
