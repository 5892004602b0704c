"""How a surface splits the light that meets it.

Particles carry factors in [0, 1], blended at each hit like their colors. The *reflection* factor is
the specular reflectance at normal incidence; it grows to 1 at grazing angles (Schlick 1994). The
*refraction* factor is the share of the remaining light that is transmitted, with an index of
refraction of 1 + refraction / 3 (1: water, 4/3). The rest is scattered diffusely. A `Material` sets
these factors for a whole scene instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from .. import _core
from .._base.checks import number, three
from .._base.fixed import Fixed, read_only


@read_only
@dataclass(frozen=True)
class Material(Fixed):
    """The material of a scene. None leaves a value to the particles.

    Args:
        reflection: specular reflectance at normal incidence, 0 to 1.
        transmission: share of the remaining light that is transmitted, 0 to 1.
        index: index of refraction, 1 to 4; reflection then follows Fresnel's equations too.
        color: (3,) linear RGB, instead of the particles'.
        absorption: (3,) per world unit, Beer's law inside the medium. None: the surface's color
            filters the light that enters.
        roughness: of reflected and refracted directions (GGX, Walter et al. 2007), 0 to 1; several
            samples per pixel make the image smooth.
        specular, shininess: highlight of the lights (Blinn-Phong); None: the settings'.

    Raises TypeError and ValueError naming the field, the expected and the given value.
    """

    reflection: float | None = None
    transmission: float | None = None
    index: float | None = None
    color: Any = None
    absorption: Any = None
    roughness: float = 0.0
    specular: float | None = None
    shininess: float | None = None

    def _check(self) -> None:
        self._packed  # noqa: B018  making it checks the fields

    @cached_property
    def _packed(self) -> Any:
        """What the core takes; below 0 (index: 0) what is left to others."""

        def given(name: str, most: float = math.inf) -> float:
            value = getattr(self, name)
            return -1.0 if value is None else number(name, value, 0.0, most)

        def colors(name: str) -> list[float]:
            value = getattr(self, name)
            return [-1.0, -1.0, -1.0] if value is None else three(name, value, 0.0)

        return _core.Material(
            {
                "reflection": given("reflection", 1.0),
                "transmission": given("transmission", 1.0),
                "index": 0.0 if self.index is None else number("index", self.index, 1.0, 4.0),
                "roughness": number("roughness", self.roughness, 0.0, 1.0),
                "color": colors("color"),
                "absorption": colors("absorption"),
                "specular": given("specular"),
                "shininess": given("shininess"),
            }
        )
