"""Several people: who steers, who looks, and how many there may be."""

import json
import socket
import threading
from contextlib import ExitStack, closing
from types import SimpleNamespace

import numpy as np
import pytest
from viewer_helpers import PATIENCE, blob, told, until, view

pytest.importorskip("websockets")

from globule.viewer.guard import OTHERS, OneLine
from globule.viewer.roles import LOOK, LOOKING, PRIVATE_ACTIONS, STEER
from viewer_program import Program, hello, link
from websockets.exceptions import InvalidStatus
from websockets.frames import Frame, Opcode


@pytest.fixture
def shared():
    with view([blob(150), blob(150, 2)], demand_token=True, most_clients=3) as made:
        yield made


@pytest.fixture
def both(shared):
    with closing(Program(shared.look_address)) as looking:
        until(lambda: shared.clients)
        with closing(Program(shared.address)) as steering:
            until(lambda: len(shared.clients) == 2 and len(shared.page.tools.hands) == 2)
            until(lambda: looking.controls and steering.controls, "for their scripts")
            yield looking, steering


@pytest.fixture
def looking(both):
    return both[0]


def from_the_top(looking):
    """One who looks moves its own camera; what it sent before has been handled then."""
    looking.command("Look from: top")

    def down(message):
        camera = message.get("camera", {"eye": (0, 0, 1), "look_at": (0, 0, 0)})
        away = np.subtract(camera["eye"], camera["look_at"])
        return away[1] > 0.99 * np.linalg.norm(away)

    looking.heard(down)


def test_who_looks_changes_nothing_that_others_see(shared, both):
    looking, steering = both
    plane = shared.page.binder.widgets["cuts.plane"].number
    assert [c.role for c in shared.clients.values()] == [LOOK, STEER]
    looking.set("Plane")
    looking.command("Play or pause")
    back = looking.heard(lambda m: plane in [c["id"] for c in m.get("controls", ())] and len(m["controls"]) == 1)
    assert back["controls"][0]["value"] is False
    looking.heard(lambda m: LOOKING in str(m))
    from_the_top(looking)
    assert not shared.state.cuts.plane
    assert not shared.state.time.playing
    steering.set("Plane")
    steering.command("Play or pause")
    until(lambda: shared.state.cuts.plane and shared.state.time.playing)


def test_the_toolbar_of_who_looks(shared, looking):
    number = next(n for n, c in shared.clients.items() if c.role == LOOK)
    desk = shared.page.desk
    model = desk.model.of(SimpleNamespace(client_id=number))
    assert (model["role"], model["people"], model["tools"]) == (LOOK, [2, 3], ["Rotate, pick", "Measure"])
    before = shared.state.to_toml()
    for name in desk._actions().keys() - PRIVATE_ACTIONS:
        looking.ask(name, {"cuts__plane": True})
    looking.ask("tool", "Measure")
    until(lambda: shared.page.tools.hands[number].tool == "Measure")
    looking.heard(lambda m: m.get("note", {}).get("body") == LOOKING)
    assert shared.state.to_toml() == before


def test_who_looks_has_and_moves_no_handle(shared, both):
    looking, steering = both
    shared.state.set(cuts__plane=True)
    (handle,) = until(lambda: steering.model["handles"], "for the handle of who steers")
    at, axes = [0.1, 0.2, 0.3], 3 * handle["axes"]
    point = shared.state.cuts.point
    looking.ask("handle", ["plane", at, axes])
    looking.heard(lambda m: LOOKING in str(m))
    assert (looking.model["handles"], shared.state.cuts.point) == ([], point)
    steering.ask("handle", ["plane", at, axes])
    until(lambda: shared.state.cuts.point == tuple(at))


def test_an_address_has_no_more_rights_than_its_token(shared):
    """The path of who looks with the token that steers, and the other way around; then none."""
    host = shared.address.partition("?")[0]
    steers, looks = f"{host}?token={shared.token}", f"{host}look/?token={shared.look_token}"
    for wrong in (
        f"{host}look/?token={shared.token}",
        f"{host}?token={shared.look_token}",
        f"{host}?",
        f"{host}look/?",
    ):
        with pytest.raises(InvalidStatus, match="403"):
            link(wrong)
    for address, role in ((steers, STEER), (looks, LOOK)):
        with closing(link(address)) as one:
            one.send(hello())
            assert told(one, lambda m: m["role"])["role"] == role
        until(lambda: not shared.clients)


def test_a_browser_that_left_complains_to_nobody(shared, looking, caplog, capfd):
    number = next(n for n, c in shared.clients.items() if c.role == LOOK)
    browser = shared.page.desk.browsers[number]
    looking.close()
    until(lambda: len(shared.clients) == 1)
    shared.page.complain(browser, "too late")
    for label in ("Next tool", "Save image", "Look from: top"):
        shared.gui.commands[label].take(browser, None)
    assert not [r for r in caplog.records if r.levelname == "WARNING"]
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.usefixtures("both")
def test_an_action_in_progress_counts_after_a_new_connection(shared, monkeypatch):
    """Of 20 connections in turn, no more actions at a time are done than there are places."""
    running, most, go = [], [], threading.Event()

    def slow(browser):
        running.append(browser)
        most.append(len(running))
        go.wait(PATIENCE)
        running.pop()

    save = next(p for p in shared.page.panels if type(p).__name__ == "Save")
    monkeypatch.setattr(save, "picture", slow)
    for _ in range(20):
        with closing(link(shared.address)) as asks:
            asks.send(hello())
            asks.send(json.dumps({"do": "picture"}))
            until(lambda: running)
            told(asks, lambda m: m["title"])
        until(lambda: len(shared.clients) == 2)
    go.set()
    until(lambda: not running)
    assert max(most) <= shared.most_clients


