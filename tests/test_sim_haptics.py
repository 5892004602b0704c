"""A haptic device beside a simulation: forces, energy and stability against closed forms."""

from __future__ import annotations

import threading

import globule as gb
import numpy as np
import pytest
from globule.sim import haptics
from globule.sim.coupling import (
    STIFFEST,
    Coupling,
    LocalModel,
    Near,
    Servo,
    displaced,
    displacement,
    rotation,
    rotation_vector,
)
from globule.sim.hand import Hand
from globule.sim.haptics import HapticLoop

D = 0.004  # m
ACROSS = 5 * D


def column(young=20000.0, model="solid", ratio=0.0, gravity=0.0, fixed=True, max_dt=0.01):
    """5 x 5 x 9 particles; a grasper holds the top layer, 16 mm below its tip."""
    half = ACROSS / 2
    solid = {
        "name": "column", "box": {"lo": [-half, -half, 0], "hi": [half, half, 9 * D]},
        "young": young, "damping": 20.0, "model": model,
    }  # fmt: skip
    if model == "solid":
        solid["poisson"] = ratio
    if fixed:
        solid["fixed"] = [{"box": {"lo": [-1, -1, -1], "hi": [1, 1, D]}}]
    grip = {
        "name": "grip", "kind": "grasper", "radius": 0.0198,
        "keys": [{"time": 0.0, "position": [0, 0, 0.05]}],
    }  # fmt: skip
    return {
        "spacing": D, "domain": {"lo": [-0.06] * 3, "hi": [0.06] * 3},
        "gravity": [0, 0, -gravity], "solver": {"max_dt": max_dt},
        "solids": [solid], "instruments": [grip, {
            "name": "knife", "kind": "scalpel", "length": 0.01,
            "keys": [{"time": 0.0, "position": [0.05, 0, 0]}],
        }],
    }  # fmt: skip


def pull_and_let_go(t):
    """3 mm in 0.2 s, held for 0.4 s, then let go."""
    return (0, 0, 0.003 * min(t / 0.2, 1.0)) if t < 0.6 else None


def felt(sim, hand, coupling, seconds):
    """Every period of a run: energy J, position and force along z, reading along z."""
    loop, rows = HapticLoop(sim, "grip", hand, coupling), []
    tick = loop.tick

    def noted():
        tick()
        reading = sim.tools["grip"].force[2]
        rows.append((loop.servo.energy, hand.position[2], hand.force[2], reading))

    loop.tick = noted
    loop.run(seconds, real_time=False)
    return loop, np.array(rows).T


def neo_hookean(stretch, young):
    """Stress of a bar, Pa, per area at rest, Poisson's ratio 0, sides free: the lateral stress
    of Smith's energy vanishes for J = 2 - 1 / stretch."""
    return young / 2 * (stretch - (2 * stretch - 1) / stretch**3)


CASES = [  # young, coupling's stiffness, longest step, device's friction
    (20000.0, 300.0, 0.01, 2.0),
    (20000.0, 300.0, 0.0025, 0.2),
    (3000.0, 1000.0, 0.016, 2.0),
    (100000.0, 300.0, 0.005, 2.0),
]


@pytest.mark.parametrize(("young", "stiffness", "max_dt", "friction"), CASES)
def test_a_hand_pulls_and_lets_go(young, stiffness, max_dt, friction):
    sim = gb.Simulation(column(young, max_dt=max_dt), device="cpu", threads=1)
    hand = Hand(pull_and_let_go, friction=friction)
    coupling = Coupling(stiffness)
    assert friction > coupling.needed_damping
    loop, (energy, at, force, reading) = felt(sim, hand, coupling, 1.2)
    assert (loop.n_ticks, loop.n_missed) == (1200, 0)
    rest = slice(400, 590)
    # The force is the simulation's, the hand's spring's, and the coupling's.
    np.testing.assert_allclose(force[rest], reading[rest], rtol=0.01)
    np.testing.assert_allclose(force[rest], -500 * (0.003 - at[rest]), rtol=0.01)
    assert np.ptp(force[rest]) < 0.01 * abs(force[590])
    # The hand never gets more than it gave.
    assert energy.max() > 0.9 * 0.5 * force[590] ** 2 / stiffness
    assert energy.min() > -0.01 * energy.max()
    # What it let go comes to rest: the envelope of a mass with this friction, or faster.
    late = np.abs(at[1000:]).max()
    assert late < max(0.1e-3, 1.2 * np.abs(at[600]) * np.exp(-friction * 0.4 / (2 * 0.1)))


