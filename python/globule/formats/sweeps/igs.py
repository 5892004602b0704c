"""Tracked sweeps of PLUS / IGSIO: .igs.mha and .igs.nrrd (or plain .mha and .nrrd).

Frame i's fields are called Seq_Frame0000_NAME: transforms `ProbeToTrackerTransform` (16 numbers)
with `…TransformStatus`, `Timestamp` and `ImageStatus`. All are kept as text, so that what is read
can be written again to the letter.
"""

from __future__ import annotations

import os
import re
import warnings
from typing import Any, NamedTuple

import numpy as np

from ..asciinum import numbers_of_words
from ..errors import bad, shown
from ..volumes import metaimage, nrrd
from ..volumes.raw import Progress, RawImage
from .transforms import Edges, Transform, parse_matrix, split_name

EXTENSIONS = (".igs.mha", ".igs.nrrd", ".mha", ".mhd", ".nrrd", ".nhdr")
_FRAME_FIELD = re.compile(r"Seq_Frame(\d{1,9})_(.+)")
_TRANSFORM = "Transform"
_AXES = ("domain", "space", "time", "list", "none", "???")  # kinds of NRRD's axes without color
_ORIENTATION = "UltrasoundImageOrientation"


class Recording(NamedTuple):
    """A file of frames as it is.

    frames         (F, H, W), in MF orientation: column 0 at the marked side, row 0 at the probe;
                   (F, 0, 0) of a tracker's buffer
    times          (F,) s, or None where a frame has none
    edges          transforms by (source, target), one matrix per frame
    ok             (F,) bool: the image's own status
    fields         the file's fields as text
    frame_fields   each frame's fields as text
    """

    frames: np.ndarray
    times: np.ndarray | None
    edges: Edges
    ok: np.ndarray
    fields: dict[str, str]
    frame_fields: list[dict[str, str]]


def read(path: str | os.PathLike[str], progress: Progress = None) -> Recording:
    """Read frames and all that is said of them. Raises FormatError naming the field."""
    with open(path, "rb") as file:
        is_nrrd = file.read(4) == b"NRRD"
    image = (nrrd if is_nrrd else metaimage).read(path, progress, empty=True)
    frames = _planes(path, image, is_nrrd)
    n = len(frames)
    fields: dict[str, str] = {}
    frame_fields: list[dict[str, str]] = [{} for _ in range(n)]
    for name, text in image.fields.items():
        plain = name.removesuffix(nrrd.KEY_VALUE) if is_nrrd else name
        match = _FRAME_FIELD.fullmatch(plain)
        if not match:
            fields[name] = text
        elif int(match[1]) < n:
            frame_fields[int(match[1])][match[2]] = text
        else:
            raise bad(path, plain, f"expected fields of {n} frames, numbered from 0, as the sizes say")
    frames = np.ascontiguousarray(_turned(path, frames, _get(fields, _ORIENTATION)))
    ok = np.array([f.get("ImageStatus", "OK") == "OK" or not frames.size for f in frame_fields])
    times = _times(path, frame_fields)
    if times is None and is_nrrd:
        times = _index_values(path, fields, n)
    return Recording(frames, times, _edges(path, frame_fields), ok, fields, frame_fields)


def write(path: str | os.PathLike[str], recording: Recording, progress: Progress = None) -> None:
    """Write a recording, in the orientation that its fields name."""
    frames = _turned(path, recording.frames, _get(recording.fields, _ORIENTATION), back=True)
    is_nrrd = _is_nrrd(path)
    suffix = nrrd.KEY_VALUE if is_nrrd else ""
    header = _translated(recording.fields, is_nrrd)
    for i, fields in enumerate(recording.frame_fields):
        header |= {f"Seq_Frame{i:04d}_{name}{suffix}": text for name, text in fields.items()}
    (nrrd if is_nrrd else metaimage).write(path, frames, header, progress=progress)


def _is_nrrd(path: str | os.PathLike[str]) -> bool:
    return os.fspath(path).lower().endswith((".nrrd", ".nhdr"))


def _get(fields: dict[str, str], name: str) -> str:
    return fields.get(name, fields.get(name + nrrd.KEY_VALUE, "MF"))


