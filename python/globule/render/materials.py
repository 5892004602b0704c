"""How a surface splits the light that meets it.

Particles carry factors in [0, 1], blended at each hit like their colors. The *reflection* factor is
the specular reflectance at normal incidence; it grows to 1 at grazing angles (Schlick 1994). The
*refraction* factor is the share of the remaining light that is transmitted, with an index of
refraction of 1 + refraction / 3 (1: water, 4/3). The rest is scattered diffusely. A `Material` sets
these factors for a whole scene instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from .. import _core
from .._base.arrays import ColorLike
from .._base.fixed import Fixed, read_only
from .._base.settings import RADIANCE, SHARE, Number, check_all, setting


@read_only
@dataclass(frozen=True)
class Material(Fixed):
    """The material of a scene. None leaves a value to the particles."""

    reflection: float | None = setting(SHARE, None, "specular reflectance at normal incidence",
        usual="the particles', else 0")  # fmt: skip
    transmission: float | None = setting(SHARE, None, "share of the light not reflected that "
        "enters the surface", usual="the particles', else 0")  # fmt: skip
    index: float | None = setting(Number(1.0, 4.0), None, "index of refraction, such as 1.33 for "
        "water and 1.5 for glass. Reflection then follows Fresnel's equations too",
        label="Refractive index", usual="the preset's, else the particles'")  # fmt: skip
    color: ColorLike | None = setting(RADIANCE, None, "color of the surface",
        usual="the particles'")  # fmt: skip
    absorption: ColorLike | None = setting(RADIANCE, None, "absorption inside the medium after "
        "Beer's law", "per world unit",
        usual="the preset's, else the surface's color filters the light that enters")  # fmt: skip
    roughness: float = setting(SHARE, 0.0, "roughness of reflection and refraction. After GGX "
        "(Walter et al. 2007); several samples per pixel make it smooth")  # fmt: skip
    specular: float | None = setting(Number(0.0), None, "highlight of the lights (Blinn-Phong)",
        usual="the settings'")  # fmt: skip
    shininess: float | None = setting(Number(0.0), None, "exponent of the highlight",
        usual="the settings'")  # fmt: skip

    def _check(self) -> None:
        self._packed  # noqa: B018  making it checks the fields

    @cached_property
    def _packed(self) -> Any:
        """What the core takes; below 0 (index: 0) what is left to others."""
        none = {"index": 0.0, "color": [-1.0] * 3, "absorption": [-1.0] * 3}
        return _core.Material({k: none.get(k, -1.0) if v is None else v for k, v in check_all(self).items()})
