"""What the scene of a simulation draws: the smooth surface of its fluids."""

import gc
from concurrent.futures import ThreadPoolExecutor

import globule as gb
import numpy as np
import pytest

SIZE = (64, 48)


def simulation(backend, **keys) -> gb.Simulation:
    scene = {
        "spacing": 0.025, "domain": {"lo": [0, 0, 0], "hi": [0.5, 0.2, 0.4], "walls": True},
        "fluids": [{"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.2, 0.2, 0.3]},
                    "color": "#2f7fd0"}],
    }  # fmt: skip
    return gb.Simulation(scene | keys, **backend)


def assert_same_image(one, other) -> None:
    assert (one.mask == other.mask).all()
    assert np.abs(one.distance[one.mask] - other.distance[one.mask]).max() < 1e-5
    assert np.abs(one.albedo - other.albedo)[one.mask].max() < 1e-6
    assert np.abs(one.image.astype(int) - other.image).max() <= 1


CAMERA = gb.Camera((0.3, -0.9, 0.5), (0.15, 0.1, 0.15), (0, 0, 1), fov=30)


def test_a_fluid_is_drawn_as_render_draws_it_and_drawing_changes_nothing(backend):
    sim = simulation(backend)
    sim.run(0.05)
    assert (sim.scene.surface, sim.scene.threshold) == ("smooth", 0.5)
    assert sim.scene.support == pytest.approx(2.25 * 0.025)
    own = gb.Scene(sim.shown_particles, surface="smooth", spacing=0.025, **backend)
    a, b = (gb.render(scene, CAMERA, SIZE) for scene in (sim, own))
    assert_same_image(a, b)
    assert a.mask.mean() > 0.1
    picked = a.pick(*np.argwhere(a.mask)[9][::-1])
    assert sim.arrays.phase[picked.particle] == 0
    assert sim.scene.octree.n_inside == len(sim.shown_particles) < len(sim)
    # The surface encloses the water, and stays inside the walls.
    sim = simulation(backend)
    measure = gb.measure.measure_surface(gb.Scene(sim.shown_particles, surface="smooth", spacing=0.025))
    assert measure.volume == pytest.approx(0.2 * 0.2 * 0.3, rel=0.04)
    top, side = sim.scene.intersect(
        np.array([[0.1, 0.1, 1.0], [0.1, -1.0, 0.1]], "f4"), np.array([[0, 0, -1], [0, 1, 0]], "f4")
    ).distance
    assert (1.0 - top, side - 1.0) == (pytest.approx(0.3, abs=0.003), pytest.approx(0.0, abs=0.003))
    hashes = []
    for draws in (False, True):
        sim = simulation(backend)
        for _ in range(5):
            sim.step()
            if draws:
                gb.render(sim, CAMERA, (16, 12))
        hashes.append(sim.hash())
    assert hashes[0] == hashes[1]


BLOCK = {"name": "tissue", "box": {"lo": [0.3, 0, 0], "hi": [0.45, 0.2, 0.1]}, "color": "#d0a090"}
POST = {"name": "post", "box": {"lo": [0.46, 0, 0], "hi": [0.5, 0.2, 0.3]}, "shown": True}


def by_kind(sim, **backend) -> list[gb.Scene]:
    """Scenes of a simulation's tissue and fluids, smooth, and of the rest, as balls."""
    kinds = np.array([phase.kind for phase in sim.phases.values()])[sim.arrays.phase]
    particles = sim.particles
    shown = np.array([phase.shown for phase in sim.phases.values()])[sim.arrays.phase]
    scenes = []
    for kind in ("tissue", "fluid", "boundary"):
        some = (kinds == kind) & shown
        options = {"surface": "smooth", "spacing": 0.025} if kind != "boundary" else {}
        at, color, support = particles.positions[some], particles.color[some], None if options else 0.05
        scenes.append(gb.Scene(gb.Particles(at, support=support, color=color), **options, **backend))
    return scenes


