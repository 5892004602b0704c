"""`reconstruct --live`: frames of a server, binned at arrival, recorded and shown."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from ..ultrasound.live import NO_IMAGE, parse_address, receive_sweeps
from ..ultrasound.live_counts import LiveCounts
from ..ultrasound.matching import LiveFrame
from ..ultrasound.pose_check import check_poses
from ..ultrasound.sweep import Sweep
from ..volumes.files import write_volume
from ..volumes.volume import Volume
from . import flags
from .pictures import draw, wanted
from .shared import Progress, UserError, check_folder, count, mistakes, positive, say, warn

AUTOSAVE = 10.0  # s: a crash loses no more of the volume
_SAME_PRESS = 1.0  # s: Ctrl-C pressed again so soon means the same
HELD = 1 << 27  # bytes of images that a growing volume keeps: older ones are in the volume alone
_FEWEST = 64  # images that are kept in any case: the longest burst of wrong poses has 32
_LATENCIES = 4096  # frames whose times are kept


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of live reconstruction."""
    group = parser.add_argument_group(
        "live", f"With --voxel-size, the volume grows with the frames and is written every {AUTOSAVE:g} s, and "
        "--three-view and --surface-image are written again while frames arrive.")  # fmt: skip
    flags.own(group, "--live igtl://HOST:PORT", "read frames from an OpenIGTLink server instead of "
        "SWEEP, until the server stops or Ctrl-C")  # fmt: skip
    flags.own(group, "--tracker igtl://HOST:PORT", "read transforms from this second OpenIGTLink "
        "server; both servers may start in any order",
        usual="from the server of --live")  # fmt: skip
    flags.own(group, "--serve [HOST:]PORT", "send the growing volume, its trust map, a slice along "
        "the probe and the surface to OpenIGTLink clients that connect to this port, such as 3D "
        "Slicer; needs --voxel-size; example: --serve 18945", usual="send nothing")  # fmt: skip
    flags.own(group, "--record FOLDER", "also store each frame in this folder, which is a SWEEP; "
        "after a crash, the same command continues the folder; a finished recording is refused")  # fmt: skip
    flags.own(group, "--idle S", "silence of the server that ends --live, seconds", positive, 5.0)
    flags.own(group, "--wait S", "time within which the server must start, seconds", positive,
        usual="as --idle")  # fmt: skip
    flags.own(group, "--space NAME", "axes of the world that the messages' matrices map to: LPS, "
        "RAS", ("LPS", "RAS"),
        usual="as the header of an image states, LPS for transforms")  # fmt: skip
    flags.own(group, "--refresh S", "time between two versions of --three-view, of --surface-image, and "
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


def numbered(path: str, i: int) -> str:
    """name-2.nii.gz of name.nii.gz."""
    stem, ending = os.path.splitext(path)
    inner, before = os.path.splitext(stem) if ending.lower() == ".gz" else (stem, "")
    return f"{inner}-{i}{before}{ending}"


@contextlib.contextmanager
def pressed_once() -> Iterator[None]:
    """Ctrl-C that is pressed twice at once ends the stream, and not also the writing of the volume."""
    usual: Any = signal.getsignal(signal.SIGINT)
    last = -np.inf

    def handle(number: int, frame: Any) -> None:
        nonlocal last
        again, last = time.monotonic() - last < _SAME_PRESS, time.monotonic()
        if not again:
            usual(number, frame)

    if not callable(usual) or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)


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
        self.recorders: list[Any] = []
        self.n_kept = 0
        self._record_error = ""
        self._first: tuple[Any, ...] | None = None  # size and type of the images that grow
        self._n_first = 0
        self.server: Any = None
        self.output: Any = None
        self.counts = LiveCounts()
        self.seconds: deque[float] = deque(maxlen=_LATENCIES)
        self.longest = 0.0
        self.frames: list[LiveFrame] = []  # of the images that grow, in the order of arrival
        self.n_gone = 0  # of these, the first, whose images are not kept
        self.removed: set[int] = set()  # of these, numbers of frames that are no longer in the volume
        self.refused: set[int] = set()  # and of those that never were
        self._told: set[str] = set()
        self.n_frames = self.n_drawn = 0
        self._drawn = -np.inf
        self._drawing: Future | None = None
        self._saved = time.monotonic()
        self._saving: Future | None = None

    def sweeps(self) -> list[Sweep]:
        """All frames until the server stops, after the frames that an earlier run recorded: a sweep
        for each size of images, the longest first."""
        options = self.options
        with ThreadPoolExecutor(1) as self._draughtsman:
            try:
                with mistakes():
                    if options.serve:
                        self._open_server()
                    self._open_recorders()
                    self.n_kept = sum(len(recorder.kept) for recorder in self.recorders)
                    if self.n_kept:
                        self.progress.clear()
                        say(f"{options.record}: goes on after the {count(self.n_kept, 'image')} of an interrupted run")
                    earlier = itertools.chain.from_iterable(recorder.kept for recorder in self.recorders)
                    sweeps = receive_sweeps(
                        options.live, options.calibration, options.plus, options.idle, self._take,
                        earlier, options.space, options.temporal_offset, options.wait, self.counts,
                        options.tracker, self._thin, clip=options.clip, fan=options.fan, mask=options.mask,
                    )  # fmt: skip
                    return sorted(sweeps, key=len, reverse=True)
            except ConnectionError as error:
                raise UserError(f"--{error}") from error
            except OSError as error:
                name = error.filename or options.record or options.three_view or options.surface_image
                read = name in (options.calibration, options.plus, options.mask)
                message = f"{name}: cannot be {'read' if read else 'written'}: {error.strerror or error}"
                raise UserError(message) from error
            finally:
                if self.output:
                    self.output.close()
                if self.server:
                    self.server.close()
                for recorder in self.recorders:
                    recorder.close()

    def grew(self, sweep: Sweep) -> bool:
        """Whether the volume of these frames has grown: not if the run only collects frames, or if
        images of another size have grown."""
        return self.reconstructor is not None and self._first == (sweep.frames.shape[1:], sweep.frames.dtype)

    def volume(self, sweep: Sweep, outliers: Sequence[int], messages: list[str]) -> Volume | None:
        """The volume without outliers, from what is kept; None if all images are, and the volume can
        better be made anew: without outliers, or with a frame that an interruption left unfinished."""
        if not self.grew(sweep):
            return None
        if not self.n_gone:
            return None if outliers or self.reconstructor.n_frames != len(sweep) else self.reconstructor.volume()
        late = [i for i in outliers if i not in self.removed | self.refused]
        for i in late:
            if self.frames[i].image is not NO_IMAGE:
                self._remove(i)
        left = [i for i in late if i not in self.removed]
        if left:
            messages.append(
                f"{count(len(left), 'frame')} of these are in the volume, as their images are no longer kept: "
                "--record them, and reconstruct the folder"
            )
        n_refused = len(self.refused - set(outliers))
        if n_refused:
            messages.append(f"{count(n_refused, 'frame')} did not fit into the volume")
        sweep.valid[list(self.removed | self.refused)] = False
        return self.reconstructor.volume()

    def _thin(self, frames: list[LiveFrame]) -> None:
        """Let images go that are in the volume, the older half of what is kept; first, frames whose
        pose is wrong are taken out of the volume."""
        if self.reconstructor is None or (frames[-1].image.shape, frames[-1].image.dtype) != self._first:
            return
        options, self.frames = self.options, frames
        n_held = len(frames) - self.n_gone
        if n_held * frames[-1].image.nbytes <= HELD or n_held < _FEWEST:
            return
        if options.cross_validate or options.maps or options.compounding != "mean":
            return  # these need all images
        held = frames[self.n_gone :]
        if not options.keep_outliers:
            sweep = Sweep([f.image for f in held], [f.world_from_image for f in held], [f.time for f in held])
            for i in np.flatnonzero(check_poses(sweep).outliers[: n_held // 2]).tolist():
                if self.n_gone + i not in self.refused:
                    self._remove(self.n_gone + i)
        for i in range(self.n_gone, self.n_gone + n_held // 2):
            frames[i] = frames[i]._replace(image=NO_IMAGE)
        self.n_gone += n_held // 2

    def _remove(self, i: int) -> None:
        self.removed.add(i)
        out = self.removed | self.refused
        rest = [frame.world_from_image for k, frame in enumerate(self.frames) if k not in out]
        self.reconstructor.remove(self.frames[i].image, self.frames[i].world_from_image, rest)

    def _once(self, what: str, error: BaseException) -> None:
        """Warn of what fails while frames come, once."""
        if what not in self._told:
            self._told.add(what)
            warn(f"{what}: {error}")

    def warnings(self) -> list[str]:
        """What became of images that are in no frame."""
        c, lines = self.counts, []
        if c.without_pose:
            lines.append(f"{count(c.without_pose, 'image')} left out: no pose came for their time")
        if c.useless:
            lines.append(
                f"{count(c.useless, 'image')} left out: the pose is no regular matrix, or not OK by its status"
            )
        if c.broken:
            what = "; ".join(f"{words} ({n:,})" for words, n in c.broken.most_common(5))
            lines.append(f"{count(c.broken.total(), 'message')} skipped: {what}")
        if c.other_devices:
            others = ", ".join(f"{device or 'one without a name'} ({n:,})" for device, n in c.other_devices.items())
            taken = ", ".join(dict.fromkeys(device or "the one without a name" for device in c.devices.values()))
            n = len({*c.devices.values(), *c.other_devices})
            lines.append(
                f"images of {count(n, 'device')} came: those of {taken} count, which came first; left out are those of "
                f"{others}: let the server send one device"
            )
        if c.ended:
            lines.append(f"the stream ended early: {c.ended}")
        lines += c.clock_lines()
        if self._record_error:
            lines.append(f"images that --record cannot store: {self._record_error}")
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
                 "let_go": self.n_gone,
                 "recorded": sum(recorder.n_frames for recorder in self.recorders),
                 "counts": self.counts.as_dict(), "broken": dict(self.counts.broken), "unused": dict(self.counts.kinds),
                 "other_devices": dict(self.counts.other_devices),
                 "clock_difference": self.counts.clock_difference}  # fmt: skip
        if self.server:
            facts |= {"sent": dict(self.server.sent), "skipped": dict(self.server.skipped),
                      "clients": self.server.connections}  # fmt: skip
        if not self.seconds:
            return facts
        return facts | {"median_seconds": float(np.median(self.seconds)), "longest_seconds": self.longest}

    def _take(self, n: int, frame: LiveFrame) -> None:
        self.n_frames = n
        size = (frame.image.shape, frame.image.dtype)
        self._first = self._first or size
        if self.recorders and n > self.n_kept:
            self._record(frame)
        if self.growing is not None and size == self._first:
            self._grow(self._n_first, frame)
            self._n_first += 1
        if self.progress.shown and n % 10 == 0:
            self.progress.done -= 1
            self.progress.step(f"{n:,} frames from {self.options.live}{self._lost()}, Ctrl-C ends")

    def _open_recorders(self) -> None:
        """Open the folders of --record: FOLDER, and FOLDER-2 … of images of other sizes."""
        from ..ultrasound.recorder import Recorder, is_unfinished

        folder = self.options.record
        while folder and (not self.recorders or (self.recorders[0].kept and is_unfinished(folder))):
            self.recorders.append(Recorder(folder))
            folder = numbered(self.options.record, len(self.recorders) + 1)

    def _record(self, frame: LiveFrame) -> None:
        from ..ultrasound.recorder import Recorder

        recorder = next((r for r in self.recorders if r.takes(frame)), None)
        if recorder is None:
            names = (numbered(self.options.record, i) for i in itertools.count(len(self.recorders) + 1))
            recorder = Recorder(next(name for name in names if not os.path.exists(name)))
            self.recorders.append(recorder)
        try:
            recorder.add(frame)
        except (ValueError, OSError) as error:  # a type that it cannot store, a full disk
            n_stored = sum(r.n_frames for r in self.recorders)
            if isinstance(error, ValueError):
                advice = ValueError(f"{error}: let the server send 8-bit images to record them; the volume goes on")
                self._once("images are not stored", advice)
            elif not n_stored:
                raise
            self._record_error = self._record_error or f"{error} (after {n_stored:,} frames)"

    def _lost(self) -> str:
        c = self.counts
        lost = c.without_pose + c.useless + c.missed + c.broken_images
        return f" ({lost:,} lost)" if lost else ""

    def _grow(self, n: int, frame: LiveFrame) -> None:
        begun = time.perf_counter()
        try:
            if self.reconstructor is None:
                self.reconstructor = self._reconstructor(frame)
            self.reconstructor.add(frame.image, frame.world_from_image)
        except (TypeError, ValueError, MemoryError) as error:
            if self.reconstructor is not None and self.reconstructor.n_frames:  # a pose far away
                self.refused.add(n)
                self._once("a frame does not fit into the volume so far", error)
                return
            # The frames stay; the error shows again after the last frame.
            warn(f"the volume cannot grow; the command only collects frames: {error}")
            self.growing = self.reconstructor = None
            return
        self.seconds.append(time.perf_counter() - begun)
        self.longest = max(self.longest, self.seconds[-1])
        if self.server:
            self._serve(frame)
        if wanted(self.options):
            self._draw()
        if self.options.output:
            self._save()

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
        self._drawn = now
        try:
            if self._drawing is not None and (error := self._drawing.exception()) is not None:
                raise error
            self._drawing = self._draughtsman.submit(draw, self.reconstructor.volume(), self.options, [])
        except (ValueError, MemoryError, OSError, UserError) as error:
            warn(f"the images are written after the last frame only: {error}")
            self._drawn = np.inf
            return
        self.n_drawn += 1

    def _save(self) -> None:
        """Write the volume so far; the same thread does, so that frames go on."""
        now = time.monotonic()
        if now - self._saved < AUTOSAVE or (self._saving is not None and not self._saving.done()):
            return
        self._saved, options = now, self.options
        try:
            if self._saving is not None and (error := self._saving.exception()) is not None:
                raise error
            volume = self.reconstructor.volume()
            self._saving = self._draughtsman.submit(write_volume, options.output, volume, options.maps)
        except (ValueError, MemoryError, OSError) as error:  # the next time may be better
            self._saving = None
            self._once("the volume so far could not be written", error)

    def _reconstructor(self, frame: LiveFrame) -> Any:
        from ..ultrasound.reconstructor import Reconstructor
        from ..ultrasound.setup import Setup

        options = self.options
        setup = Setup(options.calibration, options.plus, options.clip, options.fan, options.mask)
        return Reconstructor(mask=setup.mask(frame.image.shape), **(self.growing or {}))
