"""Processes that open files by libraries of others: kept for the next file, ended if one fails."""

import os
import signal
import subprocess
import sys

import pytest
from globule.formats import FormatError, guarded, workers
from waiting import until

# In the place of a library: does what a file says, or tells in which process it was loaded.
LIBRARY = """
import os, signal
def dcmread(path, **_):
    what = open(path).read()
    if what == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    while what == "loop":
        pass
    if what == "large":
        bytearray(1 << 40)
    if what == "silent":
        os._exit(0)
    return {"SequenceOfUltrasoundRegions": [{"PhysicalDeltaX": os.getppid()}]}
"""


@pytest.fixture
def opened(tmp_path, monkeypatch):
    (tmp_path / "pydicom.py").write_text(LIBRARY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(workers, "_idle", {})
    monkeypatch.setattr(guarded, "_SECONDS", 1)

    def work(what: str) -> int:
        path = tmp_path / "a.dcm"
        path.write_text(what)
        facts, _ = guarded.decode("regions", path, "a file")
        return int(facts["regions"][0]["delta_x"])

    yield work
    workers._end_all()


def test_a_refused_file_leaves_its_worker(opened, monkeypatch):
    first = opened("good")
    with pytest.raises(FormatError, match="more memory than there is"):
        opened("large")
    with monkeypatch.context() as limited:
        limited.setattr(guarded, "check_size", refuse)
        for _ in range(20):
            with pytest.raises(FormatError, match="needs too much"):
                opened("good")
    assert opened("good") == first


def refuse(path, place, *_):
    raise FormatError(f"{path}: {place} needs too much")


@pytest.mark.parametrize(("what", "message"), [
    ("crash", "does not survive"),
    ("loop", "does not survive"),  # SIGXCPU
    ("silent", "breaks off"),
])  # fmt: skip
def test_a_bad_file_ends_its_worker_and_nothing_else(opened, what, message):
    first = opened("good")
    with pytest.raises(FormatError, match=message) as caught:
        opened(what)
    assert "a.dcm" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)
    assert opened("good") not in (first, os.getpid())


def test_a_worker_that_was_killed_is_replaced(opened):
    first = opened("good")
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    assert opened("good") != first
    # A fork of the program has workers of its own.
    first, fork = opened("good"), os.fork()
    if fork == 0:
        status = 1
        try:
            status = 0 if opened("good") != first else 2
            workers._end_all()
        finally:
            os._exit(status)
    assert (os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]), opened("good")) == (0, first)


@pytest.mark.parametrize("end", ["", "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"])
def test_workers_end_with_the_program(end):
    program = (
        "from globule.formats import workers\n"
        "workers.prepare(['a.H5', 'b.h5'])\n"
        "(one,) = next(iter(workers._idle.values()))\n"
        f"print(one.pid, flush=True)\n{end}"
    )
    ran = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True)
    assert not ran.stderr
    path = f"/proc/{int(ran.stdout)}"
    until(lambda: not os.path.exists(path), "for its end, after it has loaded its library")


def test_nothing_is_started_for_files_that_need_no_worker(monkeypatch):
    monkeypatch.setattr(workers, "_idle", {})
    workers.prepare(["render", "a.npz", "-o", "b.png", "h5"])
    assert not workers._idle
