"""When a client gets its next picture, and how large and sharp that is.

A client acknowledges each picture once it has taken it in, in order. At most two are on their way,
so that none waits behind others: what is traced is what the camera sees now, and what it saw before
is never sent. From what tracing and transfer took, size and quality follow. When nothing has
changed for a moment, one picture of full size follows, and ever smoother ones after it.

Times are given in seconds; the pacer has no clock, no thread and no lock of its own.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

MOST_IN_FLIGHT = 2
STILL_AFTER = 0.15  # s without a change
SMALLEST = 160  # pixels of the longer side
LEAST_QUALITY, MOST_QUALITY = 35, 80  # JPEG, while something moves
LEAST_SCALE = 1 / 8
LATENCY = 0.08  # s that the bytes on their way may take
WINDOW = 64  # pictures in the statistics


@dataclass(frozen=True)
class Plan:
    """The next picture: its size, JPEG quality, and samples per pixel in all; `refine` goes on
    from the client's last picture instead of a new one."""

    size: tuple[int, int]
    quality: int
    still: bool = False
    samples: int = 1
    refine: bool = False


@dataclass
class _Sent:
    number: int
    seen: float  # when the change that it shows came
    sent: float
    n_bytes: int
    still: bool
    ahead: int  # bytes of the pictures before it that were still on their way


class Pacer:
    """One client's. The engine asks `plan`, then tells `started`, `traced` and `sent`."""

    def __init__(self) -> None:
        self.full = (640, 360)  # what the client shows, pixels
        self.scale, self.quality = 0.5, 70
        self.in_flight: deque[_Sent] = deque()
        self.making = False
        self._changed: float | None = None  # the first change that no picture shows
        self._last_change = -1e9
        self._wanted: Any = None
        self._hopeless: Any = None
        self._samples = 0  # of the last picture, 0 while it is a moving one
        self._still_size: tuple[int, int] | None = None
        self._ways: deque[tuple[float, float]] = deque(maxlen=32)  # bytes on the way, and s
        self.latency: deque[float] = deque(maxlen=WINDOW)  # s, change to acknowledgement
        self.transfer: deque[float] = deque(maxlen=WINDOW)  # s, sending to acknowledgement
        self.acknowledged: deque[float] = deque(maxlen=WINDOW)  # when
        self.n_bytes = 0

    def plan(self, now: float, what: Any, samples: int, sharpness: int, widest: int) -> Plan | None:
        """What to make now, if anything.

        Args:
            what: identifies what would be seen: camera, settings and source.
            samples, sharpness: rays per pixel in the end, and JPEG quality, of still pictures.
            widest: pixels.
        """
        if what != self._wanted:
            self._wanted = what
            self.change(now)
        if self.making or len(self.in_flight) >= MOST_IN_FLIGHT or self._hopeless == what:
            return None
        if min(self.full) < 1:  # not known yet
            return None
        full = limited(self.full, widest)
        if now - self._last_change < STILL_AFTER:
            if self._changed is None:
                return None
            return Plan(_scaled(full, self.scale), round(self.quality))
        if self._changed is not None or not self._samples or self._still_size != full:
            return Plan(full, sharpness, True)
        if self._samples < samples:
            return Plan(full, sharpness, True, min(2 * self._samples, samples), refine=True)
        return None

    def wake_at(self, now: float) -> float | None:
        """When `plan` may say more without anything happening before; None: never."""
        due = self._last_change + STILL_AFTER
        return due if due > now else None

    def change(self, now: float) -> None:
        """What the client would see is another from now on."""
        self._last_change = now
        if self._changed is None:
            self._changed = now

    def started(self) -> float:
        """The engine begins with a picture; when the change that it shows came."""
        self.making = True
        seen = self._changed
        self._changed = None
        return self._last_change if seen is None else seen

    def traced(self, plan: Plan, seconds: float, rate: float) -> None:
        """A picture was traced in so many seconds, of 1 / rate that it may take."""
        self._samples = plan.samples if plan.still else 0
        self._still_size = plan.size if plan.still else self._still_size
        if not plan.still:
            pressure = seconds * rate / 0.7  # the rest is for encoding, and for others
            if pressure > 1.1:
                self.scale *= max(0.75, pressure**-0.4)
            elif pressure < 0.8 and self.quality >= MOST_QUALITY - 10:
                self.scale *= 1.06
            self.scale = min(1.0, max(LEAST_SCALE, self.scale))

    def given_up(self) -> None:
        """Nothing came of the picture that was started; of the same again nothing would."""
        self.making, self._changed, self._hopeless = False, None, self._wanted

    def sent(self, now: float, number: int, seen: float, n_bytes: int, still: bool) -> None:
        self.making = False
        ahead = sum(one.n_bytes for one in self.in_flight)
        self.in_flight.append(_Sent(number, seen, now, n_bytes, still, ahead))
        self.n_bytes += n_bytes

    def acknowledge(self, now: float, number: int) -> None:
        """The client has taken in this picture, and so all before it."""
        while self.in_flight and self.in_flight[0].number <= number:
            done = self.in_flight.popleft()
            self.transfer.append(now - done.sent)
            self._ways.append((done.n_bytes + done.ahead, now - done.sent))
            self.acknowledged.append(now)
            if not done.still:
                self.latency.append(now - done.seen)
                self._adapt(done)

    def _adapt(self, done: _Sent) -> None:
        """Where bytes make the way long, first quality falls, then size. A browser that takes its
        time for whatever comes is not helped by less."""
        of_bytes = self.seconds_per_byte * (done.n_bytes + done.ahead)
        pressure = of_bytes / LATENCY
        if pressure > 1.1:
            if self.quality > LEAST_QUALITY:
                self.quality = max(LEAST_QUALITY, self.quality - 8)
            else:
                self.scale = max(LEAST_SCALE, self.scale * max(0.75, pressure**-0.4))
        elif pressure < 0.7:
            self.quality = min(MOST_QUALITY, self.quality + 1)

    @property
    def seconds_per_byte(self) -> float:
        """The slope of the time from sending to acknowledgement over the bytes on the way."""
        n = len(self._ways)
        if n < 4:
            return 0.0
        mean_x, mean_y = (sum(v[k] for v in self._ways) / n for k in (0, 1))
        spread = sum((x - mean_x) ** 2 for x, _ in self._ways)
        if spread <= (0.05 * mean_x) ** 2 * n:  # all of one size tell nothing but the most
            return min(y / x for x, y in self._ways if x > 0)
        slope = sum((x - mean_x) * (y - mean_y) for x, y in self._ways) / spread
        return max(0.0, slope)

    @property
    def rate(self) -> float:
        """Pictures per second lately."""
        times = self.acknowledged
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0


def limited(size: tuple[int, int], widest: int) -> tuple[int, int]:
    """The size, or as much of it as is `widest` pixels wide."""
    return _scaled(size, min(1.0, widest / max(1, size[0])))


def _scaled(size: tuple[int, int], scale: float) -> tuple[int, int]:
    longer = max(size)
    scale = max(scale, min(1.0, SMALLEST / longer))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
