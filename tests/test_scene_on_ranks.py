"""`Scene(..., comm=...)`: particles on any rank, the image of one device; frame after frame."""

import globule as gb
import numpy as np
import pytest
from globule.pieces.scene import SceneOnRanks
from launcher import mpirun
from pieces_helpers import (
    ALL,
    CAMERA,
    COLOR,
    CUT,
    GLASS,
    LATTICE,
    OF_A_FEW,
    PARTICLES,
    POSITIONS,
    SIZE,
    N,
    mine,
    on,
    own_shapes,
    same,
)


def check(particles, n, backend, camera=CAMERA, clips=(), settings=None, **options):
    def work(device, ranks):
        scene = gb.Scene(mine(particles, ranks), comm=ranks, **options, **device)
        assert isinstance(scene, gb.Scene)
        assert len(scene) == len(particles)
        return gb.render(scene, camera, SIZE, settings, clips)

    scene = gb.Scene(particles, **options | {"ranks": "auto"}, **backend)
    same(gb.render(scene, camera, SIZE, settings, clips), on(n, work, backend)[0])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7])
def test_ranks_and_cuts(n, backend):
    check(PARTICLES, n, backend, clips=[CUT], support=2.0)


def test_smooth_surfaces_and_kernels_of_their_own(backend):
    check(gb.Particles(POSITIONS), 2, backend, surface="smooth", spacing=1.0, key_bits=64)
    for particles, options in own_shapes():
        check(particles, 3, backend, clips=[CUT], **options)


@pytest.mark.parametrize("mode", ["pieces", "replicate"])
def test_spheres_have_the_radii_of_the_particles(mode, backend):
    radii = np.random.default_rng(2).uniform(0.2, 0.45, N)
    check(gb.Particles(LATTICE, attributes={"radius": radii}), 3, backend, surface="spheres", ranks=mode)


@pytest.mark.parametrize("n", [2, 3])
def test_light_is_replicated_by_itself(n, backend):
    settings = {"material": GLASS, "shadows": True, "ambient_rays": 2, "ground": gb.Ground(-1)}
    check(PARTICLES, n, backend, settings=settings, support=2.0)
    glossy = gb.Particles(POSITIONS, reflection=np.linspace(0, 0.6, N, dtype=np.float32))
    check(glossy, n, backend, support=2.0)


def test_colors_the_threshold_and_replication_on_all_ranks(backend, monkeypatch):
    particles = gb.Particles(POSITIONS, attributes={"speed": POSITIONS[:, 0] ** 2})

    def images(scene):
        colored = gb.render(scene, CAMERA, SIZE, color_by="speed")
        scene.threshold = 1.2
        return colored, gb.render(scene, CAMERA, SIZE)

    def work(device, ranks):
        return images(gb.Scene(mine(particles, ranks), support=2.0, comm=ranks, **device))

    for one, many in zip(images(gb.Scene(particles, support=2.0, **backend)), on(3, work, backend)[0], strict=True):
        same(one, many)
    check(PARTICLES, 3, backend, support=2.0, ranks="auto")

    def work(device, ranks):
        scene = gb.Scene(mine(PARTICLES, ranks), support=2.0, comm=ranks, ranks="replicate", **device)
        frame = gb.render(scene, CAMERA, SIZE)
        assert scene.whole() is scene.used(True)
        auto = gb.Scene(mine(PARTICLES, ranks), support=2.0, comm=ranks, **device)
        monkeypatch.setattr(SceneOnRanks, "room", lambda self: 1e3)
        with pytest.raises(MemoryError, match=r"^scene: expected memory for all .*, got 1e-06 GB"):
            gb.render(auto, CAMERA, SIZE, annotate=gb.Annotation())
        return frame

    same(gb.render(gb.Scene(PARTICLES, support=2.0, **backend), CAMERA, SIZE), on(2, work, backend)[0])


