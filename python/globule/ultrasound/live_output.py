"""What a live reconstruction sends back: volume, trust map, slice, surface, pose and counts.

Devices of the messages, all in RAS:
    Volume                  IMAGE, the values of the volume so far
    Trust                   IMAGE, 0 empty, 1 measured, 2 filled, 3 extrapolated
    Slice                   IMAGE, the volume in the plane of the newest image
    Surface                 POLYDATA, the surface at a level
    LiveImageToReference    TRANSFORM, the pose of the newest image (or LiveImageToTracker, …)
    Counts                  STRING, images received and lost
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np

from .._base.checks import optional
from ..formats.sweeps import messages
from ..volumes.iso_surface import default_level
from ..volumes.slices import reslice
from ..volumes.volume import FAR, Volume, origin_of
from .broadcast import Broadcaster
from .matching import LiveFrame

_SLICE = 192  # pixels along the longer side of a slice, at most
_BEHIND = 3  # messages that wait; from there on, frames go before volumes
_LONGEST = 1.0  # s without a volume, while frames go before
_COARSE = 128  # voxels along the longest axis of the volume whose surface is taken


class LiveOutput:
    """Sends a growing volume whenever it has grown, in a thread of its own; a second thread sends
    trust map and surface, which cost more, less often.

    Args:
        server: sends the messages.
        volume: returns the volume of all frames so far.
        refresh: s between two trust maps, and between two surfaces; at least four times as long as
            they take, so that they leave the processor to the frames.
        level: iso-value of the surface; default: Otsu's at each time.

    Attributes:
        n_volumes: volumes sent to the server.
        n_frames: frames that the newest volume has, at least.
        error: what ended the thread early, or None.
    """

    def __init__(
        self, server: Broadcaster, volume: Callable[[], Volume], refresh: float = 1.0, level: float | None = None
    ):
        self._server, self._volume, self._level = server, volume, level
        self._refresh = refresh
        self._changed = threading.Condition()
        self._newest: tuple[LiveFrame, int, str] | None = None  # a frame that no volume shows
        self._shown: tuple[Volume, float, str] | None = None  # a volume without its surface
        self._ended = self._last_is_shown = self._behind = False
        self.n_volumes = self.n_frames = 0
        self.error: Exception | None = None
        self._threads = [
            threading.Thread(target=self._work, args=(loop,), daemon=True)
            for loop in (self._send_volumes, self._send_surfaces)
        ]
        for thread in self._threads:
            thread.start()

    def frame(self, n: int, frame: LiveFrame, counts: str = "", waiting: int = 0) -> None:
        """The volume has this frame, its n-th. While messages wait for their use, volumes are
        made rarely: they would delay the frames, and show old ones."""
        name = f"LiveImageTo{frame.world}"[:20]
        self._server.send(messages.transform(name, _with_normal(frame), frame.time))
        with self._changed:
            self._newest, self._behind = (frame, n, counts), waiting > _BEHIND
            self._changed.notify_all()

    def close(self) -> None:
        """Send the last volume with its trust map and surface, and end."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def _work(self, loop: Callable[[], None]) -> None:
        try:
            loop()
        except Exception as error:  # the frames stay; the caller tells
            self.error = error
        finally:
            with self._changed:
                self._last_is_shown = True
                self._changed.notify_all()

    def _send_volumes(self) -> None:
        begun = -np.inf
        while True:
            with self._changed:
                while not self._ended and (self._newest is None or self._behind):
                    left = begun + _LONGEST - time.monotonic()
                    if self._newest is not None and left <= 0:
                        break
                    self._changed.wait(left if left > 0 else None)
                begun = time.monotonic()
                newest, self._newest = self._newest, None
            if newest is None:
                return
            frame, n, counts = newest
            volume = self._volume()
            self._server.send(messages.image("Volume", volume.values, volume.world_from_voxel, frame.time))
            self._server.send(_slice(volume, frame))
            self.n_volumes, self.n_frames = self.n_volumes + 1, n
            with self._changed:
                self._shown = (volume, frame.time, counts)
                self._changed.notify_all()

    def _send_surfaces(self) -> None:
        while True:
            with self._changed:
                while self._shown is None and not self._last_is_shown:
                    self._changed.wait()
                shown, self._shown = self._shown, None
            if shown is None:
                return
            begun = time.monotonic()
            volume, when, counts = shown
            trust = origin_of(volume.radius)
            self._server.send(messages.image("Trust", trust, volume.world_from_voxel, when))
            if counts:
                self._server.send(messages.text("Counts", counts, when))
            found = surface(volume, self._level)
            if found:
                self._server.send(messages.triangles("Surface", *found, when))
            deadline = begun + max(self._refresh, 4 * (time.monotonic() - begun))
            with self._changed:
                while not self._ended and (left := deadline - time.monotonic()) > 0:
                    self._changed.wait(left)


