"""What is said to a running simulation by hand: kept by checkpoints, undone by reset, checked."""

import re

import globule as gb
import numpy as np
import pytest
from globule.sim.scene_file import Vessel
from globule.sim.tissue import BALL, HALF_SPACE
from sim_helpers import reloaded
from test_sim_checkpoints import facts

SCENE = {
    "spacing": 0.004,
    "domain": {"lo": [-0.06, -0.06, 0], "hi": [0.06, 0.06, 0.06], "walls": True},
    "fluids": [{"name": "water", "sphere": {"center": [0.04, 0, 0.02], "radius": 0.008}}],
    "solids": [{
        "name": "jelly", "box": {"lo": [-0.04, -0.02, 0], "hi": [0, 0.02, 0.024]}, "young": 8000,
    }],
    "boundaries": [{"name": "wall", "sphere": {"center": [0.04, 0.04, 0.01], "radius": 0.01}}],
    "instruments": [
        {"name": "scalpel", "kind": "scalpel", "edge": [[0, 0, -0.02], [0, 0, 0.03]],
         "keys": [{"time": 0.01, "position": [-0.02, -0.03, 0.012]},
                  {"time": 0.03, "position": [-0.02, 0.03, 0.012]}]},
        {"name": "grip", "kind": "grasper", "radius": 0.008,
         "keys": [{"time": 1, "position": [-0.01, 0, 0.024]}]},
        {"name": "sucker", "kind": "suction", "radius": 0.006,
         "keys": [{"time": 1, "position": [0.04, 0, 0.02]}]},
    ],
    "emitters": [{"name": "tap", "fluid": "water", "center": [0.03, -0.03, 0.05],
                  "direction": [0, 0, -1], "radius": 0.008, "rate": 1e-4}],
}  # fmt: skip


@pytest.fixture
def sim():
    return gb.Simulation(SCENE, device="cpu")


def off(sim):
    sim.run(0.012)
    sim.tools["scalpel"].on = False


def about_to_pass(sim):
    sim.tools["scalpel"].move_to((-0.02, -0.03, 0.012))
    sim.run(0.005)
    sim.tools["scalpel"].move_to((-0.02, 0, 0.012))


