"""Objects that are made, changed, used and dropped in any order leave no memory behind."""

import subprocess
import sys
from pathlib import Path

import pytest

RUN = """
import contextlib
import ctypes
import gc
import sys
from pathlib import Path

import globule as gb
import numpy as np

MOST = 5  # of each kind
rng = np.random.default_rng(5)
on = {"device": sys.argv[1]} | ({"threads": 2} if sys.argv[1] == "cpu" else {})
light = gb.RenderSettings(shadows=True, ambient_rays=1, samples=2)
def points():
    return rng.random((int(rng.integers(1, 2000)), 3)).astype(np.float32)


def mesh():
    faces = rng.integers(0, 30, (int(rng.integers(1, 200)), 3)).astype(np.uint32)
    return gb.Mesh(rng.random((30, 3)), faces, **on)


def render(layers):
    size = (int(rng.integers(8, 65)), int(rng.integers(8, 49)))
    look = light if rng.random() < 0.3 else gb.RenderSettings()
    return gb.render(layers, gb.Camera((0.5, 0.5, 3), (0.5, 0.5, 0.5)), size, look)


make = {
    "scene": lambda: gb.Scene(points(), support=0.1, **on),
    "mesh": mesh,
    "frame": lambda: render(some("scene")),
    "simulation": lambda: gb.Simulation("dam-break", spacing=0.1, **on),
}
held = {kind: [] for kind in make}


def some(kind):
    return held[kind][int(rng.integers(len(held[kind])))]


def turn():
    kind = str(rng.choice(list(held)))
    what = rng.random()
    if not held[kind] or (len(held[kind]) < MOST and what < 0.2):
        if kind != "frame" or held["scene"]:
            held[kind].append(make[kind]())
    elif what < 0.35:
        held[kind].pop(int(rng.integers(len(held[kind]))))
    elif kind == "scene":
        some(kind).update(positions=points())
        some(kind).field(points())
    elif kind == "mesh":
        some(kind).update(rng.random((30, 3)))
        frame = render([some(kind), *held["scene"][:1]])
        held["frame"] = [*held["frame"], frame][-MOST:]
    elif kind == "frame":
        with contextlib.suppress(ValueError):  # its scene was updated since
            some(kind).refine(1)
        some(kind).picture.any()
    elif rng.random() < 0.5:
        some(kind).step()
    else:
        some(kind).reset()


def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


for kind in held:  # what many at a time need is kept for the next
    held[kind] += [make[kind]() for _ in range(MOST)]
left = []
for k in range(4000):
    turn()
    if k % 500 == 499:
        for objects in held.values():
            objects.clear()
        gc.collect()  # frames are in cycles with what refines them
        ctypes.CDLL(None).malloc_trim(0)
        left.append(resident())
print(*left)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc")
def test_three_thousand_turns(backend):
    done = subprocess.run([sys.executable, "-c", RUN, backend["device"]], capture_output=True, text=True, check=True)
    left = [int(n) for n in done.stdout.split()]
    assert len(left) == 8
    assert left[-1] < 1.05 * left[1]  # the first 500 load what is used
