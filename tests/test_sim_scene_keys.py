"""The page of scene keys names every key of a scene and no other, bold where it must be given."""

import dataclasses
import re
from pathlib import Path

import pytest
from globule.sim import instruments, scene_file, shapes, sources

PAGE = Path(__file__).resolve().parents[1] / "docs/reference/scene-keys.md"
TABLES = {
    "The scene": scene_file.SceneFile, "[domain]": scene_file.Domain,
    "[solver]": scene_file.Solver, "[[fluids]]": scene_file.Fluid,
    "[[solids]]": scene_file.Solid, "[[boundaries]]": scene_file.Boundary,
    "[[rigids]]": scene_file.Rigid, "[[instruments]]": instruments.Instrument,
    "[[emitters]]": scene_file.Emitter, "[[sinks]]": scene_file.Sink,
    "[[vessels]]": scene_file.Vessel, "[foam]": scene_file.Foam,
    "[view]": scene_file.View, "[output]": scene_file.Output,
    "Key frames": instruments.Key,
}  # fmt: skip
SHAPES = {
    "box": shapes.Box, "sphere": shapes.Sphere, "cylinder": shapes.Cylinder, "plane": shapes.Plane,
    "mesh": sources.MeshFile, "particles": sources.ParticleFile,
    "distance": sources.DistanceFile, "tomography": sources.Tomography,
}  # fmt: skip


def sections() -> dict[str, list[list[str]]]:
    """Rows of each heading's table."""
    found = {}
    for part in PAGE.read_text().split("\n## ")[1:]:
        title, _, text = part.partition("\n")
        lines = [line for line in text.splitlines() if line.startswith("|")]
        found[title] = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    return found


def required(kind) -> set[str]:
    return {
        f.name
        for f in dataclasses.fields(kind)
        if f.default is f.default_factory is dataclasses.MISSING
    }


@pytest.mark.parametrize("title", TABLES)
def test_every_key_is_documented(title):
    words = [name for row in sections()[title] for name in row[0].split(", ")]
    names = [word.strip("*") for word in words]
    assert sorted(names) == sorted(f.name for f in dataclasses.fields(TABLES[title]) if f.metadata)
    assert {word.strip("*") for word in words if word.startswith("*")} == required(TABLES[title])


def test_every_key_of_a_shape_is_documented():
    rows = {name: row[1] for row in sections()["Shapes and files"] for name in row[0].split(", ")}
    assert set(rows) == set(SHAPES)
    for name, kind in SHAPES.items():
        for field in dataclasses.fields(kind):
            assert re.search(rf"\b{field.name}\b", rows[name]), (name, field.name)
        assert set(re.findall(r"\*\*(\w+)\*\*", rows[name])) == required(kind), name
