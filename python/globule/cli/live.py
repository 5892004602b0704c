"""`reconstruct --live`: frames of a server, binned at arrival, recorded and shown."""

from __future__ import annotations

import argparse
import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..ultrasound.live import LiveCounts, LiveFrame, parse_address, receive_sweep
from ..ultrasound.sweep import Sweep
from ..volumes.volume import Volume
from . import flags
from .pictures import draw, wanted
from .shared import Progress, UserError, check_folder, count, mistakes, positive, say, warn


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of live reconstruction."""
    group = parser.add_argument_group(
        "live", "With --voxel-size, the volume grows with the frames, and --three-view and "
        "--surface are written again while frames arrive.")  # fmt: skip
    flags.own(group, "--live igtl://HOST:PORT", "read frames from an OpenIGTLink server instead of "
        "SWEEP, until the server stops or Ctrl-C")  # fmt: skip
    flags.own(group, "--tracker igtl://HOST:PORT", "read transforms from this second OpenIGTLink "
        "server; both servers may start in any order",
        usual="from the server of --live")  # fmt: skip
    flags.own(group, "--serve [HOST:]PORT", "send the growing volume, its trust map, a slice along "
        "the probe and the surface to OpenIGTLink clients that connect to this port, such as 3D "
        "Slicer; needs --voxel-size; example: --serve 18945", usual="send nothing")  # fmt: skip
    flags.own(group, "--record FOLDER", "also store each frame in this folder, which is a SWEEP; "
        "after a crash, the same command continues the folder")  # fmt: skip
    flags.own(group, "--idle S", "silence of the server that ends --live, seconds", positive, 5.0)
    flags.own(group, "--wait S", "time within which the server must start, seconds", positive,
        usual="as --idle")  # fmt: skip
    flags.own(group, "--space NAME", "axes of the world that the messages' matrices map to: LPS, "
        "RAS", ("LPS", "RAS"),
        usual="as the header of an image states, LPS for transforms")  # fmt: skip
    flags.own(group, "--refresh S", "time between two versions of --three-view, of --surface, and "
        "of the trust map and surface of --serve, seconds", positive, 1.0)  # fmt: skip


def check(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other, before any work."""
    if not options.live:
        for name in ("record", "space", "wait", "tracker", "serve"):
            if getattr(options, name):
                raise UserError(f"--{name}: expected --live beside --{name}, got none")
        return
    with mistakes():
        parse_address(options.live)
        if options.tracker:
            parse_address(options.tracker)
    if options.serve:
        _served(options.serve)
        if options.spacing is None:
            raise UserError("--serve: expected --voxel-size, so that the volume can grow, got none")
    if options.record:
        check_folder("--record", options.record)
    for name in ("poses", "frame_times"):
        if getattr(options, name) is not None:
            raise UserError(f"--{name.replace('_', '-')}: expected a SWEEP, got --live")


