"""Which files are sweeps, which volumes, and which volumes are shown by their surface."""

from __future__ import annotations

import os
import zipfile

from ..formats.sweeps import stack
from ..formats.volumes import READABLE as VOLUMES
from .files import WRITABLE as SWEEPS
from .files import is_sweep

EXTENSIONS = tuple(dict.fromkeys((*SWEEPS, *stack.DICOM, *VOLUMES)))
SURFACES = (".nrrd", ".nhdr", ".mha", ".mhd", ".vti")  # and .npz that hold a volume


def kind_of(path: str) -> str | None:
    """ "sweep", "volume", or None for everything else, which may be particles. Raises OSError."""
    name = path.lower()
    if not os.path.isdir(path) and not name.endswith(EXTENSIONS):
        return None
    try:
        if is_sweep(path):
            return "sweep"
        return "volume" if not name.endswith(".npz") or _holds_volume(path) else None
    except zipfile.BadZipFile:
        return None


def has_surface(path: str) -> bool:
    """Whether a file is a volume that is shown by its surface."""
    name = path.lower()
    try:
        return name.endswith(SURFACES) or (name.endswith(".npz") and _holds_volume(path))
    except (OSError, zipfile.BadZipFile):
        return False


def _holds_volume(path: str) -> bool:
    with zipfile.ZipFile(path) as archive:
        return {"values.npy", "world_from_voxel.npy"} <= set(archive.namelist())
