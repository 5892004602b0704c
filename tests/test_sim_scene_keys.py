"""The page of scene keys has a row for every key, and the JSON Schema takes what a scene takes."""

import json
import re
import sys
from pathlib import Path

import pytest
from globule._base.settings import settings_of
from globule._base.structured import parse_toml
from globule.sim import scene_file
from globule.sim.scene_read import FOLDER, SHIPPED
from sim_helpers import tables

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "site"))

import reference  # noqa: E402

TABLES = tables()


def test_every_key_is_on_the_page():
    page = reference.scene_pages()["reference/scene-keys.md"]
    first = [row.split(" | ")[0] for row in page.splitlines() if row.startswith("| ")]
    named = {re.sub(r"\W", "", word) for cell in first for word in re.split("[,:]", cell)}
    assert len(TABLES) > 20
    for kind in TABLES - {scene_file.Shape, scene_file.Relaxation}:
        assert set(settings_of(kind)) <= named, kind
        assert kind.__doc__
        for name, one in settings_of(kind).items():
            assert one.help, (kind, name)


def test_the_schema_takes_what_a_scene_takes():
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(reference.scene_pages()["reference/scene.schema.json"])
    check = jsonschema.Draft202012Validator(schema)
    check.check_schema(schema)
    for name in SHIPPED:
        scene = parse_toml((FOLDER / f"{name}.toml").read_text())
        check.validate(scene)
        for wrong in ({"spacing": -1}, {"spacin": 1}, {"solver": {"cfl": "x"}}, {"fluids": [{}]}):
            assert not check.is_valid(scene | wrong), wrong
