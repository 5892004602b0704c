"""Tomographies through SimpleITK: one metaball per voxel of a tissue.

NIfTI (.nii, .nii.gz), NRRD (.nrrd, .nhdr), MetaImage (.mha, .mhd), and folders with a DICOM series.
Positions are in ITK's world frame, LPS: millimetres, x towards the patient's left, y to the back
(posterior), z to the head (superior). NIfTI's own frame is RAS; ITK turns it.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from .._base.colormaps import categorical, colorize
from ..scene.particles import Particles
from .errors import bad
from .volume_length import check_length

OPTIONS = ("level", "labels", "spacing")
MOST_VOXELS = 2**31  # of a volume
MOST_METABALLS = 50_000_000
_DARKEST, _BRIGHTEST = 2, 98  # percentiles of the intensities at the gray ramp's ends
_SAMPLE = 2_000_000  # voxels that stand for all where percentiles and the level are looked for


def read(path: str | os.PathLike, **options: Any) -> Particles:
    """Read a volume's tissue as metaballs; see tomography_particles."""
    return tomography_particles(path, **options)


def tomography_particles(
    image: Any,
    level: float | None = None,
    labels: int | Iterable[int] | None = None,
    spacing: float | None = None,
) -> Particles:
    """One metaball at the middle of each voxel at or above a level, or of given labels.

    The support is two voxels, so that filled tissue looks like a lattice of particles. Where a
    voxel's edges differ, a voxel means the cube of its volume, which keeps the field inside the
    tissue and so the meaning of the threshold; but the support is at least the longest edge, so
    that slices far apart still join.

    Args:
        image: path of a file or of a folder with a DICOM series (of several, the one with most
            slices), or a SimpleITK.Image of three axes and one number per voxel.
        level: least intensity; default: Otsu's, which parts the intensities in two classes.
        labels: values to show, instead of a level.
        spacing: mm; resample to cubes of this edge first: smoothed and linear, nearest voxel for
            labels.

    Returns:
        Particles in mm, LPS. Colours are from dark gray at the 2nd percentile of the
        intensities shown to white at the 98th, with the attribute `intensity`; or one of the
        palette's for each label, with the attribute `label`.

    Raises FormatError for a file that holds no volume; ValueError for a wrong argument, more than
    50 million voxels to show (with a spacing that would do), or where SimpleITK is missing.
    """
    wanted = _labels(level, labels)
    if spacing is not None and not (spacing > 0 and math.isfinite(spacing)):
        raise ValueError(f"spacing: expected a positive number of mm, got {spacing!r}")
    sitk = _simpleitk()
    if isinstance(image, (str, os.PathLike)):
        image = _load(sitk, os.fspath(image))
    elif not isinstance(image, sitk.Image):
        raise TypeError(f"image: expected a path or SimpleITK.Image, got {type(image).__name__}")
    n_components = image.GetNumberOfComponentsPerPixel()
    _check("image", image, image.GetSize(), n_components, sitk)
    if spacing is not None:
        image = _resampled(sitk, image, float(spacing), smooth=wanted is None)

    values = sitk.GetArrayViewFromImage(image)  # [z, y, x]
    if wanted is None:
        level = otsu_level(values) if level is None else level
        shown = values >= level
    else:
        shown = np.isin(values, wanted)
    edges = image.GetSpacing()
    voxel = math.prod(edges) ** (1 / 3)
    n_shown = int(np.count_nonzero(shown))
    if n_shown > MOST_METABALLS:
        enough = 1.05 * voxel * (n_shown / MOST_METABALLS) ** (1 / 3)
        raise ValueError(
            f"image: expected at most {MOST_METABALLS:,} voxels to show, got {n_shown:,}; "
            f"resample to {enough:.3g} mm"
        )
    index = np.stack(np.nonzero(shown)[::-1], axis=1)
    world_from_index = np.reshape(image.GetDirection(), (3, 3)) * edges
    positions = index @ world_from_index.T + image.GetOrigin()
    picked = values[shown]
    if wanted is None:
        color, attributes = _grays(picked), {"intensity": picked}
    else:
        picked = picked.astype(np.int32)
        color, attributes = categorical(picked), {"label": picked}
    support = max(2 * voxel, max(edges))
    return Particles(positions, support=support, color=color, attributes=attributes)


