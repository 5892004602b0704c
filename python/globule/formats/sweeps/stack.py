"""Frames of a folder of images, TIFF, video, DICOM multi-frame, NumPy, HDF5 of TUS-REC."""

from __future__ import annotations

import os
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..asciinum import numbers_of_words
from ..errors import FormatError, bad, shown
from ..guarded import decode, need
from ..kind import PICTURE_ENDINGS
from ..numpy_format import read_archive, read_array
from ..size import check_size
from ..volumes import dicom
from ..volumes.raw import Progress
from . import igs

DICOM = (".dcm", ".dicom")
MASK = "mask.png"  # of a folder: not a frame
_FEW = 0.1  # of the pictures of a folder: gaps in their numbers
_TISSUE, _CM = 1, 3  # Region Spatial Format 2D; Physical Units cm
# What Pillow raises for a damaged file.
_DAMAGED = (
    OSError,
    SyntaxError,
    ValueError,
    MemoryError,
    TypeError,
    LookupError,
    ArithmeticError,
    RuntimeError,
    AssertionError,
    AttributeError,
    struct.error,
)


class Stack(NamedTuple):
    """frames (F, H, W); times (F,) s or None; other arrays of a NumPy archive by name."""

    frames: np.ndarray
    times: np.ndarray | None
    arrays: dict[str, np.ndarray]


