"""Calls on one object are serialized, calls on others run beside them, frames may be read from any
thread. GLOBULE_SOAK: how many times as many calls the threads make (1)."""

import os
import subprocess
import sys
import threading

import globule as gb
import numpy as np
from interrupts import count, polls, running
from sweep_helpers import small_sweep
from test_interrupts import added, water
from waiting import PATIENCE, until

SOAK = int(os.environ.get("GLOBULE_SOAK", "1"))
SIZE = (48, 36)
CPU = {"device": "cpu", "threads": 2}


def point_sets() -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [rng.random((n, 3)).astype(np.float32) for n in (2_000, 3_000, 500, 6_000)]


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
        fields.add(scene.field(places).tobytes())
        counts.add(int(scene.neighbors(places, 0.05)[0][-1]))

    def worker(seed: int):
        rng = np.random.default_rng(seed)
        for what in rng.permuted(np.repeat(range(6), 6 * SOAK)):
            if what == 0:
                scene.update(positions=sets[rng.integers(4)])
            elif what == 1:
                assert scene.field(places).tobytes() in fields
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


def test_shared_simulation_and_reconstructor():
    plain, sim = water(CPU), water(CPU)
    camera = gb.Camera((2, 2, 2), (0.5, 0.2, 0.5))
    right, pictures = {}, set()
    for _ in range(n := 4 * 10 * SOAK + 1):
        pictures.add(gb.render(plain.scene, camera, SIZE).picture.tobytes())
        right[plain.n_steps] = plain.hash()
        plain.step()
    sweep = small_sweep()
    serial = added(gb.ultrasound.Reconstructor(0.5, device="cpu"), sweep, 5)
    whole = serial.volume().values
    live = gb.ultrasound.Reconstructor(0.5, device="cpu", region=(serial._low, serial._high))
    added(live, sweep, 1)  # the lattice is the first frame's
    left, lock = list(range(1, len(sweep))), threading.Lock()

    def worker(seed: int):
        rng = np.random.default_rng(seed)
        for what in rng.permuted(np.repeat(range(4), 10 * SOAK)):
            if what == 0:
                sim.step()
            elif what == 1:
                with sim._lock:
                    assert sim.hash() == right[sim.n_steps]
            elif what == 2:
                assert gb.render(sim.scene, camera, SIZE).picture.tobytes() in pictures
            else:
                with lock:
                    i = left.pop() if left else None
                if i is not None:
                    live.add(sweep.frames[i], sweep.world_from_image[i])
                else:
                    live.volume()

    with running(*(lambda k=k: worker(k) for k in range(4))):
        pass
    assert sim.n_steps == n - 1
    assert np.array_equal(live.volume().values, whole)


def test_frames_are_read_from_any_thread():
    sets = point_sets()
    scene = gb.Scene(sets[1], support=0.08, device="cpu", threads=1)
    frame = gb.render(scene, size=SIZE)
    names = ("picture", "distance", "normal", "position", "albedo", "color")
    right = {name: getattr(frame, name).tobytes() for name in names}

    def read():
        for _ in range(60 * SOAK):
            for name in names:
                assert getattr(frame, name).tobytes() == right[name]

    def change():
        for _ in range(20 * SOAK):
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

    def draw(order, layers):
        for _ in range(20 * SOAK):
            assert gb.render(layers, camera, SIZE).distance.tobytes() == right[order]

    with running(lambda: draw("ab", (a, b)), lambda: draw("ba", (b, a))):
        pass


def test_the_interpreter_is_free_during_native_work():
    """Another thread sees how far a call is, which itself never asks Python."""
    points = np.random.default_rng(1).random((50_000, 3), np.float32)
    scene = gb.Scene(points[:100], support=0.02, device="cpu", threads=1)
    n = count(lambda: scene.update(positions=points))
    inside = threading.Event()

    def look():
        until(lambda: inside.is_set() or (0 < gb._core.n_polls() < n and inside.set()), pause=0)

    def update() -> bool:
        with polls():
            scene.update(positions=points)
        return inside.is_set()

    with running(look):
        until(update, "for a thread that runs beside a call", pause=0)


def printed(code: str) -> list[str]:
    """Lines that a program prints."""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE, check=True)
    return ran.stdout.splitlines()


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
    lines = printed(code)
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
    assert printed(code) == ["True"]