def _translated(fields: dict[str, str], to_nrrd: bool) -> dict[str, str]:
    """The file's fields in the words of the format that is written."""
    from_nrrd = "dimension" in fields
    fixed = {"kinds": "domain domain list"} if to_nrrd else {
        "BinaryData": "True", "TransformMatrix": "1 0 0 0 1 0 0 0 1", "Offset": "0 0 0",
        "ElementSpacing": "1 1 1", "Kinds": "domain domain list",
    }  # fmt: skip
    if from_nrrd == to_nrrd and fields:
        kept = dict(fields)
        for name in fixed:  # per axis: a file of four axes is written with three
            words = kept.get(name, fixed[name]).split()
            colored = name == "kinds" and not all(word.lower() in _AXES for word in words)
            if colored or len(words) != len(fixed[name].split()):
                kept[name] = fixed[name]
        return kept
    own = {_ORIENTATION: _get(fields, _ORIENTATION)}
    for name, text in fields.items():
        if name.endswith(nrrd.KEY_VALUE) or name.startswith("Ultrasound"):
            own[name.removesuffix(nrrd.KEY_VALUE)] = text
    suffix = nrrd.KEY_VALUE if to_nrrd else ""
    return fixed | {name + suffix: text for name, text in own.items()}


def _planes(path: Any, image: RawImage, is_nrrd: bool) -> np.ndarray:
    """The frames, (F, H, W); colors become gray (ITU-R BT.601)."""
    array, channels = image.array, _channel_axis(image, is_nrrd)
    items = _item_axis(image, is_nrrd)
    if items is None and is_nrrd and image.array.ndim == 3 and channels is None:
        items = _likely_axis(path, image)
    if channels is not None and items is not None:
        array = np.moveaxis(array, (items, channels), (0, -1))
    elif items is not None:
        array = np.moveaxis(array, items, 0)
    elif channels is not None:
        array = np.moveaxis(array, channels, -1)
    if channels is not None:
        if array.shape[-1] not in (1, 3, 4):
            expected = "1, 3 (RGB) or 4 (RGBA) values a pixel"
            raise bad(path, "kinds", f"expected {expected}, got {array.shape[-1]}")
        array = array[..., 0] if array.shape[-1] == 1 else to_gray(array[..., :3])
    if array.ndim == 2:
        array = array[None]
    if array.ndim == 4 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 3:
        raise bad(path, "sizes", f"expected a sequence of 2D frames, got shape {array.shape}")
    return array


def _item_axis(image: RawImage, is_nrrd: bool) -> int | None:
    """The axis of the items of a sequence, which 3D Slicer writes as the first or the last."""
    kinds = image.fields.get("kinds", "").lower().split()
    if not is_nrrd or kinds.count("list") != 1 or len(kinds) != image.array.ndim:
        return None
    return len(kinds) - 1 - kinds.index("list")  # NRRD counts from the fastest axis


def _likely_axis(path: Any, image: RawImage) -> int | None:
    """The axis of the frames where no kinds say it: the one without a direction in space, or as long as there are
    frames with fields. Warns of how the file was read, unless that is sure."""
    shape = image.array.shape
    if image.fields.get("kinds", "").strip("? ").lower():
        return None
    directions = re.findall(r"none|\([^)]*\)", image.fields.get("space directions", "").lower())
    if len(directions) == 3 and directions.count("none") == 1:
        return 2 - directions.index("none")
    fields = (_FRAME_FIELD.fullmatch(name.removesuffix(nrrd.KEY_VALUE)) for name in image.fields)
    n = 1 + max((int(match[1]) for match in fields if match), default=-1)
    axis = next((axis for axis in (0, 2, 1) if shape[axis] == n), 0)
    if shape[0] != n:
        read = f"{shape[axis]:,} frames, along its {('last', 'middle', 'first')[axis]} axis"
        why = f", as it has fields of {n:,}" if shape[axis] == n else ""
        example = "list domain domain" if axis != 2 else "domain domain list"
        warnings.warn(
            f"{path}: no kinds say which axis counts the frames: read as {read}{why}; a line as 'kinds: {example}' in "
            "its header says otherwise",
            stacklevel=2,
        )
    return axis


def _index_values(path: Any, fields: dict[str, str], n: int) -> np.ndarray | None:
    """The times of a sequence of 3D Slicer: the values of its index, if the index is a time."""
    for axis in ("0", "3"):
        text = fields.get(f"axis {axis} index values{nrrd.KEY_VALUE}")
        if text is None or "time" not in fields.get("labels", "").lower():
            continue
        values = numbers_of_words(text.split())
        if len(values) != n or not np.isfinite(values).all():
            raise bad(path, f"axis {axis} index values", f"expected {n} numbers, got {shown(text)}")
        return values
    return None


