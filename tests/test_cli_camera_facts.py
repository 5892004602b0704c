"""The fitted camera in reports: its flags give the same image again."""

from __future__ import annotations

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube, run_json
from globule.cli import main
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")
MACHINE = ["--device", "cpu", "--size", "64x48"]


def flat() -> gb.Particles:
    return gb.Particles(np.stack(np.mgrid[:12, :10], -1).reshape(-1, 2) * 0.5)


@pytest.mark.parametrize("kind", ["fluid", "balls", "flat", "ortho"])
def test_the_fitted_camera_is_given_back_by_its_flags(kind, capsys):
    particles = {"flat": flat(), "balls": cube(support=0.4)}.get(kind, cube())
    gb.write("a.npz", particles)
    more = ["--ortho", "2"] if kind == "ortho" else []
    camera = run_json(capsys, "render", "a.npz", "-o", "a.png", *MACHINE, *more)["camera"]
    assert ("height" in camera) == (kind in ("flat", "ortho"))
    words = camera["flags"].split()
    assert main(["render", "a.npz", "-o", "b.png", *MACHINE, *words]) == 0
    a, b = (np.asarray(Image.open(f"{name}.png")).astype(int) for name in "ab")
    assert np.abs(a - b).max() <= 2
    assert a.std() > 1


@pytest.mark.parametrize("particles", [cube(), cube(support=0.4), flat()])
def test_info_says_the_camera_of_the_image(particles, capsys):
    gb.write("a.npz", particles)
    told = run_json(capsys, "info", "a.npz")["camera"]
    used = run_json(capsys, "render", "a.npz", "-o", "a.png", "--device", "cpu")["camera"]
    assert told.keys() == used.keys()
    for name in told.keys() - {"flags"}:
        assert told[name] == pytest.approx(used[name], rel=1e-6, abs=1e-6), name
    main(["info", "a.npz"])
    assert f"camera     {told['flags']}" in capsys.readouterr().out


def test_each_view_has_its_camera(capsys):
    gb.write("a.npz", cube())
    words = ["render", "a.npz", "-o", "a.png", "--size", "300x150", "--views", "front,iso"]
    front, iso = run_json(capsys, *words)["cameras"]
    assert "height" in front
    assert "fov" in iso
