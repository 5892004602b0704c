"""Images shared out among ranks that all have the scene: the same bits as one rank's."""

import globule as gb
import numpy as np
import pytest
from globule._base.device import of_rank
from globule._base.ranks import run_threads
from globule.pieces.pieces import Pieces
from globule.render.pieces.whole_images import nearest_frame, nearest_image
from globule.scene.thesis import Thesis
from pieces_helpers import on

SIZE = (140, 100)
RNG = np.random.default_rng(1)
LATTICE = np.stack(np.meshgrid(*[np.arange(10)] * 3, indexing="ij"), -1).reshape(-1, 3)
POSITIONS = (LATTICE + RNG.uniform(-0.25, 0.25, LATTICE.shape)).astype(np.float32)
COLOR = RNG.random(POSITIONS.shape).astype(np.float32)
CAMERA = gb.Camera.fit(POSITIONS, size=SIZE, margin=1)
GLASS = gb.Material(reflection=0.3, transmission=0.5, index=1.3)
SMOOTH = {"surface": "smooth", "spacing": 1.0}
CASES = {
    "plain": ({}, {}),
    "edges": ({}, SMOOTH),
    "light": ({"material": GLASS, "shadows": True, "ambient_rays": 2, "ground": gb.Ground(-1)}, {}),
    "light and edges": ({"material": GLASS, "bounces": 2, "sky": gb.Sky()}, SMOOTH),
    "samples": ({"samples": 2, "transparent": True, "shadows": True}, {}),
}
ARRAYS = ("image", "color", "distance", "normal", "albedo", "position", "mask", "_layer")


@pytest.mark.few_backends
@pytest.mark.parametrize(
    ("case", "n", "one_host"),
    [("plain", 1, True), ("plain", 3, True), ("plain", 3, False), ("plain", 7, True), ("plain", 17, True),
     ("edges", 7, True), ("light", 2, True), ("light and edges", 3, True), ("light and edges", 3, False),
     ("samples", 4, True)],
)  # fmt: skip
def test_ranks_give_the_bits_of_one(case, n, one_host, backend):
    settings, options = CASES[case]
    particles = gb.Particles(POSITIONS, color=COLOR)

    def work(device, ranks):
        if ranks is not None:
            ranks.one_host = one_host  # else pixels go from host to host
        return gb.render(gb.Scene(particles, **options, **device), CAMERA, SIZE, settings, comm=ranks)

    one, many = work(backend, None), on(n, work, backend)[0]
    assert one.mask.mean() > 0.1
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(many, name), err_msg=name)
    if settings.get("transparent"):
        np.testing.assert_array_equal(one.alpha, many.alpha)


def test_refined_frames_other_ranks_only_the_image_and_shaded_pieces(backend):
    settings = {"shadows": True}

    def work(device, ranks):
        frame = gb.render(gb.Scene(POSITIONS, **device), CAMERA, SIZE, settings, comm=ranks).refine(2)
        if ranks is not None and ranks.rank:
            assert not frame.mask.any()
            assert not frame.image.any()
        return frame

    one, many = work(backend, None), on(2, work, backend)[0]
    assert many.samples == 3
    np.testing.assert_array_equal(one.image, many.image)
    with pytest.raises(ValueError, match=r"^alpha: expected settings with transparent"):
        many.alpha  # noqa: B018

    def work(device, ranks):
        ranks.only_image = True
        frame = gb.render(gb.Scene(POSITIONS, **device), CAMERA, SIZE, comm=ranks)
        return frame.image, frame.mask

    image, mask = on(3, work, backend)[0]
    np.testing.assert_array_equal(image, gb.render(gb.Scene(POSITIONS, **backend), CAMERA, SIZE).image)
    assert not mask.any()
    n = 3
    edges, particles = np.linspace(-1, 11, n + 1), gb.Particles(POSITIONS, color=COLOR)

    def work(device, ranks):
        x, (low, high) = POSITIONS[:, 0], edges[ranks.rank : ranks.rank + 2]
        mine = np.flatnonzero((x > low - 2.01) & (x < high + 2.01))
        assert len(mine) < len(POSITIONS)
        frame = gb.render(gb.Scene(particles[mine], support=2.0, **device), CAMERA, SIZE)
        by_hosts = nearest_image(ranks, frame.distance, frame.image)
        taken = nearest_frame(ranks, frame)
        if ranks.rank == 0:
            np.testing.assert_array_equal(by_hosts[0], taken[0])
            np.testing.assert_array_equal(by_hosts[1], taken[1])
            np.testing.assert_array_equal(frame.image, taken[1])  # on its device
        return taken

    one = gb.render(gb.Scene(particles, support=2.0, **backend), CAMERA, SIZE)
    depth, image = on(n, work, backend)[0]
    np.testing.assert_array_equal(one.mask, np.isfinite(depth))
    np.testing.assert_allclose(one.distance[one.mask], depth[one.mask], atol=2e-4)
    assert np.abs(one.image.astype(int) - image.astype(int)).max() <= 1


def test_what_cannot_be_shared_and_devices_are_dealt():
    scene = gb.Scene(POSITIONS, device="cpu", octree="dense")
    with pytest.raises(ValueError, match=r"^comm: "):
        run_threads(1, lambda r: gb.render(scene, CAMERA, SIZE, thesis=Thesis(), comm=r))
    pieces = Pieces(POSITIONS, 2, support=2.0, device="cpu")
    with pytest.raises(ValueError, match=r"^comm: "):
        run_threads(1, lambda r: gb.render(pieces, CAMERA, SIZE, comm=r))
    with pytest.raises(TypeError, match=r"^comm: "):
        gb.render(scene, CAMERA, SIZE, comm=3)

    def work(ranks):
        if ranks.rank == 1:
            raise ValueError("no such disk")
        ranks.all(0)

    with pytest.raises(ValueError, match="no such disk"):
        run_threads(3, work)
    assert (of_rank("cpu", 3), of_rank("cuda:1", 0)) == ("cpu", "cuda:1")
    assert of_rank("auto", 0) in ("auto", "cuda:0")


@pytest.mark.gpu
@pytest.mark.parametrize("case", ["plain", "light and edges"])
def test_two_gpus_give_the_bits_of_one(case):
    try:
        gb.Scene(POSITIONS, device="cuda:1")
    except RuntimeError:
        pytest.skip("no GPU beside the first")
    settings, options = CASES[case]

    def work(ranks):
        scene = gb.Scene(POSITIONS, **options, device=f"cuda:{ranks.rank}")
        return gb.render(scene, CAMERA, SIZE, settings, comm=ranks)

    one = gb.render(gb.Scene(POSITIONS, **options, device="cuda:0"), CAMERA, SIZE, settings)
    two = run_threads(2, work)[0]
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)
