"""OpenEXR files, through the package OpenEXR: pictures of any channels in float32, linear."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..._base.checks import optional
from ..._base.files import atomic_write
from ..errors import bad, shown
from ..guarded import decode, need


def write_exr(path: str | os.PathLike[str], channels: Mapping[str, Any]) -> None:
    """Write images as an OpenEXR file (scan lines, ZIP), which appears whole or not at all.

    Args:
        path: file to write.
        channels: name -> (H, W) or (H, W, 3) array, all of one size, row 0 at the top. float16,
            float32 and uint32 are kept, all else becomes float32. Three components become the
            channels R G B of "color", `albedo.R albedo.G albedo.B` of "albedo", and `name.X name.Y
            name.Z` of any other name.

    Raises ValueError for wrong shapes or where OpenEXR is missing.
    """
    openexr = optional("OpenEXR", "formats")
    planes: dict[str, np.ndarray] = {}
    for name, image in channels.items():
        image = np.asarray(image)
        if image.dtype not in (np.float16, np.float32, np.uint32):
            image = image.astype(np.float32)
        if image.ndim == 2:
            planes[name] = np.ascontiguousarray(image)
        elif image.ndim == 3 and image.shape[2] == 3:
            for i, part in enumerate(_component_names(name)):
                planes[part] = np.ascontiguousarray(image[..., i])
        else:
            got = f"{name!r} {image.shape}"
            raise ValueError(f"channels: expected shapes (H, W) or (H, W, 3), got {got}")
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) != 1 or 0 in next(iter(shapes)):
        raise ValueError(f"channels: expected images of one size, got {sorted(shapes)}")
    header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
    with atomic_write(path) as file, openexr.File(header, planes) as image:
        image.write(file.name)  # OpenEXR wants a name; ours is the temporary one


def frame_channels(frame: Any) -> dict[str, np.ndarray]:
    """All images of a `Frame` for write_exr: R G B, Z (along the ray), position, normal, albedo."""
    return {
        "color": frame.color,
        "Z": frame.distance,
        "position": frame.position,
        "normal": frame.normal,
        "albedo": frame.albedo,
    }


def read_exr(path: str | os.PathLike[str], most_pixels: int) -> np.ndarray:
    """R G B, or Y as gray, of the first part: (H, W, 3) float32.

    Raises FormatError for what is no such file or has more pixels; ValueError where OpenEXR is
    missing.
    """
    need("OpenEXR", "OpenEXR", "formats")
    with open(path, "rb"):  # what is no readable file is an OSError like everywhere
        pass
    facts, planes = decode("exr", path, "an OpenEXR picture", most_pixels)
    picked = planes * 3 if len(planes) == 1 else planes
    if len(picked) < 3 or len({plane.shape for plane in picked}) > 1:
        raise bad(path, "channels", f"expected R G B or Y, got {shown(' '.join(facts['channels']))}")
    if picked[0].ndim != 2:
        raise bad(path, "channels", f"expected a picture, got shape {picked[0].shape}")
    return np.stack(picked, axis=2)


def _component_names(name: str) -> list[str]:
    if name == "color":
        return ["R", "G", "B"]
    return [f"{name}.{part}" for part in ("RGB" if name == "albedo" else "XYZ")]
