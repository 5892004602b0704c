"""Several people: who steers, who looks, and how many there may be."""

from __future__ import annotations

import json
from contextlib import ExitStack, closing
from types import SimpleNamespace

import pytest
from viewer_helpers import blob, until, view

pytest.importorskip("viser")

from globule.viewer.roles import LOOK, LOOKING, STEER
from viewer_program import Program


@pytest.fixture
def shared():
    with view([blob(150), blob(150, 2)], demand_token=True, most_clients=3) as made:
        yield made


def test_who_looks_changes_nothing_that_others_see(shared):
    plane = shared.page.binder.widgets["cuts.plane"]
    looking = Program(shared.look_address)
    until(lambda: shared.page.tools.hands)
    (client,) = shared.clients.values()
    assert client.role == LOOK
    looking.set("Plane")
    looking.command("Play or pause")
    back = looking.heard(lambda m: m.get("uuid") == plane._impl.uuid and "updates" in m)
    assert back["updates"] == {"value": False}
    looking.heard(lambda m: LOOKING in str(m))
    looking.command("Look from: top")  # its own camera
    looking.heard(lambda m: m["type"] == "SetCameraPositionMessage" and m["position"][1] > 1)
    assert not shared.state.cuts.plane
    assert not shared.state.time.playing

    steering = Program(shared.address)
    until(lambda: len(shared.clients) == 2)
    assert [c.role for c in shared.clients.values()] == [LOOK, STEER]
    steering.set("Plane")
    steering.command("Play or pause")
    until(lambda: shared.state.cuts.plane and shared.state.time.playing)
    looking.close()
    steering.close()


def test_the_toolbar_of_who_looks(shared, caplog):
    looking = Program(shared.look_address)
    until(lambda: shared.page.tools.hands)
    number = next(iter(shared.clients))
    desk, browser = shared.page.desk, SimpleNamespace(client_id=number)
    model = desk.model.of(browser)
    assert (model["role"], model["people"]) == (LOOK, [1, 3])
    assert model["tools"] == ["Rotate, pick", "Measure"]
    for action in ({"do": "set", "value": {"cuts__plane": True}}, {"do": "play"}, {"do": "record"}):
        desk._do(json.dumps(action), browser)
    assert [r.getMessage() for r in caplog.records if r.levelname == "WARNING"] == 3 * [LOOKING]
    assert not shared.state.cuts.plane
    desk._do(json.dumps({"do": "tool", "value": "Measure"}), browser)
    assert shared.page.tools.hands[number].tool == "Measure"
    looking.close()


def test_no_more_than_so_many_and_the_others_are_told(shared):
    with ExitStack() as open_ones:

        def arrive(address):
            return open_ones.enter_context(closing(Program(address)))

        first = arrive(shared.look_address)
        arrive(shared.look_address)
        until(lambda: len(shared.clients) == 2)
        late = arrive(shared.look_address)  # the last place is kept for a person who steers
        late.heard(lambda m: "at most 3 browsers" in str(m))
        arrive(shared.address)
        until(lambda: len(shared.clients) == 3)
        other = arrive(shared.address)
        other.heard(lambda m: "at most 3 browsers" in str(m))
        plane = shared.page.binder.widgets["cuts.plane"]
        tick = {"type": "GuiUpdateMessage", "uuid": plane._impl.uuid, "updates": {"value": True}}
        other.say(tick)  # without a place there is no way to steer
        first.close()
        until(lambda: len(shared.clients) == 2)
        arrive(shared.address)
        until(lambda: len(shared.clients) == 3)
        assert not shared.state.cuts.plane


def test_numbers_of_browsers_that_make_no_sense():
    with pytest.raises(ValueError, match="most_clients: expected 1 or more, got 0"):
        view(blob(), most_clients=0)
