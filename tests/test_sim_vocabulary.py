"""A scene is one thing: from a file, in a dict and in Python, with every key of every table."""

import dataclasses
import json
import re
import sys
from pathlib import Path

import globule as gb
import numpy as np
import pytest
import tomli_w
from globule._base.settings import Table, settings_of
from globule._base.structured import parse_toml
from globule.sim import instruments, scene_bodies, scene_file
from globule.sim.scene_file import LISTS
from globule.sim.scene_read import FOLDER, SHIPPED, as_dict, read_scene
from sim_helpers import tables

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "docs" / "site"))

import reference

# Together they give every key of every table a value other than its default. The module's fixture
# `folder` makes the files.
BOX = {"lo": [0.1, 0.1, 0.1], "hi": [0.4, 0.4, 0.4]}
LOOK = {"color": "#204060", "reflection": 0.25, "refraction": 0.5}
RUBBING = {"adhesion": 0.05, "friction": 0.4}
POSE = {"position": [0.1, 0, 0], "axis": [0, 0, 1], "angle": 30.0, "on": False}


def ball(x: float) -> dict:
    return {"sphere": {"center": [x, 0.3, 0.3], "radius": 0.1}}


def rod(x: float) -> dict:
    return {"cylinder": {"start": [x, 0.2, 0.3], "end": [x, 0.4, 0.3], "radius": 0.1}}


def mesh(x: float, **more) -> dict:
    return {"mesh": {"file": "box.obj", "move": [x, 0, 0], **more}}


