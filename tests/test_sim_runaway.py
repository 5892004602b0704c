"""A run stops where speeds, energies or steps are such as nothing in its scene can give."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused
from globule.sim.solver import Solver

POOL = """
spacing = 0.05
seconds = 0.2
[domain]
lo = [0, 0, 0]
hi = [0.8, 0.4, 0.6]
walls = true
[output]
fps = 10
[[fluids]]
name = "water"
box = { lo = [0, 0, 0], hi = [0.4, 0.4, 0.4] }
"""


def kick(solver: Solver, faster) -> None:
    """Speeds out of nowhere: nobody is told of them, as of a solver's that runs away."""
    velocity, fluid = solver.read("velocity"), solver.read("phase") == 0
    velocity[fluid, :3] = faster(velocity[fluid, :3], solver.read("place")[fluid, :3])
    solver.write("velocity", velocity)
    solver.pushed = False


@pytest.fixture
def pool(tmp_path):
    (tmp_path / "pool.toml").write_text(POOL)
    return tmp_path / "pool.toml"


@pytest.fixture
def sim(pool):
    made = gb.Simulation(pool, device="cpu", threads=1)
    made.step()
    return made


def test_one_that_is_faster_than_anything_and_steps_that_nothing_needs_are_refused(sim):
    kick(sim._solver, lambda v, place: np.where(place[:, :1] == place[:, 0].min(), np.float32([80, 0, 0]), v))
    expected = r"^particle \d+ \(water\) at \(0.*\) moves at [\d.]+ m/s at .* gravity 4.6 m/s can give, 6.09 m/s"
    with pytest.raises(ArithmeticError, match=expected):
        sim.step(0.001)
    with pytest.raises(ArithmeticError, match=r"the steps come to 1e-07 s \(at least 3\.\d+e-06 s\)"):
        sim._runaway._check_step(1e-7)


def test_energy_from_nowhere_is_refused(sim):
    """All of the fluid at less than ten times the speed of a fall."""
    kick(sim._solver, lambda velocity, place: velocity + np.float32([0, 0, 8]))
    with pytest.raises(ArithmeticError, match=r"kinetic energy is \d.* J: energy came from nowhere"):
        sim.step(0.001)


def test_speeds_given_by_hand_are_no_runaway(sim):
    sim.velocities = np.float32(np.asarray(sim.arrays.phase) == 0)[:, None] * np.float32([30, 0, 0])
    sim.step()
    sim.steer.apply_force([0, 0, 125.0], sim.ids[:1])
    sim.step(0.01)


def test_the_command_keeps_the_frames_before(pool, tmp_path, monkeypatch, capsys):
    step = gb.Simulation._prepare

    def prepare(sim, dt):
        step(sim, dt)
        if sim.time > 0.15:
            kick(sim._solver, lambda velocity, place: velocity + np.float32([0, 0, 20]))

    monkeypatch.setattr(gb.Simulation, "_prepare", prepare)
    error = refused(capsys, "simulate", str(pool), "-o", str(tmp_path / "out"), "--device", "cpu")
    assert "energy came from nowhere" in error
    assert sorted(path.name for path in (tmp_path / "out").glob("frame_*")) == ["frame_00000.vtp", "frame_00001.vtp"]
