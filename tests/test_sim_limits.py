"""Scenes whose keys make no sense together are refused before anything is made."""

import globule as gb
import numpy as np
import pytest
from globule.sim import room
from globule.sim.bodies import bodies
from globule.sim.scene_read import read_scene
from globule.sim.schema import SceneError

SCENE = """\
spacing = 0.05
domain = { lo = [0, 0, 0], hi = [1, 0.4, 0.8], walls = true }
[[fluids]]
name = "water"
box = { lo = [0, 0, 0], hi = [0.4, 0.4, 0.4] }
"""
BOX = "{ lo = [0, 0, 0], hi = [0.4, 0.4, 0.4] }"
AWAY = "{ lo = [5, 5, 5], hi = [6, 6, 6] }"
PLATE = """
[[boundaries]]
name = "b"
sphere = """
VEIN = f"""
[[solids]]
name = "s"
box = {BOX}
[[vessels]]
name = "v"
solid = "s"
fluid = "water"
pool = 1e-3
path = [[0.5, 0, 0.2], [0.7, 0.4, 0.2]]
radius = 0.05
"""
TAP = """\
[[emitters]]
name = "tap"
fluid = "water"
center = [0.5, 0.2, 0.5]
direction = [0, 0, 1]
radius = 0.1
rate = 0.01
"""


@pytest.mark.parametrize(("old", "new", "expected"), [
    (BOX, AWAY, r":5: fluids\[0\].box: expected a place in the domain, \(0, 0, 0\) to"),
    (BOX, BOX + f'\n[[solids]]\nname = "s"\nbox = {AWAY}', r":8: solids\[0\].box: expected"),
    ("[0.5, 0.2, 0.5]", "[5, 5, 5]", r":9: emitters\[0\].center: expected a place in"),
    (BOX, "{ lo = [0, 0, 0], hi = [1e-9, 1, 1] }", r"box: expected at least a spacing, 0.05 m"),
    (BOX, BOX + f'\n[[fluids]]\nname = "air"\ndensity = 1.2\nbox = {BOX}',
     r":8: fluids\[1\].density: expected 20 to 50000 kg/m³ beside a density of 1000 kg/m³ "
     r"\(a ratio of at most 50\), got 1.2"),
    (BOX, BOX + "\nviscosity = 1e9\nimplicit = false", r"viscosity: expected steps of .* or set implicit"),
    ("0.01", "1e6", r"emitters\[0\].rate: expected steps of .* got a value that needs .* s; lower it"),
    ("domain", "solver.max_dt = 1e-30\ndomain", r":2: solver.max_dt: expected steps of .*; raise it"),
    ("domain", "seconds = 0.01\ndomain", r":2: seconds: expected at least a frame, 0.0333333"),
    ("walls = true", "walls = true, open = ['+x', '-z'], periodic = ['z']",
     r":2: domain.open\[1\]: expected faces of axes that end, got '-z' with periodic \['z'\]"),
    (BOX, BOX + PLATE + "{ center = [0.5, 0.2, 0.5], radius = 0.02 }",
     r":8: boundaries\[0\].sphere: expected at least a spacing, 0.05 m, .* got 0.04"),
    (BOX, BOX + VEIN, r":14: vessels\[0\].path: expected a course through s, \(0, 0, 0\) to "
     r"\(0.4, 0.4, 0.4\), got one that passes 0.1 m beside it"),
    ("center = [0.5, 0.2, 0.5]\ndirection = [0, 0, 1]", "center = [0.5, 0.2, 0.79]\n"
     "direction = [0, 1, 2]", r":10: emitters\[0\].direction: expected a way into the domain, "
     r"got \(0, 0.447214, 0.894427\), into its wall \+z, 0.01 m away"),
    ("domain", "view = { eye = [1, 0, 0], look_at = [1, 0, 0] }\ndomain", "view.look_at: exp"),
    ("domain", "view.speeds = [2, 0]\ndomain", "view.speeds: expected"),
    (BOX, BOX + f'\n[[solids]]\nname = "s"\nbox = {BOX}\nyoung = 1e13\npoisson = 0.49\n'
     "density = 0.1", r":9: solids\[0\].young: expected at most 100,000 substeps in a step of "
     "0.005 s, got a modulus that needs .*; lower it"),
    ("domain", f"solids = [{{name = 's', box = {BOX}, young = 9e12, density = 0.1}}]\n"
     "solver.max_dt = 0.0001\ndomain",
     r"young: expected at most 1,000,000 substeps in a frame of 0.0333 s"),
    (BOX, BOX + f'\n[[solids]]\nname = "s"\nbox = {BOX}\n[[solids]]\nname = "t"\nbox = {BOX}'
     '\nmodel = "bonds"', r":12: solids\[1\].model: expected 'solid' as of solids\[0\]"),
    ("0.05", "1e-7", r":1: spacing: expected at least 7.63e-06 in a domain up to 1 m from the"),
    (BOX, BOX + PLATE + "{ center = [5, 5, 5], radius = 1 }",
     r":8: boundaries\[0\].sphere: expected a place in the domain, \(0, 0, 0\) to"),
    ("domain", "solver = { method = 'wcsph', sound_speed = 1e9 }\ndomain",
     r":2: solver.sound_speed: expected steps of .*; lower it"),
    ("domain", "solver = { min_iterations = 9, max_iterations = 5 }\ndomain",
     r":2: solver.min_iterations: expected at most max_iterations, 5, got 9"),
    ("domain", "instruments = [{ name = 'k', kind = 'scalpel', keys = [{ time = 0 }], "
     "edge = [[0, 0, 1], [0, 0, 1]] }]\ndomain",
     r":2: instruments\[0\].edge: expected points apart, got \(0.0, 0.0, 1.0\) 2 times"),
    ("rate = 0.01", "rate = 0.01\nstart = 2\nend = 1", r":14: emitters\[0\].end: expected more than start, 2 s, got 1"),
    ("0.05", "1" + 5000 * "0", r": expected TOML, got: expected numbers of at most 4,300 "),
])  # fmt: skip
def test_what_makes_no_sense_names_its_key(tmp_path, old, new, expected):
    path = tmp_path / "scene.toml"
    path.write_text((SCENE + TAP).replace(old, new, 1))
    with pytest.raises(SceneError, match=expected):
        read_scene(path)