@contextmanager
def quiet() -> Iterator[None]:
    """Without Pillow's warnings of damage, which an error or a whole picture follows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def read_folder(path: str | os.PathLike[str], progress: Progress = None) -> Stack:
    """The pictures of a folder in the order of the numbers in their names; progress in pictures.

    Raises FormatError naming the picture.
    """
    from PIL import Image

    names = [name for name in os.listdir(path) if name.lower().endswith(PICTURE_ENDINGS)]
    names = sorted((name for name in names if name.lower() != MASK), key=_by_numbers)
    if not names:
        raise bad(path, "", f"expected pictures ({' '.join(PICTURE_ENDINGS)}), got none")
    frames: np.ndarray[Any, Any] = np.empty(0)
    for i, name in enumerate(names):
        try:
            with quiet(), Image.open(Path(path) / name) as image:
                if not i:  # all are as large as the first
                    held = sum(os.path.getsize(Path(path) / name) for name in names)
                    each = {"F": 4, "I": 4, "I;16": 2}.get(image.mode, 1)
                    claim = each * image.width * image.height * len(names)
                    check_size(path, name, claim, held, 1.2)
                elif (image.height, image.width) != frames.shape[1:]:
                    expected = f"expected {frames.shape[2]}x{frames.shape[1]} as the first"
                    raise bad(path, name, f"{expected}, got {image.width}x{image.height}")
                colored = image.mode in ("P", "PA", "LA", "RGB", "RGBA", "CMYK", "YCbCr")
                picture = np.asarray(image.convert("RGB") if colored else image)
        except FormatError:
            raise
        except (*_DAMAGED, Image.DecompressionBombError) as error:
            raise bad(path, name, f"expected a picture, got {str(error) or 'too large a one'}") from None
        if picture.ndim == 3:
            picture = igs.to_gray(picture[..., :3])
        if picture.dtype == np.int32:  # Pillow's mode I: 16-bit PNG
            picture = picture.astype(np.uint16)
        if not i:
            frames = np.empty((len(names), *picture.shape), picture.dtype)
        if picture.shape != frames.shape[1:] or picture.dtype != frames.dtype:
            expected = f"{frames.dtype} {frames.shape[1:]} as the first"
            raise bad(path, name, f"expected {expected}, got {picture.dtype} {picture.shape}")
        frames[i] = picture
        if progress:
            progress(i + 1, len(names))
    return Stack(frames, None, {})


def check_numbers(path: str | os.PathLike[str]) -> None:
    """Warn of a folder whose pictures are numbered and lack a few: at a given rate, those after a gap
    would count as earlier than they are."""
    if not os.path.isdir(path):
        return
    names = [name for name in os.listdir(path) if name.lower().endswith(PICTURE_ENDINGS) and name.lower() != MASK]
    names.sort(key=_by_numbers)
    numbers = [[int(word) for word in re.findall(r"\d+", name)] for name in names]
    if len(names) < 3 or not numbers[0] or len({len(of) for of in numbers}) > 1:
        return
    steps = np.diff(np.array([of[-1] for of in numbers], float))
    usual = np.median(steps)
    gaps = np.flatnonzero(steps > usual)
    if usual <= 0 or not len(gaps) or len(gaps) > max(1, _FEW * len(names)) or (steps < usual).any():
        return
    others = f", and {len(gaps) - 1} others" if len(gaps) > 1 else ""
    warnings.warn(
        f"{path}: pictures are missing between {names[gaps[0]]} and {names[gaps[0] + 1]}{others}; at a given rate, "
        "later pictures take the poses of earlier ones: add the missing pictures, or give the time of each in Python "
        "(frame_times)",
        stacklevel=3,
    )


def read_tiff(path: str | os.PathLike[str]) -> Stack:
    """All pages of a TIFF file. Raises FormatError naming the page."""
    from PIL import Image, ImageSequence

    frames: list[np.ndarray] = []
    try:
        with quiet(), Image.open(path) as image:
            n = getattr(image, "n_frames", 1)
            each = {"F": 4, "I": 4, "I;16": 2, "RGB": 4}.get(image.mode, 1)
            claim = each * image.width * image.height * n
            check_size(path, "header", claim, os.path.getsize(path), 2.0)
            for page in ImageSequence.Iterator(image):
                colored = page.mode in ("P", "PA", "LA", "RGB", "RGBA", "CMYK", "YCbCr")
                picture = np.asarray(page.convert("RGB") if colored else page)
                picture = igs.to_gray(picture[..., :3]) if picture.ndim == 3 else picture.copy()
                if frames and (picture.shape, picture.dtype) != (frames[0].shape, frames[0].dtype):
                    expected = f"{frames[0].dtype} {frames[0].shape} as the first"
                    got = f"{picture.dtype} {picture.shape}"
                    raise bad(path, f"page {len(frames)}", f"expected {expected}, got {got}")
                frames.append(picture)
    except FormatError:
        raise
    except (*_DAMAGED, Image.DecompressionBombError) as error:
        page_name, got = f"page {len(frames)}", str(error) or "too large a one"
        raise bad(path, page_name, f"expected an image, got {got}") from None
    return Stack(np.stack(frames), None, {})


def read_video(path: str | os.PathLike[str]) -> Stack:
    """The frames of a video (MP4, AVI, MKV …) as gray values, with their times.

    Raises FormatError, MissingPackageError without PyAV.
    """
    need("av", "av", "video")
    _, (frames, times) = decode("video", path, "a video")
    return Stack(frames, times if np.isfinite(times).all() else None, {})


def read_h5(path: str | os.PathLike[str]) -> Stack:
    """A scan of the TUS-REC data: frames, and `tforms`, the tracker from the probe's tool, mm.

    Raises FormatError, MissingPackageError without h5py.
    """
    need("h5py", "h5py", "formats")
    _, (frames, tforms) = decode("sweep_h5", path, "a scan in HDF5")
    return Stack(frames, None, {"tforms": tforms})


def read_numpy(path: str | os.PathLike[str]) -> Stack:
    """.npy: frames (F, H, W); .npz: frames, perhaps timestamps, and whatever else it holds.

    Raises FormatError naming the array.
    """
    with open(path, "rb") as file:
        is_array = file.read(6) == b"\x93NUMPY"
        file.seek(0)
        size = os.fstat(file.fileno()).st_size
        arrays = {"frames": read_array(path, "array", file, size)} if is_array else {}
    arrays = arrays or read_archive(path)
    frames = arrays.pop("frames", None)
    if frames is None or frames.ndim != 3 or frames.dtype.kind not in "biuf":
        got = "none" if frames is None else f"{frames.dtype} {frames.shape}"
        hint = "; np.stack makes one of several images" if frames is not None and frames.ndim == 2 else ""
        raise bad(path, "frames", f"expected an array (F, H, W) of numbers, got {got}{hint}")
    times = arrays.pop("timestamps", None)
    if times is not None and (times.shape != frames.shape[:1] or times.dtype.kind not in "iuf"):
        expected = f"{len(frames)} numbers"
        raise bad(path, "timestamps", f"expected {expected}, got {times.dtype} {times.shape}")
    return Stack(frames, times, arrays)


def read_dicom(path: str | os.PathLike[str]) -> Stack:
    """A DICOM multi-frame file, by SimpleITK; times from Frame Time or Frame Time Vector (ms).

    Raises FormatError for other files, MissingPackageError without SimpleITK.
    """
    frames, tags = dicom.read_frames(path)
    if frames.ndim > 2 and frames.shape[-1] in (3, 4):
        frames = igs.to_gray(frames[..., :3])
    if frames.ndim == 2:
        frames = frames[None]
    if frames.ndim != 3:
        raise bad(path, "", f"expected a sequence of 2D frames, got shape {frames.shape}")
    times = _dicom_times(path, tags, len(frames))
    return Stack(frames, times, _tissue(path, frames.shape[1:], dicom.read_regions(path)))


def _tissue(path: Any, shape: tuple[int, ...], regions: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """The largest region of tissue in cm: `mask` (H, W), `mm_per_pixel` (2,) along a row and a
    column, `reference_pixel` (2,) column and row; nothing if there is none. Raises FormatError."""
    where = "Sequence of Ultrasound Regions"
    found: dict[str, np.ndarray] = {}
    largest = 0
    for region in regions:
        if (region["spatial"], region["unit_x"], region["unit_y"]) != (_TISSUE, _CM, _CM):
            continue
        x0, y0, x1, y1 = corners = [region[name] for name in ("x0", "y0", "x1", "y1")]
        deltas = [region[name] for name in ("delta_x", "delta_y")]
        known = None not in corners and None not in deltas
        if not known or not (np.isfinite(deltas).all() and 0 not in deltas):
            raise bad(path, where, f"expected corners and sizes of pixels, got {corners + deltas}")
        if not (0 <= x0 <= x1 < shape[1] and 0 <= y0 <= y1 < shape[0]):
            got = f"{x0:g}, {y0:g} to {x1:g}, {y1:g}"
            expected = f"a region in the {shape[1]}x{shape[0]} pixels"
            raise bad(path, where, f"expected {expected}, got {got}")
        area = int((x1 - x0 + 1) * (y1 - y0 + 1))
        if area <= largest:
            continue
        largest = area
        mask = np.zeros(shape, bool)
        mask[int(y0) : int(y1) + 1, int(x0) : int(x1) + 1] = True
        # The reference pixel counts from the region's corner.
        reference = [region["reference_x"] or 0.0, region["reference_y"] or 0.0]
        found = {"mask": mask, "mm_per_pixel": 10 * np.abs(deltas), "reference_pixel": np.array([x0, y0]) + reference}
    return found


def _dicom_times(path: Any, tags: dict[str, str], n: int) -> np.ndarray | None:
    for tag, what in (("0018|1065", "Frame Time Vector"), ("0018|1063", "Frame Time")):
        if tag not in tags:
            continue
        text = tags[tag].strip("\0 ")
        steps = numbers_of_words(text.split("\\")) / 1000
        if len(steps) == 1:
            return np.arange(n) * steps[0]
        if len(steps) != n:
            raise bad(path, what, f"expected 1 or {n} numbers, got {shown(text)}")
        return np.cumsum(steps) - steps[0]
    return None


def _by_numbers(name: str) -> tuple[Any, ...]:
    """frame_2 before frame_10."""
    parts = re.split(r"(\d+)", name)
    return tuple(int(part) if i % 2 else part for i, part in enumerate(parts))