@pytest.mark.parametrize("goal", [0.003, -0.003])
def test_the_force_at_rest_is_the_columns(backend, goal):
    """E A strain of the middle, as neo-Hookean, in pull and push."""
    young = 20000.0
    sim = gb.Simulation(column(young), **backend)
    before = sim.positions.astype("f8")[:, 2]
    hand = Hand(lambda t: (0, 0, goal * min(t / 0.2, 1.0)))
    _, (_, _, force, _) = felt(sim, hand, Coupling(), 0.6)
    layer = np.round(before / D - 0.5)
    gauge = (layer >= 3) & (layer <= 5)
    stretch = np.polyfit(before[gauge], sim.positions[gauge, 2].astype("f8"), 1)[0]
    assert 0.02 < abs(stretch - 1) < 0.06
    expected = -neo_hookean(stretch, young) * ACROSS**2
    assert abs(force[-1] / expected - 1) < 0.02


def test_a_held_column_weighs_what_it_weighs():
    """The device carries the weight of what hangs on it, and sinks by weight / stiffness."""
    sim = gb.Simulation(column(gravity=9.81, fixed=False), device="cpu", threads=1)
    weight = len(sim) * sim.phases["column"].density * D**3 * 9.81
    hand = Hand(lambda t: (0, 0, 0))
    _, (_, at, force, _) = felt(sim, hand, Coupling(), 1.6)
    assert abs(force[-500:].mean() / -weight - 1) < 0.001
    assert abs(at[-500:].mean() * 500 / -weight - 1) < 0.001
    assert np.ptp(force[-500:]) < 0.001 * weight


class Turned:
    """A device that turns about z, and keeps what it must give."""

    def __init__(self, angle, seconds=0.2, rate=1000.0):
        self.angle, self.seconds, self.rate, self.n = angle, seconds, rate, 0

    def read(self):
        share = min(self.n / self.rate / self.seconds, 1.0)
        self.n += 1
        pose = np.eye(4)
        pose[:3, :3] = rotation(np.array([0, 0, share * self.angle]))
        return pose

    def write(self, force, torque):
        self.force, self.torque = force, torque


def test_a_twisted_column_gives_the_torque_of_its_reading():
    """G J angle / length of the column and the coupling's spring in series (Saint-Venant's J of a
    square is 0.1406 a⁴); the ends of a short column are stiffer."""
    sim = gb.Simulation(column(), device="cpu", threads=1)
    device, angle = Turned(0.2), 0.2
    coupling = Coupling(arm=0.02)
    loop = HapticLoop(sim, "grip", device, coupling)
    loop.run(0.6, real_time=False)
    torque = sim.tools["grip"].torque
    np.testing.assert_allclose(device.torque[2], torque[2], rtol=0.01)
    twist = rotation_vector(sim.tools["grip"].pose[:3, :3])[2]
    spring = coupling.stiffness * coupling.arm**2
    np.testing.assert_allclose(-device.torque[2], spring * (angle - twist), rtol=0.01)
    assert 1.0 < -torque[2] / twist / (10000 * 0.1406 * ACROSS**4 / (8 * D)) < 1.25
    assert np.abs(device.force).max() < 0.02 * abs(torque[2]) / ACROSS


def test_the_least_damping_of_a_sampled_wall():
    """Colgate & Schenkel's bound is reached by straight lines between -X and X, a period each:
    the wall gives 2 X² (k + 2 b / T) a period, the device's damping takes 4 c X² / T."""
    coupling = Coupling(stiffness=400.0, damping=0.3, rate=1000.0)
    rigid = Near(np.eye(4), np.zeros(3), 1e12 * np.eye(3))
    servo, size, n = Servo(coupling, rigid, 3), 0.002, 50
    for i in range(n + 2):
        if i == 2:
            before = servo.energy
        servo.tick(displaced(np.eye(4), np.array([0, 0, size * (-1) ** i]), 1.0))
    given = (before - servo.energy) / n
    taken = 4 * coupling.needed_damping * size**2 * coupling.rate
    assert abs(given / taken - 1) < 1e-6
    assert coupling.needed_damping == pytest.approx(400 / 2000 + 0.3)


