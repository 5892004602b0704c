"""An interrupted call leaves its object as it was, or to be made again: what follows is right to
the bit. GLOBULE_INTERRUPTS=all: at all places of each call, not at some."""

import signal
from functools import partial

import globule as gb
import numpy as np
import pytest
from globule._base.device import choose
from interrupts import count, interrupted, interrupts, lines, polls
from sweep_helpers import small_sweep

SIZE = (40, 30)
LIGHT = gb.RenderSettings(shadows=True, ambient_rays=2, samples=2)


@pytest.fixture(params=["1thread", "2threads", "cuda"])
def on(request):
    """Keyword arguments that choose the device."""
    if request.param != "cuda":
        return {"device": "cpu", "threads": int(request.param[0])}
    try:
        choose("cuda")
    except RuntimeError as error:
        pytest.skip(f"cuda: {error}")
    return {"device": "cuda"}


@pytest.fixture
def stops(on):
    """`interrupts` on a device. Of two threads, the one that polls has now more of the work and now less."""

    def on_device(prepare, call):
        sure = on.get("threads") == 1
        return interrupts(prepare, call, sure, few=16 if sure else 4)

    return on_device


def lattice(n: int, seed: int = 1) -> np.ndarray:
    grid = np.indices((n, n, n // 2)).reshape(3, -1).T.astype(np.float32)
    return grid + 0.3 * np.random.default_rng(seed).random(grid.shape, np.float32)


def test_build(on, stops):
    a, b = lattice(20), lattice(20, 2)
    scene = gb.Scene(a, support=2.0, **on)
    camera = gb.Camera.fit(a, size=SIZE)

    def facts():
        picture = gb.render(scene, camera, SIZE).picture.tobytes()
        return picture, scene.octree.key_hash, scene.octree.node_hash

    of = {}
    for name, positions in (("b", b), ("a", a)):
        scene.update(positions=positions)
        of[name] = facts()
    for _ in stops(lambda: scene.update(positions=a), lambda _: scene.update(positions=b)):
        assert facts() == of["a" if scene.particles.positions is a else "b"]
        scene.update(positions=b)
        assert facts() == of["b"]


@pytest.mark.parametrize("look", [gb.RenderSettings(), LIGHT], ids=["plain", "light"])
def test_render(look, on, stops):
    points = lattice(16)
    camera = gb.Camera.fit(points, size=SIZE)
    scene = gb.Scene(points, support=2.0, **on)

    def render(_=None):
        return gb.render(scene, camera, SIZE, look).picture.tobytes()

    right = render()
    for _ in stops(lambda: scene.update(positions=points), render):  # cells are made anew
        assert render() == right


def test_refine(on, stops):
    points = lattice(16)
    camera = gb.Camera.fit(points, size=SIZE)
    scene = gb.Scene(points, support=2.0, **on)
    right = {n: gb.render(scene, camera, SIZE, gb.RenderSettings(samples=n)).picture.tobytes()
             for n in (1, 3, 5)}  # fmt: skip
    for frame in stops(lambda: gb.render(scene, camera, SIZE), lambda frame: frame.refine(2)):
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


def test_step(on, stops):
    """Whole steps, and their pictures."""
    plain, sim = water(on), water(on)
    hashes, pictures = {}, {}

    def picture(sim):
        return gb.render(sim.scene, size=SIZE).picture.tobytes()

    def run(sim):
        end = sim.n_steps + 2
        sim.run(10.0, stop=lambda: sim.n_steps == end)

    for steps in (lambda sim: sim.step(), run, picture):
        for _ in stops(lambda: sim, steps):
            while plain.n_steps <= sim.n_steps:
                hashes[plain.n_steps], pictures[plain.n_steps] = plain.hash(), picture(plain)
                plain.step()
            assert sim.hash() == hashes[sim.n_steps]
            assert picture(sim) == pictures[sim.n_steps]


def test_cut(on, stops):
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

    def prepare():
        sim.arrays.set_state(state)
        assert sim.tissue.n_bonds == before

    for _ in stops(prepare, lambda _: sim.tissue.cut(blade)):
        assert sim.tissue.n_bonds in (before, after)
        sim.tissue.cut(blade)
        assert sim.tissue.n_bonds == after
        sim.step()
        assert sim.hash() == right


@pytest.mark.parametrize("method", ["pvn-om", "vvn-om", "bezier"])
def test_reconstruct(method, stops, on):
    sweep = small_sweep()

    def make(_=None):
        made = gb.ultrasound.reconstruct(sweep, method=method, spacing=0.8, **on)
        return made.values.tobytes(), made.radius.tobytes()

    right = make()
    for _ in stops(lambda: None, make):
        assert make() == right


def added(live, sweep, end: int):
    """With the frames of a sweep, from those on that it has."""
    while (i := live.n_frames) < end:
        live.add(sweep.frames[i], sweep.world_from_image[i])
    return live


@pytest.mark.parametrize("what", ["add", "undo", "volume"])
def test_live(what, on, stops):
    sweep = small_sweep()
    calls = {
        "add": lambda live: added(live, sweep, 3),
        "undo": lambda live: live.undo(),
        "volume": lambda live: live.volume(),
    }
    right = added(gb.ultrasound.Reconstructor(0.5, **on), sweep, 5).volume()
    for live in stops(lambda: added(gb.ultrasound.Reconstructor(0.5, **on), sweep, 2), calls[what]):
        assert live.n_frames in {"add": (2, 3), "undo": (1, 2), "volume": (2,)}[what]
        volume = added(live, sweep, 5).volume()
        assert volume.values.tobytes() == right.values.tobytes()
        assert volume.radius.tobytes() == right.radius.tobytes()


def test_handlers_are_given_back_wherever_one_raises():
    sweep, live = small_sweep(), gb.ultrasound.Reconstructor(0.5, device="cpu")
    add, other = partial(live.add, sweep.frames[0], sweep.world_from_image[0]), signal.SIGUSR1
    add()
    stop = 1
    while interrupted(add, partial(lines, number=other), stop, number=other):
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler, stop
        stop += 1
    assert stop > 50


def test_calls_without_signal_handlers_leave_the_protection(monkeypatch):
    """A program in the background ignores Ctrl-C; its later handlers wait all the same."""
    sweep, came = small_sweep(), []
    live = gb.ultrasound.Reconstructor(0.5, device="cpu")
    before = {signal.SIGINT: signal.signal(signal.SIGINT, signal.SIG_IGN)}
    try:
        added(live, sweep, 1)  # no handler to replace
        before[signal.SIGALRM] = signal.signal(signal.SIGALRM, lambda *_: came.append(live.n_frames))
        bin_frames = live._bin

        def bin_and_signal(added, sign):
            signal.raise_signal(signal.SIGALRM)
            assert not came
            bin_frames(added, sign)

        monkeypatch.setattr(live, "_bin", bin_and_signal)
        added(live, sweep, 2)
        assert came == [2]
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_large_builds_stop_soon():
    """The more particles, the more polls; after the one that stops, only the loop's last."""
    few, many = (np.random.default_rng(1).random((n, 3), np.float32) for n in (30_000, 120_000))
    scene = gb.Scene(few[:1000], support=0.02, device="cpu", threads=1)
    right = gb.render(scene, size=SIZE).picture.tobytes()
    n_few, n_many = (count(lambda p=p: scene.update(positions=p)) for p in (few, many))
    assert n_many > 2 * n_few > 2000
    scene.update(positions=few[:1000])
    came = 0

    def stopped():
        nonlocal came
        try:
            scene.update(positions=many)
        finally:
            came = gb._core.n_polls()

    assert interrupted(stopped, polls, n_many // 2)
    assert came <= n_many // 2 + 1
    assert len(scene) == 1000
    assert gb.render(scene, size=SIZE).picture.tobytes() == right


def test_a_handler_that_uses_the_same_object_is_told(recwarn):
    """The call that it interrupts holds the scene: waiting for it would never end."""
    points = np.random.default_rng(1).random((3000, 3), np.float32)
    scene = gb.Scene(points[:1000], support=0.02, device="cpu", threads=1)
    said = []

    def handler(*_):
        try:
            scene.field([[0, 0, 0]])
        except RuntimeError as error:
            said.append(str(error))

    before = signal.signal(signal.SIGINT, handler)
    try:
        with polls(1):
            scene.update(positions=points)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(said) == 1
    assert "inside another call" in said[0]
    assert len(scene) == len(points)
