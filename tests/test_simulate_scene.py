"""Scene files: what they hold, and the line of every mistake."""

import numpy as np
import pytest
from globule import Particles, write
from globule.sim.bodies import bodies
from globule.sim.rigidity import rigidity_of_young, young_of_rigidity
from globule.sim.sampling import BEHIND
from globule.sim.scene_read import SHIPPED, read_scene
from globule.sim.schema import SceneError
from globule.sim.toml_lines import key_lines

SCENE = """\
spacing = 0.1
gravity = [0, 0, -9.81]   # m/s²

[domain]
lo = [0, 0, 0]
hi = [1, 1, 1]
walls = true

[[fluids]]
name = "water"
viscosity = 0.001
box = { lo = [0, 0, 0], hi = [0.5, 0.5,
    0.5] }

[[solids]]
name = "jelly"
young = 3000
sphere.center = [0.7, 0.7, 0.7]
sphere.radius = 0.2

[[instruments]]
name = "knife"
kind = "scalpel"
length = 0.1
keys = [
  { time = 0, position = [0, 0, 1] },
  { time = 1, position = [1, 0, 1], axis = [0, 0, 1], angle = 90 },
]
"""


def scene(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(("old", "new", "expected"), [
    ("0.001", "-1", ":11: fluids[0].viscosity: expected a number from 0 to 1e+09, got -1"),
    ("0.5] }", "'x'] }", ":13: fluids[0].box.hi[2]: expected a number from -1e+06 to 1e+06"),
    ("young", "yung", ":17: solids[0].yung: expected one of name, box, "),
    ("= 0.2", "= true", ":19: solids[0].sphere.radius: expected a number above 0, at most"),
    ("time = 1", "time = 0", ":27: instruments[0].keys[1].time: expected more than 0, got 0"),
    ("length = 0.1", "", ":21: instruments[0]: a scalpel: expected edge or length, got none"),
    ('"jelly"', '"water"', ":16: solids[0].name: expected a name of its own, got 'water'"),
    ("spacing = 0.1", "", ": expected the key spacing, got none"),
    ("hi = [1, 1, 1]", "hi = [0, 1, 1]", ":4: domain: expected lo below hi in each axis"),
    ("[domain]", "[domain", ":4: expected TOML, got: "),
    ("young = 3000", "mesh = { file = 'no.obj' }", ":15: solids[0]: expected one"),
    ("[[instruments]]", "[[solids]]\nname = 'bone'\nmesh.file = 'no.obj'\n[[instruments]]",
     ":23: solids[1].mesh.file: expected a file, got /"),
])  # fmt: skip
def test_a_mistake_is_one_line_with_its_place(tmp_path, old, new, expected):
    path = scene(tmp_path, SCENE.replace(old, new, 1))
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert str(caught.value).startswith(f"{path}{expected}")
    assert "\n" not in str(caught.value)


def test_lines_of_all_that_toml_can_write():
    text = '''a = """x
# no comment, [no] table
"""
b.c = 'y#'   # [d]
[t."quo.ted"]
l = [ # first
  1,
  { k = [2,
  3] }, ]
[[u]]
[[u]]
v = 1979-05-27 07:32:00
[u.w]
z = {}
'''
    lines = key_lines(text)
    assert lines[("a",)] == 1
    assert lines[("b",)] == lines[("b", "c")] == 4
    assert (lines[("t", "quo.ted", "l", 0)], lines[("t", "quo.ted", "l", 1, "k")]) == (7, 8)
    assert lines[("t", "quo.ted", "l", 1, "k", 1)] == 9
    assert (lines[("u", 0)], lines[("u", 1)], lines[("u", 1, "v")]) == (10, 11, 12)
    assert (lines[("u", 1, "w")], lines[("u", 1, "w", "z")]) == (13, 14)


def test_bodies_of_a_scene_and_the_rigidity_of_nine_columns(tmp_path):
    found = {body.name: body for body in bodies(read_scene(scene(tmp_path, SCENE)))}
    assert [body.kind for body in found.values()] == ["fluid", "tissue", "boundary"]
    assert len(found["water"].positions) == 125
    assert np.allclose(found["water"].positions.min(axis=0), 0.05)
    walls, ends = found["walls"].positions, [-0.1 * BEHIND, 1 + 0.1 * BEHIND]
    assert len(walls) == 12**3 - 10**3
    assert np.allclose([walls.min(), walls.max()], ends)
    assert (found["jelly"].young == 3000).all()
    assert not found["jelly"].fixed.any()
    positions = [[0.1 * i + 0.05, 0.5, 0.5] for i in range(4)]
    write(tmp_path / "p.txt", Particles(positions, rigidity=np.array([0, 0.3, 0.8, 1])))
    text = SCENE + '[[solids]]\nname = "all"\nparticles.file = "p.txt"\n'
    parts = [body for body in bodies(read_scene(scene(tmp_path, text))) if len(body.positions) < 4]
    tissue, liquid = parts
    assert (tissue.name, tissue.kind, liquid.name, liquid.kind) == ("all", "tissue", "water", "fluid")
    assert np.allclose(liquid.positions, [[0.05, 0.5, 0.5]])
    assert tissue.fixed.tolist() == [False, False, True]
    assert np.allclose(tissue.young[:2], [100 * 10**1.2, 100 * 10**3.2])
    assert np.allclose(young_of_rigidity([0.25, 0.5]), [1e3, 1e4])
    assert np.allclose(rigidity_of_young(young_of_rigidity([0.1, 0.5, 0.9])), [0.1, 0.5, 0.9])


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n == "brain-surgery")) for n in SHIPPED])
def test_shipped_scenes_are_sound(name):
    found = read_scene(name)
    lo, hi = np.asarray(found.domain.lo), np.asarray(found.domain.hi)
    if name == "brain-surgery":
        pytest.importorskip("nilearn")
    made = bodies(found)
    assert made
    assert found.title
    for body in made:
        if body.kind != "boundary":
            assert ((body.positions > lo) & (body.positions < hi)).all()


@pytest.mark.parametrize(("kind", "name"), [
    ("fluids", "walls"), ("boundaries", "walls"), ("fluids", "brain white matter"),
])  # fmt: skip
def test_names_that_globule_gives_are_taken(kind, name):
    brain = {"name": "brain", "tomography": {"atlas": "mni152", "white": "#f7ece0"}}
    body = {"name": name, "sphere": {"center": [0.5, 0.5, 0.5], "radius": 0.3}}
    domain = {"lo": [0, 0, 0], "hi": [1, 1, 1], "walls": True}
    words = {"spacing": 0.1, "domain": domain, "solids": [brain], kind: [body]}
    with pytest.raises(SceneError, match=rf"\.name: expected a name of its own, got '{name}', the"):
        read_scene(words)
    if name == "walls":
        read_scene(words | {"domain": domain | {"walls": False}})
