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
        clock: wall time, s.
    """

    def __init__(self, begin: float, end: float, clock: Callable[[], float] = time.perf_counter):
        self.end, self.clock, self.n_steps = end, clock, 0
        self._marks = deque([(clock(), begin)], MARKS)
        self._shown = clock()

    def frame(self, reached: float) -> None:
        """A frame of the simulated time `reached`, s, begins."""
        self._marks.append((self.clock(), reached))

    def step(self, reached: float) -> str | None:
        """A step came to the simulated time `reached`, s. What has to be said of a long run, once,
        after three steps."""
        self.n_steps += 1
        if self.n_steps != SURE:
            return None
        start, begin = self._marks[0]
        left = self.seconds(reached)
        if left is None or left < LONG:
            return None
        return (
            f"{in_words(left)} to go at {1e3 * (self.clock() - start) / SURE:.3g} ms a step of "
            f"{(reached - begin) / SURE:.3g} s; Ctrl-C keeps what is done, --resume goes on"
        )

    def seconds(self, reached: float) -> float | None:
        """Wall time that is left, s; None while nothing says it."""
        start, begin = self._marks[0]
        if not reached > begin:
            return None
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
    """A duration with one or two digits: "40 s", "12 min", "3.5 h", "20 days"."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{float(f'{seconds / size:.2g}'):,g} {unit}"
    return f"{seconds:.0f} s"
