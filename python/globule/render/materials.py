"""How a surface splits the light that meets it.

Particles carry factors in [0, 1], blended at each hit like their colours. The *reflection* factor
is the mirror's weight seen straight on, and grows to 1 at grazing angles by Schlick's rule. Of the
rest, the *refraction* factor is the share that goes through, with an index of refraction of
1 + refraction / 3 (1: water, 4/3); what is left is scattered, as by chalk. A `Material` may fix
each of these for a whole scene instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from .. import _core
from .._base.checks import number, three
from .._base.fixed import Fixed


@dataclass(frozen=True)
class Material(Fixed):
    """What None leaves to the particles.

    reflection: mirror's weight at normal incidence, [0, 1]
    transmission: share of the rest that goes through, [0, 1]
    index: of refraction, 1 to 4; mirrors by Fresnel's equations too
    color: (3,) linear, instead of the particles'
    absorption: (3,) per world unit, Beer's law inside the medium; None: the surface's colour
        filters what enters
    roughness: of mirrored and transmitted directions (GGX), [0, 1]; smooth over several samples
    specular, shininess: highlight of the lights (Blinn-Phong); None: the settings'
    """

    reflection: float | None = None
    transmission: float | None = None
    index: float | None = None
    color: Any = None
    absorption: Any = None
    roughness: float = 0.0
    specular: float | None = None
    shininess: float | None = None

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
