"""Rigid bodies: momentum, spin, contact with each other and with fluids; on every backend."""

import globule as gb
import numpy as np
import pytest


def boxes(backend, tables, **more):
    """Rigid boxes of 0.1 m and 1 kg, in the order of the scene."""
    scene = {
        "spacing": 0.02, "gravity": (0, 0, 0), "domain": {"lo": (-1, -1, -1), "hi": (1, 1, 1)},
        "rigids": [
            {"name": name, "box": {"lo": lo, "hi": np.add(lo, 0.1).round(3).tolist()}, **keys}
            for name, lo, keys in tables
        ],
        **more,
    }  # fmt: skip
    return gb.Simulation(scene, **backend)


def momenta(sim, names="ab"):
    return np.array([sim.steer.body(name)["velocity"] for name in names])


def test_a_body_goes_round_and_round(backend):
    """Two laps and a half of a domain that repeats, with a neighbor that drifts over the seam."""
    tables = [
        ("a", (-0.1, 0.8, 0), {"velocity": (2.0, 0, 0), "spin": (0, 0, 1.0)}),
        ("b", (-0.1, 0.3, 0), {"velocity": (2.0, 0, 0)}),
        ("c", (-0.1, 0.44, 0), {"velocity": (2.0, -1.0, 0)}),
    ]
    sim = boxes(backend, tables, domain={"lo": (-0.5, -1, -1), "hi": (0.5, 1, 1), "periodic": ["x"]})
    while sim.time < 1.25:
        sim.step(0.005)
        assert np.abs(sim.velocities).max() < 2.2
    a, at = sim.steer.body("a"), (-0.05 + 2.0 * sim.time + 0.5) % 1.0 - 0.5
    assert a["center"][0] == pytest.approx(at, abs=1e-4)
    np.testing.assert_allclose(a["velocity"], (2, 0, 0), atol=1e-6)
    np.testing.assert_allclose(momenta(sim, "bc").sum(axis=0), (4, -1, 0), atol=1e-5)
    for name in "bc":
        assert np.abs(sim.steer.body(name)["spin"]).max() < 0.05


def test_a_bodys_particles_are_not_removed():
    sim = boxes({"device": "cpu"}, [("a", (0, 0, 0), {}), ("b", (0.5, 0, 0), {})])
    with pytest.raises(ValueError, match="ids: expected no particles of a rigid body, got 2 of 'b'"):
        sim.remove(sim.ids[[-1, -2]])
    assert len(sim) == 250
    sim.step()


def test_a_free_body_keeps_its_angular_momentum(backend):
    """About an axis that is none of its own, so that its spin changes."""
    size, spin = (0.2, 0.06, 0.12), np.array((0.1, 3.0, 0.1))
    sim = boxes(backend, [("a", (0, 0, 0), {"box": {"lo": (0, 0, 0), "hi": size}, "spin": spin})])
    edges = np.square(size)
    inertia = 1000.0 * np.prod(size) * np.diag(edges.sum() - edges) / 12

    def now():
        body = sim.steer.body("a")
        return body["rotation"] @ inertia @ body["rotation"].T @ body["spin"], body["spin"]

    before = now()[0]
    sim.run(2.0)
    after, turned = now()
    np.testing.assert_allclose(after, before, atol=1e-6 * np.linalg.norm(before))
    assert np.abs(turned - spin).max() > 0.05


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("speeds", [(1.0, -1.0), (1.0, 0.0), (0.0, -1.0)])
def test_bodies_that_meet_keep_their_momentum(backend, speeds, order):
    tables = [("a", (0, 0, 0), {"velocity": (speeds[0], 0, 0)}), ("b", (0.14, 0, 0), {"velocity": (speeds[1], 0, 0)})]
    sim = boxes(backend, tables[::order])
    before = momenta(sim).sum(axis=0)
    sim.run(0.1)
    after = momenta(sim)
    np.testing.assert_allclose(after.sum(axis=0), before, atol=1e-5)
    assert 0.5 * (after**2).sum() <= 0.5 * (np.array(speeds) ** 2).sum() + 1e-6
    assert after[0, 0] <= after[1, 0] + 1e-3  # they do not go on into each other
    assert sim.steer.body("b")["center"][0] - sim.steer.body("a")["center"][0] > 0.095


