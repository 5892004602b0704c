"""Checkpoints: whatever was done before, a loaded simulation goes on as the saved one does."""

import globule as gb
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from sim_helpers import reloaded

SCENE = {
    "spacing": 0.006,
    "domain": {"lo": [-0.06, -0.06, 0], "hi": [0.06, 0.06, 0.06], "walls": True},
    "fluids": [{"name": "water", "sphere": {"center": [0.04, 0, 0.02], "radius": 0.01}}],
    "solids": [{"name": "jelly", "box": {"lo": [-0.04, -0.02, 0], "hi": [-0.01, 0.01, 0.024]}}],
    "rigids": [{"name": "raft", "box": {"lo": [0, 0, 0.03], "hi": [0.02, 0.02, 0.045]}}],
    "boundaries": [{"name": "paddle", "sphere": {"center": [0, -0.04, 0.03], "radius": 0.012},
                    "keys": [{"time": 0}, {"time": 0.05, "position": [0.02, 0, 0]}]}],
    "instruments": [
        {"name": "scalpel", "kind": "scalpel", "edge": [[0, 0, -0.02], [0, 0, 0.03]],
         "keys": [{"time": 0.004, "position": [-0.025, -0.03, 0.012]},
                  {"time": 0.02, "position": [-0.025, 0.03, 0.012]}]},
        {"name": "grip", "kind": "grasper", "radius": 0.008,
         "keys": [{"time": 1, "position": [-0.015, 0, 0.024]}]},
        {"name": "sucker", "kind": "suction", "radius": 0.008, "ablates": True,
         "keys": [{"time": 1, "position": [0.04, 0, 0.02]}]},
    ],
    "emitters": [{"name": "tap", "fluid": "water", "center": [0.03, -0.03, 0.05],
                  "direction": [0, 0, -1], "radius": 0.01, "rate": 1e-4, "end": 0.01}],
    "vessels": [{"name": "vein", "solid": "jelly", "fluid": "water", "radius": 0.004, "pool": 1e-6,
                 "path": [[-0.04, -0.005, 0.012], [-0.01, -0.005, 0.012]]}],
}  # fmt: skip
SHEET = np.array([[(0.0, -1, -1), (0, 1, -1), (0, 0, 1)]])
SHARES = st.floats(0, 1)
OPERATIONS = {
    "step": lambda sim, x: sim.step(0.0005 + 0.002 * x), "run": lambda sim, x: sim.run(0.004 * x),
    "add": lambda sim, x: sim.add([(0.05 * x, 0.04, 0.05)], "water", (0, 0, -x)),
    "remove": lambda sim, x: remove(sim, x),
    "throw": lambda sim, x: setattr(sim, "velocities", sim.velocities * np.float32(x)),
    "push": lambda sim, x: sim.steer.apply_force((1e-4 * x, 0, 0), sim.ids[::3]),
    "sink": lambda sim, x: sim.steer.set_sinks([((0.04, 0, 0.02 * x), 0.006)]),
    "cut": lambda sim, x: sim.tissue.cut(SHEET - (0.012 + 0.025 * x, 0, 0)),
    "suture": lambda sim, x: sim.tissue.suture((-0.025, -0.005, 0.012), 0.02 + 0.02 * x),
    "ablate": lambda sim, x: sim.tissue.ablate((-0.04 + 0.03 * x, 0, 0.02), 0.006),
    "grasp": lambda sim, x: sim.tools.grasp((-0.03, 0, 0.024 * x), 0.008, 5),
    "pull": lambda sim, x: sim.tools.move_grasp(5, (0, 0, 0.1 * x)),
    "press": lambda sim, x: sim.tools.set_pushers([(0, (-0.02, 0, 0.04), (0, 0, 0), 0.01, (0, 0, -x))]),
    "hold": lambda sim, x: setattr(sim.tools["grip"], "on", x < 0.7),
    "move": lambda sim, x: sim.tools["grip"].move_to((-0.015, 0, 0.024 + 0.002 * x)),
    "suck": lambda sim, x: setattr(sim.tools["sucker"], "on", x < 0.7), "steer": lambda sim, x: steer(sim, x),
    "spin": lambda sim, x: sim.steer.make_rigid("raft", 400.0, spin=(0, x, 0)),
    "rate": lambda sim, x: setattr(sim.emitters["tap"], "rate", 3e-4 * x),
    "thicken": lambda sim, x: setattr(sim.phases["water"], "viscosity", 0.5 * x),
    "tear": lambda sim, x: setattr(sim.phases["jelly"], "tear", x),
    "rub": lambda sim, x: setattr(sim.phases["jelly"], "friction", x),
    "tilt": lambda sim, x: setattr(sim.settings, "gravity", (x, 0, -9.81)),
    "phase": lambda sim, x: f"oil {x}" in sim.phases or sim.add_phase(gb.sim.Phase(f"oil {x}")),
    "reset": lambda sim, x: sim.reset(),
}  # fmt: skip


