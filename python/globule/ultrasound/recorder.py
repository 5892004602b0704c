"""A stream's frames on disk, each safe as soon as it has come.

The folder is a sweep of its own: frame_000000.png … and poses.csv with a row for each, where a
matrix is world_from_image. A row is written when its picture is whole, so that a frame with a row
is never lost, whenever the process is killed; what came later is overwritten by the next run.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..formats.errors import bad
from ..formats.sweeps.poses import _MATRIX, read_poses
from .live import LiveFrame

_POSES = "poses.csv"
_COLUMNS = ("time", *_MATRIX, "status", "world")


class Recorder:
    """Appends frames to a folder, and knows those that were there already.

    kept    the frames of an earlier run, in the order in which they came

    Raises ValueError if the folder holds something else.
    """

    def __init__(self, folder: str | os.PathLike):
        self.folder = Path(folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"{folder}: expected a folder to record to, got a file")
        table = self.folder / _POSES
        if self.folder.is_dir() and any(self.folder.iterdir()) and not table.is_file():
            raise ValueError(f"{folder}: expected a new folder or an earlier recording's")
        self.folder.mkdir(exist_ok=True)
        self.kept = self._earlier(table) if table.is_file() else []
        self.n_frames = len(self.kept)
        self._rows = open(table, "a", encoding="utf-8", newline="\n")  # noqa: SIM115 until close
        if self._rows.tell() == 0:
            self._rows.write(",".join(_COLUMNS) + "\n")
            self._rows.flush()

    def add(self, frame: LiveFrame) -> None:
        """Write a frame; when this returns it survives a killed process."""
        if frame.image.dtype not in (np.uint8, np.uint16):
            raise ValueError(f"record: expected uint8 or uint16 images, got {frame.image.dtype}")
        path = self._picture(self.n_frames)
        part = path.with_suffix(".part")
        Image.fromarray(frame.image).save(part, "PNG", compress_level=1)
        part.replace(path)
        numbers = [float(frame.time), *np.asarray(frame.world_from_image, float).ravel().tolist()]
        self._rows.write(",".join([*map(repr, numbers), "OK", frame.world]) + "\n")
        self._rows.flush()
        self.n_frames += 1

    def close(self) -> None:
        """Close the table of poses."""
        self._rows.close()

    def _picture(self, i: int) -> Path:
        return self.folder / f"frame_{i:06d}.png"

    def _earlier(self, table: Path) -> list[LiveFrame]:
        content = table.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]  # a row that was being written is no row
        if whole != content:
            os.truncate(table, len(whole))
        for leftover in self.folder.glob("frame_*.part"):
            leftover.unlink()
        if whole.count(b"\n") < 2:
            os.truncate(table, 0)
            return []
        poses = read_poses(table)
        with open(table, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        if poses.times is None or "world" not in rows[0]:
            raise bad(table, "line 1", f"expected the columns {' '.join(_COLUMNS)} of a recording")
        frames = []
        for i, (time, matrix) in enumerate(zip(poses.times, poses.matrices, strict=True)):
            frames.append(LiveFrame(float(time), self._read(i), matrix, rows[i]["world"]))
        return frames

    def _read(self, i: int) -> Any:
        try:
            with Image.open(self._picture(i)) as image:
                picture = np.asarray(image)
        except (OSError, SyntaxError, ValueError) as error:
            raise bad(self._picture(i), "", f"expected a recorded frame, got {error}") from None
        return picture.astype(np.uint16) if picture.dtype == np.int32 else picture
