"""Particles whose kernels are stretched: `Particles.anisotropy`."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import refused, refuses
from globule.cli import main
from oracle import field
from PIL import Image
from scenes import case, cloud, lattice, stretched_matrices

N = 400


def matrices(seed: int = 0) -> np.ndarray:
    axes = 10 ** np.random.default_rng(seed).uniform(-0.9, -0.3, (N, 3))
    return stretched_matrices(axes, seed)


def test_field_and_gradient(backend):
    p, g = cloud(N, 1), matrices()
    weight = np.random.default_rng(2).uniform(-0.5, 1.5, N).astype(np.float32)
    scene = gb.Scene(gb.Particles(p, weight=weight, anisotropy=g), threshold=0.5, **backend)
    points = cloud(600, 3)
    f, grad = field(p, g, weight, "murakami", points)
    assert (f != 0).mean() > 0.5
    np.testing.assert_allclose(scene.field(points), f, atol=1e-5)
    np.testing.assert_allclose(scene.gradient(points), grad, atol=1e-3)


@pytest.mark.parametrize("kernel", ["murakami", "wendland_c2", "solid"])
def test_rays_through_the_cells(backend, kernel):
    """Where cuts send camera rays through the cells, they meet the same surface."""
    p, g = cloud(N, 4), matrices(5)
    scene = gb.Scene(gb.Particles(p, anisotropy=g), kernel, 0.45, **backend)
    camera, size = gb.Camera((1.4, 1.1, 3.0), (0, 0, 0)), (72, 60)
    far = gb.ClipPlane((1, 0, 0), 50)
    whole, cut = gb.render(scene, camera, size), gb.render(scene, camera, size, clips=[far])
    assert (whole.mask == cut.mask).all()
    assert 0.1 < whole.mask.mean() < 0.9
    m = whole.mask
    np.testing.assert_allclose(whole.distance[m], cut.distance[m], atol=1e-4)
    assert ((whole.normal * cut.normal).sum(-1)[m] > 0.999).mean() > 0.995


def test_a_cut_face_shows_the_blend(backend):
    p = lattice(7, 7, 7, 0.2)
    g = stretched_matrices(np.random.default_rng(6).uniform(1.3, 2.6, (len(p), 3)), 6)
    color = np.random.default_rng(7).uniform(0, 1, (len(p), 3)).astype(np.float32)
    scene = gb.Scene(gb.Particles(p, anisotropy=g, color=color), **backend)
    plane = gb.ClipPlane((0, 0, 1), 0.3)
    frame = gb.render(scene, gb.Camera((0.5, 0.4, 20), (0, 0, 0), fov=15), (48, 48), clips=[plane])
    face = frame.mask & (np.abs(frame.position[..., 2] - 0.3) < 1e-4)
    assert face.sum() > 300
    blend = scene.blend(frame.position[face], color)
    np.testing.assert_allclose(frame.albedo[face], blend, atol=1e-3)
    away = np.einsum("nij,mnj->mni", g, frame.position[face][:, None] - p)
    w = np.maximum(1 - (away**2).sum(2), 0) ** 2
    np.testing.assert_allclose(blend, w @ color / w.sum(1, keepdims=True), atol=2e-3)


def test_smoothed_particles_make_a_flatter_surface():
    p = lattice(14, 14, 4, 0.25, 3)
    found = gb.fluids.find_anisotropy(gb.Particles(p, support=2.0), radius=4.0)
    down = np.stack([*np.random.default_rng(8).uniform(-4, 4, (2, 500)), np.full(500, 9.0)], 1)
    d = np.tile(np.float32([0, 0, -1]), (500, 1))
    rough = []
    smooth = gb.Particles(found.centers, anisotropy=found.G)
    for particles in (gb.Particles(p, support=2.0), smooth):
        depth = gb.Scene(particles, device="cpu").intersect(down.astype(np.float32), d)[0]
        assert np.isfinite(depth).all()
        rough.append(depth.std())
    assert rough[1] < 0.5 * rough[0]


def test_selection_and_update(backend):
    p, g = cloud(N, 4), matrices(5)
    particles = gb.Particles(p, anisotropy=g)
    assert particles[:7].anisotropy.shape == (7, 3, 3)
    scene = gb.Scene(particles, **backend)
    points = cloud(50, 9)
    scene.update(positions=p[::-1].copy(), anisotropy=g[::-1].copy())
    np.testing.assert_allclose(scene.field(points), field(p, g, 1.0, "murakami", points)[0], atol=1e-5)
    scene.update(anisotropy=None, support=0.3)
    np.testing.assert_allclose(scene.field(points), field(p, 0.3, 1.0, "murakami", points)[0], atol=1e-5)


def test_mistakes():
    for bad, why in (
        (np.eye(3), "shape"),
        (np.tile(np.diag([1.0, 1, -1]), (N, 1, 1)), "positive definite"),
        (np.tile([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]], (N, 1, 1)), "symmetric"),
        (np.full((N, 3, 3), np.nan), "particle 0"),
    ):
        refuses(f"anisotropy: .*{why}", gb.Particles, cloud(N), anisotropy=bad)


def test_the_dense_octree_refuses():
    with pytest.raises(ValueError, match="anisotropy: expected the sparse octree"):
        gb.Scene(gb.Particles(cloud(N), anisotropy=matrices()), octree="dense")


def test_the_oracle_by_dense_sampling():
    c = case("stretched murakami True")
    t = np.linspace(0, 6, 6001)
    for i in range(0, len(c.depth), 97):
        o, d = c.origins[i].astype(np.float64), c.directions[i].astype(np.float64)
        f = c.field(o + t[:, None] * d)[0]
        past = np.nonzero(f > c.threshold)[0]
        if len(past):
            assert c.depth[i] <= t[past[0]] + 1e-9
        if np.isfinite(c.depth[i]):
            assert c.field((o + c.depth[i] * d)[None])[0][0] == pytest.approx(c.threshold, abs=1e-5)


def test_the_command(folder, capsys):
    p = lattice(8, 8, 8, 0.3)
    gb.write("p.npz", gb.Particles(p, support=2.0))
    line = ["render", "p.npz", "--size", "64x48", "--device", "cpu", "-o"]
    assert main([*line, "plain.png"]) == 0
    assert main([*line, "smooth.png", "--anisotropic"]) == 0
    assert (np.asarray(Image.open("plain.png")) != np.asarray(Image.open("smooth.png"))).any()
    gb.write("each.npz", gb.Particles(p, support=np.linspace(1.5, 2, len(p))))
    line[1] = "each.npz"
    capsys.readouterr()
    assert "--anisotropic: expected one support" in refused(capsys, *line, "each.png", "--anisotropic")
    assert main([*line, "each.png", "--anisotropic", "--support", "2"]) == 0
