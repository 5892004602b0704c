"""Who may see the page, and what browsers may send."""

import http.client
import itertools
import socket
from contextlib import closing

import numpy as np
import pytest
from globule.viewer.guard import Guard, is_local
from globule.viewer.roles import LOOK, STEER, Visitor
from viewer_helpers import PATIENCE, until, view

pytest.importorskip("viser")

import viser
from viewer_program import CAMERA, Program
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.sync.client import connect

PROTOCOL = f"viser-v{viser.__version__}"
POINT = np.zeros((1, 3), np.float32)


def headers(**given):
    return Headers({name.replace("_", "-"): value for name, value in given.items()})


def test_addresses_of_this_machine_tokens_and_roles_of_tabs():
    guard = Guard(None)
    assert guard.refusal("/", headers(Host="127.0.0.1:8080")) is None
    assert guard.refusal("/", headers(Host="localhost:9000", Origin="http://localhost:9000")) is None
    assert guard.refusal("/", headers(Host="evil.example"))
    for origin in ("http://evil.example", "http://[::1", "null", "http://localhost:8080@evil"):
        assert guard.refusal("/", headers(Host="localhost:8080", Origin=origin))
    twice = headers(Host="localhost")
    twice["Host"] = "evil.example"
    assert guard.refusal("/", twice)
    for host in ("[::1]:80", "LOCALHOST", "localhost:1", "127.0.0.1:80", "127.9.9.9", "[::1]"):
        assert is_local(host), host
    for host in (
        "127.0.0.1.evil.example", "evil.com@127.0.0.1", "127.0.0.1, evil.com", "[::1", "::1",
        "127.0.0.1:", "127.0.0.1:99999", "127.0.0.1:x", "localhost/", "localhost?", "localhost#",
        "", " localhost", "localhost ", "[127.0.0.1]", "127.1", "2130706433", "127.0.0.1\t",
        "[::1]evil", "localhost.", "[fe80::1%lo]", "\uff1127.0.0.1",
    ):  # fmt: skip
        assert not is_local(host), host
    guard = Guard("secret", look_token="only")
    name = guard.cookie(STEER, headers()).partition("=")[0]
    other = Guard("other").cookie(STEER, headers()).partition("=")[0]
    assert other != name  # two viewers of one host
    assert "; Secure" in guard.cookie(LOOK, headers(X_Forwarded_Proto="https"))
    for path, cookie, enters in (
        ("/", "", False), ("/?token=wrong", "", False), ("/?token=secret", "", True),
        ("/x.js", f"a=b; {name}=secret", True), ("/x.js", f"{name}=no", False),
    ):  # fmt: skip
        assert (guard.refusal(path, headers(Host="box:8080", Cookie=cookie)) is None) == enters, (path, cookie)
    guard = Guard("secret", look_token="only")
    both = "; ".join(guard.cookie(role, headers()).partition(";")[0] for role in (STEER, LOOK))
    looks = guard.cookie(LOOK, headers()).partition(";")[0]
    for path, cookies, role in (
        ("/?token=secret", "", STEER),
        ("/look/?token=only", "", LOOK),
        ("/", both, STEER),
        ("/globule/desk?word=x", both, STEER),
        ("/look", both, LOOK),  # viser's websocket
        ("/look/globule/desk?word=x", both, LOOK),
        ("/looks", both, STEER),
        ("/", looks, None),
        ("/?token=only", looks, None),
        ("/look/?token=secret", "", None),
        ("/look/?token=secret", both, LOOK),
    ):
        assert guard.role(path, headers(Host="box", Cookie=cookies)) == role, (path, cookies)
    below = ("/", "/", "/globule/desk?word=x", "/?token=only")
    paths = ("/look", "/look/", "/look/globule/desk?word=x", "/look?token=only")
    assert [guard.asked(path) for path in paths] == [(LOOK, rest) for rest in below]
    assert Guard(None).asked("/look/") == (STEER, "/look/")


@pytest.fixture
def guarded():
    with view(POINT, host="0.0.0.0") as viewer:
        yield viewer


