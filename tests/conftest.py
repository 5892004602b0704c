"""Every test that takes `backend` runs on each CPU level, with one and all threads, and CUDA."""

from __future__ import annotations

import contextlib
import faulthandler
import os

# Threads that wait should not spin: beside another busy process that costs ten times the time.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import globule as gb
import numpy as np
import pytest
from cli_helpers import cube
from globule._base import device

LEVELS = device.cpu_levels()
SOAK = float(os.environ.get("GLOBULE_SOAK", 0))  # what test_concurrency.py takes on purpose
BACKENDS = [f"{LEVELS[-1]}-1thread", *(f"{level}-threads" for level in LEVELS), "cuda"]


def pytest_configure(config):
    """Old names are an error in our own code; tests of them expect the warning."""
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


@pytest.fixture(params=BACKENDS)
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
    faulthandler.dump_traceback_later(60 + SOAK, exit=True, file=real_stderr)
    yield
    faulthandler.cancel_dump_traceback_later()


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
