"""What the viewer prints as a command and as Python makes the viewer's picture."""

from __future__ import annotations

import shlex

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.viewer.engine import Engine
from globule.viewer.equivalent import command_line, python_code
from globule.viewer.open import open_source
from globule.viewer.recording import Shot, checked_size
from globule.viewer.state import State
from PIL import Image

STATES = {
    "plain": {},
    "surface": {"surface__threshold": 0.9, "surface__support": 0.5,
                "surface__kernel": "wendland_c2"},
    "colour": {"color__by": "speed", "color__colormap": "turbo", "color__legend": True},
    "range": {"color__by": "y", "color__automatic": False, "color__low": -1.0, "color__high": 0.5},
    "cuts": {"cuts__plane": True, "cuts__normal": (0.3, 0.1, 1.0), "cuts__point": (0.0, 0.0, 0.1),
             "cuts__box": True, "cuts__lo": (0.0, -2.0, -2.0), "cuts__hi": (2.0, 0.0, 2.0)},
    "sphere": {"cuts__sphere": True, "cuts__center": (0.5, 0.0, 0.2), "cuts__radius": 0.6},
    "water": {"look__preset": "water", "look__shadows": True, "look__depth": 6},
    "own": {"look__lights": "own", "look__azimuth": 40.0, "look__matter": "own",
            "look__reflection": 0.4, "look__sky": "gradient", "look__ambient_rays": 2},
    "thesis": {"surface__root": "march"},
}


@pytest.fixture
def engine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(4)
    positions = (rng.normal(size=(200, 3)) * 0.4).astype(np.float32)
    np.savez("some cloud.npz", positions=positions, support=np.float32(0.4),
             speed=positions[:, 1])
    made = Engine(open_source("some cloud.npz"), State())
    yield made
    made.close()


@pytest.mark.parametrize("name", STATES)
def test_command_and_program_make_the_same_picture(engine, name):
    engine.state.set(quality__samples=3, **STATES[name])
    camera, size = gb.Camera((1.6, 1.2, 3.0), (0.1, 0.0, 0.0), fov=42.0), (160, 120)
    shot = Shot(engine, camera, size, 3)
    command = command_line(engine.source.files, engine.state, camera, size, engine.up)
    assert "#" not in command
    assert main(shlex.split(command)[1:]) == 0
    with Image.open("picture.png") as image:
        printed = np.asarray(image.convert("RGB")).astype(int)
    assert np.abs(printed - shot.picture).mean() < 0.05, command
    if engine.state.color.by or name == "thesis":  # the program draws no legend, and is exact
        return
    scene = engine.source.layers(engine.state)[0].scene
    code = python_code(engine.source, engine.state, camera, size, engine.up, scene)
    names: dict = {}
    exec(compile(code, "printed", "exec"), names)
    assert np.abs(names["frame"].picture.astype(int) - shot.picture).mean() < 0.05, code


def test_what_the_command_cannot_say_is_named(engine):
    engine.state.set(look__exposure=2.0, cuts__sphere=True, cuts__keep_sphere=True)
    command = command_line([], engine.state, gb.Camera((0, 0, 3), (0, 0, 0)), (64, 64), engine.up)
    assert command.endswith("# without: exposure, keep the sphere's inside")


def test_sizes_have_limits():
    assert checked_size((1920, 1080)) == (1920, 1080)
    for size in ((8, 100), (100, 20000), (16384, 16384 + 1)):
        with pytest.raises(ValueError, match="size: expected"):
            checked_size(size)
