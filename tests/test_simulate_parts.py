"""What moves, cuts, lets in and takes away in scenes, and bodies from files."""

import globule as gb
import numpy as np
import pytest
from globule.sim.bodies import bodies
from globule.sim.scene_read import read_scene

D = 0.002
BLOCK = {
    "spacing": D, "gravity": [0, 0, 0],
    "domain": {"lo": [-0.05, -0.05, -0.05], "hi": [0.07, 0.07, 0.08]},
    "solids": [{
        "name": "block", "box": {"lo": [0, 0, 0], "hi": [0.012, 0.012, 0.024]}, "young": 20000,
        "fixed": [{"box": {"lo": [0, 0, 0.022], "hi": [0.012, 0.012, 0.024]}}],
    }],
    "instruments": [{
        "name": "knife", "kind": "scalpel", "edge": [[0, 0, 0], [0, 0.03, 0]],
        "keys": [{"time": 0.01, "position": [-0.01, -0.01, 0.0121]},
                 {"time": 0.03, "position": [0.03, -0.01, 0.0121]}, {"time": 0.031, "on": False}],
    }],
}  # fmt: skip


def simulation(**changes):
    return gb.Simulation(BLOCK | changes, device="cpu")


def test_a_blade_along_its_keys_or_by_hand_cuts_exactly():
    sim = simulation()
    for time, n_cut, n_pieces in ((0.01, 0, 1), (0.04, 5 * 6 * 6 - 4 * 6, 2)):
        sim.run_to(time)
        assert (sim.record.n_cut, sim.tissue.n_pieces) == (n_cut, n_pieces)
    assert sim.record.diagnostics[-1]["n_cut"] == n_cut
    sim.record.measure()
    assert sim.record.diagnostics[-1]["n_pieces"] == 2
    sim = simulation(instruments=[BLOCK["instruments"][0] | {"keys": [{"time": 99}]}])
    knife = sim.tools["knife"]
    knife.move_to((-0.01, -0.01, 0.0121))
    knife.on = False
    sim.step(0.001)
    assert sim.record.n_cut == 0
    knife.on = True
    knife.move_to((0.03, -0.01, 0.0121))
    sim.step(0.001)
    assert sim.tissue.n_pieces == 2


def test_what_comes_in_adds_up_and_a_drop_sticks():
    tap = {"name": "tap", "fluid": "water", "center": [0, 0, 0.06], "direction": [0, 0, -1],
           "radius": 0.007, "rate": 2e-5, "start": 0.02, "end": 0.12}  # fmt: skip
    drain = {"name": "drain", "box": {"lo": [-0.05, -0.05, -0.05], "hi": [0.07, 0.07, 0]}}
    sim = simulation(gravity=[0, 0, -9.81], solids=[], instruments=[], emitters=[tap],
                     sinks=[drain], fluids=[{"name": "water"}])  # fmt: skip
    sim.run_to(0.02)
    assert len(sim) == 0
    sim.run_to(0.25)
    assert sim.record.n_born == pytest.approx(0.1 * 2e-5 / D**3, rel=0.06)
    assert sim.record.n_removed > 0
    assert sim.record.n_born == len(sim) + sim.record.n_removed
    pool = {"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.02, 0.02, 0.02]}}
    suction = {"name": "s", "kind": "suction", "radius": 0.0045,
               "keys": [{"time": 0.01, "position": [0.01, 0.01, 0.01]}]}  # fmt: skip
    sim = simulation(solids=[], instruments=[suction], fluids=[pool])
    sim.run_to(0.009)
    assert sim.record.n_removed == 0
    sim.run_to(0.02)
    near = np.linalg.norm(sim.positions - [0.01, 0.01, 0.01], axis=1) < 0.0045
    assert sim.record.n_removed > 0
    assert not near.any()
    drop = {"name": "water", "sphere": {"center": [0.01, 0.01, 0.0065], "radius": 0.006},
            "viscosity": 0.01}  # fmt: skip
    plate = {"name": "plate", "box": {"lo": [-0.01, -0.01, -0.004], "hi": [0.03, 0.03, 0]}}
    least = []  # without gravity the drop touches the plate only if it is drawn to it
    for tension, adhesion in ((0.07, 0.0), (0.0, 0.07), (0.07, 0.07)):
        sim = simulation(solids=[], instruments=[], fluids=[drop | {"surface_tension": tension}],
                         boundaries=[plate | {"adhesion": adhesion}])  # fmt: skip
        sim.run_to(0.02)
        least.append(sim.positions[sim.arrays.phase == list(sim.phases).index("water"), 2].min())
    assert least[0] > 0.001
    assert least[1] > 0.0005  # a fluid without tension sticks to nothing
    assert least[2] < 0


def test_bodies_from_files(folder):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(3, 10.0).export("ball.stl")  # mm
    grid = np.linalg.norm(np.mgrid[-15:16, -15:16, -15:16], axis=0) - 10
    affine = np.eye(4)
    affine[:3, 3] = -15
    gb.volumes.write_volume("hole.npz", gb.volumes.Volume(grid.T.astype(np.float32), affine))
    scene = {
        "spacing": D, "domain": BLOCK["domain"],
        "fluids": [{"name": "a", "mesh": {"file": "ball.stl", "scale": 0.001}}],
        "boundaries": [{"name": "b", "hollow": True, "distance": {"file": "hole.npz", "scale": 0.001}}],
    }  # fmt: skip
    ball, shell = bodies(read_scene(scene))
    assert len(ball.positions) * D**3 == pytest.approx(4 / 3 * np.pi * 0.01**3, rel=0.06)
    radii = np.linalg.norm(shell.positions, axis=1)
    assert np.allclose(radii, 0.01 + 0.555 * D, atol=0.1 * D)
    assert len(radii) == pytest.approx(4 * np.pi * 0.0111**2 / D**2, rel=0.25)
