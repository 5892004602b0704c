"""How long a simulation still takes, by what its steps have taken."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

SURE = 3  # steps whose cost says that of the others
LONG = 60.0  # s of a run that is told before its end
MARKS = 20  # frames whose pace counts: a run that fills or empties is as fast as it was lately


class TimeLeft:
    """Wall time until a simulated time is reached.

    Args:
        begin, end: simulated time now and at the end, s.
        n_frames: that are written from now on, with the one of now.
        clock: wall time, s.
    """

    def __init__(self, begin: float, end: float, n_frames: int, clock: Callable[[], float] = time.perf_counter):
        self.begin, self.end, self.n_frames, self.clock = begin, end, n_frames, clock
        self.n_steps, self.n_written = 0, -1
        self._steps = self._frames = 0.0  # s of all of them
        self._marks: deque[tuple[float, float]] = deque(maxlen=MARKS)
        self._last = self._shown = clock()

    def _passed(self) -> float:
        before, self._last = self._last, self.clock()
        return self._last - before

    def frame(self, reached: float) -> None:
        """The steps to a frame begin at the simulated time `reached`, s: the frame before is
        written."""
        self._frames += self._passed()
        self.n_written += 1
        self._marks.append((self._last, reached))

    def step(self, reached: float) -> str | None:
        """A step came to the simulated time `reached`, s. What has to be said of a long run, once,
        after three steps."""
        self._steps += self._passed()
        self.n_steps += 1
        if self.n_steps != SURE:
            return None
        step, dt = self._steps / SURE, (reached - self.begin) / SURE
        frame = self._frames / max(1, self.n_written)
        left = (self.end - reached) / dt * step + (self.n_frames - self.n_written) * frame
        if left < LONG:
            return None
        beside = f" and {frame:.2g} s a frame" if frame > 0.1 else ""
        return (
            f"{in_words(left)} to go at {1e3 * step:.3g} ms a step of {dt:.3g} s{beside}; "
            "Ctrl-C keeps what is done, --resume goes on"
        )

    def seconds(self, reached: float) -> float | None:
        """Wall time that is left, s, at the pace of the last frames; None while nothing says it."""
        if not self._marks or not reached > self._marks[0][1]:
            return None
        start, begin = self._marks[0]
        return (self.clock() - start) / (reached - begin) * max(0.0, self.end - reached)

    def is_due(self) -> bool:
        """Whether a reader could want a new line: some times a second."""
        now = self.clock()
        due = now - self._shown > 0.3
        if due:
            self._shown = now
        return due

    def words(self, reached: float) -> str:
        """The time that is left behind a comma, or nothing while that is not known."""
        left = self.seconds(reached)
        return "" if left is None else f", {in_words(left)} left"


def in_words(seconds: float) -> str:
    """A duration, shortly: "40 s", "12 min", "3.5 h", "20 days"."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{float(f'{seconds / size:.2g}'):,g} {unit}"
    return f"{seconds:.0f} s"
