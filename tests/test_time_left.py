"""What a long simulation says of its end, by a clock that the test sets."""

import re

import pytest
from globule.cli import main, time_left
from globule.cli.time_left import TimeLeft


class Clock:
    """Every look at it is `tick` seconds after the one before, beside what is added."""

    def __init__(self, tick=0.0):
        self.now, self.tick = 100.0, tick

    def __call__(self):
        self.now += self.tick
        return self.now


def steps(left, clock, n, cost, dt):
    said = []
    for k in range(1, n + 1):
        clock.now += cost
        said.append(left.step(k * dt))
    return said


def test_it_is_said_once_by_the_pace_of_the_last_frames():
    clock = Clock()
    said = steps(TimeLeft(0.0, 2.0, 3, clock), clock, 9, 0.25, 1e-4)
    assert [k for k, line in enumerate(said, 1) if line] == [3]
    # 19,997 steps of 0.25 s
    assert said[2].startswith("83 min to go at 250 ms a step of 0.0001 s; Ctrl-C keeps")
    clock = Clock()
    assert not any(steps(TimeLeft(0.0, 0.2, 3, clock), clock, 9, 0.02, 1e-4))
    clock = Clock()
    left = TimeLeft(0.0, 2.4, 121, clock)
    left.frame(0.0)
    clock.now += 20.0
    left.frame(0.0)
    (said,) = filter(None, steps(left, clock, 5, 0.1, 1e-3))
    assert said.startswith("44 min to go at 100 ms a step of 0.001 s and 20 s a frame; ")
    clock = Clock()
    left = TimeLeft(0.0, 100.0, 101, clock)
    assert left.seconds(0.0) is None  # before the first step
    assert left.words(0.0) == ""
    for frame in range(80):
        left.frame(frame)
        clock.now += frame
    assert left.seconds(80.0) == pytest.approx(20 * sum(range(60, 80)) / 20)
    assert left.words(100.0) == ", 0 s left"


@pytest.mark.parametrize("slow", [False, True])
def test_the_command_says_it(slow, tmp_path, monkeypatch, capsys):
    clock = Clock(tick=5.0 if slow else 0.0)
    monkeypatch.setattr(time_left.TimeLeft.__init__, "__defaults__", (clock,))
    out = str(tmp_path / "dam")
    assert main(["simulate", "dam-break", "-o", out, "--spacing", "0.08", "--seconds", "0.1"]) == 0
    assert len(re.findall(r"note: (.*) to go at .* ms a step of .*; ", capsys.readouterr().err)) == slow
