"""Who may see the page, and what browsers may send."""

import gzip
import http.client
import itertools
import json
import socket
from contextlib import closing

import numpy as np
import pytest
from globule.viewer.app import Viewer
from globule.viewer.guard import Guard, is_local
from globule.viewer.open import open_source
from globule.viewer.roles import LOOK, STEER
from viewer_helpers import PATIENCE, told, until, view

pytest.importorskip("websockets")

from viewer_program import Program, hello, link
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode

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
        ("/globule/desk?x=y", both, STEER),
        ("/look", both, LOOK),
        ("/look/globule/desk?x=y", both, LOOK),
        ("/looks", both, STEER),
        ("/", looks, None),
        ("/?token=only", looks, None),
        ("/look/?token=secret", "", None),
        ("/look/?token=secret", both, LOOK),
    ):
        assert guard.role(path, headers(Host="box", Cookie=cookies)) == role, (path, cookies)
    below = ("/", "/", "/globule/desk?x=y", "/?token=only")
    paths = ("/look", "/look/", "/look/globule/desk?x=y", "/look?token=only")
    assert [guard.asked(path) for path in paths] == [(LOOK, rest) for rest in below]
    assert Guard(None).asked("/look/") == (STEER, "/look/")


@pytest.fixture
def guarded():
    with view(POINT, host="0.0.0.0") as viewer:
        yield viewer


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
    for path in ("/globule/desk", "/globule/desk?token=x", f"/look/globule/desk?token={guarded.token}"):
        assert ask(guarded.port, path, **UPGRADE).status == 403
    good = ask(guarded.port, f"/?token={guarded.token}")
    assert good.status == 200
    assert "default-src 'self'" in good.headers["Content-Security-Policy"]
    cookie = good.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    name = cookie.split(";")[0]
    assert ask(guarded.port, "/", Cookie=name).status == 200
    assert ask(guarded.port, "/globule/desk", Cookie=name, **UPGRADE).status == 101
    strange = dict(UPGRADE, Origin="http://evil.example", Cookie=name)
    assert ask(guarded.port, "/globule/desk", **strange).status == 403


def test_requests_that_no_browser_sends_get_no_page_and_large_ones_no_answer(guarded):
    token, good = guarded.token.encode(), b"Host: box\r\n"
    for line, more, status in (
        (b"//[", b"", b"403"),
        (b"/?token=\xff", b"", None),  # no answer; 403 with older websockets
        (b"/?token=" + token, b"X-Forwarded-Proto: https\r\nX-Forwarded-Proto: http\r\n", b"200"),
        (b"/?token=" + token, b"Accept-Encoding: gzip\r\nAccept-Encoding: br\r\n", b"200"),
        (b"/" + 3000 * b"x" + b"?token=" + token, b"", b"404"),
    ):
        with socket.create_connection(("127.0.0.1", guarded.port)) as asked:
            asked.sendall(b"GET " + line + b" HTTP/1.1\r\n" + good + more + b"\r\n")
            answer = asked.makefile("rb").readline().split()[1:2]
            assert answer == [status] or (status is None and answer in ([], [b"403"])), line
    with closing(link(guarded.address)) as connection:
        connection.send(bytes(2 * 1024 * 1024))
        with pytest.raises(ConnectionClosed) as closed:
            all(connection.recv(timeout=PATIENCE) for _ in itertools.count())
    assert closed.value.rcvd.code == 1009


@pytest.mark.parametrize("opcode", ["PING", "PONG", "CONT"])
@pytest.mark.parametrize("first", ["", hello()], ids=["a stranger", "a page"])
def test_a_flood_of_frames_without_a_message_ends_the_connection(guarded, caplog, opcode, first):
    with closing(link(guarded.address)) as flooding:
        if first:
            flooding.send(first)
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


def test_what_is_no_message_gets_one_line(guarded, caplog, capfd):
    def asks(name, value):
        return json.dumps({"do": name, "value": value})

    nowhere = {"eye": [float("nan")] * 3, "look_at": [0] * 3, "up": [0, 1, 0], "fov": 1.0, "moves": 1}
    for first in (
        b"\x00garbage", "text", asks("Nope", 3), "[" * 4000, "[]", hello(size=[0, "x"]), hello(size=[1e300, 1e999]),
        hello(tab="x"),
    ):  # fmt: skip
        with closing(link(guarded.address)) as one, pytest.raises(ConnectionClosed) as closed:  # noqa: PT012
            one.send(first)
            one.recv(timeout=PATIENCE)
        assert closed.value.rcvd.code == 1011
    assert not guarded.clients
    for wrong in (
        "text", "[]", b"\x00garbage", "[" * 4000, asks("size", [1, 2, 3]), asks("size", [float("nan"), 2]),
        asks("look", nowhere), asks("look", [1]), asks("handle", ["plane", [0] * 3, [[0] * 3] * 2]), asks("handle", 3),
    ):  # fmt: skip
        with closing(link(guarded.address)) as one:
            one.send(hello())
            one.send(wrong)
            told(one, lambda m: m["note"]["wrong"])
    assert len(caplog.records) > 6
    for record in caplog.records:
        assert record.name == "globule.viewer"
        assert "\n" not in record.getMessage()
        assert record.exc_info is None
    assert not capfd.readouterr().err
    assert ask(guarded.port, f"/?token={guarded.token}").status == 200


def test_the_page_is_bound_to_this_machine():
    with view(POINT) as viewer:
        addresses = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None)}
        for address in addresses - {"127.0.0.1", "127.0.1.1", "::1"}:
            with pytest.raises(OSError, match=r"refused|timed out|unreachable"):
                socket.create_connection((address, viewer.port), timeout=5)


def test_a_title_is_text_and_files_are_packed_for_those_who_ask():
    with Viewer(open_source(POINT), title="a <b>", port=0) as viewer:
        plain = ask(viewer.port)
        packed = ask(viewer.port, Accept_Encoding="gzip, br")
        page = plain.read()
        assert b"<title>a &lt;b&gt; \xc2\xb7 globule</title>" in page
        assert gzip.decompress(packed.read()) == page
        assert (plain.headers["Content-Encoding"], packed.headers["Content-Encoding"]) == (None, "gzip")


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
