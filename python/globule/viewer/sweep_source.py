"""A live sweep: the volume grows while images arrive."""

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
from .overlay import Mark, Plate
from .source import Origin
from .state import State
from .volume_source import VolumeSource

COMPOUNDING = ("mean", "maximum", "latest", "first")
SHOWN_EVERY = 0.4  # s


class SweepSource(VolumeSource):
    """A sweep whose images arrive one by one.

    Args:
        name: for titles.
        open_frames: called at each start; gives an iterator of (image (H, W), world_from_image
            (4, 4)) that waits for the next image.
        spacing: first voxel edge, mm.
        device, threads: as for `Reconstructor`.
        sweep: the recorded sweep that is played, if there is one.

    Attributes:
        running: images are received.
        compounding: a name in `COMPOUNDING`; counts from the next `reset`.
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
        self._making: str | None = None  # of the reconstruction in progress
        self._method: str | None = None  # of the volume that is shown
        self.reset()

    @property
    def has_volume(self) -> bool:  # type: ignore[override]  # read-only here
        """Whether an image has come."""
        return bool(self._taken)

    def plates(self, state: State) -> list[Plate]:
        """The slices; before there are any, the sweep's first image. The caller holds `lock`."""
        if self.has_volume or self.sweep is None or not self.sweep.valid.any():
            return super().plates(state)
        self._window = 0.0, float(max(1, self.sweep.frames[0].max(initial=1)))
        return self._frame(self.sweep, int(np.argmax(self.sweep.valid)))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of the sweep or the volume, mm."""
        return super().bounds() if self._region is None else self._region

    def reset(self) -> None:
        """Remove all images; changes of compounding and spacing take effect.

        Raises:
            ValueError: an unknown compounding.
        """
        if self.compounding not in COMPOUNDING:
            known = ", ".join(COMPOUNDING)
            raise ValueError(f"compounding: expected one of {known}, got {self.compounding!r}")
        self.running = False
        with self._binning:
            self._reconstructor = Reconstructor(
                self.spacing, compounding=self.compounding, device=self._device, threads=self._threads
            )
            self._frames, self._taken = None, []
        with self.lock:
            self._take(_nothing())
            self._method = None

    def status(self) -> str:
        """What the source does, and the number of images."""
        n = f"{len(self._taken):,} images"
        if self._making is not None:
            return f"**reconstructing by {self._making}** from {n} …"
        if self.running:
            return f"**receiving** · {n}" if self._taken else "**waiting for an image …**"
        if self._method is not None:
            return f"**volume by {self._method}** from {n}; Clear starts again"
        if self._taken:
            return f"**stopped** · {n}; Play continues"
        return "**Press Play** to receive images. The volume grows with each image."

    def marks(self) -> list[Mark]:
        """A hint while there is no image."""
        if self._taken or self.running:
            return []
        lo, hi = self.bounds()
        middle = tuple(((np.asarray(lo) + hi) / 2).tolist())
        return [Mark((middle,), "No image yet: press Play", thin=True)]

    def stand_still(self) -> None:
        """Stop receiving."""
        self.running = False

    def start(self) -> None:
        """Receive images."""
        self.running = True
        self.version += 1  # the hint goes

    def stop(self) -> None:
        """Stop receiving and show the volume."""
        self.running = False
        self._show()

    def undo(self) -> None:
        """Remove the latest image."""
        with self._binning:
            self._reconstructor.undo()
            self._taken.pop()
        self._show()

    def finish(self, method: str) -> None:
        """Stop receiving and reconstruct the volume from all images.

        Args:
            method: of `gb.ultrasound.reconstruct`.

        Raises:
            ValueError: there is no image.
        """
        self.running = False
        with self._binning:
            if not self._taken:
                raise ValueError("sweep: expected images, got none yet. Press Play to receive images.")
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
        """Wait for the next image and add it to the volume."""
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
            if not self.running:  # stopped while waiting
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
        """The volume of the file by the same method, or of the images so far."""
        file = self.files[0] if self.files else "sweep.igs.mha"
        read = f"gb.ultrasound.read_sweep({', '.join([repr(file), *self.option_code()])})"
        if self._method is not None:
            before = ["globule", "reconstruct", file, *self.option_words(), "--method", self._method]
            before += ["--voxel-size", f"{self.spacing:.9g}", "-o", "volume.npz"]
            code = [
                f"sweep = {read}",
                f"volume = gb.ultrasound.reconstruct(sweep, method={self._method!r}, spacing={self.spacing!r})",
            ]
            return self.surface_of("volume.npz", before, code, state)
        code = [
            f"sweep = {read}",
            f"grown = gb.ultrasound.Reconstructor({self.spacing!r}, compounding={self.compounding!r})",
            f"for i in sweep.valid.nonzero()[0][:{len(self._taken)}]:",
            "    grown.add(sweep.frames[i], sweep.world_from_image[i])",
            "volume = grown.volume()",
        ]
        found = self.surface_of("volume.npz", [], code, state)
        found.words, found.lives = [file, *self.option_words()], True
        found.left.insert(0, "the images so far")
        return found

    def facts(self) -> dict[str, Any]:
        """The volume's voxels and the number of images."""
        return super().facts() | {"images": f"{self._reconstructor.n_frames:,}"}

    def close(self) -> None:
        """Stop receiving and close the stream."""
        self.running = False
        if self._frames is not None and hasattr(self._frames, "close"):
            with contextlib.suppress(ValueError):  # another thread waits in it
                self._frames.close()


def played(sweep: Sweep, rate: float = 20.0) -> Callable[[], Iterator[tuple[Any, Any]]]:
    """A recorded sweep as a live one; rate: images per second."""

    def frames() -> Iterator[tuple[Any, Any]]:
        for i in np.flatnonzero(sweep.valid):
            time.sleep(1 / rate)
            yield sweep.frames[i], sweep.world_from_image[i]

    return frames


def received(address: str, edges: Any, temporal_offset: float = 0.0) -> Callable[[], Iterator[tuple[Any, Any]]]:
    """The images of an OpenIGTLink server.

    Args:
        address: igtl://host:port.
        edges, temporal_offset: see `live.receive`.

    Raises:
        ValueError: a bad address.
        MissingPackageError: the extra `live` is not installed.
    """
    from ..ultrasound.live import need_pyigtl, parse_address, receive

    parse_address(address)
    need_pyigtl()

    def frames() -> Iterator[tuple[Any, Any]]:
        for frame in receive(address, edges, temporal_offset=temporal_offset):
            yield frame.image, frame.world_from_image

    return frames


def _nothing() -> Volume:
    return Volume(np.zeros((2, 2, 2), np.uint8), np.eye(4), np.full((2, 2, 2), 255, np.uint8))