def test_tissue_fluids_and_the_rest_are_layers_and_fluids_shine(backend):
    sim = simulation(backend, solids=[BLOCK], boundaries=[POST])
    sim.run(0.1)
    assert (sim.scene.surface, sim.scene.threshold) == ("smooth", 0.5)
    assert [scene.surface for scene in sim.scene.beside] == ["smooth", "balls"]
    assert [scene.threshold for scene in sim.scene.beside] == [0.5, 0.6]
    assert sim.scene.beside[0].octree.n_inside == np.count_nonzero(sim.arrays.phase == 0)
    settings = {"shadows": True, "specular": 0.0}
    a, b = (gb.render(x, CAMERA, SIZE, settings) for x in (sim, by_kind(sim, **backend)))
    assert_same_image(a, b)
    assert (a._layer == b._layer)[a.mask].all()
    assert set(np.unique(a._layer[a.mask])) == {0, 1, 2}
    sim = simulation(backend, solids=[BLOCK])
    light = {"lights": [gb.Headlight(0.3)], "ambient": 0.0, "tone": False}
    light |= {"specular": 0.3, "background": (0, 0, 0), "edge_samples": 0}
    fine = (256, 192)  # a highlight is small
    own = gb.render(by_kind(sim, **backend)[:2], CAMERA, fine, light)
    shines = gb.render(sim, CAMERA, fine, light)
    water, tissue = (own._layer == k for k in (1, 0))
    assert (own._layer == shines._layer)[own.mask].all()
    assert shines.color[water].max() > own.color[water].max() + 0.03
    assert np.abs(shines.color - own.color)[tissue].max() < 1e-5
    dull = light | {"specular": 0.0}  # as for colors that stand for values
    a, b = (gb.render(x, CAMERA, SIZE, dull) for x in (sim, by_kind(sim, **backend)[:2]))
    assert np.abs(a.color - b.color).max() < 1e-5


def test_a_program_may_want_balls_and_a_threshold_of_its_own(backend):
    sim = simulation(backend, solids=[BLOCK], boundaries=[POST])
    smooth = gb.render(sim, CAMERA, SIZE)
    sim.scene.surface = "balls"
    assert (sim.scene.surface, sim.scene.threshold, sim.scene.beside) == ("balls", 0.6, ())
    assert sim.scene.octree.build_seconds == 0  # the solver's own tree; nobody took its time
    p, balls = sim.shown_particles, gb.render(sim, CAMERA, SIZE)
    expected = gb.render(gb.Scene(p, **backend), CAMERA, SIZE)
    assert (balls.mask == expected.mask).all()
    assert balls.mask.sum() > smooth.mask.sum()
    sim.scene.surface = "smooth"
    assert (gb.render(sim, CAMERA, SIZE).mask == smooth.mask).all()
    assert sim.scene.octree.build_seconds > 0
    with pytest.raises(ValueError, match="surface: expected smooth or balls, got 'spheres'"):
        sim.scene.surface = "spheres"
    sim = simulation(backend)
    before = gb.render(sim, CAMERA, SIZE).mask.sum()
    sim.scene.threshold = 0.2
    sim.step()
    assert sim.scene.threshold == 0.2
    assert gb.render(sim, CAMERA, SIZE).mask.sum() > before


