"""A sequence of frames: files, or particles in memory."""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from ..data.particles import Particles
from ..formats import read
from ..render.layers import Layer
from ..render.sequence import OneOrigin, leader
from .scenes import SceneMaker
from .source import Origin, Source
from .state import State

KEPT_BYTES = 1 << 30  # of frames in memory
AHEAD = 3  # frames that are read before they are shown


class SequenceSource(Source):
    """A sequence; the next frame is read while the current one is shown.

    Args:
        name: for titles.
        frames: paths or `Particles`. Frames stay in memory up to `KEPT_BYTES`.
        device, threads: as for `Scene`.
        read_frame: reads one path.

    Attributes:
        frame: index of the current frame.
        together: gives the positions of all frames from one origin.
    """

    kind = "sequence"

    def __init__(
        self,
        name: str,
        frames: Sequence[Any],
        device: str = "auto",
        threads: int = 0,
        read_frame: Callable[[Any], Particles] = read,
    ):
        super().__init__(name)
        if not len(frames):
            raise ValueError("frames: expected at least one, got none")
        self._frames, self._read_frame = list(frames), read_frame
        self.together = OneOrigin()
        self.files = [os.fspath(f) for f in frames if not isinstance(f, Particles)]
        self.n_frames = len(self._frames)
        self.maker = SceneMaker(device, threads)
        self._kept: OrderedDict[int, Future] = OrderedDict()
        self._sizes: dict[int, int] = {}  # bytes of the kept frames that have been read
        self._fetching = threading.Lock()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="globule read")
        self.frame = 0
        at = leader(self._frames)
        self.maker.lead = (lambda: self._fetch(at).result()) if at else None
        self._now = self._fetch(0).result()
        self.up = self._now.up

    def particles(self) -> Particles:
        """The particles of the current frame."""
        return self._now

    def outline(self) -> np.ndarray | None:
        """A box around the first and the last frame, so that moving particles stay visible, with
        some room for their surface."""
        try:
            ends = [self._fetch(i).result().bounds() for i in (0, self.n_frames - 1)]
        except (ValueError, OSError):  # an empty frame, or one that is not written yet
            return None
        lo, hi = (np.array(corners) for corners in zip(*ends, strict=True))
        low, high = lo.min(axis=0), hi.max(axis=0)
        room = 0.03 * float(np.max(high - low))
        return box_corners(low - room, high + room)

    def layers(self, state: State) -> list[Layer]:
        """The scene of the current frame. The caller holds `lock`."""
        return [Layer(self.maker.scene(self._now, state))]

    def advance(self, state: State) -> float | None:
        """Go to the frame of the settings, or during playback to the next one."""
        time = state.time
        wanted = min(time.frame, self.n_frames - 1)
        onwards = time.playing and wanted == self.frame
        try:
            found = self._following(time.loop) if onwards else (wanted, self._fetch(wanted).result())
        except (ValueError, OSError):
            state.set(time__playing=False, time__frame=self.frame)  # what is shown, and said
            raise
        if found is None:
            state.set(time__playing=False)
            return None
        wanted, particles = found
        if wanted == self.frame:
            return None
        for ahead in range(1, min(AHEAD, self.n_frames - 1) + 1):
            self._fetch((wanted + ahead) % self.n_frames)
        with self.lock:
            self._now, self.frame = particles, wanted
            self.version += 1
        if time.playing:
            state.set(time__frame=wanted)
        return 1 / time.rate

    def _following(self, loop: bool) -> tuple[int, Particles] | None:
        """The next frame that can be read, with its number; None at the end. Others are passed over,
        and said. Raises what the last one did if none can be read."""
        last: Exception | None = None
        for step in range(1, self.n_frames + 1):
            at = self.frame + step
            if at >= self.n_frames and not loop:
                return None
            at %= self.n_frames
            if at == self.frame:
                break
            try:
                return at, self._fetch(at).result()
            except (ValueError, OSError) as error:
                last = error
                self.troubles.append(error)
        if last is not None:
            raise last
        return None

    def origin(self, state: State) -> Origin:
        """The file of the current frame."""
        return self._read_from(self.files[self.frame] if self.files else None)

    def facts(self) -> dict[str, Any]:
        """The number of the current frame."""
        return {"frame": f"{self.frame + 1} of {self.n_frames}"}

    def close(self) -> None:
        """Stop reading."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _read(self, item: Any) -> Particles:
        particles = item if isinstance(item, Particles) else self._read_frame(item)
        return self.together(particles)

    def _fetch(self, i: int) -> Future:
        """A frame that is being read or has been read."""
        with self._fetching:  # images and time have threads of their own
            kept = self._kept.get(i)
            # After an error the file may have changed.
            if kept is None or (kept.done() and kept.exception()):
                item = self._frames[i]
                if isinstance(item, Particles):
                    found: Future = Future()
                    found.set_result(self._read(item))
                    return found
                self._forget()
                self._kept[i] = self._pool.submit(self._read, item)
                self._sizes.pop(i, None)
            self._kept.move_to_end(i)
            return self._kept[i]

    def _forget(self) -> None:
        """Free memory, oldest frames first."""
        for i in [i for i in self._kept.keys() - self._sizes.keys() if self._kept[i].done()]:
            failed = self._kept[i].exception() is not None
            self._sizes[i] = 0 if failed else _bytes(self._kept[i].result())
        while sum(self._sizes.values()) > KEPT_BYTES and len(self._kept) > 2:
            i, _ = self._kept.popitem(last=False)
            self._sizes.pop(i, None)


def _bytes(particles: Particles) -> int:
    names = "positions", "support", "weight", "color"
    arrays = [getattr(particles, name) for name in names] + list(particles.attributes.values())
    return sum(getattr(array, "nbytes", 0) for array in arrays)