def linked(viewer, path="?"):
    """A connection as browsers have it."""
    url = f"ws://127.0.0.1:{viewer.port}/{path}token={viewer.token}"
    return connect(url, subprotocols=[PROTOCOL], max_size=None)


def ask(port: int, path: str = "/", **given) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
    connection.request("GET", path, headers={k.replace("_", "-"): v for k, v in given.items()})
    return connection.getresponse()


UPGRADE = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13"}
UPGRADE["Sec_WebSocket_Key"] = "dGhlIHNhbXBsZSBub25jZQ=="


def test_without_the_token_neither_page_nor_messages(guarded, capfd):
    assert f"?token={guarded.token}" in guarded.address
    for path in ("/", "/index.html", "/?token=x", "/%2e%2e/etc/passwd"):
        assert ask(guarded.port, path).status == 403
    assert (ask(guarded.port, **UPGRADE).status, ask(guarded.port, "/?token=x", **UPGRADE).status) == (403, 403)
    good = ask(guarded.port, f"/?token={guarded.token}")
    assert good.status == 200
    assert "default-src 'self'" in good.headers["Content-Security-Policy"]
    cookie = good.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    name = cookie.split(";")[0]
    assert ask(guarded.port, "/", Cookie=name).status == 200
    assert ask(guarded.port, Cookie=name, Sec_WebSocket_Protocol=PROTOCOL, **UPGRADE).status == 101
    strange = dict(UPGRADE, Origin="http://evil.example", Cookie=name)
    assert ask(guarded.port, **strange).status == 403


def test_requests_that_no_browser_sends_get_403_and_large_ones_no_answer(guarded):
    token, good = guarded.token.encode(), b"Host: box\r\n"
    for line, more in (
        (b"//[", b""),
        (b"/?token=\xff", b""),
        (b"/?token=" + token, b"X-Forwarded-Proto: https\r\nX-Forwarded-Proto: http\r\n"),
        (b"/?token=" + token, b"Accept-Encoding: gzip\r\nAccept-Encoding: br\r\n"),
        (b"/" + 3000 * b"x" + b"?token=" + token, b""),
    ):
        with socket.create_connection(("127.0.0.1", guarded.port)) as asked:
            asked.sendall(b"GET " + line + b" HTTP/1.1\r\n" + good + more + b"\r\n")
            status = asked.makefile("rb").readline().split()[1]
        assert status == (b"200" if b"Forwarded" in more else b"403"), line
    with linked(guarded) as connection:
        connection.send(bytes(2 * 1024 * 1024))
        with pytest.raises(ConnectionClosed) as closed:
            all(connection.recv(timeout=PATIENCE) for _ in itertools.count())
    assert closed.value.rcvd.code == 1009


@pytest.mark.parametrize("opcode", ["PING", "PONG", "CONT"])
@pytest.mark.parametrize("path", ["", "globule/desk"])
def test_a_flood_of_frames_without_a_message_ends_the_connection(guarded, caplog, opcode, path):
    steering = Program(guarded.address, script=not path)
    word = until(lambda: steering.word)
    with linked(guarded, f"{path}?word={word}&") as flooding:
        if opcode == "CONT":
            flooding.socket.sendall(Frame(Opcode.BINARY, b"x", fin=False).serialize(mask=True))
        empty = Frame(Opcode[opcode], b"", fin=opcode != "CONT").serialize(mask=True)
        flooding.socket.sendall(3000 * empty)
        with pytest.raises(ConnectionClosed):
            all(flooding.recv(timeout=PATIENCE) for _ in itertools.count())
    with closing(Program(guarded.address)) as other:
        other.set("Plane")
        until(lambda: guarded.state.cuts.plane)
    said = [r.getMessage() for r in caplog.records if "frames" in r.getMessage()]
    assert said == ["page: a browser sent too many frames without a message"]
    steering.close()