def passing(sim):
    about_to_pass(sim)
    sim.step(0.001)
    turned = np.eye(4)
    turned[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    turned[:3, 3] = (-0.02, 0.01, 0.012)
    sim.tools["scalpel"].move_to(turned)


def pushed(sim):
    sim.run(0.005)
    sim.steer.apply_force((1e-3, 0, 0), sim.ids[:50])
    sim.steer.apply_force((0, 0, 1e-3))


def held(sim):
    sim.tools["grip"].on = True
    sim.run(0.005)
    sim.tools["grip"].move_to((-0.01, 0, 0.03))
    sim.tools["sucker"].radius = 0.005
    sim.tools["sucker"].on = True
    sim.step(0.001)


def drained(sim):
    sim.steer.set_sinks([((0.04, 0.0, 0.02), 0.005)])
    sim.tools.grasp((-0.03, 0, 0.02), 0.006, 5)
    sim.tools.move_grasp(5, (0, 0, 0.1))
    sim.emitters["second"] = type(sim.emitters["tap"])((0, 0.04, 0.05), (1, 2, -3), 0.006, 1e-4)
    sim.emitters["tap"].rate = 2e-4
    sim.phases["water"].viscosity = 0.5


def vein(fluid):
    path = [[-0.04, 0, 0.012], [0, 0, 0.012]]
    return Vessel(name="vein", solid="jelly", fluid=fluid, path=path, radius=0.005, pool=1e-6)


def pressed(sim):
    sim.tools.set_pushers([(BALL, (-0.02, 0, 0.03), (0, 0, 0), 0.006, (0, 0, -0.1)),
                     (HALF_SPACE, (-0.043, 0, 0), (1, 0, 0), 0, (0.1, 0, 0), 0.2)])  # fmt: skip
    sim.tissue.add_vessel(vein("water"))
    sim.run(0.012)


@pytest.mark.parametrize("said", [off, about_to_pass, passing, pushed, held, drained, pressed])
def test_what_was_said_goes_on_after_loading(sim, tmp_path, said):
    said(sim)
    again = reloaded(sim, tmp_path)
    for one in (sim, again):
        one.run(0.02)
    assert facts(again) == facts(sim)


@pytest.mark.parametrize("said", [off, about_to_pass, passing, pushed, held, drained, pressed])
def test_reset_forgets_what_was_said(said):
    one, other = (gb.Simulation(SCENE, device="cpu") for _ in range(2))
    one.emitters["tap"].on = False
    said(one)
    one.emitters.pop("second", None)
    one.reset()
    assert one.hash() == other.hash()
    assert one.emitters["tap"].on
    assert (one.time, one.record.diagnostics) == (0, [])
    for sim in (one, other):
        sim.run(0.02)
    assert (len(one), one.hash()) == (len(other), other.hash())


def test_a_force_stays_with_its_particle(sim):
    ids = sim.ids[sim.arrays.phase == 0][:5]
    sim.steer.apply_force((0, 0, 0.01), ids)
    sim.remove(ids[:2])
    more, before = sim.add([[0.02, -0.02, 0.03]], "water"), sim.velocities
    sim.step(0.0005)
    gained, at = (sim.velocities - before)[:, 2], np.searchsorted(sim.ids, [*ids[2:], *more])
    assert (gained[at[:3]] > 0.01).all()
    assert gained[at[3]] < 0


WATER = "density, viscosity, implicit, surface_tension, color, reflection, refraction, shown"


@pytest.mark.parametrize(("thing", "name", "expected"), [
    (lambda sim: sim.phases["water"], "viscositty", f"phases['water'].viscositty: expected one "
     f"of {WATER}, got an unknown name"),
    (lambda sim: sim.phases["water"], "velocity", "phases['water'].velocity: cannot be "
     f"changed after the start, expected one of {WATER}"),
    (lambda sim: sim.phases["water"], "tear", "tear: expected one of density"),
    (lambda sim: sim.emitters["tap"], "speed", "emitters['tap'].speed: expected one of rate, "),
    (lambda sim: sim.tools["scalpel"], "radius", "tools['scalpel'].radius: "
     "cannot be changed after the start, expected one of on"),
    (lambda sim: sim.tools["sucker"], "of", "expected one of on, radius, ablates, got"),
    (lambda sim: sim.settings, "gravty", "settings.gravty: expected one of gravity, meth"),
])  # fmt: skip
def test_other_names_are_refused(sim, thing, name, expected):
    with pytest.raises(AttributeError) as caught:
        setattr(thing(sim), name, 0.5)
    assert expected in str(caught.value)


def test_names_are_those_of_a_scene_file(sim):
    fluid = SCENE["fluids"][0] | {"viscosity": 2.0, "surface_tension": 0.05, "density": 900.0}
    solid = SCENE["solids"][0] | {"plastic": 0.01, "creep": 20.0, "damping": 3.0, "tear": 0.4}
    told = gb.Simulation(SCENE | {"fluids": [fluid], "solids": [solid]}, device="cpu")
    water, jelly = sim.phases["water"], sim.phases["jelly"]
    water.viscosity, water.implicit = np.float64(2), True
    water.surface_tension, water.density = 0.05, 900
    jelly.plastic, jelly.creep, jelly.damping, jelly.tear = 0.01, 20, 3, 0.4
    plain = gb.Simulation(SCENE, device="cpu")
    for one in (sim, told, plain):
        one.run(0.02)
    assert sim.hash() == told.hash() != plain.hash()
    water.color = "#ff0000"
    assert tuple(water.color) == (1, 0, 0)


NAN = float("nan")
DOMAIN = {"lo": [0, 0, 0], "hi": [1, 1, 1]}
MIRROR = np.diag([-1.0, 1, 1, 1])


@pytest.mark.parametrize(("mistake", "expected"), [
    (lambda s: setattr(s.phases["water"], "viscosity", -1),
     "phases['water'].viscosity: expected a number from 0 to 1e+09, got -1"),
    (lambda s: setattr(s.phases["water"], "color", (0, 0, 2)),
     "phases['water'].color[2]: expected a number from 0 to 1, got 2"),
    (lambda s: setattr(s.emitters["tap"], "rate", -1), "emitters['tap'].rate: expected a number of at least 0, got -1"),
    (lambda s: setattr(s.emitters["tap"], "on", "no"), "on: expected true or false, got 'no'"),
    (lambda s: setattr(s.tools["grip"], "on", 2), "on: expected true or false, got 2"),
    (lambda s: s.steer.apply_force((0, NAN, 0)), "force: expected finite numbers, got a NaN"),
    (lambda s: s.steer.apply_force((0, 1)), "force: expected shape (3,) or ("),
    (lambda s: s.steer.apply_force("up"), "force: expected numbers, got 'up'"),
    (lambda s: s.tools["grip"].move_to(np.diag([5.0, 1, 1, 1])),
     "tools['grip'].move_to: expected a rotation and a place, got [[5.0, 0.0,"),
    (lambda s: s.tools["grip"].move_to(MIRROR), "expected a rotation and a place"),
    (lambda s: s.tools["grip"].move_to("here"), "move_to: expected numbers (4, 4) or"),
    (lambda s: s.tools["grip"].move_to((0, 0)), "move_to: expected shape (4, 4) or (3,)"),
    (lambda s: setattr(s, "velocities", s.velocities * NAN), "velocities: expected finite"),
    (lambda s: s.tissue.add_vessel(vein("ichor")), "phase: expected one of"),
    (lambda s: setattr(s, "positions", s.positions[1:]), "positions: expected shape ("),
])  # fmt: skip
def test_values_are_checked_as_a_scene_files_are(sim, mistake, expected):
    before = sim.hash()
    with pytest.raises(ValueError, match=re.escape(expected)):
        mistake(sim)
    sim.step()
    fresh = gb.Simulation(SCENE, device="cpu")
    assert fresh.hash() == before
    fresh.step()
    assert sim.hash() == fresh.hash()


@pytest.mark.parametrize(("change", "expected"), [
    (lambda s: setattr(s.phases["water"], "viscosity", 1e9), "phases['water'].viscosity: exp"),
    (lambda s: setattr(s.emitters["tap"], "rate", 1e6), "emitters['tap'].rate: expected ste"),
])  # fmt: skip
def test_what_would_take_a_million_steps_a_frame_is_refused_at_the_next_step(sim, change, expected):
    change(sim)
    with pytest.raises(ValueError, match=re.escape(expected) + ".*a millionth of a frame"):
        sim.run(0.01)
    sim.phases["water"].implicit = True  # as thick as that, but solved for
    sim.emitters["tap"].rate = 1e-4
    sim.step()


@pytest.mark.parametrize(("mistake", "kind", "expected"), [
    (lambda s: s.phases["x"], KeyError, "phases: expected one of water, jelly, wall, walls, got 'x'"),
    (lambda s: s.emitters["x"], KeyError, "emitters: expected one of tap, got 'x'"),
    (lambda s: s.phases.__setitem__("water", 3), TypeError, "phases['water']: expected Phase"),
    (lambda s: gb.Simulation(3), TypeError, "scene: expected a name, a path, a dict or"),
    (lambda s: gb.Simulation("dam-brek"), FileNotFoundError, "expected a .toml file or one of dam-break, droplet"),
    (lambda s: gb.Simulation(spacing=0.1), ValueError, "expected the key domain, got none"),
    (lambda s: gb.Simulation(spacing=0.2, domain=DOMAIN | {"periodic": ["y"]}), ValueError, "at least 8 spacings"),
    (lambda s: setattr(s.settings, "domain", 3), AttributeError, "cannot be changed after"),
    (lambda s: s.add_phase("x"), TypeError, "phase: expected a gb.sim.Phase, got 'x'"),
    (lambda s: gb.Simulation(spacing=0.1, domain=DOMAIN).add([(0, 0, 0)]), ValueError,
     "phase: expected fluids, solids or rigids in the scene, got none"),
])  # fmt: skip
def test_messages_say_what_there_is(sim, mistake, kind, expected):
    with pytest.raises(kind) as caught:
        mistake(sim)
    assert expected in str(caught.value)


def test_a_state_that_cannot_be_loaded_does_not_replace_one_that_can(sim, tmp_path):
    sim.save(tmp_path / "good")
    before, velocity = (tmp_path / "good.npz").read_bytes(), sim._solver.read("velocity")
    velocity[0] = NAN
    sim._solver.write("velocity", velocity)
    with pytest.raises(ValueError, match=r"good\.npz: expected a state .* velocity: expected fin"):
        sim.save(tmp_path / "good")
    assert (tmp_path / "good.npz").read_bytes() == before
    assert len(gb.Simulation.load(tmp_path / "good", device="cpu")) == len(sim)