@pytest.mark.parametrize(("more", "named", "n"), [
    (f'[[solids]]\nname = "s"\nbox = {BOX}', "solids[0] (s)", "5.12e+08"),
    ('[[boundaries]]\nname = "b"\nhollow = true\nsphere = { center = [0, 0, 0], radius = 500 }',
     "boundaries[0] (b)", "1.26e+13"),
    (TAP.replace("0.1", "1e5"), "emitters[0] (tap)", "1.26e+17"),
    (TAP.replace("0.01", "10"), "emitters[0] (tap)", "8e+10"),
], ids=["solid", "boundary", "disc", "rate"])  # fmt: skip
def test_particles_without_memory_are_counted_not_made(tmp_path, monkeypatch, more, named, n):
    monkeypatch.setattr(room, "room", lambda: 2**30)
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.replace("0.05", "0.0005") + more)
    with pytest.raises(SceneError) as caught:
        gb.Simulation(path, device="cpu")
    message = str(caught.value)
    assert message.startswith(f"{path}: {named}: expected particles that fit in the 1 GiB")
    assert f"got about {n} that need" in message


def test_what_only_looks_like_it_is_taken(tmp_path):
    """A vessel beside its solid by less than its radius, a tap away from its wall or at one that
    is open, a plate of one spacing."""
    path = tmp_path / "scene.toml"
    words = SCENE + VEIN.replace("0.5, 0,", "0.44, 0,") + TAP.replace("0, 0, 1]", "0, 0, -1]")
    words = words.replace("[0.5, 0.2, 0.5]", "[0.5, 0.2, 0.79]") + PLATE
    words += "{ center = [0.8, 0.2, 0.5], radius = 0.025 }\n"
    path.write_text(words + TAP.replace('"tap"', '"tip"'))
    assert len(read_scene(path).emitters) == 2
    words = SCENE.replace("walls = true", "walls = true, open = ['+z']")
    path.write_text(words + TAP.replace("[0.5, 0.2, 0.5]", "[0.5, 0.2, 0.79]"))
    assert len(read_scene(path).emitters) == 1
    path = tmp_path / "scene.toml"
    for plate in (
        PLATE.replace("sphere", "box") + "{ lo = [0, 0, -0.2], hi = [1, 0.4, -0.01] }",
        "[[boundaries]]\nname = 'b'\nkeys = [{ time = 0 }]\nsphere = { center = [5, 5, 5], radius = 1 }",
    ):
        path.write_text(SCENE + plate)
        assert len(bodies(read_scene(path))) == 3


def test_the_spacing_that_would_fit_does_and_steps_that_vanish_stop(tmp_path, monkeypatch):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    monkeypatch.setattr(room, "room", lambda: 2**20)
    with pytest.raises(SceneError, match=r"a spacing of ([\d.]+) m would fit") as caught:
        bodies(read_scene(path))
    words = str(caught.value).split()
    fits = float(words[words.index("spacing") + 2])
    assert 0.05 < fits < 0.1
    n = sum(len(body.positions) for body in bodies(read_scene(path, fits)))
    assert n * room.BYTES["fluids"] == pytest.approx(2**20, rel=0.3)
    sim = gb.Simulation("dam-break", spacing=0.1, device="cpu")
    sim.velocities = (0.0, 0.0, 1e30)
    with pytest.raises(ArithmeticError, match=r"steps come to 0 s .* lower speeds .*1e\+30"):
        sim.run(0.1)