def surface(volume: Volume, level: float | None = None) -> tuple[np.ndarray, np.ndarray] | None:
    """The surface of a volume as triangles, fast and coarse: marching cubes (Lewiner et al. 2003)
    between the means of 2, 4, … voxels, at most 128 along an axis, and not at the border of the
    data.

    Args:
        volume: the volume.
        level: iso-value; default: Otsu's.

    Returns:
        vertices (V, 3) float32, mm, world; faces (F, 3) int32, counterclockwise seen from outside.
        None without a surface.

    Raises MissingPackageError without scikit-image.
    """
    marching_cubes = optional("skimage.measure", "measure", "scikit-image").marching_cubes
    values, known = volume.values.astype(np.float32), volume.radius != FAR
    step = np.ones(3)
    while max(values.shape) > _COARSE:
        for axis in range(3):
            if values.shape[axis] > 1:
                values, known = _halved(values, known, axis)
                step[2 - axis] *= 2
    values, known = _smoothed(values, known)
    coarse = Volume(values, np.eye(4), np.where(known, np.uint8(0), np.uint8(FAR)))
    try:
        level = default_level(coarse) if level is None else level
        vertices, faces, _, _ = marching_cubes(values, level, mask=known, gradient_direction="descent")
    except (ValueError, RuntimeError):  # of one value, below the level, or too thin
        return None
    if not len(faces):
        return None
    points = vertices[:, ::-1] * step + (step - 1) / 2
    matrix = volume.world_from_voxel
    if np.linalg.det(matrix[:3, :3]) < 0:  # a reflection
        faces = faces[:, ::-1]
    return (points @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32), faces.astype(np.int32)


def _halved(values: np.ndarray, known: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Means of two neighbors along an axis, of those that are known."""
    n = values.shape[axis] // 2 * 2
    even, odd = (tuple(slice(start, n, 2) if k == axis else slice(None) for k in range(3)) for start in (0, 1))
    a, b, in_a, in_b = values[even], values[odd], known[even], known[odd]
    return np.where(in_a & in_b, (a + b) / 2, np.where(in_a, a, b)), in_a | in_b


def _smoothed(values: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights 1 2 1 along each axis over the known values."""
    weights = known.astype(np.float32)
    values = values * weights
    for axis in range(3):
        for array in (values, weights):
            swapped = np.moveaxis(array, axis, 0)
            padded = np.pad(swapped, ((1, 1), (0, 0), (0, 0)))
            swapped[:] = padded[:-2] + 2 * padded[1:-1] + padded[2:]
    return np.where(known, values / np.where(known, weights, 1), 0), known


def _slice(volume: Volume, frame: LiveFrame) -> messages.Packed:
    """The volume in the plane of an image, with fewer pixels than the image."""
    height, width = frame.image.shape
    coarser = max(1, -(-max(height, width) // _SLICE))
    plane = _with_normal(frame)
    plane[:3, 3] += plane[:3, :2] @ np.full(2, (coarser - 1) / 2)
    plane[:3, :2] *= coarser
    values = reslice(volume, plane, (-(-width // coarser), -(-height // coarser))).values
    if volume.values.dtype.kind == "u":
        values = np.rint(values)
    return messages.image("Slice", values.astype(volume.values.dtype)[None], plane, frame.time)


def _with_normal(frame: LiveFrame) -> np.ndarray:
    """The frame's pose with a third column that is perpendicular to the image, as long as the
    pixels are wide: receivers divide by its length."""
    matrix = np.array(frame.world_from_image, np.float64)
    u, v = matrix[:3, 0], matrix[:3, 1]
    normal = np.cross(u, v)
    matrix[:3, 2] = normal / np.linalg.norm(normal) * np.linalg.norm(u)
    return matrix
