"""Words of flags about looks (lights, colors, color maps), and the colors of particles."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from .._base.settings import RADIANCE
from ..data.attributes import attribute_colors, attribute_values
from ..data.particles import Particles
from ..fluids.smoothing import find_anisotropy
from ..formats.frames import said
from ..pieces.scene import Scene
from ..render.lights import MAX_LIGHTS, DirectionalLight, Headlight, PointLight
from ..scene.mesh import Mesh
from .shared import UserError, count, number, vector

Color = tuple[float, float, float]


color = RADIANCE.parse  # linear RGB of R,G,B or V (linear) or #rrggbb (sRGB)


def interval(text: str) -> tuple[float, float]:
    """LO,HI; HI,LO reverses the color map."""
    words = text.split(",")
    if len(words) != 2:
        raise argparse.ArgumentTypeError(f"expected LO,HI, got {text!r}")
    low, high = number(words[0]), number(words[1])
    if low == high:
        raise argparse.ArgumentTypeError(f"expected LO,HI apart, got {text!r}")
    return low, high


def light(text: str) -> Headlight | DirectionalLight | PointLight:
    """head, dir:X,Y,Z[,ANGLE] or point:X,Y,Z[,RADIUS], of radiance 1; `given` divides it."""
    kind, colon, place = text.partition(":")
    if kind == "head" and not colon:
        return Headlight()
    words = place.split(",")
    if kind not in ("dir", "point") or len(words) not in (3, 4):
        expected = "head, dir:X,Y,Z[,ANGLE] or point:X,Y,Z[,RADIUS]"
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")
    where, size = vector(",".join(words[:3])), number(words[3]) if len(words) == 4 else 0.0
    try:
        if kind == "dir":
            return DirectionalLight(where, angle=size)
        return PointLight(where, radius=size)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{error} in {text!r}") from None


class OneLook(argparse.Action):
    """--preset NAME, or a flag without a value that stands for one: both at once are refused."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option: str | None = None) -> None:
        """Store the name."""
        name = self.const if self.nargs == 0 else values
        before = vars(namespace).get("_look", name)
        if before != name:
            parser.error(f"{option}: expected one look, got {before} and {name}")
        namespace._look = name
        setattr(namespace, self.dest, name)


def given(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of RenderSettings that --light, --ambient and --background set."""
    fields: dict[str, Any] = {}
    if options.light:
        n = len(options.light)
        if n > MAX_LIGHTS:
            raise UserError(f"--light: expected at most {MAX_LIGHTS} lights, got {n}")
        fields["lights"] = tuple(replace(one, radiance=(1 / n,) * 3) for one in options.light)
    if options.ambient is not None:
        fields["ambient"] = options.ambient
    if options.background is not None:
        fields["background"] = options.background
    return fields


def stretched(options: argparse.Namespace, particles: Particles) -> Particles:
    """The particles, smoothed, with kernels stretched along the surface."""
    support = options.support or particles.support
    if support is None and len(particles):
        support = Scene(particles, options.kernel, device="cpu", threads=options.threads).support
    if support is not None and np.ndim(support):  # a file has one each, also where all are equal
        support = float(support[0]) if np.ptp(support) == 0 else support
    if support is not None and not isinstance(support, float):
        raise UserError(
            "--anisotropic: expected one support for all particles, got a support per particle; give --support"
        )
    found = find_anisotropy(particles, support or 1.0)
    return replace(particles, positions=found.centers, anisotropy=found.G)


def color_by(
    options: argparse.Namespace, path: str, particles: Particles, messages: list[str]
) -> tuple[np.ndarray, tuple[float, float]]:
    """Linear colors (N, 3) of the values that --color-by names, and the values at the map's ends;
    adds to the messages."""
    with _names_of(path):
        found = attribute_colors(particles, options.color_by, options.colormap, options.range)
    if found.n_unknown:
        messages.append(_unknown(options, found.n_unknown, count(len(particles))))
    return found.color, found.range


def color_mesh(options: argparse.Namespace, path: str, mesh: Mesh, messages: list[str]) -> tuple[float, float]:
    """Give the vertices the colors of the values that --color-by names; returns the values at the
    map's ends; adds to the messages."""
    with _names_of(path):
        ends = mesh.color_by(options.color_by, options.colormap, options.range)
    values = attribute_values(mesh.points, options.color_by)[np.unique(mesh.faces)]  # no face shows the others
    if n_unknown := int((~np.isfinite(values)).sum()):
        messages.append(_unknown(options, n_unknown, count(len(values), "point")))
    return ends


def _unknown(options: argparse.Namespace, n: int, of: str) -> str:
    what = f"{n:,} of {of} without a finite {options.color_by}"
    return f"{what}: gray, or at an end of the map where infinite"


def values_of(path: str, particles: Particles, name: str) -> np.ndarray:
    """The values (N,) float64 of a field or attribute `name` of a file."""
    with _names_of(path):
        return attribute_values(particles, name)


@contextmanager
def _names_of(path: str) -> Iterator[None]:
    """An unknown name in this block is the user's mistake."""
    try:
        yield
    except ValueError as error:
        expected, comma, got = str(error).rpartition(", got ")
        of = "" if " to " in expected else f" of {said(path)}"
        raise UserError(f"--color-by: {expected}{of}{comma}{got}") from error