@pytest.mark.parametrize("n", [3, 6])
def test_springs_in_series(n):
    """A tool in a linear matter: force and place are those of two springs in a row."""
    rng = np.random.default_rng(3)
    a = rng.normal(size=(n, n))
    matter = 100 * (a @ a.T) / n + 50 * np.eye(n)
    coupling = Coupling(stiffness=300.0)
    servo = Servo(coupling, Near(np.eye(4), np.zeros(n), matter), n)
    u = 0.001 * rng.normal(size=n)
    force, torque = servo.tick(displaced(np.eye(4), u, coupling.arm))
    expected = -np.linalg.inv(np.linalg.inv(matter) + np.eye(n) / 300) @ u
    np.testing.assert_allclose(force, expected[:3], rtol=1e-6)
    np.testing.assert_allclose(torque, [*expected[3:], 0, 0, 0][:3] * np.array(coupling.arm),
                               rtol=1e-5)  # fmt: skip
    at = displacement(servo.tool, np.eye(4), coupling.arm, n)
    np.testing.assert_allclose(at, -np.linalg.solve(matter, expected), rtol=1e-6)


def test_a_model_learns_the_stiffness_of_a_linear_matter():
    rng = np.random.default_rng(5)
    a = rng.normal(size=(6, 6))
    matter = 100 * (a @ a.T) / 6 + 20 * np.eye(6)
    coupling = Coupling()
    model, offs = LocalModel(coupling, 1e-6), []
    for _ in range(600):
        u = 0.001 * rng.normal(size=6)
        wrench = -matter @ u
        pose = displaced(np.eye(4), u, coupling.arm)
        model.learn(pose, wrench[:3], wrench[3:] * coupling.arm, 0.01)
        offs.append(np.linalg.norm(model.matrix - matter) / np.linalg.norm(matter))
        np.testing.assert_allclose(model.matrix, model.matrix.T, atol=1e-9)
    assert offs[0] > 0.3
    assert offs[-1] < 0.03


def test_a_model_stays_passive_whatever_it_reads():
    rng = np.random.default_rng(6)
    coupling, model = Coupling(), LocalModel(Coupling(), 1e-6)
    for _ in range(50):
        pose = displaced(np.eye(4), 0.001 * rng.normal(size=6), coupling.arm)
        near = model.learn(pose, rng.normal(size=3), 0.01 * rng.normal(size=3), 0.01)
        values = np.linalg.eigvalsh(model.matrix)
        assert values[0] > -1e-9
        assert values[-1] < STIFFEST * coupling.stiffness * (1 + 1e-9)
        assert np.isfinite(near.wrench).all()


def test_a_hand_alone_is_a_damped_mass():
    """Free, then against a constant force, by the closed form of the oscillator."""
    mass, k, c = 0.2, 300.0, 1.5
    hand = Hand(lambda t: (0.01, 0, 0), mass, k, c - 0.5, 0.5)
    hand.write(np.array([0.3, 0, 0]), np.zeros(3))
    for _ in range(137):
        hand.read()
    t, goal = 0.137, 0.01 + 0.3 / k
    decay, omega = c / (2 * mass), np.sqrt(k / mass - (c / (2 * mass)) ** 2)
    swing = np.cos(omega * t) + decay / omega * np.sin(omega * t)
    assert hand.position[0] == pytest.approx(goal * (1 - np.exp(-decay * t) * swing), rel=1e-9)
    assert hand.time == pytest.approx(t)