FLUIDS = {
    "title": "One", "spacing": 0.05, "gravity": [0, -3, 0], "seconds": 0.5, "fine_fluids": True,
    "domain": {"lo": [0, 0, 0], "hi": [2.4, 0.6, 0.6], "walls": True, "open": ["+z"],
               "periodic": ["x"]},
    "solver": {"method": "wcsph", "max_error": 0.01, "divergence_error": 0.02,
               "viscosity_error": 0.01, "min_iterations": 3, "max_iterations": 50, "cfl": 0.5,
               "max_dt": 0.002, "sound_speed": 20.0, "extra_viscosity": 0.5},
    "fluids": [
        {"name": "water", "box": BOX, "density": 900.0, "viscosity": 2.0, "surface_tension": 0.05,
         "velocity": [0, 0, -1], "shown": False, **LOOK},
        {"name": "oil", **ball(0.7)},
        {"name": "honey", **rod(1.1)},
        {"name": "milk", "particles": {"file": "p.npz", "scale": 1.2, "move": [1.5, 0.1, 0.1]}},
    ],
    "emitters": [{"name": "tap", "fluid": "water", "center": [2.1, 0.4, 0.3], "radius": 0.1,
                  "direction": [0, 1, 0], "rate": 0.02, "start": 0.01, "end": 0.02}],
    "sinks": [{"name": "drain", **ball(2.1)}, {"name": "gap", "box": BOX}],
    "foam": {"approach": [0.5, 2.0], "curvature": [0.25, 1.0], "speed": [0.5, 5.0], "seed": 1,
             "air_rate": 50.0, "crest_rate": 40.0, "lifetime": 3.0, "max_particles": 10},
    "view": {"eye": [1, 0, 1], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 30.0, "ground": -1.0,
             "look": "water", "speeds": [0, 2], "size": [64, 48]},
    "output": {"fps": 60.0, "format": "ply"},
}  # fmt: skip
TISSUE = {
    "spacing": 0.05, "domain": {"lo": [0, 0, 0], "hi": [5, 0.6, 0.6]},
    "fluids": [{"name": "blood"}],
    "solids": [
        {"name": "jelly", "box": BOX, "density": 900.0, "young": 9000.0, "poisson": 0.3,
         "relaxation": [{"share": 0.5, "time": 2.0}], "viscosity": 2.0, "surface_tension": 0.05,
         "damping": 3.0, "tear": 0.5, "plastic": 0.1, "creep": 2.0, "friction": 0.3,
         "fixed": [{"box": {**BOX, "hi": [0.4, 0.4, 0.2]}}], "velocity": [0, 0, -1],
         "shown": False, **LOOK},
        {"name": "fat", **ball(0.8), "fixed": [ball(0.8)]},
        {"name": "muscle", **rod(1.2), "fixed": [rod(1.2)]},
        {"name": "skin", "particles": {"file": "p.npz", "move": [1.5, 0.1, 0.1]}},
    ],
    "boundaries": [
        {"name": "floor", "box": {"lo": [1.9, 0.1, 0.1], "hi": [2.1, 0.3, 0.3]}, "hollow": True,
         "open": ["+z"], "keys": [{"time": 0.25, **POSE}], "shown": True, **RUBBING, **LOOK},
        {"name": "knob", **ball(2.4)},
        {"name": "rod", **rod(2.7)},
        {"name": "slope", "plane": {"point": [0, 0, 0.02], "normal": [0, 0.1, 1]}},
    ],
    "rigids": [
        {"name": "raft", "box": {"lo": [3, 0.1, 0.1], "hi": [3.2, 0.3, 0.3]}, "density": 300.0,
         "velocity": [0, 0, 1], "spin": [0, 1, 0], "shown": False, **RUBBING, **LOOK},
        {"name": "cork", **ball(3.5)},
        {"name": "log", **rod(3.9)},
    ],
    "vessels": [{"name": "vein", "solid": "jelly", "fluid": "blood", "radius": 0.06, "pool": 1e-3,
                 "path": [[0.1, 0.2, 0.2], [0.4, 0.2, 0.2]], "pressure": 4000.0}],
    "instruments": [
        {"name": "knife", "kind": "scalpel", "length": 0.1, "keys": [{"time": 0.25, **POSE}]},
        {"name": "blade", "kind": "scalpel", "edge": [[0, 0, 0], [0, 0, 0.1]],
         "keys": [{"time": 0.0}]},
        {"name": "sucker", "kind": "suction", "radius": 0.1, "ablates": True,
         "keys": [{"time": 0.0}]},
    ],
}  # fmt: skip
FILES = {
    "spacing": 0.05, "domain": {"lo": [-1, -1, -1], "hi": [5, 1, 1]},
    "fluids": [{"name": "water", "implicit": True, **mesh(0.05, scale=1.2)}],
    "solids": [
        {"name": "brain", "model": "bonds", "implicit": True,
         "tomography": {"file": "head.nrrd", "level": 0.4, "scale": 0.002, "white_level": 0.5,
                        "center": [1, 0.2, 0.1], "white": [1, 1, 0.9]}},
        {"name": "bone", "model": "bonds", "rigidity": 0.5,
         "tomography": {"file": "head.nrrd", "labels": [1], "center": [2, 0, 0]}},
        {"name": "cast", "model": "bonds", **mesh(2.5)},
    ],
    "boundaries": [
        {"name": "hole", "distance": {"file": "hole.npz", "scale": 1.2, "move": [3, 0, 0]}},
        {"name": "wheel", "sphere": {"center": [0.3, 0.3, 0.3], "radius": 0.1}, "velocity": [0.1, 0, 0],
         "spin": [0, 0, 1], "about": [0.3, 0.3, 0.3]},
        {"name": "wall", **mesh(3.5)},
    ],
    "rigids": [{"name": "raft", **mesh(4)}],
}  # fmt: skip
ATLAS = {
    "spacing": 0.05, "domain": {"lo": [0, 0, 0], "hi": [0.6, 0.5, 0.4]},
    "solids": [{"name": "brain", "tomography": {"atlas": "mni152", "center": [0.3, 0.25, 0.2]}}],
}  # fmt: skip
SCENES = {"fluids": FLUIDS, "tissue": TISSUE, "files": FILES, "atlas": ATLAS}
PACKAGES = {"files": "trimesh", "atlas": "nilearn"}
TABLES = {kind.__name__: kind for kind in tables()}
ROWS = {
    ("SceneFile", "fluids"): scene_bodies.Fluid, ("SceneFile", "solids"): scene_bodies.Solid,
    ("SceneFile", "boundaries"): scene_bodies.Boundary, ("SceneFile", "rigids"): scene_bodies.Rigid,
    ("SceneFile", "instruments"): instruments.Instrument, ("SceneFile", "sinks"): scene_file.Sink,
    ("SceneFile", "emitters"): scene_file.Emitter, ("SceneFile", "vessels"): scene_file.Vessel,
    ("Solid", "fixed"): scene_bodies.Shape, ("Boundary", "keys"): instruments.Key,
    ("Instrument", "keys"): instruments.Key,
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder to be in, with files of every kind that a scene names."""
    path = tmp_path_factory.mktemp("scene")
    at = np.mgrid[0:3, 0:3, 0:3].reshape(3, -1).T * 0.05 + 0.1
    gb.write(path / "p.npz", gb.Particles(at, attributes={"velocity": 0 * at}))
    ball = 0.1 - np.linalg.norm(np.mgrid[-6:7, -6:7, -6:7] * 0.02, axis=0)
    world = np.diag([0.02, 0.02, 0.02, 1])
    world[:3, 3] = 0.1
    gb.volumes.write_volume(path / "hole.npz", gb.volumes.Volume(-ball.astype(np.float32), world))
    head = (ball > 0).astype(np.uint8)
    gb.volumes.write_volume(path / "head.nrrd", gb.volumes.Volume(head, np.diag([20.0, 20.0, 20.0, 1])))
    corners = [f"v {x} {y} {z}" for x in (0, 0.3) for y in (0, 0.3) for z in (0, 0.3)]
    sides = ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
    (path / "box.obj").write_text("\n".join([*corners, *sides]))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(path)
        yield path


def in_python(scene: dict) -> gb.Simulation:

    def table(kind, values):
        made = {}
        for field in dataclasses.fields(kind):
            if field.name not in values:
                continue
            made[field.name] = value = values[field.name]
            inner = [t for name, t in TABLES.items() if name in str(field.type)]
            if isinstance(value, dict):
                made[field.name] = table(inner[0], value)
            elif (kind.__name__, field.name) in ROWS:
                made[field.name] = [table(ROWS[kind.__name__, field.name], one) for one in value]
        return kind(**made)

    found = table(scene_file.SceneFile, scene)
    return gb.Simulation(**{name: getattr(found, name) for name in scene}, device="cpu")


def facts(sim: gb.Simulation) -> dict:
    """Everything that a simulation starts from, and where two steps bring it."""
    start = {"scene": as_dict(sim.file), "by_hand": sim._by_hand(), "hash": sim.hash()}
    sim.step(0.001)
    sim.step(0.001)
    return json.loads(json.dumps({**start, "later": sim.hash()}))


def not_default(table) -> set[tuple[str, str]]:
    """The keys of a table, and of those in it, that have another value than by default."""
    found = set()
    for field in dataclasses.fields(table):
        value, usual = getattr(table, field.name), field.default
        if field.default_factory is not dataclasses.MISSING:
            usual = field.default_factory()
        if field.metadata and value != usual:
            found.add((type(table).__name__, field.name))
        for one in value if isinstance(value, list) else [value]:
            found |= not_default(one) if isinstance(one, Table) else set()
    return found


@pytest.mark.parametrize("name", [*SCENES][:-1] + [pytest.param("atlas", marks=pytest.mark.slow)])
def test_a_key_means_the_same_in_a_file_a_dict_and_python(name, folder):
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name])
    (folder / "scene.toml").write_text(tomli_w.dumps(SCENES[name]))
    of_file, of_dict, of_python = (
        facts(sim)
        for sim in (
            gb.Simulation("scene.toml", device="cpu"),
            gb.Simulation(SCENES[name], device="cpu"),
            in_python(SCENES[name]),
        )
    )
    assert (of_file, of_file) == (of_dict, of_python)


def test_the_scenes_have_every_key_and_defaults_are_those_of_the_tables(folder):
    """Each with a value other than its default, which is what the test above compares."""
    found = set()
    for scene in SCENES.values():
        found |= not_default(read_scene(scene))
    assert found == {
        (kind, field.name) for kind, table in TABLES.items() for field in dataclasses.fields(table) if field.metadata
    }
    assert {name for kind, name in ROWS if kind == "SceneFile"} == set(LISTS)
    domain = {"lo": [0, 0, 0], "hi": [0.6, 0.5, 0.4]}
    tables = {"fluids": "fluid", "solids": "tissue", "boundaries": "boundary", "rigids": "rigid"}
    for name, kind in tables.items():
        sim = gb.Simulation(spacing=0.05, domain=domain, **{name: [{"name": "a"}]})
        assert vars(sim.phases["a"]) == vars(gb.sim.Phase("a", kind=kind))
    assert sim.settings.gravity == (0.0, 0.0, -9.81)
    assert not sim.settings.domain.walls
    fluid = gb.Simulation(gb.Particles(np.mgrid[0:3, 0:3, 0:3].reshape(3, -1).T * 0.05))
    assert fluid.settings.gravity == sim.settings.gravity
    assert gb.sim.Phase("oil", viscosity=1.0).implicit
    assert not gb.sim.Phase("oil").implicit


def test_every_key_is_on_the_page_and_in_the_schema():
    page = reference.scene_pages()["reference/scene-keys.md"]
    first = [row.split(" | ")[0] for row in page.splitlines() if row.startswith("| ")]
    named = {re.sub(r"\W", "", word) for cell in first for word in re.split("[,:]", cell)}
    assert len(tables()) > 20
    for kind in tables() - {scene_bodies.Shape, scene_bodies.Relaxation}:
        assert set(settings_of(kind)) <= named, kind
        assert kind.__doc__
        for name, one in settings_of(kind).items():
            assert one.help, (kind, name)
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(reference.scene_pages()["reference/scene.schema.json"])
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    for name in SHIPPED:
        scene = parse_toml((FOLDER / f"{name}.toml").read_text())
        check.validate(scene)
        for wrong in ({"spacing": -1}, {"spacin": 1}, {"solver": {"cfl": "x"}}, {"fluids": [{}]}):
            assert not check.is_valid(scene | wrong), wrong
