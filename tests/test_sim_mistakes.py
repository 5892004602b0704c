"""What a simulation is told that cannot be is refused in one line, and changes nothing."""

import re
from pathlib import Path

import globule as gb
import numpy as np
import pytest
from globule.sim.emitter import Emitter
from globule.sim.tissue import BALL

NAN = float("nan")
DOCS = Path(__file__).parents[1] / "docs/how-to/simulate-own-scene.md"


@pytest.fixture
def sim():
    return gb.Simulation("dam-break", spacing=0.1, device="cpu")


def test_the_scene_in_the_documentation_runs(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(re.search(r"```toml\n(.*?)```", DOCS.read_text("utf-8"), re.S)[1], "utf-8")
    sim = gb.Simulation(path, device="cpu")
    sim.step()
    assert sim.tissue.n_bonds > 0
    assert sim.time > 0


def push(sim, *more):
    sim.tools.set_pushers([(BALL, (9, 9, 9), (9, 9, 9), 0.1, (0, 0, 0), *more)])


@pytest.mark.parametrize(("mistake", "kind", "words"), [
    (lambda sim: sim.add([[NAN, 0, 0]], "water"), ValueError, "positions"),
    (lambda sim: sim.add([[0.5, 0.5, 0.5]], "water", (0, np.inf, 0)), ValueError, "velocities"),
    (lambda sim: gb.Simulation("dam-break", spacing=NAN), ValueError, "spacing"),
    (lambda sim: sim.tissue.ablate((0, 0, NAN), 1.0), ValueError, "center: .*finite"),
    (lambda sim: sim.tissue.suture((0, 0, 0), -1.0), ValueError, "radius"),
    (lambda sim: sim.tools.grasp((0, 0, 0), 1.0, 8), ValueError, "number: expected 0 to 7"),
    (lambda sim: sim.tools.pusher_force(), ValueError, "number: expected pushers first"),
    (lambda sim: (push(sim), sim.tools.pusher_force(1)), ValueError, "number: expected a pusher from 0 to 0, got 1"),
    (lambda sim: push(sim, -1.0), ValueError, r"shapes\[0\].*friction"),
    (lambda sim: push(sim, 0.1, 0.1), ValueError, r"shapes\[0\].*or"),
    (lambda sim: sim.remove([-1]), ValueError, "ids"),
    (lambda sim: sim.steer.apply_force((0, 0, 1), ids=[999_999]), ValueError, "ids"),
    (lambda sim: sim.step(NAN), ValueError, "dt"),
    (lambda sim: sim.run(NAN), ValueError, "seconds"),
    (lambda sim: sim.run_to(np.inf), ValueError, "end"),
    (lambda sim: setattr(sim, "positions", None), ValueError, "positions: .* got None"),
    (lambda sim: setattr(sim, "velocities", 1j), ValueError, "velocities: .*real .* got 1j"),
    (lambda sim: Emitter((0, 0, 0), (0, 0, 1), 0.1, 1, start=2, end=1), ValueError,
     "emitter.end: expected more than start, 2 s, got 1"),
    (lambda sim: sim.run(0.01, stop=5), TypeError, "stop: expected a function, got 5"),
    (lambda sim: [sim.add_phase(gb.sim.Phase(f"p{i}")) for i in range(32)], ValueError,
     "phases: expected at most 32, got 33 with 'p30'"),
])  # fmt: skip
def test_mistakes_say_what_came_and_change_nothing(sim, mistake, kind, words):
    before = sim.hash()
    with pytest.raises(kind, match=words):
        mistake(sim)
    assert (sim.hash(), sim.n_steps, sim.step().n) == (before, 0, len(sim))


def test_checkpoints_are_files_of_their_kind(sim, tmp_path):
    with pytest.raises(IsADirectoryError, match="expected a file, got a folder"):
        sim.save(tmp_path)
    assert not tmp_path.with_name(f"{tmp_path.name}.npz").exists()
    (tmp_path / "c.toml").write_text("")
    with pytest.raises(ValueError, match=r"c\.toml: expected a checkpoint .*, got another file"):
        gb.Simulation.load(tmp_path / "c.toml")


def test_a_step_much_too_long_is_warned_of_once(sim, caplog):
    sim.step(3 * sim.dt)
    assert not caplog.messages
    for _ in range(2):
        sim.step(5 * sim.dt)
    assert [words for words in caplog.messages if words.startswith("dt: expected at most")]
    assert len(caplog.messages) == 1
