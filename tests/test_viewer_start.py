"""The start page: scenes, recent files and uploads, never a path of the browser's."""

import json
import os
import subprocess
import sys
import threading
import urllib.error
import urllib.request

import globule as gb
import numpy as np
import pytest
from viewer_helpers import PATIENCE, talk, told, until

pytest.importorskip("websockets")

from globule.viewer.open import open_source
from globule.viewer.start import MOST_PART, Start, recent_files, remember

BROWSERS = True  # see hang_guard
PARTICLES = gb.Particles(np.random.default_rng(1).normal(size=(200, 3)), support=0.4)


@pytest.fixture
def start(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    gb.write(tmp_path / "known.npz", PARTICLES)
    remember(str(tmp_path / "known.npz"))
    made = Start(open_source)
    yield made
    made.close()


def heard(connection, name):
    return told(connection, lambda message: name in message)[name]


def test_a_scene_and_a_recent_file_are_opened(start, tmp_path):
    with urllib.request.urlopen(start.address()) as answer:
        assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        assert b"Drop a file" in answer.read()
    with pytest.raises(urllib.error.HTTPError):
        urllib.request.urlopen(start.address() + "etc/passwd")
    with talk(start.port, "start?token=") as connection:
        hello = told(connection)
        assert hello["recent"] == [["known.npz", str(tmp_path)]]
        assert "dam-break" in dict(hello["scenes"])
        for bad in ({"do": "scene", "name": "/etc/passwd"}, {"do": "recent", "number": 7}, {}, 3):
            connection.send(json.dumps(bad))
            assert "expected" in heard(connection, "error")
        connection.send(json.dumps({"do": "recent", "number": 0}))
        assert heard(connection, "opened")
    assert len(start.wait().particles()) == 200
    with pytest.raises(urllib.error.URLError):  # the port is free for the viewer
        urllib.request.urlopen(start.address(), timeout=2)


def send(connection, name, data, size=None, **more):
    asked = {"do": "upload", "name": name, "size": size or len(data), **more}
    connection.send(json.dumps(asked))
    for i in range(0, len(data), MOST_PART):
        connection.send(data[i : i + MOST_PART])


def test_an_upload_is_opened_and_its_copy_removed(start, tmp_path):
    data = (tmp_path / "known.npz").read_bytes()
    with talk(start.port, "start?token=") as connection:
        send(connection, "../../my file.npz", data)
        assert heard(connection, "opened")
    source = start.wait()
    assert len(source.particles()) == 200
    assert source.name.endswith(".npz")
    assert "/" not in source.name
    folder = start._folder
    assert os.listdir(folder)
    start.close()
    assert not os.path.exists(folder)


def test_two_uploads_are_compared(start, tmp_path):
    data = (tmp_path / "known.npz").read_bytes()
    with talk(start.port, "start?token=") as connection:
        for name in ("before.npz", "after.npz"):
            send(connection, name, data, more=name[0] == "b")
            if name[0] == "b":
                assert heard(connection, "kept") == name
                assert start.source is None
        assert heard(connection, "opened")
    source = start.wait()
    assert (source.kind, source.name) == ("compare", "before.npz | after.npz")


def test_three_uploads_are_a_sequence(start, tmp_path):
    data = (tmp_path / "known.npz").read_bytes()
    with talk(start.port, "start?token=") as connection:
        for i in range(3):
            send(connection, f"frame_{i}.npz", data, more=2 - i)
            if i < 2:
                assert heard(connection, "kept") == f"frame_{i}.npz"
        assert heard(connection, "opened")
    source = start.wait()
    assert (source.kind, source.n_frames, source.name) == ("sequence", 3, "frame_*.npz, 3 frames")


def test_uploads_that_are_refused_stall_or_drip(start, tmp_path, monkeypatch):
    mha = b"ObjectType = Image\nNDims = 3\nElementDataFile = /etc/passwd\n"
    nrrd = b"NRRD0004\ntype: uchar\ndimension: 1\nsizes: 9\ndata file: /etc/passwd\n\n"
    with talk(start.port, "start?token=") as connection:
        for name, data, size, why in (
            ("scene.toml", b"x", None, "expected a file with one of"),
            ("a.npz", b"x", 1 << 50, "expected 1 to"), ("a.npz", b"", -3, "expected 1 to"),
            ("a.mha", mha, None, "the name of another file"),
            ("a.nrrd", nrrd, None, "the name of another file"), ("a.npz", b"no archive", None, "a.npz"),
        ):  # fmt: skip
            send(connection, name, data, size)
            said = heard(connection, "error")
            assert why in said
            assert said.startswith(f"{name}: ")  # without the folder of the copy
            assert os.listdir(start._folder) == []
        send(connection, "kept.npz", (tmp_path / "known.npz").read_bytes(), more=1)
        assert heard(connection, "kept") == "kept.npz"
        send(connection, "a.npz", b"no archive")
        heard(connection, "error")
        assert os.listdir(start._folder) == []
        send(connection, "half.npz", 65536 * b"PK", 1_000_000)
        until(lambda: os.listdir(start._folder))
    until(lambda: not os.listdir(start._folder), "for the half file to go with its browser")
    assert start.source is None
    with talk(start.port, "start?token=") as connection:
        send(connection, "a.npz", b"x", 100_000)
        assert heard(connection, "error") == "a.npz: expected the bytes of the file"
        monkeypatch.setattr("globule.viewer.start.STALLED", 0.01)
        send(connection, "a.npz", b"", 1000)
        said = "a.npz: expected 1,000 more bytes, got none for 0.01 s. Send it again."
        assert (heard(connection, "error"), os.listdir(start._folder)) == (said, [])


def test_recent_files_are_few_and_another_machine_needs_the_token(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    (tmp_path / "temporary/gone-soon.npz").write_bytes(b"")
    remember(str(tmp_path / "temporary/gone-soon.npz"))
    assert recent_files() == []
    for i in range(10):
        (tmp_path / f"{i}.npz").write_bytes(b"")
        remember(str(tmp_path / f"{i}.npz"))
    os.remove(tmp_path / "9.npz")
    assert [os.path.basename(path) for path in recent_files()][:2] == ["8.npz", "7.npz"]
    (tmp_path / "globule/recent.json").write_text("{")
    assert recent_files() == []
    made = Start(open_source, "0.0.0.0")
    try:
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(f"http://127.0.0.1:{made.port}/")
        assert refused.value.code == 403
        with urllib.request.urlopen(made.address()) as answer:
            assert answer.status == 200
    finally:
        made.close()


@pytest.mark.browser
@pytest.mark.slow
def test_files_are_opened_in_a_running_viewer(chromium, tmp_path):
    """The start page takes the viewer's place, and the next viewer that of the start page."""
    for i in range(3):
        gb.write(tmp_path / f"frame_{i}.npz", PARTICLES)
    gb.write(tmp_path / "first.npz", PARTICLES)
    words = [sys.executable, "-m", "globule", "view", "first.npz", "--no-browser", "--port", "0"]
    run = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True, bufsize=1)
    try:
        address = next(line for line in run.stdout if "http" in line).split()[-1]
        page = chromium.new_page()
        page.goto(address)
        page.get_by_text("first.npz").first.wait_for()
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Open files").click()
        chooser.value.set_files([str(tmp_path / f"frame_{i}.npz") for i in range(3)])
        page.get_by_text("1 / 3").wait_for(timeout=60_000)
        assert page.url == address
        page.close()
    finally:
        run.terminate()
        run.wait(PATIENCE)


@pytest.mark.slow
def test_the_command_without_a_file(tmp_path):
    words = [sys.executable, "-m", "globule", "view", "--no-browser", "--port", "0"]
    env = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    run, lines = subprocess.Popen(words, env=env, stdout=subprocess.PIPE, text=True, bufsize=1), []
    threading.Thread(target=lambda: lines.extend(iter(run.stdout.readline, "")), daemon=True).start()
    try:
        until(lambda: any("choose" in line for line in lines), "for the address")
        address = lines[0].split()[-1]
        port = int(address.rstrip("/").rsplit(":", 1)[1])
        with talk(port, "start?token=") as connection:
            connection.send(json.dumps({"do": "scene", "name": "splash"}))
            assert heard(connection, "opened")
        until(lambda: any("splash at" in line for line in lines), "for the viewer")
        with urllib.request.urlopen(address) as answer:
            assert b"globule/desk.js" in answer.read()
    finally:
        run.terminate()
        run.wait(PATIENCE)
