"""Calls on one object are serialized, calls on others run beside them, frames may be read from any
thread. GLOBULE_SOAK is how long threads make random calls, s (4; the goal is stated for 60)."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time

import globule as gb
import numpy as np
import pytest
from interrupts import running
from sweep_helpers import small_sweep
from test_interrupts import water

SECONDS = float(os.environ.get("GLOBULE_SOAK", "4"))
SIZE = (48, 36)
CPU = {"device": "cpu", "threads": 2}


def point_sets() -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [rng.random((n, 3)).astype(np.float32) for n in (2_000, 6_000, 500, 12_000)]


def test_shared_scene():
    sets = point_sets()
    scene = gb.Scene(sets[0], support=0.08, device="cpu", threads=1)
    camera = gb.Camera.fit(sets[0], size=SIZE)
    looks = [gb.RenderSettings(), gb.RenderSettings(shadows=True, samples=2)]
    places = sets[0][:50]
    right, fields, counts = [set() for _ in looks], set(), set()
    for points in sets:
        scene.update(positions=points)
        for k, look in enumerate(looks):
            right[k].add(gb.render(scene, camera, SIZE, look).picture.tobytes())
        fields.add(gb.field(scene, places).tobytes())
        counts.add(int(scene.neighbors(places, 0.05)[0][-1]))
    end = time.monotonic() + SECONDS

    def worker(seed: int):
        rng = np.random.default_rng(seed)
        while time.monotonic() < end:
            what = rng.integers(6)
            if what == 0:
                scene.update(positions=sets[rng.integers(4)])
            elif what == 1:
                assert gb.field(scene, places).tobytes() in fields
            elif what == 2:
                assert int(scene.neighbors(places, 0.05)[0][-1]) in counts
            elif what == 3:
                assert scene.octree.n_inside in [len(points) for points in sets]
            else:
                k = what - 4
                frame = gb.render(scene, camera, SIZE, looks[k])
                assert frame.picture.tobytes() in right[k]
                try:
                    frame.refine(1)
                except ValueError as error:  # the scene has changed since
                    if "as it was rendered" not in str(error):
                        raise
                assert np.isfinite(frame.color).all()

    with running(*(lambda k=k: worker(k) for k in range(4))):
        pass


@pytest.mark.slow
def test_shared_simulation_and_reconstructor():
    plain, sim = water(CPU), water(CPU)
    right, pictures = {0: plain.hash()}, set()
    for _ in range(400):
        pictures.add(gb.render(plain.scene, camera := gb.Camera((2, 2, 2), (0.5, 0.2, 0.5)), SIZE)
                     .picture.tobytes())  # fmt: skip
        plain.step()
        right[plain.n_steps] = plain.hash()
    sweep = small_sweep()
    serial = gb.Reconstructor(0.5, device="cpu")
    for i in range(len(sweep)):
        serial.add(sweep.frames[i], sweep.world_from_image[i])
    whole = serial.volume().values
    live = gb.Reconstructor(0.5, device="cpu", region=(serial._low, serial._high))
    live.add(sweep.frames[0], sweep.world_from_image[0])  # the lattice is the first frame's
    added, lock = list(range(1, len(sweep))), threading.Lock()
    end = time.monotonic() + SECONDS

    def worker(seed: int):
        rng = np.random.default_rng(seed)
        while time.monotonic() < end:
            what = rng.integers(4)
            if what == 0 and sim.n_steps < 390:
                sim.step()
            elif what == 1:
                with sim._lock:
                    assert sim.hash() == right[sim.n_steps]
            elif what == 2 and sim.n_steps < 390:
                assert gb.render(sim.scene, camera, SIZE).picture.tobytes() in pictures
            else:
                with lock:
                    i = added.pop() if added else None
                if i is not None:
                    live.add(sweep.frames[i], sweep.world_from_image[i])
                elif live.n_frames:
                    live.volume()

    with running(*(lambda k=k: worker(k) for k in range(4))):
        pass
    for i in added:
        live.add(sweep.frames[i], sweep.world_from_image[i])
    assert np.array_equal(live.volume().values, whole)


def test_frames_are_read_from_any_thread():
    sets = point_sets()
    scene = gb.Scene(sets[1], support=0.08, device="cpu", threads=1)
    frame = gb.render(scene, size=SIZE)
    names = ("picture", "distance", "normal", "position", "albedo", "color")
    right = {name: getattr(frame, name).tobytes() for name in names}
    end = time.monotonic() + 0.3 * SECONDS

    def read():
        while time.monotonic() < end:
            for name in names:
                assert getattr(frame, name).tobytes() == right[name]

    def change():
        while time.monotonic() < end:
            scene.update(positions=sets[2])
            gb.render(scene, size=SIZE)

    with running(read, read, read, change):
        pass


def test_layers_in_both_orders_do_not_block_each_other():
    sets = point_sets()
    a, b = (gb.Scene(points, support=0.08, device="cpu", threads=1) for points in sets[:2])
    camera = gb.Camera.fit(sets[0], size=SIZE)
    right = {order: gb.render(layers, camera, SIZE).distance.tobytes()
             for order, layers in (("ab", (a, b)), ("ba", (b, a)))}  # fmt: skip
    end = time.monotonic() + 0.5 * SECONDS

    def draw(order, layers):
        while time.monotonic() < end:
            assert gb.render(layers, camera, SIZE).distance.tobytes() == right[order]

    with running(lambda: draw("ab", (a, b)), lambda: draw("ba", (b, a))):
        pass


def test_the_interpreter_is_free_during_native_work():
    points = np.random.default_rng(1).random((1_500_000, 3), np.float32)
    scene = gb.Scene(points[:100], support=0.02, device="cpu", threads=1)
    ticks, done = [0], threading.Event()

    def tick():
        while not done.wait(0.001):
            ticks[0] += 1

    with running(tick):
        start = time.perf_counter()
        scene.update(positions=points)
        seconds = time.perf_counter() - start
        done.set()
    assert ticks[0] > 50 * seconds


def test_a_forked_child_is_told():
    code = """
import os, sys
import globule as gb, numpy as np
scene = gb.Scene(np.random.default_rng(0).random((2000, 3)), support=0.1, device="cpu", threads=2)
gb.render(scene, size=(32, 24))
child = os.fork()
if child == 0:
    for call in (lambda: gb.render(scene, size=(32, 24)), lambda: gb.Scene(np.zeros((1, 3)))):
        try:
            call()
        except RuntimeError as error:
            print(error, flush=True)
    os._exit(0)
os.waitpid(child, 0)
print(gb.render(scene, size=(32, 24)).mask.any())
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    lines = ran.stdout.splitlines()
    assert len(lines) == 3
    assert lines[-1] == "True"
    assert all("forked" in line and "spawn" in line for line in lines[:2])


def test_a_child_may_be_the_first_to_use_it():
    code = """
import os
import globule as gb, numpy as np
child = os.fork()
if child == 0:
    scene = gb.Scene(np.random.default_rng(0).random((2000, 3)), support=0.1, device="cpu")
    print(gb.render(scene, size=(32, 24)).mask.any(), flush=True)
    os._exit(0)
os.waitpid(child, 0)
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert ran.stdout.split() == ["True"]


def test_blend_checks_its_rows_where_the_particles_are():
    sets = point_sets()
    scene = gb.Scene(sets[0], support=0.08, device="cpu")
    with pytest.raises(ValueError, match=r"values: expected 2000 rows, got 6000"):
        scene.blend(sets[0][:3], np.zeros(6000, np.float32))