@pytest.mark.parametrize("kind", ["fluids", "boundaries"])
def test_a_mesh_out_of_the_domain_or_with_holes_is_refused(tmp_path, kind):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(2, 0.1).export(tmp_path / "ball.stl")
    mesh = {"file": str(tmp_path / "ball.stl"), "move": [9, 9, 9]}
    domain = {"lo": [0, 0, 0], "hi": [1, 1, 1]}
    scene = {"spacing": 0.05, "domain": domain, kind: [{"name": "b", "mesh": mesh}]}
    with pytest.raises(SceneError, match=rf"{kind}\[0\] \(b\): .* got all outside of it"):
        gb.Simulation(scene, device="cpu")
    mesh["move"] = [0.5, 0.5, 0.5]
    sim = gb.Simulation(scene, device="cpu")
    assert np.allclose(sim.positions.mean(axis=0), 0.5, atol=0.01)
    ball = trimesh.creation.icosphere(2, 0.1)
    ball.update_faces(ball.triangles_center[:, 2] < 0.06)
    ball.export(tmp_path / "ball.stl")
    if kind == "boundaries":  # its surface counts
        assert len(gb.Simulation(scene, device="cpu").positions) > 0
        return
    with pytest.raises(SceneError, match=rf"{kind}\[0\] \(b\): expected a closed mesh, got holes"):
        gb.Simulation(scene, device="cpu")


KINDS = {"fluids": "fluid", "solids": "tissue", "rigids": "rigid"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_body_partly_out_of_the_domain_is_refused(kind):
    domain = {"lo": [0, 0, 0], "hi": [1, 1, 1]}
    body = {"name": "b", "box": {"lo": [0.5, 0, 0], "hi": [1.2, 0.5, 0.5]}}
    scene = {"spacing": 0.05, "domain": domain, kind: [body]}
    message = rf"{kind}\[0\] \(b\): expected particles in the domain, got 400 of 1,400 outside"
    for domain["periodic"] in ([], ["x"]):
        with pytest.raises(SceneError, match=message):
            gb.Simulation(scene, device="cpu")
    body["box"] = {"lo": [0.5, 0, 0], "hi": [1.0, 0.5, 0.5]}
    assert gb.Simulation(scene, device="cpu").record.counts[KINDS[kind]] == 1000


def test_tissue_is_fixed_where_it_is():
    solid = {"name": "s", "box": {"lo": (0, 0, 0), "hi": (0.4, 0.4, 0.4)}}
    solid["fixed"] = [{"sphere": {"center": (0.2, 0.2, 0.2), "radius": 0.1}},
                      {"sphere": {"center": (0.9, 0.2, 0.2), "radius": 0.1}}]  # fmt: skip
    domain = {"lo": (0, 0, 0), "hi": (1, 1, 1)}
    with pytest.raises(SceneError, match=r"solids\[0\] \(s\): fixed\[1\]: expected a shape with"):
        bodies(read_scene({"spacing": 0.05, "domain": domain, "solids": [solid]}))
    del solid["fixed"][1]
    solid["fixed"][0] = {"box": {"lo": (0, 0, -0.1), "hi": (0.4, 0.4, 0.02)}}
    with pytest.warns(UserWarning, match=r"s: fixed\[0\]: .* at a spacing of 0.05 m: nothing"):
        bodies(read_scene({"spacing": 0.05, "domain": domain, "solids": [solid]}))


@pytest.mark.parametrize("kind", ["fluids", "rigids"])
def test_bodies_in_one_place_are_both_named(kind):
    pool = {"name": "pool", "box": {"lo": (0, 0, 0), "hi": (1, 1, 0.5)}}
    other = {"name": "other", "box": {"lo": (0.12, 0.1, 0.03), "hi": (0.92, 0.9, 0.43)}}
    scene = {"spacing": 0.05, "domain": {"lo": (0, 0, 0), "hi": (1, 1, 1)}, "fluids": [pool]}
    expected = rf"{kind}\[.\] \(other\): expected room beside fluids\[0\] \(pool\), got particles"
    small = {"name": "other", "sphere": {"center": (0.5, 0.5, 0.25), "radius": 0.05}}  # of a large pool's volume 0.1 %
    for within in (other, small):
        with pytest.raises(SceneError, match=expected):
            bodies(read_scene(scene | {kind: [*scene.get(kind, ()), within]}))
    other["box"] |= {"lo": (0.1, 0.1, 0.5), "hi": (0.9, 0.9, 0.9)}
    assert len(bodies(read_scene(scene | {kind: [*scene.get(kind, ()), other]}))) == 2