def test_layers_come_and_go_with_what_is_shown_and_count(backend):
    sim = simulation(backend, solids=[BLOCK], boundaries=[POST])
    everything = gb.render(sim, CAMERA, SIZE)
    sim.phases["water"].shown = sim.phases["post"].shown = False
    sim.step()
    assert sim.scene.beside == ()
    tissue = gb.render(sim, CAMERA, SIZE)
    assert 0 < tissue.mask.sum() < everything.mask.sum()
    sim.phases["tissue"].shown, sim.phases["water"].shown = False, True
    sim.step()
    assert (sim.scene.surface, sim.scene.beside) == ("smooth", ())
    assert (gb.render(sim, CAMERA, SIZE).mask & ~tissue.mask).any()
    sim.phases["tissue"].shown = sim.phases["post"].shown = True
    sim.step()
    assert len(sim.scene.beside) == 2
    again = gb.render(sim, CAMERA, SIZE)
    assert (again.mask == everything.mask).mean() > 0.98  # two steps later
    for name in ("water", "tissue", "post"):
        sim.phases[name].shown = False
    sim.step()
    assert sim.scene.surface == "balls"
    assert not gb.render(sim, CAMERA, SIZE).mask.any()
    sim = simulation(backend, solids=[BLOCK], fluids=[{"name": "water"}])
    assert len(sim.scene.beside) == 1
    before = gb.render(sim, CAMERA, SIZE)
    sim.phases["water"].shown = False
    sim.step(1e-6)
    assert (gb.render(sim, CAMERA, SIZE).mask == before.mask).all()
    sim.phases["water"].shown = True
    sim.add([[0.1, 0.1, 0.1]], "water")
    assert gb.render(sim, CAMERA, SIZE).mask.sum() > before.mask.sum()
    sim = simulation(backend, solids=[BLOCK], boundaries=[POST])
    meshes = [gb.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]) for _ in range(2)]
    frame = gb.render([gb.Layer(sim), meshes[0]], CAMERA, SIZE)
    assert set(np.unique(frame._layer[frame.mask])) <= {0, 1, 2, 3}
    with pytest.raises(ValueError, match="at most 4 layers, got 5"):
        gb.render([gb.Layer(sim), *meshes], CAMERA, SIZE)


def test_white_matter_is_of_the_same_body(tmp_path, backend):
    """A ball of 60 mm whose inner 35 mm are brighter."""
    pytest.importorskip("SimpleITK", reason="the tomography's file needs SimpleITK")
    far = np.linalg.norm(np.mgrid[-8:9, -8:9, -8:9], axis=0) * 5.0
    head = np.where(far < 17.5, 200.0, np.where(far < 30.0, 100.0, 0.0)).astype(np.float32)
    gb.volumes.write_volume(tmp_path / "head.nrrd", gb.volumes.Volume(head, np.diag([5.0, 5.0, 5.0, 1.0])))
    source = {"file": str(tmp_path / "head.nrrd"), "level": 50.0}

    def made(**keys):
        solid = {"name": "brain", "tomography": source | keys, "color": [0.4, 0.3, 0.2]}
        domain = {"lo": [-0.1] * 3, "hi": [0.1] * 3}
        return gb.Simulation({"spacing": 0.005, "domain": domain, "solids": [solid]}, **backend)

    sim = made(white=[0.9, 0.9, 0.8], white_level=150.0)
    assert list(sim.phases) == ["brain", "brain white matter"]
    white, distance = sim.arrays.phase == 1, np.linalg.norm(sim.positions, axis=1)
    assert (white == (distance < 0.0175)).all()
    assert 0 < white.sum() < len(sim) / 2
    plain = made()
    assert list(plain.phases) == ["brain"]
    assert sim.tissue.n_bonds == plain.tissue.n_bonds  # one body
    camera = gb.Camera((0, -0.3, 0), (0, 0, 0), (0, 0, 1), 20)
    frame = gb.render(sim, camera, (48, 48), clips=[gb.ClipPlane((0, -1, 0))])
    middle, rim = frame.albedo[24, 24], frame.albedo[24, 12]
    assert (middle, rim) == (pytest.approx([0.9, 0.9, 0.8], abs=0.02), pytest.approx([0.4, 0.3, 0.2], abs=0.05))
    for keys in ({"white": [1, 1, 1]}, {"white_level": 150.0}):
        with pytest.raises(ValueError, match="white_level of a file, got one"):
            made(**keys)


def test_an_image_reads_no_particles(monkeypatch):
    """They are all of a simulation's arrays: ten times an image's time on a GPU."""
    sim = simulation({"device": "cpu"})
    settings = gb.load_preset("tissue", sim.scene, (0, 0, 1))
    monkeypatch.setattr("globule.sim.arrays.Arrays.particles", lambda self: pytest.fail("read"))
    for what in (sim, sim.scene, [gb.Layer(sim.scene)]):
        assert gb.render(what, CAMERA, SIZE, settings).mask.any()


