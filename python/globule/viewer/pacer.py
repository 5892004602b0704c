"""When a client gets its next image, and with what size and quality.

A client acknowledges each image on arrival, in order. At most two images are in flight, so no image
waits behind others, and each image shows the current camera. Size and quality follow from the times
that tracing and transfer took. When nothing has changed for `STILL_AFTER` seconds, an image of full
size follows. The image then gains samples until something changes.

Times are in seconds. The pacer has no clock, no thread and no lock of its own.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

MOST_IN_FLIGHT = 2
STILL_AFTER = 0.1  # s without a change
SMALLEST = 160  # pixels of the longer side
LEAST_QUALITY, MOST_QUALITY = 35, 80  # JPEG, while something moves
LEAST_SCALE = 1 / 8
LATENCY = 0.08  # s that the bytes in flight may take
WINDOW = 64  # images in the statistics


@dataclass(frozen=True)
class Plan:
    """The next image of a client.

    Attributes:
        size: (width, height), pixels.
        quality: of the JPEG, 1 to 100.
        still: nothing has changed for a moment.
        samples: per pixel, in total.
        refine: add samples to the client's last frame instead of tracing a new one.
    """

    size: tuple[int, int]
    quality: int
    still: bool = False
    samples: int = 1
    refine: bool = False


@dataclass
class _Sent:
    number: int
    seen: float  # time of the change that it shows
    sent: float
    n_bytes: int
    still: bool
    ahead: int  # bytes of earlier images that were in flight then


class Pacer:
    """The pacer of one client.

    The engine calls `plan`; if there is one, it then calls `started`, `traced` and `sent`.
    """

    def __init__(self) -> None:
        self.full = (640, 360)  # of the client's window, pixels
        self.scale, self.quality = 0.5, 70
        self.in_flight: deque[_Sent] = deque()
        self.making = False
        self._changed: float | None = None  # the first change that no image shows
        self._last_change = -1e9
        self._wanted: Any = None
        self._hopeless: Any = None
        self._marks: Any = None  # of the last image
        self._over: Any = None  # those that the next image has
        self._samples = 0  # of the last still image; 0 while something moves
        self._still_size: tuple[int, int] | None = None
        self._ways: deque[tuple[float, float]] = deque(maxlen=32)  # bytes in flight, and s
        self.latency: deque[float] = deque(maxlen=WINDOW)  # s, change to acknowledgement
        self.transfer: deque[float] = deque(maxlen=WINDOW)  # s, sending to acknowledgement
        self.acknowledged: deque[float] = deque(maxlen=WINDOW)  # when
        self.n_bytes = 0

    def plan(self, now: float, what: Any, samples: int, sharpness: int, widest: int, marks: Any = None) -> Plan | None:
        """The image to make now, or None.

        Args:
            now: time.
            what: identifies the content: camera, settings and source.
            marks: identifies what is drawn over the content. Where only that changes, it is drawn
                over the last sharp image at once.
            samples: rays per pixel of a still image, in the end.
            sharpness: JPEG quality of still images.
            widest: most pixels in a row.
        """
        if what != self._wanted:
            self._wanted = what
            self.change(now)
        if self.making or len(self.in_flight) >= MOST_IN_FLIGHT or self._hopeless == what:
            return None
        if min(self.full) < 1:  # the window is not known yet
            return None
        full = limited(self.full, widest)
        sharp = self._samples > 0 and self._changed is None and self._still_size == full
        over, self._over = self._marks, marks
        if sharp and marks != over:
            return Plan(full, sharpness, True, self._samples, refine=True)
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
        """When to call `plan` again if nothing happens before; None: no need."""
        due = self._last_change + STILL_AFTER
        return due if due > now else None

    def change(self, now: float) -> None:
        """Note that the content changes now."""
        self._last_change = now
        if self._changed is None:
            self._changed = now

    def started(self) -> float:
        """Note that the engine starts an image; returns the time of the change that it shows."""
        self.making, self._marks = True, self._over
        seen = self._changed
        self._changed = None
        return self._last_change if seen is None else seen

    def traced(self, plan: Plan, seconds: float, rate: float) -> None:
        """Note that tracing took some seconds; the target is 1 / rate."""
        self._samples = plan.samples if plan.still else 0
        self._still_size = plan.size if plan.still else self._still_size
        if not plan.still:
            pressure = seconds * rate / 0.7  # the rest is for encoding and for other clients
            if pressure > 1.1:
                self.scale *= max(0.75, pressure**-0.4)
            elif pressure < 0.8 and self.quality >= MOST_QUALITY - 10:
                self.scale *= 1.06
            self.scale = min(1.0, max(LEAST_SCALE, self.scale))

    def given_up(self) -> None:
        """Note that the image failed; the same content is not tried again."""
        self.making, self._changed, self._hopeless = False, None, self._wanted

    def gains(self, plan: Plan) -> bool:
        """Whether a plan only adds samples to an image that is already shown: nobody waits for it."""
        return plan.refine and plan.samples > self._samples

    def interrupted(self, seen: float | None) -> None:
        """Note that the image was not finished.

        Args:
            seen: as `started` returned it; None: the image only adds samples to the one before.
        """
        self.making = False
        if seen is not None:
            self._changed = seen if self._changed is None else min(seen, self._changed)

    def sent(self, now: float, number: int, seen: float, n_bytes: int, still: bool) -> None:
        """Note that an image was sent; `seen`: as `started` returned it."""
        self.making = False
        ahead = sum(one.n_bytes for one in self.in_flight)
        self.in_flight.append(_Sent(number, seen, now, n_bytes, still, ahead))
        self.n_bytes += n_bytes

    def acknowledge(self, now: float, number: int) -> None:
        """Note that an image has arrived, and with it all earlier ones."""
        while self.in_flight and self.in_flight[0].number <= number:
            done = self.in_flight.popleft()
            self.transfer.append(now - done.sent)
            self._ways.append((done.n_bytes + done.ahead, now - done.sent))
            self.acknowledged.append(now)
            if not done.still:
                self.latency.append(now - done.seen)
                self._adapt(done)

    def _adapt(self, done: _Sent) -> None:
        """If the bytes cause the delay, lower the quality first, then the size.

        Fewer bytes would not help a browser that is slow itself.
        """
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
        """The slope of the time from sending to acknowledgement over the bytes in flight."""
        n = len(self._ways)
        if n < 4:
            return 0.0
        mean_x, mean_y = (sum(v[k] for v in self._ways) / n for k in (0, 1))
        spread = sum((x - mean_x) ** 2 for x, _ in self._ways)
        if spread <= (0.05 * mean_x) ** 2 * n:  # sizes that hardly differ give an upper bound only
            return min(y / x for x, y in self._ways if x > 0)
        slope = sum((x - mean_x) * (y - mean_y) for x, y in self._ways) / spread
        return max(0.0, slope)

    @property
    def rate(self) -> float:
        """Recent images per second."""
        times = self.acknowledged
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0


def limited(size: tuple[int, int], widest: int) -> tuple[int, int]:
    """A size, scaled down to at most `widest` pixels per row."""
    return _scaled(size, min(1.0, widest / max(1, size[0])))


def _scaled(size: tuple[int, int], scale: float) -> tuple[int, int]:
    longer = max(size)
    scale = max(scale, min(1.0, SMALLEST / longer))
    return max(1, round(size[0] * scale)), max(1, round(size[1] * scale))