def test_updates_keep_the_partition_until_it_is_out_of_balance(backend):
    frames = [POSITIONS + 0.05 * k for k in range(3)]
    half = np.where(np.arange(N) < N // 2, np.float32(0.5), np.float32(1))[:, None]
    frames += [POSITIONS * half, POSITIONS * np.float32(1.6)]

    def work(device, ranks):
        scene = gb.Scene(mine(gb.Particles(frames[0]), ranks), support=2.0, comm=ranks, **device)
        images, divisions = [], []
        for positions in frames:
            scene.update(positions=positions[ranks.rank :: ranks.size])
            images.append(gb.render(scene, CAMERA, SIZE))
            divisions.append(scene.pieces().divisions)
        # Fewer than before, all on one rank; and with light, as many as before.
        scene.update(frames[0][: N // 3] if ranks.rank else np.empty((0, 3), np.float32))
        images.append(gb.render(scene, CAMERA, SIZE))
        assert len(scene) == (ranks.size - 1) * (N // 3)
        scene.update(mine(gb.Particles(frames[0]), ranks))
        images.append(gb.render(scene, CAMERA, SIZE, {"shadows": True}))
        return images, divisions

    images, divisions = on(2, work, backend)[0]
    assert divisions[0] == 1
    assert divisions[2] <= 2
    assert divisions == sorted(divisions)
    assert divisions[4] > divisions[2]
    scene = gb.Scene(frames[0], support=2.0, **backend)
    for positions, many in zip([*frames, frames[0][: N // 3]], images[:-1], strict=True):
        scene.update(positions=positions)
        same(gb.render(scene, CAMERA, SIZE), many)
    scene.update(positions=frames[0])
    same(gb.render(scene, CAMERA, SIZE, {"shadows": True}), images[-1])


def test_a_balanced_partition_is_kept_and_moves_each_particle_once():
    def work(device, ranks):
        own = np.array_split(POSITIONS, ranks.size)[ranks.rank]
        scene, start = gb.Scene(own, support=2.0, comm=ranks, **device), ranks.sent
        scene.update(positions=own)
        pieces = scene.pieces()
        held = sum(len(s) for _, s in pieces.visit())
        return pieces.divisions, ranks.sent - start, held, len(own)

    found = on(4, work, {"device": "cpu"})
    assert all(f[0] == 1 for f in found)
    assert sum(f[1] for f in found) <= 12 * sum(f[2] for f in found)  # 12 bytes a particle


@pytest.mark.parametrize(("n", "count"), OF_A_FEW.values(), ids=OF_A_FEW)
def test_ranks_without_particles(n, count, backend):
    def work(device, ranks):
        own = PARTICLES[slice(count if ranks.rank == n - 1 else 0)]
        scene = gb.Scene(own, support=2.0, comm=ranks, **device)
        return [gb.render(scene, CAMERA, SIZE, s) for s in ({}, {"shadows": True})]

    found = on(n, work, backend)[0]
    scene = gb.Scene(PARTICLES[slice(count)], support=2.0, **backend)
    for frame, settings in zip(found, ({}, {"shadows": True}), strict=True):
        same(gb.render(scene, CAMERA, SIZE, settings), frame, -1)


def test_a_rank_that_fails_is_named_and_an_update_leaves_no_other_particles():
    def work(device, ranks):
        bad = np.zeros((4, 2, 2)) if ranks.rank == 1 else POSITIONS
        with pytest.raises(ValueError, match=r"^rank 1: positions: expected shape \(N, 3\)"):
            gb.Scene(bad, support=2.0, comm=ranks, **device)
        scene = gb.Scene(POSITIONS, support=2.0, comm=ranks, **device)
        with pytest.raises(TypeError, match=r"^rank 2: update: unknown field 'place'"):
            scene.update(**({"place": 1} if ranks.rank == 2 else {"positions": POSITIONS}))
        support = None if ranks.rank else np.ones(N, np.float32)
        with pytest.raises(ValueError, match=r"^support: expected it of all particles or of none"):
            gb.Scene(gb.Particles(POSITIONS, support=support), comm=ranks, **device)
        return gb.render(scene, CAMERA, SIZE).mask.any()  # as before the failed update

    assert on(3, work, {"device": "cpu"})[0]
    moved = gb.Particles(POSITIONS + 0.05, color=COLOR)

    def work(device, ranks):
        scene = gb.Scene(mine(gb.Particles(POSITIONS), ranks), support=2.0, comm=ranks, **device)
        pieces = scene.pieces()
        if ranks.rank == 1:
            pieces._built = broken
        for draw in (lambda: scene.update(mine(moved, ranks)),
                     lambda: gb.render(scene, CAMERA, SIZE)):  # fmt: skip
            with pytest.raises(MemoryError, match=r"^rank 1: full"):
                draw()
        for settings in ({}, {"shadows": True}):
            with pytest.raises(ValueError, match="pieces: expected particles"):
                gb.render(pieces, CAMERA, SIZE, settings)
        if ranks.rank == 1:
            del pieces._built
        return gb.render(scene, CAMERA, SIZE)

    def broken(_):
        raise MemoryError("full")

    frame = on(2, work, {"device": "cpu"})[0]
    same(gb.render(gb.Scene(moved, support=2.0, device="cpu"), CAMERA, SIZE), frame)


def test_what_differs_between_ranks_is_named_and_mistakes():
    def work(device, ranks):
        own = "on rank 0 and .* on rank 1$"
        with pytest.raises(ValueError, match=f"^support: expected the same on all ranks, .* {own}"):
            gb.Scene(POSITIONS, support=2.0 + ranks.rank, comm=ranks, **device)
        scene = gb.Scene(mine(gb.Particles(POSITIONS), ranks), support=2.0, comm=ranks, **device)
        for settings in ({}, {"shadows": True}):
            with pytest.raises(ValueError, match=f"^size: expected the same .* {own}"):
                gb.render(scene, CAMERA, (SIZE[0], SIZE[1] + ranks.rank), settings)

    on(2, work, {"device": "cpu"})

    def work(device, ranks):
        for options, word in (
            ({"octree": "dense"}, "octree"), ({"level": 3}, "level"), ({"ranks": "some"}, "ranks"),
            ({"bounds": ((0, 0, 0), (1, 1, 1))}, "bounds"), ({"kernel": "cone"}, "kernel"),
        ):  # fmt: skip
            with pytest.raises(ValueError, match=rf"^{word}: "):
                gb.Scene(POSITIONS, comm=ranks, **options, **device)
        scene = gb.Scene(POSITIONS, support=2.0, comm=ranks, **device)
        with pytest.raises(ValueError, match=r"^scene: expected a scene in one process"):
            scene.field(POSITIONS[:1])
        with pytest.raises(ValueError, match=r"^comm: expected None with a scene on ranks"):
            gb.render(scene, CAMERA, SIZE, comm=ranks)

    on(1, work, {"device": "cpu"})
    with pytest.raises(ValueError, match=r"^ranks: "):
        gb.Scene(POSITIONS, ranks="pieces")
    with pytest.raises(TypeError, match=r"^comm: expected an mpi4py communicator"):
        gb.Scene(POSITIONS, comm=3)


PROGRAM = """
import globule as gb, numpy as np
from mpi4py import MPI
from pieces_helpers import ALL, CAMERA, PARTICLES, SIZE, mine

comm = MPI.COMM_WORLD
own = mine(PARTICLES, comm)
scene = gb.Scene(own, support=2.0, comm=comm, device="cpu")
images = []
for k in range(3):
    scene.update(positions=own.positions * np.float32(1 + 0.1 * k))
    for settings in ({}, {"shadows": True}):
        images.append(gb.render(scene, CAMERA, SIZE, settings).image)
scene = gb.Scene(own, support=2.0, comm=comm, ranks="pieces", device="cpu")
images += [gb.render(scene, CAMERA, SIZE, ALL).image for _ in "ab"]
few = gb.Scene(mine(PARTICLES[:2], comm), support=2.0, comm=comm, device="cpu")  # a rank has none
images.append(gb.render(few, CAMERA, SIZE).image)
if comm.rank == 0:
    np.save("images.npy", images)
"""


def test_through_mpiexec(tmp_path):
    run = mpirun(3, "-c", PROGRAM, cwd=tmp_path)
    assert run.returncode == 0, run.stderr[-2000:]
    *found, light, again, few = np.load(tmp_path / "images.npy").astype(int)
    scene = gb.Scene(PARTICLES, support=2.0, device="cpu")
    for k in range(3):
        scene.update(positions=POSITIONS * np.float32(1 + 0.1 * k))
        for j, settings in enumerate(({}, {"shadows": True})):
            one = gb.render(scene, CAMERA, SIZE, settings)
            assert np.abs(one.image.astype(int) - found[2 * k + j]).max() <= 1
    np.testing.assert_array_equal(light, again)
    for particles, settings, many in ((PARTICLES, ALL, light), (PARTICLES[:2], {}, few)):
        one = gb.render(gb.Scene(particles, support=2.0, device="cpu"), CAMERA, SIZE, settings).image
        assert np.abs(one.astype(int) - many).max() <= 1