def test_viser_takes_no_file_and_another_version_prints_nothing(guarded, capfd):
    """Ten headers of files whose bytes never come."""
    program = Program(guarded.address)
    begin = {"type": "FileTransferStartUpload", "filename": "f", "mime_type": "text/plain"}
    for i in range(10):
        file = {"source_component_uuid": "x", "transfer_uuid": f"stalled {i}"}
        program.say(begin | file | {"part_count": 1, "size_bytes": 9})
    program.ask("load", ["view.toml", "[cuts]\nplane = true\n"])
    until(lambda: guarded.state.cuts.plane)
    assert not guarded.server.gui._current_file_upload_states
    program.close()
    url = f"ws://127.0.0.1:{guarded.port}/?token={guarded.token}"
    with connect(url, subprotocols=["viser-v0"]) as one, pytest.raises(ConnectionClosed) as closed:
        one.recv(timeout=PATIENCE)
    assert closed.value.rcvd.code == 1002  # at which the page says why
    assert capfd.readouterr() == ("", "")


def test_what_is_no_message_gets_one_line(guarded, caplog, capfd):
    pack = pytest.importorskip("msgspec").msgpack.encode
    nowhere = CAMERA | {"position": [float("nan")] * 3, "image_height": 0, "image_width": 10**9}
    for messages in (
        [b"\x00garbage"], ["text"], [pack({"type": "Nope"})], [pack([CAMERA])], [pack(nowhere)],
        [pack(CAMERA), pack(nowhere)],
    ):  # fmt: skip
        known = len(caplog.records)
        with linked(guarded) as one:
            for message in messages:
                one.send(message)
            until(lambda known=known: len(caplog.records) > known, "for a line in the log")
    for record in caplog.records:
        assert record.name == "globule.viewer"
        assert "\n" not in record.getMessage()
        assert record.exc_info is None
    assert not capfd.readouterr().err
    assert ask(guarded.port, f"/?token={guarded.token}").status == 200


def test_the_page_is_bound_to_this_machine_and_cannot_be_shared():
    from viser import _messages

    with view(POINT) as viewer:
        for kind in (_messages.ShareUrlRequest, _messages.FileTransferStartUpload, _messages.GuiUpdateMessage):
            assert not viewer.page.roles.may(Visitor(STEER), kind.__new__(kind))
        addresses = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
        for address in addresses - {"127.0.0.1", "127.0.1.1", "::1"}:
            with pytest.raises(OSError, match=r"refused|timed out|unreachable"):
                socket.create_connection((address, viewer.port), timeout=5)


def test_values_that_no_widget_would_send_are_refused():
    """A browser may be somebody's own program."""
    from globule.viewer.page.widgets import bounded

    with view(POINT) as viewer:
        save = viewer.page.panels[-3]
        save.format.value = "/../../../tmp/x.PNG"
        with pytest.raises(ValueError, match="Image format: expected PNG or EXR"):
            save.chosen_extension()
        for size in ("0x10", "99999x99999", "1x1; rm", 7):
            save.size.value = size
            with pytest.raises((ValueError, TypeError)):
                save.chosen_size()
        save.samples.value = 10**12
        assert bounded(save.samples) == 256
        save.samples.value = "many"
        with pytest.raises(ValueError, match="expected a number"):
            bounded(save.samples)
        heard = []
        viewer.page.binder.on_error = lambda browser, message: heard.append(message)
        widget = viewer.page.binder.widgets["quality.samples"]
        before = viewer.state.quality.samples
        for value in (float("nan"), "x", None, [1]):
            with pytest.raises(ValueError, match="expected a value that the control can hold"):
                widget.take(None, value)
            assert viewer.state.quality.samples == widget.value == before
        widget.take(None, 10**9)
        assert "expected 1 to 64, got 1e+09" in heard[0]
        assert viewer.state.quality.samples == widget.max == 64


def test_other_servers_of_the_process_are_not_affected(monkeypatch):
    refused = []
    monkeypatch.setattr(Guard, "refusal", lambda *request: refused.append(request))
    with view(POINT) as viewer:
        assert (ask(viewer.port).status, len(refused)) == (200, 1)
        plain = viser.ViserServer("127.0.0.1", 0, verbose=False)
        assert "Content-Security-Policy" not in ask(plain.get_port()).headers
        plain.stop()
        assert len(refused) == 1
