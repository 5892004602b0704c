"""Light that turns, through particles that no rank has all of: rays go from piece to piece."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import refuses
from globule.pieces.pieces import Pieces
from globule.pieces.scene import SceneOnRanks
from globule.render.pieces import wavefront
from pieces_helpers import ALL, CAMERA, COLOR, CUT, GLASS, OF_A_FEW, PARTICLES, POSITIONS, SIZE, N, mine
from pieces_helpers import on as on_all
from pieces_helpers import same as same_image
from scenes import KERNELS

ONE_RAY = ALL | {"ambient_rays": 1}
LAMP = gb.PointLight((16, 20, 17), radius=1.5)
RNG = np.random.default_rng(5)
DROPS = np.repeat(RNG.uniform(0, 24, (500, 3)), 6, axis=0) + RNG.normal(0, 0.7, (3000, 3))
SPRAY = gb.Particles(DROPS.astype(np.float32))
MIRROR = {"material": gb.Material(reflection=0.3), "bounces": 4}


def on(n, work, backend):
    """What rank 0 of n threads returns."""
    return on_all(n, work, backend)[0]


def same(one, many, least=0.03):
    """Of the image, and of what each pixel shows."""
    same_image(one, many, least)
    np.testing.assert_array_equal(one._layer, many._layer)


def check(particles, n, backend, settings, camera=CAMERA, clips=(), **options):
    def work(device, ranks):
        scene = gb.Scene(mine(particles, ranks), comm=ranks, ranks="pieces", **options, **device)
        frame = gb.render(scene, camera, SIZE, settings, clips)
        assert scene._whole is None
        return frame

    scene = gb.Scene(particles, **options, **backend)
    same(gb.render(scene, camera, SIZE, settings, clips), on(n, work, backend))


@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 4, 7))])
def test_ranks_give_the_light_of_one_device(n, backend):
    check(PARTICLES, n, backend, ALL, support=2.0)


@pytest.mark.few_backends
@pytest.mark.parametrize(
    "settings",
    [
        {"shadows": True, "lights": [LAMP], "ground": gb.Ground(-1.5, reflection=0.3)},
        {"sky": gb.Sky(), "ambient": "sky", "ambient_rays": 4},
        {"material": gb.Material(transmission=0.9, index=1.2, absorption=(0.1, 0.2, 0.3)),
         "shadows": True, "bounces": 8},
        {"material": gb.Material(reflection=0.6, roughness=0.4), "samples": 3,
         "transparent": True},
    ],
)  # fmt: skip
def test_every_light(settings, backend):
    check(PARTICLES, 3, backend, settings, support=2.0)


QUICK = ("murakami", "wendland_c2")


@pytest.mark.few_backends
@pytest.mark.parametrize("kernel", [pytest.param(k, marks=[] if k in QUICK else [pytest.mark.slow]) for k in KERNELS])
def test_every_kernel(kernel, backend):
    support = 3.2 if kernel == "blinn" else 2.5
    check(PARTICLES, 3, backend, ONE_RAY, kernel=kernel, support=support)


@pytest.mark.few_backends
def test_cuts(backend):
    for clip in (CUT, gb.ClipSphere((8, 8, 10), 5.0), gb.ClipBox((0, 0, 0), (11, 8, 9), True)):
        check(PARTICLES, 3, backend, ONE_RAY, clips=[clip], support=2.0)


@pytest.mark.slow
def test_smooth_surfaces_with_samples_at_edges(backend):
    check(PARTICLES, 3, backend, ONE_RAY, surface="smooth", spacing=1.0)


@pytest.mark.slow
@pytest.mark.few_backends
def test_particles_of_their_own(backend):
    rng = np.random.default_rng(6)
    own = {"reflection": np.linspace(0, 0.6, N), "refraction": rng.uniform(0, 0.8, N)}
    check(gb.Particles(POSITIONS, color=COLOR, **own), 3, backend, {"shadows": True}, support=2.0)
    weight = np.where(np.arange(N) % 5 == 0, -0.6, 1.0)
    check(gb.Particles(POSITIONS, weight=weight), 3, backend, ALL, support=2.0)
    support = rng.uniform(1.2, 2.2, N)
    support[700] = 30  # over all pieces
    check(gb.Particles(POSITIONS, support=support), 4, backend, {"shadows": True}, threshold=1.0)


@pytest.mark.few_backends
def test_eyes_inside_and_parallel_rays(backend):
    cave = gb.Particles(POSITIONS[np.linalg.norm(POSITIONS - 5.5, axis=1) >= 3])
    inside = gb.Camera((5.5, 5.5, 5.5), (11, 9, 6))
    for particles in (cave, PARTICLES):
        check(particles, 3, backend, ONE_RAY, inside, support=2.0)
    far = gb.Camera.fit(POSITIONS, size=SIZE, margin=1, orthographic=True)
    check(PARTICLES, 3, backend, ONE_RAY, far, support=2.0)


@pytest.mark.parametrize("n", [2, pytest.param(7, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "settings",
    [pytest.param(MIRROR, id="mirror", marks=pytest.mark.slow), pytest.param(ALL | {"bounces": 4}, id="glass")],
)
def test_spray(n, settings, backend):
    """Reflections in small drops turn the last bits of a hit into other pixels."""
    camera = gb.Camera.fit(DROPS, size=SIZE, margin=1)
    check(SPRAY, n, backend, settings, camera, support=1.5)


def test_the_octree_makes_no_difference(backend):
    """What light goes on from depends on the particles and the ray alone."""
    camera = gb.Camera.fit(DROPS, size=SIZE, margin=1)
    found = [
        gb.render(gb.Scene(SPRAY, support=1.5, bounds=bounds, **backend), camera, SIZE, MIRROR)
        for bounds in (None, ((-3, -3, -3), (34, 34, 34)))
    ]
    assert found[0].mask.mean() > 0.1
    differ = found[0].distance != found[1].distance
    assert differ.mean() <= 2e-4  # a tangent
    np.testing.assert_array_equal(found[0].image[~differ], found[1].image[~differ])


def test_a_far_eye(backend, monkeypatch):
    """Its rays begin at the space; here, those of a near eye do."""

    def work(device, ranks):
        scene = gb.Scene(mine(PARTICLES, ranks), comm=ranks, ranks="pieces", support=2.0, **device)
        return gb.render(scene, CAMERA, SIZE, {"shadows": True, "lights": [LAMP]})

    near = on(3, work, backend)
    monkeypatch.setattr(wavefront, "FAR", 0.0)
    same(near, on(3, work, backend))


def test_layers_and_meshes(backend):
    low, high = PARTICLES[POSITIONS[:, 1] < 6], PARTICLES[POSITIONS[:, 1] > 5]
    corners = np.array([[-2, 3, -2], [14, 3, -2], [14, 3, 14], [-2, 3, 14]], np.float32)
    red = gb.Material(color=(0.8, 0.1, 0.1), reflection=0.3)

    def layers(scenes):
        plate = gb.Mesh(corners, [[0, 1, 2], [0, 2, 3]])
        return [gb.Layer(scenes[0], red), gb.Layer(scenes[1], GLASS, [CUT]), gb.Layer(plate)]

    def work(device, ranks):
        of_ranks = [gb.Scene(mine(p, ranks), support=2.0, comm=ranks, ranks="pieces", **device)
                    for p in (low, high)]  # fmt: skip
        return gb.render(layers(of_ranks), CAMERA, SIZE, {"shadows": True})

    one = [gb.Scene(p, support=2.0, **backend) for p in (low, high)]
    same(gb.render(layers(one), CAMERA, SIZE, {"shadows": True}), on(3, work, backend))


@pytest.mark.few_backends
@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 8))])
def test_pieces_one_after_the_other(n, backend):
    pieces = Pieces(PARTICLES, n, support=2.0, **backend)
    try:
        many = gb.render(pieces, CAMERA, SIZE, ALL)
        one = gb.render(gb.Scene(PARTICLES, support=2.0, **backend), CAMERA, SIZE, ALL)
        same(one, many)
        refuses(r"^pick: expected one scene, got pieces", many.pick, 24, 18)
        many.refine(1)
        same(one.refine(1), many)
    finally:
        pieces.close()


def test_frame_after_frame(backend):
    def work(device, ranks):
        scene = gb.Scene(mine(PARTICLES, ranks), support=2.0, comm=ranks, ranks="pieces", **device)
        images = [gb.render(scene, CAMERA, SIZE, {"shadows": True})]
        scene.update(positions=1.1 * mine(PARTICLES, ranks).positions)
        refuses(r"^refine: expected the scene as it was rendered", images[0].refine)
        return [*images, gb.render(scene, CAMERA, SIZE, {"shadows": True})]

    scene = gb.Scene(PARTICLES, support=2.0, **backend)
    found = on(3, work, backend)
    same(gb.render(scene, CAMERA, SIZE, {"shadows": True}), found[0])
    scene.update(positions=np.float32(1.1) * POSITIONS)
    same(gb.render(scene, CAMERA, SIZE, {"shadows": True}), found[1])


@pytest.mark.parametrize(("n", "count"), OF_A_FEW.values(), ids=OF_A_FEW)
def test_ranks_without_particles(n, count, backend):
    def work(device, ranks):
        own = PARTICLES[slice(count if ranks.rank == n - 1 else 0)]
        scene = gb.Scene(own, support=2.0, comm=ranks, ranks="pieces", **device)
        return gb.render(scene, CAMERA, SIZE, ALL)

    scene = gb.Scene(PARTICLES[slice(count)], support=2.0, **backend)
    same(gb.render(scene, CAMERA, SIZE, ALL), on(n, work, backend), -1)


def test_pieces_where_the_memory_does_not_suffice(backend, monkeypatch):
    """By itself: all particles on every rank, or else rays from rank to rank."""
    one = gb.render(gb.Scene(PARTICLES, support=2.0, **backend), CAMERA, SIZE, ALL)
    for room, whole in ((1e12, True), (1e3, False)):
        monkeypatch.setattr(SceneOnRanks, "room", lambda self, room=room: room)

        def work(device, ranks, whole=whole):
            scene = gb.Scene(mine(PARTICLES, ranks), support=2.0, comm=ranks, **device)
            frame = gb.render(scene, CAMERA, SIZE, ALL)
            assert (scene._whole is not None) == whole
            return frame

        same(one, on(2, work, backend))


@pytest.mark.parametrize("where", ["march_part", "occlude_part"])
def test_a_rank_that_fails_is_named_on_all(where, monkeypatch):
    own = getattr(wavefront, where)

    def fails(spread, *rest):
        if spread.pieces.ranks.rank == 1:
            raise OSError("no such disk")
        return own(spread, *rest)

    monkeypatch.setattr(wavefront, where, fails)

    def work(device, ranks):
        scene = gb.Scene(mine(PARTICLES, ranks), support=2.0, comm=ranks, ranks="pieces", **device)
        refuses(r"^rank 1: no such disk", gb.render, scene, CAMERA, SIZE, ALL, error=OSError)
        monkeypatch.setattr(wavefront, where, own)
        ranks.all(None)
        return gb.render(scene, CAMERA, SIZE, ALL)

    scene = gb.Scene(PARTICLES, support=2.0, device="cpu")
    same(gb.render(scene, CAMERA, SIZE, ALL), on(3, work, {"device": "cpu"}))
