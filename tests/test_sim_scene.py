"""What the scene of a simulation draws: the smooth surface of its fluids."""

import globule as gb
import numpy as np
import pytest
from globule.sim.pictures import Eye

SIZE = (64, 48)


def tank(**keys):
    """A column of water in a box, and what else `keys` say."""
    fluids = [
        {"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.2, 0.2, 0.3]}, "color": "#2f7fd0"}
    ]
    scene = {
        "spacing": 0.025, "domain": {"lo": [0, 0, 0], "hi": [0.5, 0.2, 0.4], "walls": True},
        "fluids": fluids,
    }  # fmt: skip
    return scene | keys


def simulation(backend, **keys) -> gb.Simulation:
    return gb.Simulation(tank(**keys), **backend)


CAMERA = gb.Camera((0.3, -0.9, 0.5), (0.15, 0.1, 0.15), (0, 0, 1), fov=30)


def test_a_fluid_is_drawn_as_render_draws_its_particles(backend):
    sim = simulation(backend)
    sim.run(0.05)
    assert sim.scene.surface == "smooth"
    assert sim.scene.threshold == 0.5
    assert sim.scene.support == pytest.approx(2.25 * 0.025)
    own = gb.Scene(sim.shown_particles, surface="smooth", spacing=0.025, **backend)
    a, b = (gb.render(scene, CAMERA, SIZE) for scene in (sim, own))
    assert (a.mask == b.mask).all()
    assert a.mask.mean() > 0.1
    assert np.abs(a.distance - b.distance)[a.mask].max() < 1e-5
    assert np.abs(a.albedo - b.albedo)[a.mask].max() < 1e-6
    assert np.abs(a.image.astype(int) - b.image).max() <= 1
    assert sim.scene.octree.n_inside == len(sim.shown_particles) < len(sim)


def test_the_surface_encloses_the_water_and_stays_inside_the_walls(backend):
    sim = simulation(backend)
    measure = gb.measure_surface(gb.Scene(sim.shown_particles, surface="smooth", spacing=0.025))
    assert measure.volume == pytest.approx(0.2 * 0.2 * 0.3, rel=0.04)
    top, side = sim.scene.intersect(
        np.array([[0.1, 0.1, 1.0], [0.1, -1.0, 0.1]], "f4"),
        np.array([[0, 0, -1], [0, 1, 0]], "f4"),
    ).distance
    assert 1.0 - top == pytest.approx(0.3, abs=0.003)
    assert side - 1.0 == pytest.approx(0.0, abs=0.003)


def test_drawing_changes_nothing(backend):
    hashes = []
    for draws in (False, True):
        sim = simulation(backend)
        for _ in range(5):
            sim.step()
            if draws:
                gb.render(sim, CAMERA, (16, 12))
        hashes.append(sim.hash())
    assert hashes[0] == hashes[1]


def test_what_else_is_shown_decides(backend):
    sim = simulation(backend, boundaries=[{
        "name": "post", "box": {"lo": [0.35, 0, 0], "hi": [0.45, 0.2, 0.3]}, "shown": False
    }])  # fmt: skip
    hidden = gb.render(sim, CAMERA, SIZE).mask.mean()
    sim.phases["post"].shown = True
    sim.step()
    assert sim.scene.surface == "smooth"
    assert gb.render(sim, CAMERA, SIZE).mask.mean() > 1.1 * hidden
    sim.phases["post"].shown = False
    sim.phases["water"].shown = False
    sim.step()
    assert sim.scene.surface == "balls"
    assert not gb.render(sim, CAMERA, SIZE).mask.any()


def test_tissue_keeps_its_balls(backend):
    block = {"name": "tissue", "box": {"lo": [0.3, 0, 0], "hi": [0.45, 0.2, 0.1]}}
    sim = simulation(backend, solids=[block])
    assert sim.scene.surface == "balls"
    assert (sim.scene.threshold, sim.scene.support) == (0.6, pytest.approx(0.05))
    own = gb.Scene(gb.Particles(sim.shown_particles.positions, support=0.05), **backend)
    a, b = (gb.render(scene, CAMERA, SIZE).distance for scene in (sim, own))
    assert (np.isfinite(a) == np.isfinite(b)).all()
    assert np.abs(a - b)[np.isfinite(a)].max() < 1e-5


def test_a_threshold_of_ones_own_stays(backend):
    sim = simulation(backend)
    before = gb.render(sim, CAMERA, SIZE).mask.sum()
    sim.scene.threshold = 0.2
    sim.step()
    assert sim.scene.threshold == 0.2
    assert gb.render(sim, CAMERA, SIZE).mask.sum() > before


def test_colors_by_value_and_speed(backend):
    sim = simulation(
        backend, view={"speeds": [0, 1], "eye": [0.3, -1.2, 0.6], "look_at": [0.2, 0.1, 0.1]}
    )
    sim.run(0.05)
    frame = gb.render(sim, CAMERA, SIZE, color_by="z")
    plain = gb.render(sim, CAMERA, SIZE)
    assert (frame.mask == plain.mask).all()
    eye = Eye(sim.file, SIZE)
    eye.picture(sim)
    assert eye._shown(sim).surface == "smooth"
    assert gb.render(sim, CAMERA, SIZE).pick(*np.argwhere(plain.mask)[9][::-1]).particle is not None
