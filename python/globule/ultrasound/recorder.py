"""The frames of a stream on disk, each safe on arrival.

The folder is a sweep that `read_sweep` reads: frame_000000.png … and poses.csv, one row per image;
a row's matrix is world_from_image. The recorder writes a row after its image is complete, so a
frame with a row survives a killed process. The next run overwrites an image without a row. A file
`unfinished` stands in the folder until the recording ends in order: only what was interrupted goes on.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..formats.errors import bad, faults
from ..formats.sweeps.poses import MATRIX, read_poses
from .matching import LiveFrame

_POSES = "poses.csv"
_UNFINISHED = "unfinished"
_COLUMNS = ("time", *MATRIX, "status", "world")


class _Kept(Sequence[LiveFrame]):
    """Frames on the disk."""

    def __init__(self, read: Callable[[int], Any], times: Any, matrices: Any, worlds: list[str]):
        self._read, self._times, self._matrices, self._worlds = read, times, matrices, worlds

    def __len__(self) -> int:
        return len(self._times)

    def __getitem__(self, i: Any) -> Any:
        if not 0 <= i < len(self):
            raise IndexError(i)
        return LiveFrame(float(self._times[i]), self._read(i), self._matrices[i], self._worlds[i])


def is_unfinished(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder holds a recording that was interrupted."""
    return os.path.isfile(os.path.join(folder, _UNFINISHED))


class Recorder:
    """Appends frames to a folder.

    Args:
        folder: new, empty, or the folder of an interrupted recording, which goes on.

    Attributes:
        kept: the frames of the earlier recording, in order of arrival; an image is read when it is
            asked for.
        n_frames: frames in the folder.

    Raises:
        ValueError: the folder holds something else, such as a recording that has ended.
        OSError: the folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike[str]):
        self.folder = Path(folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"{folder}: expected a folder to record to, got a file")
        table = self.folder / _POSES
        if self.folder.is_dir() and any(self.folder.iterdir()) and not table.is_file():
            raise ValueError(f"{folder}: expected a new folder or that of an interrupted recording")
        self.folder.mkdir(exist_ok=True)
        if not is_unfinished(folder) and (n := len([*self.folder.glob("*.png")])):
            got = f"a finished recording of {n:,} image{'s' * (n > 1)}; give another name"
            raise ValueError(f"{folder}: expected a new folder or that of an interrupted recording, got {got}")
        self.kept: Sequence[LiveFrame] = self._earlier(table) if table.is_file() else []
        (self.folder / _UNFINISHED).touch()
        self.n_frames = len(self.kept)
        first = self.kept[0].image if self.kept else None
        self._kind = None if first is None else (first.shape, first.dtype)
        self._rows = open(table, "a", encoding="utf-8", newline="\n")  # noqa: SIM115 until close
        if self._rows.tell() == 0:
            self._rows.write(",".join(_COLUMNS) + "\n")
            self._rows.flush()

    def takes(self, frame: LiveFrame) -> bool:
        """Whether the folder's images have the size and the type of this one, or there are none."""
        return self._kind in (None, (frame.image.shape, frame.image.dtype))

    def add(self, frame: LiveFrame) -> None:
        """Write a frame; on return it survives a killed process.

        Raises:
            ValueError: the image is neither uint8 nor uint16.
        """
        if frame.image.dtype not in (np.uint8, np.uint16):
            raise ValueError(f"record: expected uint8 or uint16 images, got {frame.image.dtype}")
        path = self._picture(self.n_frames)
        part = path.with_suffix(".part")
        Image.fromarray(frame.image).save(part, "PNG", compress_level=1)
        part.replace(path)
        numbers = [float(frame.time), *np.asarray(frame.world_from_image, float).ravel().tolist()]
        self._rows.write(",".join([*map(repr, numbers), "OK", frame.world]) + "\n")
        self._rows.flush()
        self._kind = frame.image.shape, frame.image.dtype
        self.n_frames += 1

    def close(self) -> None:
        """End the recording."""
        self._rows.close()
        (self.folder / _UNFINISHED).unlink(missing_ok=True)

    def _picture(self, i: int) -> Path:
        return self.folder / f"frame_{i:06d}.png"

    def _earlier(self, table: Path) -> Sequence[LiveFrame]:
        content = table.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]  # without a row that was cut short
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
        return _Kept(self._read, poses.times, poses.matrices, [row["world"] for row in rows])

    def _read(self, i: int) -> Any:
        name = self._picture(i)
        damaged = faults(name, expected="a recorded frame", refused=(OSError, SyntaxError, ValueError))
        with damaged, Image.open(name) as image:
            picture = np.asarray(image)
        return picture.astype(np.uint16) if picture.dtype == np.int32 else picture
