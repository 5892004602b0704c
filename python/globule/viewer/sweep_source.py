"""A sweep that is being recorded: the volume grows while frames come in."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from ..ultrasound.reconstruct import reconstruct
from ..ultrasound.reconstructor import Reconstructor
from ..ultrasound.sweep import Sweep
from ..volumes.volume import Volume
from .locks import FairLock
from .overlay import Mark
from .source import Origin
from .state import State
from .volume_source import VolumeSource

COMPOUNDING = ("mean", "maximum", "latest", "first")
SHOWN_EVERY = 0.4  # s


class SweepSource(VolumeSource):
    """Frames that come, put into voxels one by one.

    open_frames: gives an iterator of (image (H, W), world_from_image (4, 4)), and waits in it
    until the next frame comes; called at each start.
    spacing: edge of a voxel, mm, to begin with.
    """

    kind = "sweep"
    grows = True

    def __init__(
        self,
        name: str,
        open_frames: Callable[[], Iterator[tuple[Any, Any]]],
        spacing: float = 1.0,
        device: str = "auto",
        threads: int = 0,
        sweep: Sweep | None = None,
    ):
        super().__init__(name, _nothing(), sweep, device, threads)
        self._open, self._device, self._threads = open_frames, device, threads
        self._region = None if sweep is None else sweep.bounds()
        self.spacing, self.compounding = spacing, COMPOUNDING[0]
        self._binning = FairLock()  # of the reconstructor
        self._frames: Iterator | None = None
        self._taken: list[tuple[Any, Any]] = []
        self.running = False
        self._last_shown = 0.0
        self._making: str | None = None  # the method that a volume is being made by
        self._method: str | None = None  # that the volume which is shown was made by
        self.reset()

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return super().bounds() if self._region is None else self._region

    def reset(self) -> None:
        """Forget all frames; compounding and spacing count from now on."""
        if self.compounding not in COMPOUNDING:
            known = ", ".join(COMPOUNDING)
            raise ValueError(f"compounding: expected one of {known}, got {self.compounding!r}")
        self.running = False
        with self._binning:
            self._reconstructor = Reconstructor(
                self.spacing,
                compounding=self.compounding,
                device=self._device,
                threads=self._threads,
            )
            self._frames, self._taken = None, []
        with self.lock:
            self._take(_nothing())
            self._method = None

    def status(self) -> str:
        n = f"{len(self._taken):,} frames"
        if self._making is not None:
            return f"**making the volume by {self._making}** of {n} …"
        if self.running:
            return f"**frames come in** · {n}" if self._taken else "**waiting for a frame …**"
        if self._method is not None:
            return f"**volume by {self._method}** of {n}; Clear begins anew"
        if self._taken:
            return f"**stopped** · {n}; Start goes on"
        return "**Press Start**: frames come in, and the volume grows."

    def marks(self) -> list[Mark]:
        """What to do, where there is nothing to see yet."""
        if self._taken or self.running:
            return []
        lo, hi = self.bounds()
        middle = tuple(((np.asarray(lo) + hi) / 2).tolist())
        return [Mark((middle,), "Nothing yet: press Start, at the right", thin=True)]

    def stand_still(self) -> None:
        self.running = False

    def start(self) -> None:
        self.running = True
        self.version += 1  # what was to be done is done

    def stop(self) -> None:
        """Take in no more."""
        self.running = False
        self._show()

    def undo(self) -> None:
        """Take out the latest frame."""
        with self._binning:
            self._reconstructor.undo()
            self._taken.pop()
        self._show()

    def finish(self, method: str) -> None:
        """Stop, and make the volume of all frames by another method."""
        self.running = False
        with self._binning:
            if not self._taken:
                raise ValueError("sweep: expected frames, got none yet")
            frames, poses = (np.stack(arrays) for arrays in zip(*self._taken, strict=True))
        mask = None if self.sweep is None else self.sweep.mask
        self._making = method
        try:
            volume = reconstruct(
                Sweep(frames, poses, mask=mask),
                method=method,
                spacing=self.spacing,
                device=self._device,
                threads=self._threads,
            )
        finally:
            self._making = None
        with self.lock:
            self._take(volume)
            self._method = method

    def advance(self, state: State) -> float | None:
        if not self.running:
            return None
        if self._frames is None:
            self._frames = iter(self._open())
        found = next(self._frames, None)
        if found is None:
            self._frames = None
            self.stop()
            return None
        with self._binning:
            if not self.running:  # stopped while it came
                return None
            self._reconstructor.add(*found)
            self._taken.append(found)
        if time.monotonic() - self._last_shown > SHOWN_EVERY:
            self._show()
        return 0.0

    def _show(self) -> None:
        with self._binning:
            volume = self._reconstructor.volume() if self._reconstructor.n_frames else _nothing()
        with self.lock:
            self._take(volume)
            self._method = None
        self._last_shown = time.monotonic()

    def origin(self, state: State) -> Origin:
        """Of a file, its volume by the same method; while frames come in, what has come so far."""
        file = self.files[0] if self.files else "sweep.igs.mha"
        read = f"gb.read_sweep({', '.join([repr(file), *self.option_code()])})"
        if self._method is not None:
            before = [
                "globule",
                "reconstruct",
                file,
                *self.option_words(),
                "--method",
                self._method,
                "--voxel-size",
                f"{self.spacing:.9g}",
                "-o",
                "volume.npz",
            ]
            code = [
                f"sweep = {read}",
                f"volume = gb.reconstruct(sweep, method={self._method!r}, "
                f"spacing={self.spacing!r})",
            ]
            return self.surface_of("volume.npz", before, code, state)
        code = [
            f"sweep = {read}",
            f"grown = gb.Reconstructor({self.spacing!r}, compounding={self.compounding!r})",
            f"for i in sweep.valid.nonzero()[0][:{len(self._taken)}]:",
            "    grown.add(sweep.frames[i], sweep.world_from_image[i])",
            "volume = grown.volume()",
        ]
        found = self.surface_of("volume.npz", [], code, state)
        found.words, found.lives = [file, *self.option_words()], True
        found.left.insert(0, "the frames that came")
        return found

    def facts(self) -> dict[str, Any]:
        return super().facts() | {"frames": f"{self._reconstructor.n_frames:,}"}

    def close(self) -> None:
        self.running = False
        if hasattr(self._frames, "close"):
            with contextlib.suppress(ValueError):  # it still waits for a frame
                self._frames.close()


def played(sweep: Sweep, rate: float = 20.0) -> Callable[[], Iterator[tuple[Any, Any]]]:
    """A recorded sweep as if it were coming in now, so many frames a second."""

    def frames() -> Iterator[tuple[Any, Any]]:
        for i in np.flatnonzero(sweep.valid):
            time.sleep(1 / rate)
            yield sweep.frames[i], sweep.world_from_image[i]

    return frames


def received(address: str, edges: Any) -> Callable[[], Iterator[tuple[Any, Any]]]:
    """Frames of an OpenIGTLink server. Raises ValueError for a bad address or without pyigtl."""
    from ..ultrasound.live import need_pyigtl, parse_address, receive

    parse_address(address)
    need_pyigtl()

    def frames() -> Iterator[tuple[Any, Any]]:
        for frame in receive(address, edges):
            yield frame.image, frame.world_from_image

    return frames


def _nothing() -> Volume:
    return Volume(np.zeros((2, 2, 2), np.uint8), np.eye(4), np.full((2, 2, 2), 255, np.uint8))
