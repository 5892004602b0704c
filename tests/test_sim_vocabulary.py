"""A scene is one thing: from a file, in a dict and in Python, key by key."""

from __future__ import annotations

import dataclasses
import json

import globule as gb
import numpy as np
import pytest
import tomli_w
from globule.sim import instruments, scene_file, shapes, sources
from globule.sim.scene_file import LISTS, as_dict
from globule.sim.schema import Table

BOX = {"lo": [0, 0, 0], "hi": [0.3, 0.3, 0.3]}
BALL = {"center": [0.2, 0.2, 0.2], "radius": 0.15}
ROLL = {"start": [0.1, 0.1, 0.1], "end": [0.1, 0.3, 0.1], "radius": 0.1}
KEYS = [{"time": 0.0, "position": [0, 0, 0]}, {"time": 0.5, "position": [0.1, 0, 0]}]
LEAST = {
    "spacing": 0.05,
    "domain": {"lo": [0, 0, 0], "hi": [0.6, 0.5, 0.4]},
    "fluids": [{"name": "water", "sphere": {"center": [0.5, 0.4, 0.3], "radius": 0.08}}],
}
SOLID = {"name": "jelly", "box": BOX}
WALL = {"name": "wall", "box": BOX}
RAFT = {"name": "raft", "box": BOX}
TAP = {"name": "tap", "fluid": "water", "center": [0.4, 0.3, 0.2], "direction": [0, 0, -1],
       "radius": 0.1, "rate": 0.02}  # fmt: skip
DRAIN = {"name": "drain", "sphere": {"center": [0.2, 0.2, 0.1], "radius": 0.1}}
VEIN = {"name": "vein", "solid": "jelly", "fluid": "water",
        "path": [[0, 0.1, 0.1], [0.3, 0.1, 0.1]], "radius": 0.06, "pool": 1e-3}  # fmt: skip
KNIFE = {"name": "tool", "kind": "scalpel", "length": 0.1, "keys": KEYS}
SUCTION = {"name": "tool", "kind": "suction", "radius": 0.1, "keys": KEYS}
IMAGE = [("color", "#204060"), ("reflection", 0.25), ("refraction", 0.5), ("shown", None)]
FILES = {
    "mesh": "ball.stl",
    "particles": "p.npz",
    "distance": "hole.npz",
    "tomography": "head.nrrd",
}


def near(table, key, value, **more):
    """One table of a list with a key that is not its default."""
    return [{**table, **more, key: value}]