def test_who_floods_waits_and_the_others_do_not(shared, both, caplog):
    """1,300 wrong actions of one who looks: few lines in the log, one action at a time, and the one
    who steers is served in between."""
    looking, steering = both
    evil = "x\nglobule: ok\x1b[2J\x1b]0;t\x07"
    for i in range(1300):
        looking.ask(f"{evil}{i}")
        if i == 1100:
            steering.ask("set", {"cuts__plane": True})
    until(lambda: shared.state.cuts.plane)
    until(lambda: steering.model["plane"])
    looking.close()
    lines = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert 0 < len(lines) < 40
    assert all(line.startswith("page: ") and line.isprintable() for line in lines)


def test_who_looks_leaves_threads_for_the_others(shared, both, caplog):
    """The page's buttons and keys run in 32 threads for all; these wait for the source."""
    looking, steering = both
    with shared.source.lock:
        for _ in range(40):
            looking.command("Fit all")
        steering.set("Plane")
        until(lambda: shared.state.cuts.plane)
    turns = next(client.turns for client in shared.clients.values() if client.role == LOOK)
    until(lambda: turns._value == 2, "for both to end")
    caplog.clear()
    looking.set("As command and Python")
    looking.heard("globule render")
    assert not caplog.records  # the terminal is for who steers


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
        other.ask("control", [shared.page.binder.widgets["cuts.plane"].number, True])
        other.ask("set", {"cuts__plane": True})  # without a place there is no way to steer
        first.close()
        until(lambda: len(shared.clients) == 2)
        arrive(shared.address)
        until(lambda: len(shared.clients) == 3)
        assert not shared.state.cuts.plane
    with pytest.raises(ValueError, match="most_clients: expected 1 or more, got 0"):
        view(blob(), most_clients=0)


@pytest.mark.usefixtures("both")
def test_a_click_of_who_looks_restarts_no_image_of_others(shared):
    engine, samples = shared.engine, shared.state.quality.samples

    def complete(client):
        return client.frame and client.frame.samples == samples and not client.pacer.making

    until(lambda: all(map(complete, shared.clients.values())), "for both to have their last images")
    hands = {hand.client.role: hand for hand in shared.page.tools.hands.values()}
    scene = SimpleNamespace(cancel=lambda: None)
    for whose, stopped in ((STEER, [False, True]), (LOOK, [True, True])):
        for asks, stops in zip((LOOK, STEER), stopped, strict=True):
            still = hands[whose].client, scene
            engine._still, engine._stopping = still, None
            assert hands[asks].pick((0.5, 0.5)) is not None
            assert (engine._stopping is still) == stops, (whose, asks)
            engine._still = None


class Gone:
    """A browser whose network broke: its connection stays open and answers nothing."""

    def __init__(self, viewer, role=""):
        self.socket = socket.create_connection(("127.0.0.1", viewer.port))
        token = viewer.look_token if role else viewer.token
        lines = (
            f"GET {role}/globule/desk?token={token} HTTP/1.1", "Host: localhost", "Upgrade: websocket",
            "Connection: Upgrade", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        )  # fmt: skip
        self.socket.sendall("\r\n".join([*lines, "", ""]).encode())
        self.socket.sendall(Frame(Opcode.TEXT, hello().encode()).serialize(mask=True))

    def close(self):
        self.socket.close()


@pytest.mark.parametrize("role", ["", "/look"])
def test_who_returns_takes_the_place_of_a_connection_that_broke(shared, role, monkeypatch):
    monkeypatch.setattr("globule.viewer.app.ANSWERS", 0.5)
    shared.most_clients = 1
    with closing(Gone(shared, role)):
        until(lambda: shared.clients)
        (dead,) = shared.clients
        with closing(Program(shared.address)):
            until(lambda: shared.clients.keys() - {dead}, "for a place")
            assert dead not in shared.clients
            until(lambda: len(shared.engine.clients) == 1)
            until(lambda: shared.page.tools.hands.keys() == shared.clients.keys())


def test_values_that_would_end_every_connection_are_refused(shared, both):
    """A finger that rests on a key types numbers that no message can hold."""
    _, steering = both

    def change(key, value):
        steering.ask("control", [shared.page.binder.widgets[key].number, value])

    for key, values in {
        "quality.samples": (1e20, -1e300, "9" * 30, True, None, [1], float("nan")),
        "cuts.plane": (1, "x", None),
        "surface.kernel": ("", "x" * 3_000, 3),
        "cuts.point": ([1.0], [1.0, 2.0, "x"], [1e30, float("inf"), 0.0], 5, None),
    }.items():
        widget = shared.page.binder.widgets[key]
        before = widget.value
        for value in values:
            change(key, value)
            back = steering.heard(lambda m, w=widget: [c["id"] for c in m.get("controls", ())] == [w.number])
            assert np.array_equal(back["controls"][0]["value"], before)
            assert widget.value == before
    change("quality.rate", 30)
    until(lambda: shared.state.quality.rate == 30)
    with closing(Program(shared.address)) as other:
        until(lambda: other.images or other.closed, "for an image")
        assert not other.closed


def test_cameras_that_are_none_write_few_lines(looking, caplog):
    for i in range(40):
        looking.look(eye=[f"\x1b[2J{i}"])
    looking.camera["eye"] = [0, 0, 4]
    from_the_top(looking)
    assert 0 < len(caplog.records) < 40
    assert not any("\x1b" in record.getMessage() for record in caplog.records)


def test_strangers_write_few_lines(caplog):
    said = OneLine()
    for i in range(40):
        said.say("connection handler failed", ValueError(f"{i}"))
    assert len(caplog.records) == OTHERS[0]
