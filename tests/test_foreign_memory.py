"""NaN in new memory changes no bit. Parts of arrays that only fill up SIMD lanes are easily forgotten."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# New memory holds NaN.
FILL = """
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>
#include <malloc.h>
extern "C" void* aligned_alloc(size_t unit, size_t n) {
    void* p;
    if (posix_memalign(&p, unit < 8 ? 8 : unit, n)) return nullptr;
    return memset(p, 0xff, n);
}
extern "C" void* realloc(void* q, size_t n) {
    static auto real = (void* (*)(void*, size_t))dlsym(RTLD_NEXT, "realloc");
    const size_t old = q ? malloc_usable_size(q) : 0;
    void* p = real(q, n);
    if (p && n > old) memset((char*)p + old, 0xff, n - old);
    return p;
}
"""

PARTS = """
import hashlib
import globule as gb, numpy as np
from bench.tables import physics_fluid as physics
from sweep_helpers import small_sweep
from test_sim_fluid import D, column

def show(name, *arrays):
    data = b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)
    print(name, hashlib.md5(data).hexdigest())

points = np.random.default_rng(1).random((1237, 3), np.float32)
camera = gb.Camera.fit(points, size=(61, 47))
glass = gb.Material(transmission=0.9, index=1.33)
light = gb.RenderSettings(shadows=True, ambient_rays=1, bounces=2, samples=2, material=glass)
dense = {"octree": "dense", "level": 4}
for options in ({"support": 0.1}, {"support": 0.1} | dense, {"surface": "smooth"}):
    scene = gb.Scene(points, device="cpu", **options)
    for settings in (gb.RenderSettings(), light):
        frame = gb.render(scene, camera, (61, 47), settings)
        show(options, frame.color, frame.distance, frame.normal)
mesh = gb.Mesh(*[np.array(a) for a in ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
               [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])], device="cpu")
show("mesh", gb.render([scene, mesh], camera, (61, 47), light).color)
for method in ("pvn-om", "vvn-om", "pvn", "vvn", "bezier", "frames"):
    volume = gb.ultrasound.reconstruct(small_sweep(), method=method, spacing=2.0, device="cpu")
    show(method, volume.values)
sim = gb.Simulation(column(), device="cpu")
sim.add(physics.lattice((0, 0, 0), (0.5, 0.4, 0.37), D), "water")
sim.run(0.05)
show("fluid", sim.positions, sim.velocities, sim.arrays.pressure)
for name, spacing in (("droplet", 0.001), ("cut-block", 0.01)):
    sim = gb.Simulation(name, spacing=spacing, device="cpu")
    sim.run(2 * 0.002)
    show(name, sim.positions, sim.velocities, gb.render(sim.scene, size=(64, 48)).color)
sim = gb.Simulation(column(), device="cpu")
sim.add(physics.lattice((0, 0, 0), (1.0, 0.8, 0.4), 0.9 * D), "water")
try:
    sim.run(1.0)
except ArithmeticError as error:
    print(error)
"""


@pytest.mark.slow
def test_memory_of_others_changes_nothing(tmp_path):
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    if not compiler or not sys.platform.startswith("linux"):
        pytest.skip("needs Linux and a C++ compiler")
    source, library = tmp_path / "fill.cpp", tmp_path / "fill.so"
    source.write_text(FILL, encoding="utf-8")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    tests = str(Path(__file__).parent)
    path = os.pathsep.join(filter(None, [tests, os.environ.get("PYTHONPATH")]))
    found = []
    for preload in ("", str(library)):
        environment = {**os.environ, "PYTHONPATH": path, "LD_PRELOAD": preload}
        done = subprocess.run([sys.executable, "-c", PARTS], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        found.append(done.stdout.splitlines())
    assert len(found[0]) > 12
    assert found[0] == found[1]
