"""What a simulation is told that cannot be is refused in one line, and changes nothing."""

import re
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.sim.scene_file import read_scene

NAN = float("nan")
DOCS = Path(__file__).parents[1] / "docs/how-to/simulate-own-scene.md"


@pytest.fixture
def sim():
    return gb.Simulation("dam-break", spacing=0.1, device="cpu")


@pytest.mark.parametrize(
    ("mistake", "named"),
    [
        (lambda sim: sim.add([[NAN, 0, 0]], "water"), "positions"),
        (lambda sim: sim.add([[0.5, 0.5, 0.5]], "water", (0, np.inf, 0)), "velocities"),
        (lambda sim: setattr(sim, "positions", sim.positions * NAN), "positions"),
        (lambda sim: sim.remove([-1]), "ids"),
        (lambda sim: sim.apply_force((0, 0, 1), ids=[999_999]), "ids"),
        (lambda sim: sim.step(NAN), "dt"),
        (lambda sim: sim.step(-0.1), "dt"),
        (lambda sim: sim.advance(NAN), "seconds"),
        (lambda sim: sim.advance(-1), "seconds"),
        (lambda sim: sim.advance_to(np.inf), "end"),
    ],
)
def test_mistakes_change_nothing(sim, mistake, named):
    before = sim.hash()
    with pytest.raises(ValueError, match=named):
        mistake(sim)
    assert sim.hash() == before
    assert sim.n_steps == 0
    assert sim.step().n == len(sim)


def test_ablating_nowhere_is_refused():
    sim = gb.Simulation("beam", device="cpu")
    n = len(sim)
    with pytest.raises(ValueError, match="finite"):
        sim.ablate((0, 0, NAN), 1.0)
    assert len(sim) == n


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("seconds = 1" + 400 * "0", "seconds: expected"),
        ('[output]\nformat = "doc"', "output.format: expected"),
        ("[view]\neye = [1, 0, 0]\nlook_at = [1, 0, 0]", "view.look_at: expected"),
        ("[view]\nspeeds = [2, 0]", "view.speeds: expected"),
    ],
)
def test_scenes_are_refused_before_they_run(tmp_path, words, named):
    path = tmp_path / "bad.toml"
    domain = "[domain]\nlo = [0, 0, 0]\nhi = [1, 1, 1]\n"
    path.write_text(f"spacing = 0.1\n{words}\n{domain}")
    with pytest.raises(ValueError, match=named):
        read_scene(path)


def test_spacing_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="spacing"):
        gb.Simulation("dam-break", spacing=NAN)


def test_the_scene_in_the_documentation_runs(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(re.search(r"```toml\n(.*?)```", DOCS.read_text("utf-8"), re.S)[1], "utf-8")
    sim = gb.Simulation(path, device="cpu")
    sim.step()
    assert sim.n_bonds > 0
    assert sim.time > 0


def test_what_was_removed_stays_so_in_pictures_after_loading(sim, tmp_path):
    sim.remove(sim.ids[:20])
    sim.step()
    sim.save(tmp_path / "state")
    again = gb.Simulation.load(tmp_path / "state", device="cpu")
    camera = gb.Camera((3, -4, 2), (1, 0.5, 0.5))
    pictures = [gb.render(s.scene, camera, size=(64, 48)).color for s in (sim, again)]
    assert again.hash() == sim.hash()
    assert np.array_equal(*pictures)
