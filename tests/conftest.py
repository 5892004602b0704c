"""Options of the tests, and what they share.

A test that takes `backend` runs on the best CPU level with all threads, and on the GPU where there
is one. With --matrix it runs on every CPU level, with one thread and with all, and on CUDA; tests
marked `slow` run too.
"""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import locale
import os
import signal

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube
from globule._base import device
from waiting import PATIENCE

LEVELS = device.cpu_levels()
SOAK = float(os.environ.get("GLOBULE_SOAK", 0))  # what test_concurrency.py takes on purpose
MATRIX = [f"{LEVELS[-1]}-1thread", *(f"{level}-threads" for level in LEVELS), "cuda"]


def pytest_addoption(parser):
    group = parser.getgroup("globule")
    group.addoption("--matrix", action="store_true", help="every CPU level and slow tests too")
    group.addoption(
        "--passed",
        metavar="FILE",
        help="leave out the tests that FILE names, and add those that pass",
    )
    group.addoption(
        "--expected-skips", metavar="FILE", help="fail on a skip whose reason no line of FILE has"
    )


def pytest_generate_tests(metafunc):
    if "backend" in metafunc.fixturenames:
        few = [f"{LEVELS[-1]}-threads", *(["cuda"] if has_gpu() else [])]
        every = metafunc.config.getoption("--matrix")
        if every and metafunc.definition.get_closest_marker("few_backends"):
            few = [f"{LEVELS[-1]}-threads", "cuda"]
            every = False
        metafunc.parametrize("backend", MATRIX if every else few, indirect=True)


@functools.cache
def has_gpu() -> bool:
    try:
        device.choose("cuda")
    except RuntimeError:
        return False
    return True


def pytest_collection_modifyitems(config, items):
    for item in items:
        params = getattr(getattr(item, "callspec", None), "params", {})
        if any(isinstance(value, str) and value == "cuda" for value in params.values()):
            item.add_marker("gpu")
    if not config.getoption("--matrix"):
        slow = [item for item in items if item.get_closest_marker("slow")]
        config.hook.pytest_deselected(items=slow)
        items[:] = [item for item in items if item not in slow]

    known = _passed_before(config)
    done = [item for item in items if item.nodeid in known and not _of_all_levels(item)]
    config.hook.pytest_deselected(items=done)
    gone = set(done)
    items[:] = [item for item in items if item not in gone]


def _of_all_levels(item) -> bool:
    """Whether a test looks at more CPU levels the more there are."""
    return "reference" in item.fixturenames or hasattr(item.module, "LEVELS")


def _passed_before(config) -> frozenset[str]:
    """The tests that another run with the same file has passed."""
    file = config.getoption("--passed")
    if not file or not os.path.exists(file):
        return frozenset()
    with open(file, encoding="utf-8") as lines:
        return frozenset(line.rstrip("\n") for line in lines)


def pytest_terminal_summary(terminalreporter, config):
    for line in config.stash.get(UNEXPECTED, ()):
        terminalreporter.write_line(f"unexpected skip: {line}", red=True)


def pytest_sessionfinish(session, exitstatus):
    """Note what has passed. A skip that nobody expects is a failure: something is not installed,
    or has gone."""
    if hasattr(session.config, "workerinput"):  # the process that deals out the tests does this
        return
    if passed := session.config.getoption("--passed"):
        reporter = session.config.pluginmanager.getplugin("terminalreporter")
        with open(passed, "a", encoding="utf-8") as lines:
            lines.writelines(f"{r.nodeid}\n" for r in reporter.stats.get("passed", ()))
    file = session.config.getoption("--expected-skips")
    if not file:
        return
    with open(file, encoding="utf-8") as lines:
        expected = [line.strip() for line in lines if line.strip() and line[0] != "#"]
    reporter = session.config.pluginmanager.getplugin("terminalreporter")
    found = set()
    for report in reporter.stats.get("skipped", ()):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        if not any(part in reason for part in expected):
            found.add(f"{report.nodeid}: {reason}")
    session.config.stash[UNEXPECTED] = sorted(found)
    if found and exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


UNEXPECTED = pytest.StashKey[list[str]]()


def pytest_configure(config):
    """Old names are an error in our own code; tests of them expect the warning. A shell that starts
    the tests with & has them, and all programs that they start, ignore Ctrl-C."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line("filterwarnings", "error:globule:DeprecationWarning")


@contextlib.contextmanager
def simd(level: str):
    """Scenes made inside use this SIMD level."""
    before = os.environ.get("GLOBULE_SIMD")
    os.environ["GLOBULE_SIMD"] = level
    try:
        yield
    finally:
        del os.environ["GLOBULE_SIMD"]
        if before is not None:
            os.environ["GLOBULE_SIMD"] = before


@pytest.fixture
def backend(request):
    """Keyword arguments for gb.Scene."""
    if request.param == "cuda":
        try:
            device.choose("cuda")
        except RuntimeError as error:
            pytest.skip(f"cuda: {error}")
        yield {"device": "cuda"}
        return
    level, threads = request.param.split("-")
    with simd(level):
        yield {"device": "cpu", "threads": 1 if threads == "1thread" else 0}


@pytest.fixture(scope="session")
def reference():
    """Makes a scene on one thread of the plainest CPU level: what all others must agree with."""

    def make(*args, **kwargs):
        with simd(LEVELS[0]):
            return gb.Scene(*args, **{**kwargs, "device": "cpu", "threads": 1})

    return make


@pytest.fixture(scope="session")
def real_stderr(pytestconfig):
    """Where pytest's capture does not reach."""
    with pytestconfig.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
        return os.dup(2)


@pytest.fixture(autouse=True)
def hang_guard(request, real_stderr):
    """A test that hangs in compiled code ends the run with a traceback instead of never. Those of
    files with `BROWSERS` take their time, and what they wait for has a limit of its own."""
    if getattr(request.module, "BROWSERS", False):
        yield
        return
    faulthandler.dump_traceback_later(PATIENCE + 30 + SOAK, exit=True, file=real_stderr)
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture(autouse=True)
def same_locale():
    """Some library sets the locale of the whole process to C, where text files are ASCII."""
    before = locale.setlocale(locale.LC_CTYPE)
    yield
    locale.setlocale(locale.LC_CTYPE, before)


@pytest.fixture(scope="module")
def chromium():
    """A headless browser for the tests of one file."""
    from viewer_helpers import browser

    with browser() as opened:
        yield opened


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of the test's own, where it runs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GLOBULE_TRACEBACK", raising=False)
    return tmp_path


@pytest.fixture
def particles(folder):
    """A cube of particles with attributes, in cube.npz."""
    p = cube()
    speed = np.arange(len(p), dtype=np.float64)
    p.attributes = {"speed": speed, "flow": np.stack([speed, speed, speed], axis=1)}
    gb.write("cube.npz", p)
    return "cube.npz"


@pytest.fixture
def sweep(folder):
    """A phantom of 24 small frames in phantom.igs.mha."""
    made = gb.phantoms.cylinders(n_frames=24, size=(64, 60), spacing=0.8)
    gb.write_sweep("phantom.igs.mha", made)
    return made