def describe(path: str | os.PathLike) -> dict[str, Any]:
    """A volume's size in voxels, spacing and origin in mm (LPS), and type of number."""
    sitk, path = _simpleitk(), os.fspath(path)
    with _itk_errors(sitk, path):
        image = _series(sitk, path) if os.path.isdir(path) else _header(sitk, path)
    return {
        "size": list(image.GetSize()[:3]),
        "spacing": list(image.GetSpacing()[:3]),
        "origin": list(image.GetOrigin()[:3]),
        "pixel": sitk.GetPixelIDValueAsString(image.GetPixelID()),
    }


def otsu_level(values: np.ndarray) -> float:
    """The level that parts values in two classes of least variance (Otsu 1979), of 256 bins."""
    sample = _sample(values)
    if not sample.size:
        return 0.0
    lo, hi = np.percentile(sample, (0.1, 99.9))  # a few bright voxels must not stretch the bins
    count, ends = np.histogram(np.clip(sample, lo, hi), 256, (lo, hi) if hi > lo else None)
    middle = (ends[1:] + ends[:-1]) / 2
    below, above = np.cumsum(count)[:-1], np.cumsum(count[::-1])[-2::-1]
    mass = count * middle
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_below = np.cumsum(mass)[:-1] / below
        mean_above = np.cumsum(mass[::-1])[-2::-1] / above
        between = below * above * (mean_above - mean_below) ** 2
    return float(ends[1 + np.nanargmax(between)]) if hi > lo else float(lo)


def _grays(values: np.ndarray) -> np.ndarray | None:
    sample = _sample(values)
    if not sample.size:
        return None
    lo, hi = np.percentile(sample, (_DARKEST, _BRIGHTEST))
    # The voxels at tissue's border are the darkest: black ones would hide the surface's shading.
    return colorize(values, "gray", float(lo - 0.5 * (hi - lo)), float(hi))