def test_an_open_grasper_gives_no_force():
    sim = gb.Simulation(column(), device="cpu", threads=1)
    hand = Hand(lambda t: (0, 0, 0.002))
    loop = HapticLoop(sim, "grip", hand)
    loop.run(0.1, real_time=False)
    assert hand.force[2] < -0.01
    sim.tools["grip"].on = False
    loop.run(0.05, real_time=False)
    assert not hand.force.any()
    sim.tools["grip"].on = True  # here, and not where it was closed first
    loop.run(0.01, real_time=False)
    assert np.abs(hand.force).max() < 0.5


def test_same_bits_without_the_clock():
    states = []
    for _ in range(2):
        sim = gb.Simulation(column(), device="cpu", threads=1)
        hand = Hand(pull_and_let_go)
        HapticLoop(sim, "grip", hand).run(0.1, real_time=False)
        states.append((sim.hash(), hand.position.tobytes()))
    assert states[0] == states[1]


def test_a_run_in_real_time_has_a_thread():
    sim = gb.Simulation(column(), device="cpu", threads=1)
    hand = Hand(pull_and_let_go)
    with HapticLoop(sim, "grip", hand) as loop:
        loop.run(0.05)
        assert any(t.name == "haptic loop" for t in threading.enumerate())
    assert not any(t.name == "haptic loop" for t in threading.enumerate())
    assert sim.time == pytest.approx(0.05)
    assert loop.n_ticks > 0
    assert len(loop.lateness) >= loop.n_ticks - 1
    assert not hand.force.any()  # the end lets go


class Clock:
    """Time that only sleeping takes, and what the test adds."""

    now = 0.0

    def perf_counter(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


class Slow(Turned):
    """Each tenth reading takes three and a half periods; the hundredth ends the loop."""

    def read(self):
        if self.n % 10 == 0:
            self.clock.now += 3.5e-3
        if self.n == 100:
            self.loop._stop.set()
        return super().read()


def test_periods_that_are_left_out_are_counted(monkeypatch):
    sim = gb.Simulation(column(), device="cpu", threads=1)
    Slow.clock = Clock()
    device = Slow(0.0)
    device.loop = HapticLoop(sim, "grip", device)  # which reads once
    monkeypatch.setattr(haptics, "time", device.clock)
    device.clock.now = 0.0
    device.loop._loop()
    assert (device.loop.n_ticks, device.loop.n_missed) == (100, 20)
    assert device.clock.now == pytest.approx(120 / 1000, abs=2e-3)
    assert device.loop.lateness.max() == pytest.approx(0.5e-3, abs=1e-6)


class Broken(Turned):
    def read(self):
        if self.n == 20:
            raise OSError("device: no answer")
        return super().read()


def test_an_error_of_the_device_ends_the_run():
    sim = gb.Simulation(column(), device="cpu", threads=1)
    device = Broken(0.0)
    loop = HapticLoop(sim, "grip", device)
    with pytest.raises(OSError, match="device: no answer"):
        loop.run(5.0)
    assert sim.time < 5.0
    assert not device.force.any()
    assert not any(t.name == "haptic loop" for t in threading.enumerate())
    device.n, device.force = 0, np.ones(3)
    with pytest.raises(OSError, match="device: no answer"):
        loop.run(5.0, real_time=False)
    assert not device.force.any()


def test_mistakes_are_named():
    sim = gb.Simulation(column(), device="cpu", threads=1)
    hand = Hand(pull_and_let_go)
    with pytest.raises(ValueError, match=r"tool: expected an instrument \(grip, knife\), got 'x'"):
        HapticLoop(sim, "x", hand)
    with pytest.raises(ValueError, match=r"tool: expected a grasper.* got 'knife', a scalpel"):
        HapticLoop(sim, "knife", hand)
    with pytest.raises(TypeError, match="device: expected a method read"):
        HapticLoop(sim, "grip", object())
    with pytest.raises(ValueError, match="stiffness"):
        Coupling(stiffness=0.0)
    with pytest.raises(ValueError, match="damping"):
        Coupling(damping=-1.0)
    loop = HapticLoop(sim, "grip", hand)
    with pytest.raises(ValueError, match="seconds"):
        loop.run(-1.0)
    hand.read = lambda: np.array([np.nan, 0, 0])
    with pytest.raises(ValueError, match=r"device.read\(\): expected finite"):
        loop.run(0.1, real_time=False)
