"""The timeline of a running simulation: back, forth, and on from there."""

from types import SimpleNamespace

import globule as gb
import numpy as np
import pytest
from viewer_helpers import until, view

pytest.importorskip("websockets")

from globule.viewer import past
from globule.viewer.open import open_source
from globule.viewer.state import State


def opened(name: str = "dam-break", spacing: float = 0.1):
    return open_source(gb.Simulation(name, spacing=spacing, device="cpu"))


def steps(source, n: int) -> list[str]:
    hashes = []
    for _ in range(n):
        source.step()
        source.advance(State())
        hashes.append(source.simulation.hash())
    return hashes


def go(source, to: int) -> str:
    source.go_to(to)
    source.advance(State())
    return source.simulation.hash()


def test_states_are_few_and_back_forth_and_on_again_the_same_bits(monkeypatch):
    source = opened()
    sim = source.simulation
    begin, after = sim.hash(), steps(source, 9)
    rows, version = [row["time"] for row in sim.record.diagnostics], source.version
    assert (source.place, go(source, 4), source.place) == ((9, 9), after[3], (4, 9))
    assert source.version > version
    assert not source.running
    assert len(sim.record.diagnostics) == 9  # the plot over time still shows all of it
    assert go(source, 0) == begin
    assert go(source, 9) == after[8]
    assert go(source, 4) == after[3]
    assert steps(source, 3) == after[4:7]
    assert source.place == (7, 7)  # what came later is another story now
    assert [row["time"] for row in sim.record.diagnostics] == rows[:7]
    source.reset()
    assert (source.place, go(source, 5)) == ((0, 0), begin)
    monkeypatch.setattr(past, "MOST", 8)
    source = opened()
    after = [source.simulation.hash(), *steps(source, 40)]
    kept = [state["steps"] for state in source._past._kept]
    assert len(kept) <= 8
    assert kept[0] == 0
    assert max(np.diff(kept)) <= 2 * min(np.diff(kept)[:-1])
    nearest = min([*kept, 40], key=lambda k: abs(k - 21))
    assert (go(source, 21), go(source, 40)) == (after[nearest], after[40])
    monkeypatch.setattr(past, "BYTES", 3 * source._past._kept[0]["bytes"])
    steps(source, 30)
    assert 2 <= len(source._past._kept) <= 3
    assert go(source, 0) == after[0]


def test_a_cut_belongs_to_its_time():
    from test_viewer_first_use import across

    source = opened("cut-block", 0.004)
    sim = source.simulation
    steps(source, 2)
    bonds = sim.tissue.n_bonds
    source.cut_depth = None
    source.cut_along(*across(0.02))
    assert sim.tissue.n_bonds < bonds
    steps(source, 2)
    cut = sim.tissue.n_bonds
    go(source, 1)
    assert sim.tissue.n_bonds == bonds
    go(source, 2)
    assert sim.tissue.n_bonds == cut  # as it was left at this time
    source.undo()
    assert (sim.tissue.n_bonds, source.place) == (bonds, (2, 2))
    source.cut_along(*across(0.02))
    go(source, 0)
    steps(source, 1)  # without the cut
    assert sim.tissue.n_bonds == bonds
    with pytest.raises(ValueError, match="undo: expected a cut"):
        source.undo()


def test_the_page_goes_to_a_step_and_refuses_others():
    with view(gb.Simulation("dam-break", spacing=0.1, device="cpu")) as viewer:
        source, desk = viewer.source, viewer.page.desk
        for n in range(1, 4):
            source.step()
            viewer.engine.notify()
            until(lambda n=n: source.place == (n, n))
        browser = SimpleNamespace(client_id=-1)
        desk._actions()["time"](browser, 1)
        until(lambda: source.place == (1, 3))
        time = desk.model.of(browser)["time"]
        assert (time["frame"], time["frames"], time["running"]) == (1, 3, False)
        for wrong in (-1, 1.5, True, "1", None):
            with pytest.raises(ValueError, match="page: expected a step of a simulation"):
                desk._actions()["time"](browser, wrong)