def devices(backend) -> list[str | None]:
    """Devices for a snapshot: the simulation's own, and another GPU's where there is one."""
    try:
        second = ["cuda:1"] if gb.Scene(np.zeros((1, 3)), device="cuda:1") and backend["device"] == "cuda" else []
    except RuntimeError:
        second = []
    return [None, *second]


@pytest.mark.parametrize("others", [{}, {"solids": [BLOCK], "boundaries": [POST]}], ids=["water", "all"])
def test_a_snapshot_is_the_scene_of_its_time_while_steps_go_on(backend, others):
    sim = simulation(backend, **others)
    snapshots = [sim.snapshot(device) for device in devices(backend)]
    sim.run(0.02)
    before = gb.render(sim, CAMERA, SIZE)
    for snapshot in snapshots:
        snapshot.update()
        assert (len(snapshot), snapshot.builds) == (len(sim), sim.n_steps)
        assert (snapshot.surface, snapshot.support) == (sim.scene.surface, sim.scene.support)
        assert len(snapshot.beside) == len(sim.scene.beside)
    with ThreadPoolExecutor(1) as pool:
        steps = pool.submit(sim.run, 0.02)
        meanwhile = [gb.render(snapshot, CAMERA, SIZE) for snapshot in snapshots]
        steps.result()
    images = [gb.render(snapshot, CAMERA, SIZE) for snapshot in snapshots]
    after = gb.render(sim, CAMERA, SIZE)
    assert before.mask.any()
    if others:
        assert set(np.unique(before._layer[before.mask])) == {0, 1, 2}
    assert (before.image != after.image).any()
    for image in meanwhile:
        np.testing.assert_array_equal(image.image, before.image)
    for snapshot, image in zip(snapshots, images, strict=True):
        np.testing.assert_array_equal(image.image, before.image)
        np.testing.assert_array_equal(image.distance, before.distance)
        snapshot.update()
        np.testing.assert_array_equal(gb.render(snapshot, CAMERA, SIZE).image, after.image)
    for scene in (sim.scene, *sim.scene.beside[:1]):
        scene.threshold = 0.7
    image = gb.render(sim, CAMERA, SIZE).image
    assert (image != after.image).any()
    for snapshot in snapshots:
        snapshot.update()
        np.testing.assert_array_equal(gb.render(snapshot, CAMERA, SIZE).image, image)
    # What was there may come and go, and be drawn as balls.
    sim.scene.surface = "balls"
    sim.remove(sim.arrays.ids[::2])
    image = gb.render(sim, CAMERA, SIZE).image
    for snapshot in snapshots:
        snapshot.update()
        assert (snapshot.surface, len(snapshot)) == ("balls", len(sim))
        assert np.abs(gb.render(snapshot, CAMERA, SIZE).image.astype(int) - image).max() <= 1


def test_a_snapshot_outlives_its_simulation_and_refuses_what_is_the_simulations(backend):
    sim = simulation(backend)
    snapshot = sim.snapshot()
    image = gb.render(sim, CAMERA, SIZE).image
    with pytest.raises(TypeError, match=r"^update: "):
        snapshot.update(np.zeros((3, 3)))
    with pytest.raises(TypeError, match=r"^particles: "):
        _ = snapshot.particles
    with pytest.raises(AttributeError, match=r"^surface: "):
        snapshot.surface = "balls"
    with pytest.raises(AttributeError, match=r"^threshold: "):
        snapshot.threshold = 0.7
    with pytest.raises((ValueError, RuntimeError), match=r"device|cuda"):
        sim.snapshot("cpu" if backend["device"] == "cuda" else "cuda")
    assert np.array_equal(gb.render(snapshot, CAMERA, SIZE).image, image)
    del sim
    gc.collect()
    assert np.array_equal(gb.render(snapshot, CAMERA, SIZE).image, image)
