"""Flags of `render` that say how rays are traced, and presets of flags."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ..data.particles import Particles
from ..pieces.scene import Scene
from ..render import presets as looks
from ..scene.thesis import POLYNOMIAL_KERNELS, Thesis, default_support, fitting_level
from ..viewer.state import Surface
from . import flags, look
from .shared import UserError, mistakes

# Options that a preset sets if no flag does; looks set fields of RenderSettings instead.
PRESETS = {"thesis": {"root": "march", "octree": "dense"}, **{key: {} for key in looks.PRESETS}}
PRESET_DEPTH = 7  # if no support asks for another level


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags that say how rays are traced."""
    group = parser.add_argument_group("tracing")
    flags.add_settings(group, Surface, "root")
    flags.add_settings(group, Thesis, "step")
    flags.add(group, "--preset", "or thesis; default: none", action=look.OneLook, choices=tuple(PRESETS))


def settle(options: argparse.Namespace) -> Thesis | None:
    """Fill in the options that preset and root leave open; refuse contradictions."""
    for name, value in PRESETS.get(options.preset, {}).items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    options.root = options.root or "exact"
    if options.step is not None and options.root != "march":
        raise UserError(f"--step: expected --root march beside --step, got --root {options.root}")
    if options.root == "exact":
        options.octree = options.octree or "sparse"
        return None
    if options.beside:
        asked = "--preset thesis" if options.preset == "thesis" else f"--root {options.root}"
        raise UserError(f"--with: expected no --with beside {asked}, which shows one scene, got {options.beside[0][0]}")
    options.octree = options.octree or "dense"
    if options.octree != "dense":
        raise UserError(f"--octree: expected dense with --root {options.root}, got sparse")
    if options.root == "bezier" and options.kernel not in POLYNOMIAL_KERNELS:
        known = " or ".join(POLYNOMIAL_KERNELS)
        raise UserError(f"--kernel: expected {known} with --root bezier, got {options.kernel}")
    with mistakes():
        given = {} if options.step is None else {"step": options.step}
        return Thesis(root=options.root, **given)


@contextmanager
def octree_mistakes() -> Iterator[None]:
    """Turn what an octree refuses into a UserError; its level is --octree-level here."""
    try:
        yield
    except (TypeError, ValueError) as error:
        raise UserError(re.sub(r"^(depth|level):", "--octree-level:", str(error))) from error


def support_and_depth(options: argparse.Namespace, particles: Particles) -> tuple[float | None, int | None]:
    """The support and the octree's level that fit together (§3.6); given flags win.

    The octree is as deep as leaves no smaller than the supports allow. With --preset thesis and
    without supports, the support is half a leaf's edge.
    """
    given = options.support or particles.support
    extent = float(np.ptp(particles.bounds(), axis=0).max()) if len(particles) else 0.0
    if options.root == "exact" or not extent:
        return options.support, options.depth
    if given is not None:
        fitting = fitting_level(extent, float(np.max(given)))
        return options.support, fitting if options.depth is None else options.depth
    if options.preset != "thesis":
        return None, options.depth
    depth = PRESET_DEPTH if options.depth is None else options.depth
    with octree_mistakes():
        return default_support(particles, depth), depth


def why_dust(options: argparse.Namespace, particles: Particles, scene: Scene) -> str | None:
    """A message if the preset's supports are too small for neighbors to meet."""
    if options.preset != "thesis" or (options.support or particles.support) is not None:
        return None
    support, spacing = scene.support, scene.spacing
    if np.ndim(support) or support >= spacing / 3:
        return None
    extent = scene.octree.extent
    fitting = int(np.clip(np.floor(np.log2(extent / (2 * spacing))), 0, 8))
    return (
        f"supports are half a leaf, {support:.3g}, which is less than a third of the particles' "
        f"spacing, {spacing:.3g}: the particles look like dust; try --octree-level {fitting} or "
        f"--support {2 * spacing:.2g}"
    )


def why_cut(scene: Scene) -> str | None:
    """A message if supports are larger than a leaf, which only meets its neighbors."""
    extent = scene.octree.extent
    edge, largest = extent / 2 ** scene._tree[1], float(np.max(scene.support, initial=0.0))
    if largest <= edge or not extent:
        return None
    return (
        f"supports of up to {largest:.3g} are larger than a leaf's edge, {edge:.3g}: parts of "
        f"the surface may be missing; try --octree-level {fitting_level(extent, largest)}"
    )
