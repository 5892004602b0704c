"""Volumes among the files of `render`: their iso-surface.

NIfTI, DICOM, and any volume with --label or --resample become one metaball per voxel instead.
"""

from __future__ import annotations

import argparse
import os

from ..scene.particles import Particles
from ..scene.scene import DEFAULTS
from ..ultrasound.kinds import has_surface
from .shared import UserError, read_volume_file


def is_surface(path: str, options: argparse.Namespace) -> bool:
    """Whether `render` shows the iso-surface of this file."""
    return not options.label and not options.resample and has_surface(path)


def check_surface(path: str, options: argparse.Namespace) -> None:
    """Refuse the flags that an iso-surface does not have, before any work."""
    for name in ("threshold", "support"):
        if getattr(options, name) is not None:
            raise UserError(f"--{name}: expected --level for the volume {path}, got --{name}")
    from ..ultrasound.files import is_sweep

    try:
        with open(path, "rb"):
            pass
        tracked = is_sweep(path)
    except OSError as error:
        raise UserError(f"{path}: expected a file to read, got: {error.strerror}") from error
    if tracked:
        raise UserError(
            f"{path}: expected a volume, got a sweep; globule reconstruct makes a volume of it"
        )


def read_surface(path: str, options: argparse.Namespace) -> tuple[Particles, list[str]]:
    """The particles of the iso-surface, for the kernel's own threshold; and messages."""
    from ..volumes.iso_surface import iso_surface

    volume = read_volume_file(path)
    try:
        particles, threshold, level = iso_surface(volume, options.level, options.kernel)
    except ValueError as error:
        raise UserError(f"{path}: {error}") from error
    particles.weight = particles.weight * (DEFAULTS[options.kernel][1] / threshold)
    if options.level is not None:
        return particles, []
    return particles, [
        f"{os.path.basename(path)}: surface at {level:.4g}; --level sets another iso-value"
    ]
