"""Lights, the sky and the ground. Colors and radiances are linear RGB; 1 is white."""

from __future__ import annotations

import itertools
import math
import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from .. import _core
from .._base.arrays import ColorLike, VectorLike, address
from .._base.checks import number, three, unit
from .._base.fixed import Fixed, fixed, read_only

MAX_LIGHTS: int = _core.limits["lights"]


@read_only
@dataclass(frozen=True)
class Headlight(Fixed):
    """Light from the eye. A headlight casts no visible shadow.

    Args:
        radiance: (3,) linear RGB, or one number for all three.
    """

    radiance: ColorLike = (0.35, 0.35, 0.35)

    def _check(self) -> None:
        self._pack()

    def _pack(self) -> tuple:
        return 0, [0.0, 0.0, 1.0], three("radiance", self.radiance, 0.0), 0.0


@read_only
@dataclass(frozen=True)
class DirectionalLight(Fixed):
    """Light from far away.

    Args:
        direction: (3,) world, towards the light, of any length above 0.
        radiance: (3,) linear RGB, or one number for all three.
        angle: angular diameter, degrees, 0 to 170 (the sun: 0.53). 0 gives hard shadows; larger
            angles give soft shadows, which several samples per pixel make smooth.
    """

    direction: VectorLike = (-0.4, 1.0, 0.6)
    radiance: ColorLike = (0.75, 0.73, 0.70)
    angle: float = 0.0

    def _check(self) -> None:
        self._pack()

    def _pack(self) -> tuple:
        half = math.radians(number("angle", self.angle, 0.0, 170.0) / 2)
        direction = unit("direction", self.direction)
        return 1, direction, three("radiance", self.radiance, 0.0), math.tan(half)


@read_only
@dataclass(frozen=True)
class PointLight(Fixed):
    """Light from a ball, without fall-off.

    Args:
        position: (3,) world.
        radiance: (3,) linear RGB, or one number for all three.
        radius: world units; 0 gives hard shadows.
    """

    position: VectorLike
    radiance: ColorLike = (0.75, 0.75, 0.75)
    radius: float = 0.0

    def _check(self) -> None:
        self._pack()

    def _pack(self) -> tuple:
        radius = number("radius", self.radius, 0.0)
        return 2, three("position", self.position), three("radiance", self.radiance, 0.0), radius


Light: TypeAlias = "Headlight | DirectionalLight | PointLight"
LIGHTS = (Headlight, DirectionalLight, PointLight)


@read_only
@dataclass(frozen=True)
class Sky(Fixed):
    """The radiance of rays that meet nothing: a gradient from the ground's color to the zenith's.

    Args:
        zenith, horizon, ground: (3,) linear RGB radiance, or one number for all three.
        up: (3,) world, towards the zenith.
    """

    zenith: ColorLike = (0.30, 0.48, 0.80)
    horizon: ColorLike = (0.85, 0.90, 0.95)
    ground: ColorLike = (0.30, 0.28, 0.26)
    up: VectorLike = (0.0, 1.0, 0.0)

    def _check(self) -> None:
        self._pack()

    def _pack(self) -> dict:
        up = unit("up", self.up)
        return {
            "zenith": three("zenith", self.zenith, 0.0),
            "horizon": three("horizon", self.horizon, 0.0),
            "ground": three("ground", self.ground, 0.0),
            "up": up,
            "east": _across(up),
            "image": 0,
            "width": 0,
            "height": 0,
            "strength": 1.0,
            "id": 0,
            "owner": None,
        }


def uniform_sky(color: ColorLike) -> Sky:
    """The same radiance, (3,) linear RGB or one number, from everywhere."""
    return Sky(color, color, color)


_ids = itertools.count(1)


@read_only
@dataclass(frozen=True, eq=False)
class Environment(Fixed):
    """A sky from an image.

    Args:
        image: (H, W, 3) linear RGB radiance, equirectangular, row 0 at the zenith; at most 32768
            pixels a side. Or the name of a file: .hdr, .exr, .png or .jpg, in which the light of
            8-bit pictures is sRGB and 1 is white.
        strength: factor of the radiance.
        up: (3,) world, towards the zenith.
        turn: rotation about `up`, degrees.
    """

    image: Any = field(repr=False)
    strength: float = 1.0
    up: VectorLike = (0.0, 1.0, 0.0)
    turn: float = 0.0

    def __post_init__(self) -> None:
        image = self.image
        if isinstance(image, (str, os.PathLike)):
            from ..formats.pictures.environment import read_environment

            image = read_environment(image)
        try:
            image = np.ascontiguousarray(image, np.float32)
        except (TypeError, ValueError):
            raise TypeError(
                f"image: expected an array (H, W, 3) or a file's name, got {type(image).__name__}"
            ) from None
        if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape or max(image.shape) > 32768:
            raise ValueError(f"image: expected shape (H, W, 3), got {image.shape}")
        if not (np.isfinite(image).all() and (image >= 0).all()):
            raise ValueError("image: expected finite radiance >= 0")
        object.__setattr__(self, "image", image)
        object.__setattr__(self, "up", fixed(self.up))
        object.__setattr__(self, "_id", next(_ids))
        self._pack()

    def mean(self) -> tuple[float, float, float]:
        """Mean radiance over all directions, linear RGB."""
        return self._mean

    @cached_property
    def _mean(self) -> tuple[float, float, float]:
        height = len(self.image)
        weight = np.sin((np.arange(height) + 0.5) / height * np.pi)
        rows = self.image.mean(axis=1, dtype=np.float64)
        strength = number("strength", self.strength, 0.0)
        red, green, blue = strength * (weight @ rows) / weight.sum()
        return float(red), float(green), float(blue)

    def _pack(self) -> dict:
        up = np.asarray(unit("up", self.up))
        east = np.asarray(_across(up))
        angle = math.radians(number("turn", self.turn))
        east = east * math.cos(angle) + np.cross(up, east) * math.sin(angle)
        height, width, _ = self.image.shape
        return {
            **uniform_sky(self.mean())._pack(),  # seen all at once, by a matte surface
            "up": up.tolist(),
            "east": east.tolist(),
            "image": address(self.image),
            "width": width,
            "height": height,
            "strength": float(self.strength),
            "id": vars(self)["_id"],
            "owner": self.image,
        }


@read_only
@dataclass(frozen=True)
class Ground(Fixed):
    """A plane under the scene.

    Args:
        height: of the plane along `normal`, world units.
        normal: (3,) world, up from the plane.
        color, other: (3,) linear RGB of the checkerboard's squares, or one number for all three.
        check: edge of a square, world units; 0: the whole plane has `color`.
        reflection: specular reflectance at normal incidence, 0 to 1.
    """

    height: float
    normal: VectorLike = (0.0, 1.0, 0.0)
    color: ColorLike = (0.75, 0.75, 0.75)
    other: ColorLike = (0.55, 0.55, 0.55)
    check: float = 0.0
    reflection: float = 0.0

    def _check(self) -> None:
        self._pack()

    def _pack(self) -> dict:
        return {
            "normal": unit("normal", self.normal),
            "offset": number("height", self.height),
            "color": three("color", self.color, 0.0),
            "other": three("other", self.other, 0.0),
            "field": number("check", self.check, 0.0),
            "reflection": number("reflection", self.reflection, 0.0, 1.0),
        }


def _across(up: Any) -> list[float]:
    """A unit vector across `up`: x, or z where up is along x."""
    up = np.asarray(up, np.float64)
    axis = np.eye(3)[2 if abs(up[0]) > 0.9 else 0]
    across = axis - up * (axis @ up)
    return (across / np.linalg.norm(across)).tolist()
