"""Options of the tests, and what they share.

A test that takes `backend` runs on the best CPU level with several threads, on the plainest with
one, and on the GPU where there is one. With --matrix it runs on every CPU level with several
threads too, and tests marked `slow` run: if they are marked `few_backends` as well, on one of them.
"""

import collections
import contextlib
import faulthandler
import functools
import gc
import locale
import os
import signal
from pathlib import Path

# Each worker of the tests has one thread; a test that needs several says so. Before the libraries
# that read these come in.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube
from globule._base import device
from waiting import PATIENCE, Waits

LEVELS = device.cpu_levels()
QUICK = [*dict.fromkeys((f"{LEVELS[-1]}-2threads", f"{LEVELS[0]}-1thread"))]
MATRIX = [f"{LEVELS[0]}-1thread", *(f"{level}-2threads" for level in LEVELS), "cuda"]
MOST_CPU = 20.0  # s of one file
LONG_FILES = Path(__file__).with_name("long_files.txt")


def pytest_addoption(parser):
    group = parser.getgroup("globule")
    group.addoption("--matrix", action="store_true", help="every CPU level and slow tests too")
    group.addoption(
        "--expected-skips", metavar="FILE", action="append", help="fail on a skip whose reason no line of the FILEs has"
    )


def pytest_generate_tests(metafunc):
    if "backend" in metafunc.fixturenames:
        quick = [*QUICK, *(["cuda"] if has_gpu() else [])]
        every = metafunc.config.getoption("--matrix")
        metafunc.parametrize("backend", MATRIX if every else quick, indirect=True)


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
    if any("::" in str(word) for word in config.args):  # runs whatever its marks are
        return
    slow = {item for item in items if item.get_closest_marker("slow")}
    if config.getoption("--matrix"):
        gone = {*run_elsewhere(item for item in items if item in slow)}
    else:
        gone = slow.union(run_elsewhere(item for item in items if item not in slow))
    if gone:
        config.hook.pytest_deselected(items=list(gone))
        items[:] = [item for item in items if item not in gone]


def run_elsewhere(items) -> list:
    """Cases of `few_backends` that run on another CPU level: they take turns; an only one runs on the best."""
    found, turns = [], collections.defaultdict(dict)
    for item in items:
        backend = getattr(getattr(item, "callspec", None), "params", {}).get("backend")
        if backend not in (None, "cuda") and item.get_closest_marker("few_backends"):
            cases = turns[item.parent.nodeid, item.originalname]
            turn = cases.setdefault(item.callspec.id.replace(backend, "", 1), len(cases))
            if QUICK[turn % len(QUICK)] != backend:
                found.append(item)
    return found


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item):
    """Each report carries the CPU time that has passed since the one before: of this process, and
    of programs that it started and that have ended."""
    report = (yield).get_result()
    now = sum(os.times()[:4])
    report.cpu = now - item.config.stash.get(CPU_BEFORE, now)
    item.config.stash[CPU_BEFORE] = now


def cpu_of_files(reporter) -> list[tuple[float, str]]:
    """CPU time of each test file (s), the largest first."""
    files: collections.Counter[str] = collections.Counter()
    for reports in reporter.stats.values():
        for report in reports:
            if hasattr(report, "cpu"):
                files[report.nodeid.partition("::")[0]] += report.cpu
    return [(seconds, file) for file, seconds in files.most_common()]


def too_long(found: list[tuple[float, str]], listed: list[str]) -> list[str]:
    """A line for each file over the limit that is not among those that may be."""
    may = {line.split()[0] for line in listed}
    return [
        f"{file}: {seconds:.0f} CPU s, expected at most {MOST_CPU:g}: make its cases smaller, "
        f"mark them `slow`, or list it in {LONG_FILES.name}"
        for seconds, file in found
        if seconds > MOST_CPU and Path(file).name not in may
    ]


def lines_of(path: str | Path) -> list[str]:
    """The lines of a list, without comments and blank ones."""
    with open(path, encoding="utf-8") as lines:
        return [line.strip() for line in lines if line.strip() and line[0] != "#"]


def pytest_terminal_summary(terminalreporter, config):
    found = cpu_of_files(terminalreporter)
    terminalreporter.section(f"{sum(s for s, _ in found):.0f} CPU s; the longest files")
    for seconds, file in found[:30]:
        terminalreporter.write_line(f"{seconds:7.1f} s  {file}")
    for line in config.stash.get(WRONG, ()):
        terminalreporter.write_line(line, red=True)


def pytest_sessionfinish(session, exitstatus):
    """A skip that nobody expects is a failure: something is not installed, or has gone. So is a
    file that takes long, unless long_files.txt has it. Both count with --expected-skips."""
    config = session.config
    if hasattr(config, "workerinput"):  # the process that deals out the tests does this
        return
    reporter = config.pluginmanager.getplugin("terminalreporter")
    long, wrong = too_long(cpu_of_files(reporter), lines_of(LONG_FILES)), []
    if skips := config.getoption("--expected-skips"):
        wrong += long  # elsewhere a processor may be slow
        expected = [line for file in skips for line in lines_of(file)]
        for report in reporter.stats.get("skipped", ()):
            reason = report.longrepr
            reason = reason[2] if isinstance(reason, tuple) else str(reason)
            if not any(part in reason for part in expected):
                wrong.append(f"unexpected skip: {report.nodeid}: {reason}")
    config.stash[WRONG] = sorted({*wrong, *long})
    if wrong and exitstatus == 0:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


WRONG = pytest.StashKey[list[str]]()
CPU_BEFORE = pytest.StashKey[float]()


@pytest.hookimpl(wrapper=True)
def pytest_collection(session):
    """What is collected stays to the end: looking for cycles in it took a fifth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_configure(config):
    """A shell that starts the tests with & has them and their programs ignore Ctrl-C."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


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
        yield {"device": "cpu", "threads": 1 if threads == "1thread" else 2}


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
    faulthandler.dump_traceback_later(2 * PATIENCE, exit=True, file=real_stderr)
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
def clock(monkeypatch):
    """Of the client of a live run."""
    from globule.ultrasound import senders

    monkeypatch.setattr(senders, "time", waits := Waits())
    return waits


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
    made = gb.ultrasound.phantoms.cylinders(n_frames=24, size=(64, 60), spacing=0.8)
    gb.ultrasound.write_sweep("phantom.igs.mha", made)
    return made