def _sample(values: np.ndarray) -> np.ndarray:
    """Finite values, float64, at most about _SAMPLE of them, evenly taken."""
    flat = values.reshape(-1)
    sample = flat[:: 1 + len(flat) // _SAMPLE].astype(np.float64)
    return sample[np.isfinite(sample)]


def _labels(level: float | None, labels: int | Iterable[int] | None) -> np.ndarray | None:
    if level is not None and not math.isfinite(level):
        raise ValueError(f"level: expected a finite number, got {level!r}")
    if labels is None:
        return None
    if level is not None:
        raise ValueError("level: expected none beside labels, got both")
    wanted = np.atleast_1d(np.asarray(labels))
    if wanted.dtype.kind not in "iu" or wanted.ndim != 1 or not wanted.size:
        raise ValueError(f"labels: expected one or more whole numbers, got {labels!r}")
    return wanted


def _resampled(sitk: Any, image: Any, spacing: float, smooth: bool) -> Any:
    """The volume in cubes of the given edge, over the same box."""
    edges = np.array(image.GetSpacing())
    size = np.maximum(1, np.ceil(edges * image.GetSize() / spacing - 1e-6))
    if size.prod() > MOST_VOXELS:
        least = spacing * (size.prod() / MOST_VOXELS) ** (1 / 3)
        raise ValueError(f"spacing: expected at least {1.05 * least:.3g} mm, got {spacing:g}")
    if smooth:
        image = sitk.Cast(image, sitk.sitkFloat32)
        # What is finer than the new voxels must go first, or it comes back as noise: a Gaussian as
        # wide at half its height as they are.
        sigma = np.where(spacing > edges, spacing / 2.355, 0.0)
        if sigma.any():
            image = sitk.DiscreteGaussian(image, variance=(sigma**2).tolist())
    direction = np.reshape(image.GetDirection(), (3, 3))
    origin = image.GetOrigin() + direction @ ((spacing - edges) / 2)
    interpolator = sitk.sitkLinear if smooth else sitk.sitkNearestNeighbor
    return sitk.Resample(
        image,
        [int(n) for n in size],
        sitk.Transform(),
        interpolator,
        origin.tolist(),
        [spacing] * 3,
        image.GetDirection(),
        0.0,
        image.GetPixelID(),
        True,
    )


def _load(sitk: Any, path: str) -> Any:
    with _itk_errors(sitk, path):
        return _series(sitk, path) if os.path.isdir(path) else _header(sitk, path).Execute()


def _header(sitk: Any, path: str) -> Any:
    """A reader that has read the file's header, whose size has been checked."""
    with open(path, "rb"):  # what is no readable file is an OSError like everywhere
        pass
    reader = sitk.ImageFileReader()
    reader.SetFileName(path)
    reader.ReadImageInformation()
    size = reader.GetSize()
    if len(size) == 4 and size[3] == 1:  # a series of one moment, as NIfTI files often have it
        size = size[:3]
        reader.SetExtractSize((*size, 0))
    _check(path, reader, size, reader.GetNumberOfComponents(), sitk)
    if any(key.startswith("Seq_Frame") for key in reader.GetMetaDataKeys()):
        raise bad(path, "header", "expected a volume, got a tracked sweep")
    one = sitk.Image(1, 1, reader.GetPixelID())
    check_length(path, reader, one.GetSizeOfPixelComponent())
    return reader


def _series(sitk: Any, folder: str) -> Any:
    """A folder's DICOM series with the most slices."""
    reader = sitk.ImageSeriesReader()
    series = [reader.GetGDCMSeriesFileNames(folder, i) for i in reader.GetGDCMSeriesIDs(folder)]
    if not series:
        raise bad(folder, "", "expected a DICOM series in this folder, got none")
    names = max(series, key=len)
    first = sitk.ImageFileReader()
    first.SetFileName(names[0])
    first.ReadImageInformation()
    if math.prod(first.GetSize()) * len(names) > MOST_VOXELS:
        raise bad(folder, "", f"expected at most {MOST_VOXELS:,} voxels, got more")
    reader.SetFileNames(names)
    return reader.Execute()


def _check(path: str, image: Any, size: tuple[int, ...], n_components: int, sitk: Any) -> None:
    """Refuse what has not three axes, one real number per voxel, and a size that can be held."""
    if len(size) != 3:
        raise bad(path, "header", f"expected a volume of 3 axes, got {len(size)}")
    if math.prod(size) > MOST_VOXELS:
        got = "x".join(map(str, size))
        raise bad(path, "header", f"expected at most {MOST_VOXELS:,} voxels, got {got}")
    kind = sitk.GetPixelIDValueAsString(image.GetPixelIDValue())
    if n_components != 1 or "complex" in kind:
        raise bad(path, "header", f"expected one number per voxel, got {n_components} ({kind})")
    frame = (*image.GetSpacing(), *image.GetOrigin(), *image.GetDirection())
    if not np.isfinite(frame).all():
        raise bad(path, "header", "expected a finite spacing, origin and direction")


@contextmanager
def _itk_errors(sitk: Any, path: str) -> Iterator[None]:
    """ITK's errors as FormatError, and none of its warnings, which it prints."""
    shown = sitk.ProcessObject.GetGlobalWarningDisplay()
    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        yield
    except RuntimeError as error:
        lines = [line.strip() for line in str(error).splitlines()]
        # ITK's "Reason" is the system's last error, which may have nothing to do with it.
        lines = [line for line in lines if line and not line.startswith("Reason:")]
        reason = lines[-1] if lines else "an unknown error"
        raise bad(path, "", f"expected a volume, got {reason}") from None
    finally:
        sitk.ProcessObject.SetGlobalWarningDisplay(shown)


def _simpleitk() -> Any:
    try:
        import SimpleITK
    except ImportError:
        raise ValueError(
            "volumes: expected the package SimpleITK, got none: pip install 'globule[medical]'"
        ) from None
    return SimpleITK
