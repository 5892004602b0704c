"""mpiexec for tests: where it is, and the environment that it needs."""

import os
import shutil
import subprocess
import sys

import pytest
from waiting import PATIENCE

# Open MPI starts no ranks for root, and no more ranks than cores, unless it is told to.
ENV = {
    **os.environ,
    "OMP_NUM_THREADS": "1",
    "PYTHONPATH": os.pathsep.join(filter(None, (os.path.dirname(__file__), os.environ.get("PYTHONPATH")))),
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}


def mpiexec() -> str:
    """The mpiexec beside this Python, or of the PATH; without one, the test is skipped."""
    path = f"{os.path.dirname(sys.executable)}{os.pathsep}{os.environ['PATH']}"
    found = shutil.which("mpiexec", path=path)
    if found is None:
        pytest.skip("no mpiexec")
    return found


def mpirun(n: int, *words: str, **options) -> subprocess.CompletedProcess:
    """Python with these arguments on n ranks."""
    pytest.importorskip("mpi4py")
    return subprocess.run(
        [mpiexec(), "-n", str(n), sys.executable, *words],
        capture_output=True, text=True, timeout=PATIENCE, env=ENV, **options,
    )  # fmt: skip