def _channel_axis(image: RawImage, is_nrrd: bool) -> int | None:
    """The axis of colors: the header says which, else a last one of three."""
    n = image.array.ndim
    if not is_nrrd:
        return n - 1 if image.fields.get("ElementNumberOfChannels", "1") != "1" else None
    kinds = image.fields.get("kinds", "").lower().split()
    colors = [axis for axis, kind in enumerate(kinds) if kind not in _AXES]
    if len(kinds) == n and colors:
        return n - 1 - colors[0]  # NRRD counts from the fastest axis
    return n - 1 if n == 4 and image.array.shape[-1] == 3 else None


def to_gray(array: np.ndarray) -> np.ndarray:
    """(..., 3) RGB to (...), ITU-R BT.601, rounded where the type is an integer."""
    gray = array @ np.array([0.299, 0.587, 0.114])
    return (np.rint(gray) if array.dtype.kind in "iu" else gray).astype(array.dtype)


def _turned(path: Any, frames: np.ndarray, orientation: str, back: bool = False) -> np.ndarray:
    """Frames (F, H, W) of an orientation in MF, or back. Its letters are the ways in which the
    columns and the rows count: to the marked (M) or unmarked (U) side, far from (F) or near (N) to
    the probe; a third one, A or D, is that of volumes."""
    letters = orientation[:2] if frames.size > len(frames) else "MF"  # nothing to turn
    across = letters[:1] in ("F", "N")  # columns along the depth
    side, depth = (letters[1:], letters[:1]) if across else (letters[:1], letters[1:])
    known = side in ("M", "U") and depth in ("F", "N") and orientation[2:] in ("", "A", "D")
    if not known and frames.size > len(frames):
        expected = "M or U and F or N (and A or D), as MF or FMA"
        problem = f"expected {expected}, got {shown(orientation)}; the header must say how the image lies"
        raise bad(path, _ORIENTATION, problem)
    step = np.s_[:, :: -1 if depth == "N" else 1, :: -1 if side == "U" else 1]
    if back:
        return frames[step].swapaxes(1, 2) if across else frames[step]
    return (frames.swapaxes(1, 2) if across else frames)[step]


def _times(path: Any, frame_fields: list[dict[str, str]]) -> np.ndarray | None:
    times = []
    for i, fields in enumerate(frame_fields):
        text = fields.get("Timestamp")
        if text is None:
            return None
        try:
            times.append(float(text))
        except ValueError:
            times.append(np.nan)
        if not np.isfinite(times[-1]):
            raise bad(path, _name(i, "Timestamp"), f"expected a time, got {shown(text)}")
    return np.array(times)


def _edges(path: Any, frame_fields: list[dict[str, str]]) -> Edges:
    n = len(frame_fields)
    edges: Edges = {}
    for i, fields in enumerate(frame_fields):
        for name, text in fields.items():
            key = split_name(name.removesuffix(_TRANSFORM)) if name.endswith(_TRANSFORM) else None
            if key is None:
                continue
            if key not in edges:
                missing = np.tile(np.full((4, 4), np.nan), (n, 1, 1))
                edges[key] = Transform(missing, np.zeros(n, bool))
            status = fields.get(name + "Status", "OK").strip() == "OK"
            try:
                matrix = parse_matrix(text)
            except ValueError as error:
                if not status:
                    continue  # no pose, whatever stands there
                problem = f"expected 16 numbers, got {error}"
                raise bad(path, _name(i, name), problem) from None
            edges[key].matrices[i] = matrix
            edges[key].ok[i] = status and is_pose(matrix)
    return edges


def is_pose(matrix: np.ndarray) -> bool:
    """Whether it can be a pose: its columns 0 and 1 span a plane. Trackers also write zeros for
    what they do not see."""
    u, v = matrix[:3, 0], matrix[:3, 1]
    with np.errstate(over="ignore", invalid="ignore"):
        area, size = np.linalg.norm(np.cross(u, v)), u @ u + v @ v
    return bool(np.isfinite(matrix).all() and area > 1e-9 * size)


def _name(i: int, name: str) -> str:
    return f"Seq_Frame{i:04d}_{name}"
