"""The pacer with a simulated clock; settings as files."""

import dataclasses
import re

import globule as gb
import numpy as np
import pytest
from globule.viewer.pacer import MOST_IN_FLIGHT, MOST_QUALITY, STILL_AFTER, Pacer
from globule.viewer.state import State


class Link:
    def __init__(self, trace: float, bandwidth: float, delay: float = 0.02, browser: float = 0.0):
        self.pacer = Pacer()
        self.pacer.full = (1280, 720)
        self.trace, self.bandwidth, self.delay, self.browser = trace, bandwidth, delay, browser
        self.now, self.number, self.free = 0.0, 0, 0.0
        self.acknowledgements: list[tuple[float, int]] = []
        self.plans: list = []

    def run(self, seconds: float, what, step: float = 0.002) -> list[float]:
        end, latencies = self.now + seconds, []
        while self.now < end:
            while self.acknowledgements and self.acknowledgements[0][0] <= self.now:
                at, number = self.acknowledgements.pop(0)
                self.pacer.latency.clear()
                self.pacer.acknowledge(at, number)
                latencies += list(self.pacer.latency)
            plan = self.pacer.plan(self.now, what(self.now), 8, 92, 1920)
            if plan is None:
                self.now += step
                continue
            seen, share = self.pacer.started(), plan.size[0] * plan.size[1] / (1280 * 720)
            took = self.trace * share
            self.now += took
            self.pacer.traced(plan, took, 20.0)
            n_bytes = int(200_000 * share * (plan.quality / 92) ** 2) + 500
            self.number += 1
            self.plans.append((self.now, plan))
            self.pacer.sent(self.now, self.number, seen, n_bytes, plan.still)
            self.free = max(self.free, self.now) + n_bytes / self.bandwidth
            self.acknowledgements.append((self.free + 2 * self.delay + self.browser, self.number))
            assert len(self.pacer.in_flight) <= MOST_IN_FLIGHT
        return latencies


def test_a_slow_link_keeps_its_latency():
    late = np.array(Link(trace=0.1, bandwidth=1e6).run(60, lambda now: int(now / 0.02)))
    assert np.median(late) < 0.2
    assert np.median(late[-100:]) < 1.2 * np.median(late[100:300])
    assert len(late) > 60 * 8


@pytest.mark.parametrize(("times", "scales", "quality"), [
    ({"trace": 0.02, "bandwidth": 1e9, "delay": 0.001}, (1.0, 1.0), MOST_QUALITY),
    ({"trace": 2.0, "bandwidth": 1e9, "delay": 0.001}, (0.0, 0.3), 61),
    ({"trace": 0.02, "bandwidth": 1e8, "browser": 0.3}, (0.9, 1.0), 0),
], ids=["fast", "slow tracing", "slow browser"])  # fmt: skip
def test_only_slow_tracing_makes_pictures_smaller(times, scales, quality):
    link = Link(**times)
    link.run(30, lambda now: int(now / 0.02))
    assert scales[0] <= link.pacer.scale <= scales[1]
    assert link.pacer.quality >= quality


def test_stillness_brings_sharp_pictures_but_not_to_who_does_not_answer():
    pacer = Pacer()
    for number in range(1, 10):
        if pacer.plan(float(number), number, 8, 92, 1920) is None:
            break
        pacer.started()
        pacer.sent(float(number), number, 0.0, 1000, False)
    assert number == MOST_IN_FLIGHT + 1
    pacer.acknowledge(20.0, 2)
    assert pacer.plan(21.0, "more", 8, 92, 1920) is not None
    # What failed is not tried again until something changes.
    pacer = Pacer()
    assert pacer.plan(0.0, "bad", 8, 92, 1920) is not None
    pacer.started()
    pacer.given_up()
    assert pacer.plan(5.0, "bad", 8, 92, 1920) is None
    assert pacer.plan(6.0, "good", 8, 92, 1920) is not None
    link = Link(trace=0.05, bandwidth=1e8)
    link.run(2, lambda now: int(now / 0.02))
    link.plans.clear()
    link.run(3, lambda now: "still")
    plans = [plan for _, plan in link.plans]
    assert ([p.still for p in plans[:2]], plans[1].size) == ([False, True], (1280, 720))
    assert [(p.samples, p.refine) for p in plans[1:]] == [(1, False), (2, True), (4, True), (8, True)]
    assert STILL_AFTER - 0.02 < link.plans[1][0] - link.plans[0][0] < STILL_AFTER + 0.2


def test_settings_become_a_file_and_come_back():
    state = State()
    state.set(surface__threshold=0.75, look__preset="water", cuts__normal=(0.0, 1.0, 0.0), time__frame=3)
    state.set(color__by='a "name" \\ with\nall')
    state.bookmarks["left.side"] = gb.Camera((1, 2, 3), (0, 0, 0))
    camera = gb.Camera((3, 2, 1), (0, 0, 0.5), (0, 0, 1), 35.0)
    text, other = state.to_toml(camera), State()
    other.set(surface__kernel="blinn")
    assert (other.load_toml(text), other.bookmarks) == (camera, state.bookmarks)
    for name in ("surface", "look", "color", "cuts", "time", "quality", "slices"):
        assert dataclasses.asdict(getattr(other, name)) == dataclasses.asdict(getattr(state, name))


@pytest.mark.parametrize(("text", "message"), [
    ("[surface]\nkernel = 'cubic'", "surface.kernel: expected one of murakami"),
    ("[surface]\ncolor = 1", "surface.color: expected one of kernel, threshold"),
    ("[look]\nshadows = 1", "look.shadows: expected true or false, got 1"),
    ("[cuts]\nnormal = [1, 2]", "normal: expected three numbers"),
    ("[quality]\nsamples = 2.5", "samples: expected a whole number from 1 to"),
    ("lights = 3", "lights: expected one of surface"),
    ("[camera]\neye = [0, 0, 1]", "camera: expected eye, look_at"),
    ("surface = 1", "surface: expected a table, got 1"),
    ("[surface\n", "line 1"),
    ("# " + 300_000 * "x", "at most"),
], ids=lambda text: text[:40])  # fmt: skip
def test_mistakes_in_a_file_name_the_key_and_change_nothing(text, message):
    state = State()
    state.set(surface__threshold=0.9)
    version = state.version
    with pytest.raises(ValueError, match=re.escape(message)):
        state.load_toml(text)
    assert (state.version, state.surface.threshold) == (version, 0.9)
