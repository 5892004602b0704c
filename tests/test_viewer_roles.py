"""Several people: who steers, who looks, and how many there may be."""

import asyncio
import json
import socket
import threading
from contextlib import ExitStack, closing, contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from viewer_helpers import PATIENCE, blob, talk, told, until, view

pytest.importorskip("viser")

import msgspec
from globule.viewer.guard import OTHERS, OneLine
from globule.viewer.roles import LOOK, LOOKING, PRIVATE_ACTIONS, STEER, VISITOR
from viewer_program import CAMERA, Program
from websockets.exceptions import ConnectionClosed, InvalidStatus
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
    looking.heard(lambda m: m["type"] == "SetCameraPositionMessage" and m["position"][1] > 1)


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
    with toolbar(shared, looking, shared.look_token) as asks:
        for name in desk._actions().keys() - PRIVATE_ACTIONS:
            asks.send(json.dumps({"do": name, "value": {"cuts__plane": True}}))
        asks.send(json.dumps({"do": "tool", "value": "Measure"}))
        until(lambda: shared.page.tools.hands[number].tool == "Measure")
        told(asks, lambda m: m["note"]["body"] == LOOKING)
        assert shared.state.to_toml() == before


@contextmanager
def toolbar(viewer, program, token):
    word = until(lambda: program.word, "for the page's word")
    page = "/look" if token == viewer.look_token else ""
    with talk(viewer.port, f"desk?word={word}&token={token}", page) as connection:
        yield connection


def test_a_toolbar_has_no_more_rights_than_its_page_and_its_own_token(shared):
    """The page looks and its script has the token that steers, and the other way around; then the
    page goes."""
    steers, looks = (shared.address, shared.token), (shared.look_address, shared.look_token)
    for page, script in ((steers[0], looks[1]), (looks[0], steers[1]), looks):
        program = Program(page, script=False)
        with toolbar(shared, program, script) as asks:
            asks.send(json.dumps({"do": "set", "value": {"cuts__plane": True}}))
            told(asks, lambda m: m["note"]["body"] == LOOKING)
            program.close()
            until(lambda: not shared.clients)
            with pytest.raises(ConnectionClosed):  # the script's goes with the page's
                ask_for_ever(asks, {"do": "set", "value": {"cuts__box": True}})
        assert not shared.state.cuts.plane
        assert shared.state.look.preset == "plain"
    program = Program(shared.address, script=False)
    word = until(lambda: program.word)
    program.close()
    until(lambda: not shared.clients)
    late = talk(shared.port, f"desk?word={word}&token={shared.token}")
    with late, pytest.raises(ConnectionClosed):
        late.recv(timeout=PATIENCE)
    with pytest.raises(InvalidStatus, match="403"):
        talk(shared.port, f"desk?word={word}")


def test_no_message_of_visers_page_sets_a_control_or_an_attribute(shared, both):
    """viser would set whatever attribute of a widget a message names."""
    looking, steering = both
    slider = shared.server.gui.add_slider("Of viser", 0, 9, 1, 5)
    for program in (looking, steering):
        for updates in ({"value": 7}, {"removed": True}, {"update_cb": []}):
            program.say({"type": "GuiUpdateMessage", "uuid": slider._impl.uuid, "updates": updates})
    from_the_top(looking)
    from_the_top(steering)
    assert (slider.value, slider._impl.removed) == (5, False)


def test_a_browser_that_left_complains_to_nobody(shared, looking, caplog, capfd):
    number = next(n for n, c in shared.clients.items() if c.role == LOOK)
    browser = shared.server.get_clients()[number]
    looking.close()
    until(lambda: len(shared.clients) == 1)
    shared.page.complain(browser, "too late")
    for label in ("Next tool", "Save image", "Look from: top"):
        shared.gui.commands[label].take(browser, None)
    assert not [r for r in caplog.records if r.levelname == "WARNING"]
    assert "Traceback" not in capfd.readouterr().err


def test_an_action_in_progress_counts_after_a_new_connection(shared, both, monkeypatch):
    """Of 20 connections of one page's script, one action at a time is done."""
    running, most, go = [], [], threading.Event()

    def slow(browser):
        running.append(browser)
        most.append(len(running))
        go.wait(PATIENCE)
        running.pop()

    save = next(p for p in shared.page.panels if type(p).__name__ == "Save")
    monkeypatch.setattr(save, "picture", slow)
    for _ in range(20):
        with toolbar(shared, both[1], shared.token) as asks:
            asks.send(json.dumps({"do": "picture"}))
            until(lambda: running)
    go.set()
    until(lambda: not running)
    assert max(most) == 1


def ask_for_ever(talk, action):
    while True:
        talk.send(json.dumps(action))
        talk.recv(timeout=PATIENCE)


def test_no_message_of_a_page_without_a_role_is_heard(shared):
    """Each handler of the server, for a connection whose role is not known."""
    server, called = shared.server._websock_server, []
    kinds, asked = list(server._incoming_handlers), VISITOR.set(None)
    try:
        for kind in kinds:
            assert server._incoming_handlers[kind], kind
            server._incoming_handlers[kind] = [lambda *found: called.append(found)]
            asyncio.run(server._handle_incoming_message(0, kind.__new__(kind)))
    finally:
        VISITOR.reset(asked)
    assert len(kinds) > 3
    assert not called


def test_who_floods_waits_and_the_others_do_not(shared, both, caplog):
    """1,300 wrong actions of one who looks: few lines in the log, one action at a time, and the one
    who steers is served in between."""
    looking, steering = both
    evil = "x\nglobule: ok\x1b[2J\x1b]0;t\x07"
    with toolbar(shared, looking, shared.look_token) as flood, toolbar(shared, steering, shared.token) as asks:
        for i in range(1300):
            flood.send(json.dumps({"do": f"{evil}{i}"}))
            if i == 1100:
                asks.send(json.dumps({"do": "set", "value": {"cuts__plane": True}}))
        until(lambda: shared.state.cuts.plane)
        told(asks, lambda model: model["plane"])
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
        import viser

        self.socket = socket.create_connection(("127.0.0.1", viewer.port))
        token = viewer.look_token if role else viewer.token
        lines = (
            f"GET {role}/?token={token} HTTP/1.1", "Host: localhost", "Upgrade: websocket",
            "Connection: Upgrade", "Sec-WebSocket-Version: 13", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            f"Sec-WebSocket-Protocol: viser-v{viser.__version__}",
        )  # fmt: skip
        self.socket.sendall("\r\n".join([*lines, "", ""]).encode())
        frame = Frame(Opcode.BINARY, msgspec.msgpack.encode(CAMERA)).serialize(mask=True)
        self.socket.sendall(frame)

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


def test_what_viser_warns_of_reaches_no_terminal(recwarn, looking, caplog):
    for i in range(40):
        looking.say(CAMERA | {"position": [f"\x1b[2J{i}"]})
    from_the_top(looking)
    assert not [str(w.message) for w in recwarn]
    assert not any("\x1b" in record.getMessage() for record in caplog.records)


def test_strangers_write_few_lines(caplog):
    said = OneLine()
    for i in range(40):
        said.say("connection handler failed", ValueError(f"{i}"))
    assert len(caplog.records) == OTHERS[0]
