"""Tissue of a volume as metaballs: the iso-surface at a level, or the voxels of given labels."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from .._base.checks import number, positive
from .._base.colormaps import categorical, colorize
from ..data.particles import Particles
from ..formats.errors import FormatError, bad
from ..formats.volumes.dicom import from_itk
from ..formats.volumes.geometry import VolumeData
from ..scene.scene import DEFAULTS
from .files import read_volume, volume_of
from .iso_surface import check_count, default_level, evenly, extract_iso_surface
from .volume import Volume

MOST_VOXELS = 2**31  # after resampling
_KERNEL = "murakami"  # a scene's default, whose threshold the surface is made for
_DARKEST, _BRIGHTEST = 2, 98  # percentiles of the intensities at the gray ramp's ends


def sample_tomography(
    image: Any, level: float | None = None, labels: int | Iterable[int] | None = None, spacing: float | None = None
) -> Particles:
    """A volume as metaballs: its iso-surface at a level, or the voxels of given labels.

    With a level, a scene of these particles with default settings has its surface where the volume
    is `level`, like `iso_surface`. With labels, each labeled voxel is a metaball with a support of
    two voxels: thin tissue stays visible. If the edges of a voxel differ, a voxel represents the
    cube of its volume, and the support is at least the longest edge.

    Args:
        image: path of a volume's file or of a folder with a DICOM series, a Volume, or
            a SimpleITK.Image of three axes and one number per voxel.
        level: iso-value, in the units of the file's values; default: `default_level(volume)`.
        labels: values of the shown voxels, instead of a level.
        spacing: mm; resample to cubes of this edge first (SimpleITK): smoothed and linear, nearest
            voxel for labels.

    Returns:
        Particles, positions (N, 3) in mm, LPS; none if no value reaches the level. Colors are from
        dark gray at the 2nd percentile of the intensities to white at the 98th, with the attribute
        `intensity`; or one of the palette's for each label, with the attribute `label`.

    Raises FormatError for a file that holds no volume; ValueError for a wrong argument, or more
    than 50 million voxels to show (with a spacing that would do); MissingPackageError for a format
    or a resampling that needs a package that is not installed.
    """
    with _of_file(image):
        return _particles(*_volume(image, level, labels, spacing), level)


@contextmanager
def _of_file(image: Any) -> Iterator[None]:
    """What is wrong with a file's values is said with its name."""
    try:
        yield
    except FormatError:
        raise
    except ValueError as error:
        if isinstance(image, (str, os.PathLike)):
            raise bad(image, "", str(error)) from error
        raise


def _particles(volume: Volume, wanted: np.ndarray | None, level: float | None) -> Particles:
    if wanted is not None:
        shown = np.isin(volume.values, wanted)
        check_count(volume, int(np.count_nonzero(shown)))
        positions, values = _voxels(volume, shown)
        label = values.astype(np.int32)
        edges = volume.spacing
        support = max(2 * math.prod(edges) ** (1 / 3), float(edges.max()))
        return Particles(positions, support=support, color=categorical(label), attributes={"label": label})
    level = default_level(volume) if level is None else level
    if not (volume.values >= level).any():
        return Particles(np.zeros((0, 3), np.float32), attributes={"intensity": np.zeros(0)})
    particles, threshold, _ = extract_iso_surface(volume, level, _KERNEL)
    intensity = particles.attributes.pop("value")
    particles.weight = particles.weight * np.float32(DEFAULTS[_KERNEL][1] / threshold)
    particles.color = _grays(intensity, intensity[intensity >= level])
    particles.attributes["intensity"] = intensity
    return particles


def tissue_voxels(
    image: Any, level: float | None = None, labels: int | Iterable[int] | None = None, spacing: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the voxels at or above a level, or of given labels: (N, 3) float64, mm, LPS; and
    their values (N,).

    Arguments and errors are those of `sample_tomography`.
    """
    with _of_file(image):
        volume, wanted = _volume(image, level, labels, spacing)
        if wanted is not None:
            shown = np.isin(volume.values, wanted)
        else:
            shown = volume.values >= (default_level(volume) if level is None else level)
            shown &= ~volume.empty
        check_count(volume, int(np.count_nonzero(shown)))
        return _voxels(volume, shown)


def _volume(image: Any, level: float | None, labels: Any, spacing: float | None) -> tuple[Volume, np.ndarray | None]:
    """The volume, resampled if a spacing is given, and the labels as an array."""
    wanted = _labels(level, labels)
    if spacing is not None:
        spacing = positive("spacing", spacing)
    if isinstance(image, (str, os.PathLike)):
        volume = read_volume(image)
    elif isinstance(image, Volume):
        volume = image.in_space("LPS")
    elif type(image).__module__.partition(".")[0] == "SimpleITK":
        volume = volume_of(from_itk("image", image))
    else:
        expected = "a path, Volume or SimpleITK.Image"
        raise TypeError(f"image: expected {expected}, got {type(image).__name__}")
    if spacing is not None:
        volume = _resampled(volume, spacing, smooth=wanted is None)
    return volume, wanted


def _voxels(volume: Volume, shown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles (N, 3) float64 and values (N,) of the voxels in a mask."""
    index = np.argwhere(shown)
    matrix = volume.world_from_voxel
    return index[:, ::-1] @ matrix[:3, :3].T + matrix[:3, 3], volume.values[tuple(index.T)]


def _grays(values: np.ndarray, shown: np.ndarray) -> np.ndarray:
    low, high = np.percentile(evenly(shown), (_DARKEST, _BRIGHTEST))
    # The voxels at tissue's border are the darkest: black ones would hide the surface's shading.
    return colorize(values, "gray", float(low - 0.5 * (high - low)), float(high))


def _labels(level: float | None, labels: int | Iterable[int] | None) -> np.ndarray | None:
    if level is not None:
        number("level", level)
    if labels is None:
        return None
    if level is not None:
        raise ValueError("level: expected none beside labels, got both")
    wanted = np.atleast_1d(np.asarray(labels))
    if wanted.dtype.kind not in "iu" or wanted.ndim != 1 or not wanted.size:
        raise ValueError(f"labels: expected one or more whole numbers, got {labels!r}")
    return wanted


def _resampled(volume: Volume, spacing: float, smooth: bool) -> Volume:
    """The volume in cubes of the given edge, over the same box."""
    from scipy import ndimage

    edges = volume.spacing
    size = np.maximum(1, np.ceil(edges * volume.shape[::-1] / spacing - 1e-6))
    if size.prod() > MOST_VOXELS:
        least = spacing * (size.prod() / MOST_VOXELS) ** (1 / 3)
        raise ValueError(f"spacing: expected at least {1.05 * least:.3g} mm, got {spacing:g}")
    values, scale = volume.values, (spacing / edges)[::-1]  # scale: z, y, x
    if smooth:
        # What is finer than the new voxels must go first, or it comes back as noise: a Gaussian as
        # wide at half its height as they are.
        sigma = np.where(scale > 1, scale / 2.355, 0.0)
        values = ndimage.gaussian_filter(values.astype(np.float32), sigma, mode="nearest")
    shape = tuple(size[::-1].astype(int))
    values = ndimage.affine_transform(values, scale, (scale - 1) / 2, shape, order=int(smooth), mode="nearest")
    direction = volume.world_from_voxel[:3, :3] / edges
    origin = volume.world_from_voxel[:3, 3] + direction @ ((spacing - edges) / 2)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = direction * spacing, origin
    return volume_of(VolumeData(values, matrix))
