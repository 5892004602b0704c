"""Recordings of Stradwin (.sw with its .sxi): gray images with poses and the calibration, in cm.

The .sw is text: RES_… settings, and a line `IM time x y z azimuth elevation roll` for each frame;
the .sxi has the frames as bytes (Stradwin's pages on its files). Translations are in cm, angles in
degrees; a matrix is Rz(azimuth) Ry(elevation) Rx(roll), and a pixel's place

    tracker_from_sensor @ sensor_from_image @ [x, y, 0, 1],

where x and y count in cm from the upper left corner of the image, not from a pixel's center.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..asciinum import numbers_of_words
from ..errors import bad, shown
from ..size import bytes_of, check_size, whole_text
from ..volumes.raw import beside
from . import igs
from .transforms import Edges, Transform

_CM = 10.0  # mm
_MOVE = ("RES_XTRANS", "RES_YTRANS", "RES_ZTRANS", "RES_AZIMUTH", "RES_ELEVATION", "RES_ROLL")
_SIZES = ("RES_BUF_FRAMES", "RES_BUF_HEIGHT", "RES_BUF_WIDTH")
_REFUSED = {  # what is true, and what to do instead
    "RES_BUF_RF": "save the recording as B-scans in Stradwin",
    "RES_BUF_DOPPLER": "colors are not read",
    "RES_BUF_DICOM": "the images are in DICOM files: read those, with the poses as a table",
    "RES_INVERT_BSCAN": "save the recording with the probe at the top of the image",
}


def read(path: str | os.PathLike[str]) -> igs.Recording:
    """Frames (F, H, W) uint8, times, and the edges Image to Probe and Probe to Tracker, mm.

    Raises FormatError naming the line or the setting.
    """
    if os.fspath(path).lower().endswith(".sxi"):
        raise bad(path, "", "expected the .sw of the recording, got its .sxi")
    fields, times, moves = _lines(path)
    for name, advice in _REFUSED.items():
        if fields.get(name, "false").lower() == "true":
            raise bad(path, name, f"expected false, got true; {advice}")
    if fields.get("RES_POS_REC", "true").lower() != "true":
        raise bad(path, "RES_POS_REC", "expected positions with the images, got none")
    n, height, width = (_size(path, fields, name) for name in _SIZES)
    if len(times) != n:
        raise bad(path, "IM", f"expected a line for each of {n} frames, got {len(times)}")
    scale = [_number(path, fields, name) for name in ("RES_XSCALE", "RES_YSCALE")]
    if min(scale) <= 0:
        raise bad(path, "RES_XSCALE", f"expected cm per pixel above 0, got {scale}")
    sensor_from_image = _rigid(np.array([_number(path, fields, name, 0.0) for name in _MOVE]))
    corner = np.diag([*(_CM * np.array(scale)), 1.0, 1.0])
    corner[:2, 3] = 0.5 * _CM * np.array(scale)  # of a pixel's center
    poses = _rigid(moves)
    ok = np.isfinite(moves).all(axis=1) & np.isfinite(times)
    edges: Edges = {
        ("Image", "Probe"): Transform(sensor_from_image @ corner, np.array(True)),
        ("Probe", "Tracker"): Transform(poses, ok),
    }
    name = fields.get("RES_BIN_IM_FILENAME") or f"{os.path.basename(path).rpartition('.')[0]}.sxi"
    frames = _frames(path, os.path.basename(name), (n, height, width))
    return igs.Recording(frames, times, edges, np.ones(n, bool), {}, [{} for _ in range(n)])


def _lines(path: Any) -> tuple[dict[str, str], np.ndarray, np.ndarray]:
    """Settings by name, times (F,) in s, and positions (F, 6) in cm and degrees."""
    try:
        text = whole_text(path)
    except UnicodeDecodeError:
        raise bad(path, "", "expected a text of Stradwin, got other data") from None
    fields: dict[str, str] = {}
    rows: list[np.ndarray] = []
    for i, line in enumerate(text.splitlines(), 1):
        name, _, value = line.strip().partition(" ")
        if name.startswith("RES_"):
            fields[name] = value.strip()
        elif name == "IM":
            row = numbers_of_words(value.split())
            if len(row) != 1 + len(_MOVE):
                expected = "expected IM time x y z azimuth elevation roll"
                raise bad(path, f"line {i}", f"{expected}, got {shown(line)}")
            rows.append(row)
    table = np.array(rows).reshape(-1, 1 + len(_MOVE))
    return fields, table[:, 0], table[:, 1:]


def _rigid(moves: np.ndarray) -> np.ndarray:
    """(…, 4, 4) of (…, 6): translations in cm, azimuth, elevation and roll in degrees; mm."""
    from scipy.spatial.transform import Rotation

    matrix = np.zeros((*moves.shape[:-1], 4, 4))
    turned = Rotation.from_euler("ZYX", moves[..., 3:].reshape(-1, 3), degrees=True).as_matrix()
    matrix[..., :3, :3] = turned.reshape(*moves.shape[:-1], 3, 3)
    matrix[..., :3, 3] = _CM * moves[..., :3]
    matrix[..., 3, 3] = 1
    return matrix


def _frames(path: Any, name: str, shape: tuple[int, int, int]) -> np.ndarray:
    with beside(path, "RES_BIN_IM_FILENAME", name) as file:
        held, size = os.fstat(file.fileno()).st_size, shape[0] * shape[1] * shape[2]
        if held != size:
            got = f"{held:,} bytes in {shown(name)}"
            raise bad(path, "frames", f"expected {size:,} bytes of gray images, got {got}")
        check_size(path, "frames", size, held)
        frames = np.empty(shape, np.uint8)
        if file.readinto(bytes_of(frames)) != size:  # type: ignore[attr-defined]
            raise bad(path, "frames", f"expected {size:,} bytes, got fewer")
    return frames


def _size(path: Any, fields: dict[str, str], name: str) -> int:
    text = fields.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text) > 0):
        raise bad(path, name, f"expected a number from 1, got {shown(text)}")
    return int(text)


def _number(path: Any, fields: dict[str, str], name: str, default: float | None = None) -> float:
    text = fields.get(name)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise bad(path, name, f"expected a number, got {shown(text or '')}")
    return value