def _served(text: str) -> tuple[str, int]:
    """Host and port of [HOST:]PORT."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and int(port) < 65536):
        raise UserError(f"--serve: expected PORT or HOST:PORT, got {text!r}")
    return host or "127.0.0.1", int(port)


class Live:
    """The frames of one run.

    growing   arguments of `Reconstructor`; None if the volume cannot grow
    """

    def __init__(self, options: argparse.Namespace, progress: Progress, growing: dict[str, Any] | None):
        if options.serve and growing is None:
            raise UserError("--serve: expected --method pvn-om without a median, which can grow")
        self.options, self.progress, self.growing = options, progress, growing
        self.reconstructor: Any = None
        self.recorder: Any = None
        self.server: Any = None
        self.output: Any = None
        self.counts = LiveCounts()
        self.seconds: list[float] = []
        self.n_frames = self.n_drawn = 0
        self._drawn = -np.inf
        self._drawing: Future | None = None

    def sweep(self) -> Sweep:
        """All frames until the server stops, after the frames that an earlier run recorded."""
        options = self.options
        with ThreadPoolExecutor(1) as self._draughtsman:
            try:
                with mistakes():
                    if options.serve:
                        self._open_server()
                    if options.record:
                        from ..ultrasound.recorder import Recorder

                        self.recorder = Recorder(options.record)
                    earlier = self.recorder.kept if self.recorder else []
                    return receive_sweep(
                        options.live, options.calibration, options.plus, options.idle, self._take,
                        earlier, options.space, options.temporal_offset, options.wait, self.counts,
                        options.tracker, clip=options.clip, fan=options.fan, mask=options.mask,
                    )  # fmt: skip
            except ConnectionError as error:
                raise UserError(f"--{error}") from error
            except OSError as error:
                name = error.filename or options.record or options.three_view or options.surface_image
                message = f"{name}: cannot be written: {error.strerror or error}"
                raise UserError(message) from error
            finally:
                if self.output:
                    self.output.close()
                if self.server:
                    self.server.close()
                if self.recorder:
                    self.recorder.close()

    def volume(self) -> Volume | None:
        """The volume of all frames so far; None if the run only collects frames, or an
        interruption left the last frame unfinished."""
        whole = self.reconstructor is not None and self.reconstructor.n_frames == self.n_frames
        return self.reconstructor.volume() if whole else None

    def warnings(self) -> list[str]:
        """What became of images that are in no frame."""
        c, lines = self.counts, []
        if c.without_pose:
            lines.append(f"{count(c.without_pose, 'image')} left out: no pose came for their time")
        if c.useless:
            lines.append(f"{count(c.useless, 'image')} left out: the pose is no regular matrix")
        if c.missed:
            lines.append(
                f"{count(c.missed, 'image')} never arrived, by the gaps of the time stamps: the "
                "server dropped them, or the connection was broken"
            )
        if c.missed_poses:
            lines.append(f"{count(c.missed_poses, 'pose')} never arrived, by the gaps of the stamps")
        if c.clock_difference:
            lines.append(
                f"the clocks of tracker and images differ by {c.clock_difference:.3f} s; arrival "
                "times tell this, and --temporal-offset the rest"
            )
        if self.output and self.output.error:
            lines.append(f"--serve ended early: {self.output.error}")
        return lines

    def figures(self) -> dict[str, Any]:
        """Seconds from the arrival of a frame until the volume has the frame."""
        facts = {"grew": bool(self.seconds), "drawn": self.n_drawn,
                 "recorded": self.recorder.n_frames if self.recorder else 0,
                 "counts": self.counts.as_dict(),
                 "clock_difference": self.counts.clock_difference}  # fmt: skip
        if self.server:
            facts |= {"sent": dict(self.server.sent), "skipped": dict(self.server.skipped),
                      "clients": self.server.connections}  # fmt: skip
        if not self.seconds:
            return facts
        return facts | {"median_seconds": float(np.median(self.seconds)), "longest_seconds": max(self.seconds)}

    def _take(self, n: int, frame: LiveFrame) -> None:
        self.n_frames = n
        if self.recorder and n > len(self.recorder.kept):
            self.recorder.add(frame)
        if self.growing is not None:
            self._grow(frame)
        if self.progress.shown and n % 10 == 0:
            self.progress.done -= 1
            self.progress.step(f"{n:,} frames from {self.options.live}{self._lost()}, Ctrl-C ends")

    def _lost(self) -> str:
        c = self.counts
        lost = c.without_pose + c.useless + c.missed
        return f" ({lost:,} lost)" if lost else ""

    def _grow(self, frame: LiveFrame) -> None:
        begun = time.perf_counter()
        try:
            if self.reconstructor is None:
                self.reconstructor = self._reconstructor(frame)
            self.reconstructor.add(frame.image, frame.world_from_image)
        except (TypeError, ValueError, MemoryError) as error:
            # The frames stay; the error shows again after the last frame.
            warn(f"the volume cannot grow; the command only collects frames: {error}")
            self.growing = self.reconstructor = None
            return
        self.seconds.append(time.perf_counter() - begun)
        if self.server:
            self._serve(frame)
        if wanted(self.options):
            self._draw()

    def _open_server(self) -> None:
        from ..ultrasound.broadcast import Broadcaster

        host, port = _served(self.options.serve)
        try:
            self.server = Broadcaster(host, port)
        except OSError as error:
            raise UserError(f"--serve: cannot listen at {host}:{port}: {error.strerror}") from error
        self.progress.clear()
        say(f"sending to OpenIGTLink clients at igtl://{host}:{self.server.port}")

    def _serve(self, frame: LiveFrame) -> None:
        from ..ultrasound.live_output import LiveOutput

        if self.output is None:
            volume = self.reconstructor.volume
            self.output = LiveOutput(self.server, volume, self.options.refresh)
        c = self.counts
        words = f"{self.n_frames} frames of {c.images} images{self._lost()}"
        self.output.frame(self.n_frames, frame, words, c.waiting)

    def _draw(self) -> None:
        """Draw the current volume; a thread writes the file while frames come."""
        now = time.monotonic()
        busy = self._drawing is not None and not self._drawing.done()
        if busy or now - self._drawn < self.options.refresh:
            return
        if self._drawing is not None:
            self._drawing.result()  # raises the error of the last drawing
        self._drawn = now
        self._drawing = self._draughtsman.submit(draw, self.reconstructor.volume(), self.options, [])
        self.n_drawn += 1

    def _reconstructor(self, frame: LiveFrame) -> Any:
        from ..ultrasound.reconstructor import Reconstructor
        from ..ultrasound.setup import Setup

        options = self.options
        setup = Setup(options.calibration, options.plus, options.clip, options.fan, options.mask)
        return Reconstructor(mask=setup.mask(frame.image.shape), **(self.growing or {}))
