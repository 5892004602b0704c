"""What rests is at rest: bodies on walls and on each other."""

import globule as gb
import numpy as np
import pytest

D = 0.004


def rms(sim, steps=20):
    """Root mean square and largest of the speeds over some steps, m/s."""
    speeds = []
    for _ in range(steps):
        sim.step()
        speeds.append(np.linalg.norm(sim.velocities, axis=1))
    return float(np.sqrt(np.mean(np.square(speeds)))), float(np.max(speeds))


@pytest.mark.few_backends
def test_a_block_without_friction_rests_on_the_walls_of_the_domain(backend):
    """A wall is flat: its particles do not throw what slides on it to and fro."""
    sim = gb.Simulation({
        "spacing": D, "domain": {"lo": (-0.08, -0.08, 0), "hi": (0.12, 0.12, 0.2), "walls": True, "open": ["+z"]},
        "solver": {"max_dt": 0.005},
        "solids": [{"name": "block", "box": {"lo": (0, 0, 0), "hi": (0.04, 0.04, 0.03)},
                    "young": 1e4, "poisson": 0.45, "damping": 5.0}],
    }, **backend)  # fmt: skip
    mine = sim.arrays.phase == list(sim.phases).index("block")
    sim.run_to(1.9)
    speeds = []
    while sim.time < 2.0:
        sim.step()
        speeds.append((sim.velocities[mine] ** 2).sum(1).mean())
    assert np.sqrt(np.mean(speeds)) < 2e-3


@pytest.mark.few_backends
def test_blocks_on_each_other_nearly_report_that_they_rest(backend):
    """Pressure acts once a step: within the step, what it carries must not seem to fall."""
    floor = {"name": "floor", "box": {"lo": (-0.05, -0.05, -0.012), "hi": (0.08, 0.08, 0)}}
    blocks = [
        {"name": name, "box": {"lo": (0, 0, 4 * D * k), "hi": (6 * D, 6 * D, 4 * D * (k + 1))},
         "young": 1e4, "poisson": 0.3, "damping": 20.0, "friction": 0.3}
        for k, name in enumerate(("lower", "upper"))
    ]  # fmt: skip
    sim = gb.Simulation({
        "spacing": D, "domain": {"lo": (-0.05, -0.05, -0.02), "hi": (0.08, 0.08, 0.1)},
        "boundaries": [floor], "solids": blocks,
    }, **backend)  # fmt: skip
    sim.run_to(0.5)
    mean, most = rms(sim)
    assert mean < 1e-3
    assert most < 12e-3


@pytest.mark.few_backends
def test_a_run_goes_on_with_the_loads_of_its_contacts(backend, tmp_path):
    """Friction and pressure remember: a run from a checkpoint has the bits of one without."""

    blocks = [
        {"name": name, "box": {"lo": (0, 0, 3 * D * k), "hi": (5 * D, 5 * D, 3 * D * (k + 1))}, "young": 2e4}
        for k, name in enumerate("ab")
    ]  # fmt: skip
    floor = {"name": "floor", "friction": 0.4, "box": {"lo": (-0.05, -0.05, -0.012), "hi": (0.1, 0.08, 0)}}
    scene = {
        "spacing": D, "gravity": (4.0, 0, -9.0), "boundaries": [floor], "solids": blocks,
        "domain": {"lo": (-0.05, -0.05, -0.02), "hi": (0.1, 0.08, 0.1)},
    }  # fmt: skip
    whole = gb.Simulation(scene, **backend)
    for _ in range(40):
        whole.step(0.001)
    first = gb.Simulation(scene, **backend)
    for _ in range(20):
        first.step(0.001)
    assert {"tissue_loads", "tissue_pressed"} <= set(first.arrays.state())
    first.save(tmp_path / "state.npz")
    second = gb.Simulation.load(tmp_path / "state.npz", **backend)
    for _ in range(20):
        second.step(0.001)
    assert np.array_equal(whole.positions, second.positions)
    assert np.array_equal(whole.velocities, second.velocities)