# What to add to LEAST so that a key of a table has a value other than its default.
CASES = {
    "SceneFile": {
        "spacing": {"spacing": 0.04}, "domain": {"domain": {**LEAST["domain"], "lo": [0, 0, -0.1]}},
        "title": {"title": "One"}, "gravity": {"gravity": [0, -3, 0]}, "seconds": {"seconds": 0.5},
        "fine_fluids": {"fine_fluids": True},
        "solver": {"solver": {"cfl": 0.5}}, "fluids": {"fluids": [{"name": "oil", "box": BOX}]},
        "solids": {"solids": [SOLID]}, "boundaries": {"boundaries": [WALL]},
        "rigids": {"rigids": [RAFT]}, "instruments": {"instruments": [KNIFE]},
        "emitters": {"emitters": [TAP]}, "sinks": {"sinks": [DRAIN]},
        "vessels": {"solids": [SOLID], "vessels": [VEIN]}, "foam": {"foam": {}},
        "view": {"view": {"fov": 30.0}}, "output": {"output": {"fps": 60.0}},
    },
    "Domain": {
        k: {"domain": {**LEAST["domain"], **v}}
        for k, v in {
            "lo": {"lo": [-0.1, 0, 0]}, "hi": {"hi": [0.7, 0.5, 0.5]}, "walls": {"walls": True},
            "open": {"walls": True, "open": ["+z"]}, "periodic": {"walls": True, "periodic": ["x"]},
        }.items()
    },
    "Solver": {
        k: {"solver": {k: v} | ({"method": "wcsph"} if "s" in k[:1] + k[-1:] else {})}
        for k, v in {
            "method": "wcsph", "max_error": 0.01, "divergence_error": 0.02, "viscosity_error": 0.01,
            "min_iterations": 3, "max_iterations": 50, "cfl": 0.5, "max_dt": 0.002,
            "sound_speed": 20.0, "extra_viscosity": 0.5,
        }.items()
    },
    "Fluid": {
        k: {"fluids": near({"name": "water", "sphere": BALL}, k, v)}
        for k, v in [
            ("name", "oil"), ("density", 900.0), ("viscosity", 2.0), ("implicit", True),
            ("surface_tension", 0.05), ("velocity", [0, 0, -1]), *IMAGE[:3], ("shown", False),
        ]
    } | {
        k: {"fluids": [{"name": "water", k: v}]}
        for k, v in {"box": BOX, "sphere": BALL, "cylinder": ROLL, "mesh": "mesh",
                     "particles": "particles"}.items()
    },
    "Solid": {
        k: {"solids": near(SOLID, k, v)}
        for k, v in [
            ("name", "fat"), ("density", 900.0), ("young", 9000.0), ("rigidity", 0.5),
            ("viscosity", 2.0), ("implicit", True), ("surface_tension", 0.05), ("damping", 3.0),
            ("tear", 0.5), ("plastic", 0.1), ("creep", 2.0), ("friction", 0.3),
            ("fixed", [{"box": BOX}]), ("velocity", [0, 0, -1]), *IMAGE[:3],
            ("shown", False), ("model", "solid"),
        ]
    } | {
        k: {"solids": [near(SOLID, k, v)[0] | {"model": "solid"}]}
        for k, v in [("poisson", 0.3), ("relaxation", [{"share": 0.5, "time": 1.0}])]
    } | {
        k: {"solids": [{"name": "jelly", k: v}]}
        for k, v in {"box": BOX, "sphere": BALL, "cylinder": ROLL, "mesh": "mesh",
                     "tomography": "tomography", "particles": "particles"}.items()
    },
    "Boundary": {
        k: {"boundaries": near(WALL, k, v)}
        for k, v in [
            ("name", "floor"), ("hollow", True), ("open", ["+z"]), ("keys", KEYS),
            ("adhesion", 0.05), ("friction", 0.4), ("shown", True), *IMAGE[:3],
        ]
    } | {
        k: {"boundaries": [{"name": "wall", k: v}]}
        for k, v in {"box": BOX, "sphere": BALL, "cylinder": ROLL, "mesh": "mesh",
                     "distance": "distance",
                     "plane": {"point": [0, 0, 0.1], "normal": [0, 0, 1]}}.items()
    },
    "Rigid": {
        k: {"rigids": near(RAFT, k, v)}
        for k, v in [
            ("name", "cork"), ("density", 300.0), ("velocity", [0, 0, 1]), ("spin", [0, 1, 0]),
            ("adhesion", 0.05), ("friction", 0.4), *IMAGE[:3], ("shown", False),
        ]
    } | {
        k: {"rigids": [{"name": "raft", k: v}]}
        for k, v in {"box": BOX, "sphere": BALL, "cylinder": ROLL, "mesh": "mesh"}.items()
    },
    "Instrument": {
        "name": {"instruments": [{**KNIFE, "name": "other"}]},
        "kind": {"instruments": [SUCTION]}, "radius": {"instruments": [SUCTION]},
        "keys": {"instruments": [{**KNIFE, "keys": KEYS[:1]}]},
        "edge": {"instruments": [{**KNIFE, "length": None, "edge": [[0, 0, 0], [0, 0, 0.1]]}]},
        "length": {"instruments": [KNIFE]},
        "ablates": {"instruments": [{**SUCTION, "ablates": True}]},
    },
    "Emitter": {
        k: {"emitters": near(TAP, k, v)}
        for k, v in {
            "name": "jet", "fluid": "water", "center": [0.4, 0.2, 0.2], "direction": [0, 1, 0],
            "radius": 0.15, "rate": 0.03, "start": 0.01, "end": 0.02,
        }.items()
    },
    "Sink": {
        "name": {"sinks": [{**DRAIN, "name": "hole"}]}, "sphere": {"sinks": [DRAIN]},
        "box": {"sinks": [{"name": "drain", "box": {"lo": [0, 0, 0], "hi": [0.3, 0.3, 0.1]}}]},
    },
    "Vessel": {
        k: {"solids": [SOLID], "vessels": near(VEIN, k, v)}
        for k, v in {
            "name": "artery", "solid": "jelly", "fluid": "water", "radius": 0.1, "pool": 2e-3,
            "path": [[0, 0.2, 0.2], [0.3, 0.2, 0.2]], "pressure": 4000.0,
        }.items()
    },
    "Foam": {
        k: {"foam": {k: v}}
        for k, v in {
            "approach": [0.5, 2.0], "curvature": [0.25, 1.0], "speed": [0.5, 5.0],
            "air_rate": 50.0, "crest_rate": 40.0, "lifetime": 3.0, "max_particles": 10, "seed": 1,
        }.items()
    },
    "View": {
        k: {"view": {k: v, **({"eye": [1, 0, 1], "look_at": [0, 0, 0]} if k in ("eye", "look_at")
                              else {})}}
        for k, v in {
            "eye": None, "look_at": None, "up": [0, 1, 0], "fov": 30.0, "look": "water",
            "ground": -1.0, "speeds": [0, 2], "size": [64, 48],
        }.items()
    },
    "Output": {"fps": {"output": {"fps": 60.0}}, "format": {"output": {"format": "ply"}}},
    "Key": {
        k: {"instruments": [{**KNIFE, "keys": [{"time": 0.0, **v}]}]}
        for k, v in {
            "time": {"time": 0.25}, "position": {"position": [0.1, 0, 0]},
            "axis": {"axis": [0, 0, 1], "angle": 30.0}, "angle": {"axis": [0, 0, 1], "angle": 60.0},
            "on": {"on": False},
        }.items()
    },
    "Relaxation": {
        k: {"solids": [{**SOLID, "model": "solid", "relaxation": [term]}]}
        for k, term in {
            "share": {"share": 0.5, "time": 2.0}, "time": {"share": 0.4, "time": 1.0},
        }.items()
    },
    "Shape": {
        k: {"solids": [{**SOLID, "fixed": [{k: v}]}]}
        for k, v in {"box": BOX, "sphere": BALL, "cylinder": ROLL}.items()
    },
    "Box": {
        "lo": {"fluids": [{"name": "water", "box": {**BOX, "lo": [0.1, 0, 0]}}]},
        "hi": {"fluids": [{"name": "water", "box": {**BOX, "hi": [0.4, 0.3, 0.3]}}]},
    },
    "Sphere": {
        "center": {"fluids": [{"name": "water", "sphere": {**BALL, "center": [0.3, 0.2, 0.2]}}]},
        "radius": {"fluids": [{"name": "water", "sphere": {**BALL, "radius": 0.1}}]},
    },
    "Cylinder": {
        k: {"fluids": [{"name": "water", "cylinder": {**ROLL, k: v}}]}
        for k, v in {"start": [0.2, 0.1, 0.1], "end": [0.2, 0.3, 0.1], "radius": 0.06}.items()
    },
    "Plane": {
        k: {"boundaries": [{"name": "wall", "plane": {"point": [0, 0, 0.1], "normal": [0, 0, 1],
                                                      k: v}}]}
        for k, v in {"point": [0, 0, 0.2], "normal": [0, 1, 1]}.items()
    },
    **{
        kind.__name__: {
            k: {where: [{"name": "thing", name: (name, {k: v})}]}
            for k, v in {"file": None, "scale": 1.2, "move": [0.05, 0, 0]}.items()
        }
        for kind, where, name in (
            (sources.MeshFile, "fluids", "mesh"), (sources.ParticleFile, "fluids", "particles"),
            (sources.DistanceFile, "boundaries", "distance"),
        )
    },
    "Tomography": {
        k: {"solids": [{"name": "jelly", "tomography": ("tomography", {k: v})}]}
        for k, v in {"file": None, "atlas": "mni152", "level": 0.4, "labels": [1], "scale": 0.002,
                     "center": [0.2, 0.2, 0.1]}.items()
    } | {
        k: {"solids": [{"name": "jelly", "tomography": ("tomography", {
            "white": [1, 1, 0.9], "white_level": 0.5,
        })}]}
        for k in ("white", "white_level")
    },
}  # fmt: skip
TABLES = {
    kind.__name__: kind
    for module in (scene_file, instruments, shapes, sources)
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, Table) and kind is not Table
}
ALL = [
    (kind, field.name)
    for kind, table in TABLES.items()
    for field in dataclasses.fields(table)
    if field.metadata
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of every kind that a scene names."""
    path = tmp_path_factory.mktemp("scene")
    at = np.mgrid[0:3, 0:3, 0:3].reshape(3, -1).T * 0.05 + 0.1
    gb.write(path / "p.npz", gb.Particles(at, attributes={"velocity": 0 * at}))
    ball = 0.1 - np.linalg.norm(np.mgrid[-6:7, -6:7, -6:7] * 0.02, axis=0)
    world = np.diag([0.02, 0.02, 0.02, 1])
    world[:3, 3] = 0.1
    gb.write_volume(path / "hole.npz", gb.Volume(-ball.astype(np.float32), world))
    head = (ball > 0).astype(np.uint8)
    gb.write_volume(path / "head.nrrd", gb.Volume(head, np.diag([20.0, 20.0, 20.0, 1])))
    write_stl(path / "ball.stl")
    return path


def write_stl(path) -> None:
    """A box of 0.3 m, as text."""
    corners = np.array([(x, y, z) for x in (0, 0.3) for y in (0, 0.3) for z in (0, 0.3)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = ["solid box"]
    for a, b, c, d in faces:
        for triangle in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += ["vertex {} {} {}".format(*corners[i]) for i in triangle]
            lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid box"]))


def scene_with(kind: str, key: str, folder) -> dict:
    """LEAST and the case's keys, with the names of files filled in."""

    def filled(value):
        if isinstance(value, str) and value in FILES:
            value = (value, {})
        if isinstance(value, tuple):
            name, more = value
            if "atlas" in more:
                return {**more, "center": [0.3, 0.25, 0.2]}
            scale = {"tomography": 0.001}.get(name, 1.0)
            center = {"center": [0.3, 0.25, 0.2]} if name == "tomography" else {}
            file = {"file": str(folder / FILES[name])}
            return {**file, "scale": scale, **center, **{k: v for k, v in more.items() if v}}
        if isinstance(value, dict):
            return {k: filled(v) for k, v in value.items() if v is not None}
        return [filled(v) for v in value] if isinstance(value, list) else value

    return filled({**LEAST, **CASES[kind][key]})


def in_python(scene: dict) -> gb.Simulation:
    """The same through keywords and tables, without a dict."""

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


ROWS = {
    ("SceneFile", "fluids"): scene_file.Fluid, ("SceneFile", "solids"): scene_file.Solid,
    ("SceneFile", "boundaries"): scene_file.Boundary, ("SceneFile", "rigids"): scene_file.Rigid,
    ("SceneFile", "instruments"): instruments.Instrument, ("SceneFile", "sinks"): scene_file.Sink,
    ("SceneFile", "emitters"): scene_file.Emitter, ("SceneFile", "vessels"): scene_file.Vessel,
    ("Solid", "fixed"): scene_file.Shape, ("Boundary", "keys"): instruments.Key,
    ("Instrument", "keys"): instruments.Key,
}  # fmt: skip


def facts(sim: gb.Simulation) -> dict:
    """Everything that a simulation starts from, and where two steps bring it."""
    start = {"scene": as_dict(sim.file), "by_hand": sim._by_hand(), "hash": sim.hash()}
    sim.step(0.001)
    sim.step(0.001)
    return json.loads(json.dumps({**start, "later": sim.hash()}))


def test_every_key_has_a_case():
    assert {(kind, key) for kind, keys in CASES.items() for key in keys} == set(ALL)


@pytest.mark.parametrize(("kind", "key"), ALL)
def test_a_key_means_the_same_in_a_file_a_dict_and_python(kind, key, folder, tmp_path):
    if "mesh" in (key, kind[:4].lower()):
        pytest.importorskip("trimesh")
    if key == "atlas":
        pytest.importorskip("nilearn")
    scene = scene_with(kind, key, folder)
    (tmp_path / "scene.toml").write_text(tomli_w.dumps(scene))
    of_file, of_dict, of_python = (
        facts(sim)
        for sim in (
            gb.Simulation(tmp_path / "scene.toml", device="cpu"),
            gb.Simulation(scene, device="cpu"),
            in_python(scene),
        )
    )
    assert of_file == of_dict == of_python
    if scene != LEAST:
        assert of_dict["scene"] != as_dict(scene_file.read_scene(LEAST))


def test_defaults_are_those_of_the_tables():
    """A phase made in Python is the one of a table without keys; gravity points down z."""
    tables = {"fluids": "fluid", "solids": "tissue", "boundaries": "boundary", "rigids": "rigid"}
    for name, kind in tables.items():
        sim = gb.Simulation(spacing=0.05, domain=LEAST["domain"], **{name: [{"name": "a"}]})
        assert vars(sim.phases["a"]) == vars(gb.Phase("a", kind=kind))
    assert sim.settings.gravity == (0.0, 0.0, -9.81)
    assert not sim.settings.domain.walls
    fluid = gb.Simulation(gb.Particles(np.mgrid[0:3, 0:3, 0:3].reshape(3, -1).T * 0.05))
    assert fluid.settings.gravity == sim.settings.gravity
    assert gb.Phase("oil", viscosity=1.0).implicit
    assert not gb.Phase("oil").implicit


def test_lists_are_all_tables():
    assert {name for kind, name in ROWS if kind == "SceneFile"} == set(LISTS)