@pytest.mark.few_backends
@pytest.mark.parametrize("densities", [(2000.0, 500.0), (100.0, 10000.0)])
def test_boxes_stand_on_each_other(backend, densities):
    """On four corners each: they settle among the particles of what is below, and stay; what is
    light is not shot away from under what is heavy, which may slide off it."""
    d = 0.02
    tables = [("a", (0, 0, 0), {"density": densities[0]}), ("b", (0, 0.1, 0), {"density": densities[1]})]
    sim = boxes(
        backend, tables, gravity=(0, -9.81, 0),
        domain={"lo": (-0.5, 0, -0.5), "hi": (0.5, 0.5, 0.5), "walls": True},
    )  # fmt: skip
    at = np.array([sim.steer.body(name)["center"] for name in "ab"])
    while sim.time < 1.0:
        sim.step()
        bodies = [sim.steer.body(name) for name in "ab"]
        energy = sum(
            0.001 * density * (body["velocity"] @ body["velocity"] / 2 + 9.81 * body["center"][1])
            for density, body in zip(densities, bodies, strict=True)
        )
        assert energy < 9.81e-3 * np.dot(densities, at[:, 1]) * 1.001
        assert np.abs([body["center"] for body in bodies]).max() < 0.5
    if densities[1] > densities[0]:
        return
    now = [sim.steer.body(name) for name in "ab"]
    assert np.abs(np.array([body["center"] for body in now]) - at).max() < 1.1 * d
    for body in now:
        assert np.abs(body["velocity"]).max() < 0.05
        np.testing.assert_allclose(body["rotation"], np.eye(3), atol=0.1)


MEETINGS = {
    "plain": {},
    "light": {"density": 30.0},  # most of what moves is water
    "oblique": {"offset": 0.04, "spin": (0, 0, 3.0)},
    "viscous": {"fluid": {"viscosity": 2.0, "implicit": False}},
    "honey": {"density": 100.0, "fluid": {"viscosity": 50.0}},
    "stiff": {"density": 1.0, "fluid": {"viscosity": 1e4}},
    "sticky": {"fluid": {"surface_tension": 1.0}, "body": {"adhesion": 1.0}},
    "wcsph": {"solver": {"method": "wcsph"}},
    "short steps": {"solver": {"max_dt": 2e-4}},
}


@pytest.mark.few_backends
@pytest.mark.parametrize("meeting", MEETINGS)
def test_a_body_and_the_fluid_that_it_hits_keep_their_momentum(backend, meeting):
    keys = MEETINGS[meeting]
    d, density, lift = 0.02, keys.get("density", 1000.0), keys.get("offset", 0.0)
    spin = keys.get("spin", (0, 0, 0))
    scene = {
        "spacing": d, "domain": {"lo": (-1, -1, -1), "hi": (1, 1, 1)}, "gravity": (0, 0, 0),
        "solver": keys.get("solver", {}),
        "fluids": [{
            "name": "water", "viscosity": 0.0, **keys.get("fluid", {}),
            "box": {"lo": (0.14, lift, 0), "hi": (0.24, lift + 0.1, 0.1)},
        }],
        "rigids": [{
            "name": "box", "density": density, "velocity": (1.0, 0, 0), "spin": spin,
            "box": {"lo": (0, 0, 0), "hi": (0.1, 0.1, 0.1)}, **keys.get("body", {}),
        }],
    }  # fmt: skip
    sim, mass = gb.Simulation(scene, **backend), density * 0.1**3
    inertia = mass * (0.1**2 + d**2) / 6  # with the particles' own

    def now():
        body, totals = sim.steer.body("box"), sim.record.totals()
        kinetic = 0.5 * mass * (body["velocity"] ** 2).sum() + 0.5 * inertia * (body["spin"] ** 2).sum()
        return mass * body["velocity"] + totals["momentum"], kinetic + totals["kinetic"]

    before, energy = now()
    while sim.time < 0.15:
        sim.step()
        momentum, kinetic = now()
        np.testing.assert_allclose(momentum, before, atol=1e-4 * mass)
        if "body" not in keys:  # attraction gives some
            assert kinetic < energy * 1.001
    assert sim.steer.body("box")["velocity"][0] < 0.95  # they have met
