"""The reader of globule for napari: volumes and tracked ultrasound.

napari finds it by the entry point `napari.manifest` (`napari.yaml` beside this file). napari's axes
are z, y, x, and its world is that of the file, in millimeters.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .formats.kind import kind_or_none
from .ultrasound.files import read_sweep
from .ultrasound.sweep import Sweep
from .volumes.files import read_volume
from .volumes.volume import Volume

Layer = tuple[Any, dict[str, Any], str]
MEASURED, FILLED, EXTRAPOLATED = 1, 2, 3  # of the layer of labels; 0: empty


def get_reader(path: str | Sequence[str]) -> Callable[[Any], list[Layer]] | None:
    """The function that reads a path, or None: the answer that npe2 asks a reader for.

    A volume or a sweep has a reader; other files and lists of files have none.
    """
    if not isinstance(path, (str, os.PathLike)) or not os.path.exists(path):
        return None
    kind = kind_or_none(path)
    if kind is None or kind.kind not in ("volume", "sweep"):
        return None
    return _layers_of_volume if kind.kind == "volume" else _layers_of_sweep


def volume_layers(volume: Volume, name: str = "volume") -> list[Layer]:
    """A volume as an image layer, with a hidden layer of labels that says where values are from.

    Args:
        volume: (Z, Y, X) voxels.
        name: of the layer.

    Returns:
        Tuples of data, keywords and kind. The image has the affine matrix (4, 4) from voxels
        (z, y, x) to mm; the labels, where not all voxels are measured, are 1 measured, 2 filled,
        3 extrapolated, 0 empty.
    """
    turn = [2, 1, 0, 3]  # from x, y, z to z, y, x
    affine = volume.world_from_voxel[np.ix_(turn, turn)]
    common = {"affine": affine, "units": ("mm",) * 3, "axis_labels": ("z", "y", "x")}
    about = {"space": volume.space, "world_from_voxel": volume.world_from_voxel}
    image = {"name": name, "colormap": "gray", "metadata": about, **common}
    layers: list[Layer] = [(volume.values, image, "image")]
    radius = volume.radius
    if radius.any():
        labels = np.full(radius.shape, FILLED, np.uint8)
        labels[radius == 0] = MEASURED
        labels[radius > 128] = EXTRAPOLATED
        labels[radius == 255] = 0
        layers.append((labels, {"name": f"{name}: origin", "visible": False, **common}, "labels"))
    return layers


def sweep_layers(sweep: Sweep, name: str = "sweep") -> list[Layer]:
    """The frames of a sweep as an image layer (F, H, W), in frames and mm.

    napari has one affine matrix for a layer, so that the frames lie above one another, not at their
    poses; these, and the times, are in the layer's metadata.
    `globule.ultrasound.reconstruct` makes a volume of a sweep.
    """
    pixel = np.linalg.norm(sweep.world_from_image[sweep.valid][:, :3, :2], axis=1)
    column, row = np.median(pixel, axis=0) if len(pixel) else (1.0, 1.0)
    names = ("world_from_image", "timestamps", "valid", "mask", "space", "world")
    image = {
        "name": name,
        "colormap": "gray",
        "scale": (1.0, float(row), float(column)),
        "units": ("pixel", "mm", "mm"),
        "axis_labels": ("frame", "row", "column"),
        "metadata": {key: getattr(sweep, key) for key in names},
    }
    return [(sweep.frames, image, "image")]


def _layers_of_volume(path: Any) -> list[Layer]:
    return volume_layers(read_volume(path), _name(path))


def _layers_of_sweep(path: Any) -> list[Layer]:
    return sweep_layers(read_sweep(path), _name(path))


def _name(path: Any) -> str:
    return os.path.basename(os.path.normpath(path))
