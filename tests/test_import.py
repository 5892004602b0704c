"""What `import globule` does to the process."""

import os
import subprocess
import sys

import globule
import pytest

NAMES = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT")
ASK = f"import os, globule; print([os.environ.get(name) for name in {NAMES}])"


@pytest.mark.parametrize(
    ("given", "policy", "checks"),
    [
        ({}, "PASSIVE", "400"),
        ({"OMP_WAIT_POLICY": "active"}, "ACTIVE", None),
        ({"OMP_WAIT_POLICY": "passive"}, "PASSIVE", "0"),
        ({"GOMP_SPINCOUNT": "7"}, None, "7"),
    ],
)
def test_threads_that_wait_check_for_a_moment(given, policy, checks):
    """Unless the environment says otherwise; and nothing stays in it."""
    env = {name: value for name, value in os.environ.items() if name not in NAMES}
    done = subprocess.run(
        [sys.executable, "-c", ASK],
        env={**env, **given, "OMP_DISPLAY_ENV": "VERBOSE"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == str([given.get(name) for name in NAMES])
    if "GOMP_SPINCOUNT = " not in done.stderr:
        pytest.skip("the OpenMP runtime is not libgomp")
    for name, value in zip(NAMES, (policy, checks), strict=True):
        assert value is None or f"{name} = '{value}'" in done.stderr, done.stderr


def test_nothing_slow_is_loaded_before_ctrl_c_is_quiet():
    """As the command: what is looked for while Ctrl-C would still print a traceback."""
    root = os.path.dirname(os.path.dirname(globule.__file__))
    code = f"""
import os, signal, sys  # the interpreter has these already
class Watch:
    def find_spec(self, name, path=None, target=None):
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            seen.append(name)
seen, sys.argv = [], ["globule"]
sys.path[:] = [{root!r}, *sys.path]
sys.meta_path.insert(0, Watch())
try:
    import globule
except ImportError:
    pass  # without site-packages there is no NumPy
print(*seen)
"""
    isolated = [sys.executable, "-I", "-S", "-c", code]
    seen = subprocess.run(isolated, capture_output=True, text=True, check=True).stdout.split()
    assert seen == ["globule", "globule._base", "globule._base.starting"]