def remove(sim, x):
    free = sim.ids[sim.arrays.phase != list(sim.phases).index("raft")]  # a body keeps its particles
    sim.remove(free[int(x * (len(free) - 5)) :][:5])


def steer(sim, x):
    pose = np.eye(4)
    if "post" not in sim.phases:
        sim.add_phase(gb.sim.Phase("post", kind="boundary"))
        sim.add([(-0.05, 0.05, 0.03)], "post")
        sim.steer.move_boundary("post", pose)
    pose[0, 3] = 0.02 * x
    sim.steer.move_boundary("post", pose)


def facts(sim):
    shown = len(sim.shown_particles)
    return sim.hash(), sim.time, sim.tissue.n_bonds, sim.tissue.pools, sim.record.counts, shown


def whole_state(sim):
    arrays = {name: values.tobytes() for name, values in sim.arrays.state().items()}
    return repr(sim._by_hand()), facts(sim), arrays


@settings(max_examples=20, deadline=None, derandomize=True, database=None,
          phases=[Phase.generate], suppress_health_check=[HealthCheck.too_slow])  # fmt: skip
@given(
    before=st.lists(st.tuples(st.sampled_from(sorted(OPERATIONS)), SHARES), max_size=8),
    after=st.lists(st.tuples(st.sampled_from(sorted(OPERATIONS)), SHARES), max_size=3),
    fine=st.booleans(),
)
def test_a_loaded_simulation_goes_on_bit_by_bit(tmp_path_factory, before, after, fine):
    path = tmp_path_factory.mktemp("checkpoint") / "state"
    sim = gb.Simulation(SCENE | {"fine_fluids": fine}, device="cpu")
    for name, share in before:
        OPERATIONS[name](sim, share)
    sim.save(path)
    again = gb.Simulation.load(path, device="cpu")
    assert facts(again) == facts(sim)
    for one in (sim, again):
        for name, share in after:
            OPERATIONS[name](one, share)
        one.run(0.003)
    assert facts(again) == facts(sim)


def test_every_operation_changes_the_state():
    """What changes nothing tests nothing."""
    sim = gb.Simulation(SCENE, device="cpu")
    sim.run(0.006)
    for name, operation in OPERATIONS.items():
        before = whole_state(sim)
        operation(sim, 0.5)
        assert whole_state(sim) != before, name


@pytest.mark.parametrize("name", ["hold", "phase", "vessel", "whose"])
def test_numbers_that_point_nowhere_are_refused(tmp_path, name):
    def change(arrays, facts):
        arrays[f"tissue_{name}"] = np.full_like(arrays[f"tissue_{name}"], 200)

    with pytest.raises(ValueError, match=f"tissue_{name}: expected numbers up to"):
        reloaded(gb.Simulation(SCENE, device="cpu"), tmp_path, change)
