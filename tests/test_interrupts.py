"""An interrupted call leaves its object as it was, or to be made again: what follows is right to
the bit. GLOBULE_INTERRUPTS is the number of interrupts a test makes (63: 504 in all)."""

from __future__ import annotations

import os
import signal
import time
from functools import partial

import globule as gb
import numpy as np
import pytest
from globule._base.device import choose
from interrupts import interrupted
from sweep_helpers import small_sweep

N = int(os.environ.get("GLOBULE_INTERRUPTS", "20"))
SIZE = (64, 48)
LIGHT = gb.RenderSettings(shadows=True, ambient_rays=2, samples=2)


@pytest.fixture(params=["cpu", "cuda"])
def on(request):
    """Keyword arguments that choose the device."""
    if request.param == "cpu":
        return {"device": "cpu", "threads": 2}
    try:
        choose("cuda")
    except RuntimeError as error:
        pytest.skip(f"cuda: {error}")
    return {"device": "cuda"}


def lattice(n: int, seed: int = 1) -> np.ndarray:
    grid = np.indices((n, n, n // 2)).reshape(3, -1).T.astype(np.float32)
    return grid + 0.3 * np.random.default_rng(seed).random(grid.shape, np.float32)


def delays(seconds: float, seed: int = 0) -> np.ndarray:
    """Moments of a call that takes so long."""
    return np.random.default_rng(seed).uniform(0, 1.1 * seconds, N)


def timed(call) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def test_build(on):
    a, b = lattice(40), lattice(40, 2)
    scene = gb.Scene(a, support=2.0, **on)
    camera = gb.Camera.fit(a, size=SIZE)

    def picture():
        return gb.render(scene, camera, SIZE).picture.tobytes()

    def facts():
        return scene.octree.key_hash, scene.octree.node_hash

    of = {}
    for name, positions in (("a", a), ("b", b)):
        scene.update(positions=positions)
        of[name] = picture(), facts()
    n_came = 0
    for delay in delays(timed(lambda: scene.update(positions=a))):
        scene.update(positions=a)
        n_came += interrupted(lambda: scene.update(positions=b), delay)
        now = "a" if scene.particles.positions is a else "b"
        assert (picture(), facts()) == of[now]
        scene.update(positions=b)
        assert (picture(), facts()) == of["b"]
    assert n_came > 0


@pytest.mark.parametrize("look", [gb.RenderSettings(), LIGHT], ids=["plain", "light"])
def test_render(look, on):
    points = lattice(40)
    camera = gb.Camera.fit(points, size=SIZE)
    scene = gb.Scene(points, support=2.0, **on)

    def render():
        return gb.render(scene, camera, SIZE, look)

    scene.update(positions=points)
    seconds = timed(render)  # with cells, where there is light
    right = render().picture.tobytes()
    n_came = 0
    for delay in delays(seconds):
        scene.update(positions=points)  # cells are made anew
        n_came += interrupted(render, delay)
        assert render().picture.tobytes() == right
    assert n_came > 0


def test_refine(on):
    points = lattice(30)
    camera = gb.Camera.fit(points, size=SIZE)
    scene = gb.Scene(points, support=2.0, **on)
    frame = gb.render(scene, camera, SIZE)
    seconds = timed(lambda: frame.refine(2))
    right = {n: gb.render(scene, camera, SIZE, gb.RenderSettings(samples=n)).picture.tobytes()
             for n in (1, 3, 5)}  # fmt: skip
    for delay in delays(seconds):
        frame = gb.render(scene, camera, SIZE)
        interrupted(lambda frame=frame: frame.refine(2), delay)
        assert frame.picture.tobytes() == right[frame.samples]
        frame.refine(2)
        assert frame.picture.tobytes() == right[frame.samples]


def water(on):
    return gb.Simulation(
        {
            "spacing": 0.05,
            "domain": {"lo": [0, 0, 0], "hi": [1, 1, 1], "walls": True},
            "fluids": [{"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.5, 0.5, 0.5]}}],
        },
        **on,
    )


def test_step(on):
    plain, sim = water(on), water(on)
    right = {0: plain.hash()}
    for _ in range(2 * N):
        plain.step()
        right[plain.n_steps] = plain.hash()
    n_came = 0
    for delay in delays(timed(lambda: water(on).step()) / 2):
        n_came += interrupted(sim.step, delay)
        assert sim.hash() == right[sim.n_steps]
    sim.step()
    assert sim.hash() == right[sim.n_steps]
    assert n_came > 0


def test_picture_of_a_simulation(on):
    sim = water(on)
    sim.step()
    right = gb.render(sim.scene, size=SIZE).picture.tobytes()
    for delay in delays(0.02):
        interrupted(lambda: gb.render(sim.scene, size=SIZE), delay)
        assert gb.render(sim.scene, size=SIZE).picture.tobytes() == right


def test_cut(on):
    sim = gb.Simulation("cut-block", spacing=0.005, **on)
    sim.step()
    state, before = sim.arrays.state(), sim.tissue.n_bonds
    low, high = sim.positions.min(0), sim.positions.max(0)
    middle, far = (low + high) / 2, 2 * (high - low)
    edge = np.array([[middle[0], low[1] - far[1], 0], [middle[0], high[1] + far[1], 0]])
    blade = edge + [0, 0, low[2] - far[2]], edge + [0, 0, high[2] + far[2]]
    sim.tissue.cut(blade)
    after = sim.tissue.n_bonds
    sim.step()
    right = sim.hash()
    assert after < before
    for delay in delays(0.002):
        sim.arrays.set_state(state)
        assert sim.tissue.n_bonds == before
        interrupted(lambda: sim.tissue.cut(blade), delay)
        assert sim.tissue.n_bonds in (before, after)
        sim.tissue.cut(blade)
        assert sim.tissue.n_bonds == after
        sim.step()
        assert sim.hash() == right


@pytest.mark.parametrize("method", ["pvn-om", "vvn-om", "bezier"])
def test_reconstruct(method, on):
    sweep = small_sweep()

    def make():
        return gb.reconstruct(sweep, method=method, spacing=0.5, **on)

    right = make()
    right = right.values.tobytes(), right.radius.tobytes()
    seconds = timed(make)
    for delay in delays(seconds)[: max(1, N // 3)]:
        interrupted(make, delay)
        again = make()
        assert (again.values.tobytes(), again.radius.tobytes()) == right


def test_live(on):
    sweep = small_sweep()
    whole = gb.Reconstructor(0.5, **on)
    for i in range(len(sweep)):
        whole.add(sweep.frames[i], sweep.world_from_image[i])
    right = whole.volume()
    rng = np.random.default_rng(3)
    for _ in range(max(1, N // len(sweep))):
        live = gb.Reconstructor(0.5, **on)
        while (i := live.n_frames) < len(sweep):
            add = partial(live.add, sweep.frames[i], sweep.world_from_image[i])
            interrupted(add, rng.uniform(0, 0.002))
            if rng.random() < 0.2 and live.n_frames:
                interrupted(live.volume, rng.uniform(0, 0.01))
        volume = live.volume()
        assert volume.values.tobytes() == right.values.tobytes()
        assert volume.radius.tobytes() == right.radius.tobytes()


def test_calls_without_signal_handlers_leave_the_protection(monkeypatch):
    """A program in the background ignores Ctrl-C; its later handlers wait all the same."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        sweep = small_sweep()
        live = gb.Reconstructor(0.5, device="cpu")
        live.add(sweep.frames[0], sweep.world_from_image[0])  # no handler to replace
        bin_frames = live._bin

        def bin_and_signal(added, sign):
            os.kill(os.getpid(), signal.SIGALRM)
            for _ in range(100):  # Python handles signals between its own instructions
                pass
            bin_frames(added, sign)

        monkeypatch.setattr(live, "_bin", bin_and_signal)
        came = interrupted(lambda: live.add(sweep.frames[1], sweep.world_from_image[1]), 60)
        assert came
        assert live.n_frames == 2
    finally:
        signal.signal(signal.SIGINT, before)


def test_million_particles_stop_soon():
    """A long build does not keep Ctrl-C waiting until its end."""
    points = np.random.default_rng(1).random((3_000_000, 3), np.float32)
    scene = gb.Scene(points[:1000], support=0.02, device="cpu", threads=1)
    right = gb.render(scene, size=SIZE).picture.tobytes()
    start = time.perf_counter()
    assert interrupted(lambda: scene.update(positions=points), 0.15)
    assert time.perf_counter() - start < 2.0
    assert len(scene) == 1000
    assert gb.render(scene, size=SIZE).picture.tobytes() == right


def test_a_handler_that_uses_the_same_object_is_told(recwarn):
    """The call that it interrupts holds the scene: waiting for it would never end."""
    import signal

    points = np.random.default_rng(1).random((2_000_000, 3), np.float32)
    scene = gb.Scene(points[:1000], support=0.02, device="cpu", threads=1)
    said = []

    def handler(*_):
        try:
            gb.field(scene, [[0, 0, 0]])
        except RuntimeError as error:
            said.append(str(error))

    before = signal.signal(signal.SIGALRM, handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        scene.update(positions=points)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert said
    assert "inside another call" in said[0]
    assert len(scene) == len(points)
