"""Volumes among the files of `render`: their iso-surface.

With --label or --resample a volume becomes one metaball per voxel instead.
"""

from __future__ import annotations

import argparse
import os

from ..data.particles import Particles
from ..formats.kind import kind_or_none
from ..formats.volumes import READABLE
from ..scene.scene import DEFAULTS
from .shared import UserError, mistakes, read_volume_file, readable


def is_surface(path: str, options: argparse.Namespace) -> bool:
    """Whether a file is a volume that is shown by its surface."""
    if options.label or options.resample:
        return False
    try:
        found = kind_or_none(path)
    except OSError:
        return path.lower().endswith(READABLE)
    return found is not None and (found.kind == "volume" or found.format in ("metaimage", "nrrd"))


def check_surface(path: str, options: argparse.Namespace) -> None:
    """Refuse the flags that an iso-surface does not have, before any work."""
    from ..ultrasound.files import is_sweep

    with readable(path, "expected a file to read, got"):
        if not os.path.isdir(path):
            with open(path, "rb"):
                pass
        tracked = is_sweep(path)
    for name in ("threshold", "support"):
        if getattr(options, name) is not None:
            raise UserError(f"--{name}: expected --level for the volume {path}, got --{name}")
    if tracked:
        raise UserError(f"{path}: expected a volume, got a sweep; globule reconstruct makes a volume of it")


def read_surface(path: str, options: argparse.Namespace) -> tuple[Particles, list[str]]:
    """The particles of the iso-surface, for the kernel's own threshold; and messages."""
    from ..volumes.iso_surface import extract_iso_surface

    volume = read_volume_file(path)
    with mistakes(path):
        particles, threshold, level = extract_iso_surface(volume, options.level, options.kernel)
    particles.weight = particles.weight * (DEFAULTS[options.kernel][1] / threshold)
    if options.level is not None:
        return particles, []
    return particles, [f"{os.path.basename(path)}: surface at {level:.4g}; --level sets another iso-value"]
