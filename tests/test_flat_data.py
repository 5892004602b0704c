"""2-D data: which particles they are, spheres of half a spacing, flat colors, seen from above."""

import globule as gb
import numpy as np
import pytest
from cli_helpers import SMALL, run_json
from globule.data.spacing import normal_of
from globule.pieces.shown import shown_scene


def plane(n: int = 20, spacing: float = 0.5, z: float = 0.0) -> np.ndarray:
    grid = np.stack(np.mgrid[:n, :n], -1).reshape(-1, 2) * spacing
    return np.c_[grid, np.full(len(grid), z)]


def turned(points: np.ndarray, seed: int = 3) -> np.ndarray:
    """In another plane, as float32 rounds it."""
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return (points @ turn.T).astype("f4")


def test_which_particles_are_flat():
    def normal(points):
        return normal_of(gb.Particles(points).finite_positions())

    for points, expected in (
        (plane(z=3.25), (0, 0, 1)),
        (plane()[:, :2], (0, 0, 1)),  # (N, 2)
        (plane(2), (0, 0, 1)),
        (plane(z=2)[:, [0, 2, 1]], (0, -1, 0)),
        (plane()[:, [2, 0, 1]], (1, 0, 0)),
    ):
        np.testing.assert_allclose(normal(points), expected, atol=1e-6)
    assert (gb.Particles(plane()[:, :2]).positions == plane().astype("f4")).all()
    tilted = normal(turned(plane()))
    assert np.ptp(turned(plane()).astype("f8") @ tilted) < 1e-5
    assert normal(turned(plane(z=7) + (1e4, 2e4, 0))) is not None  # rounded by 1e-3
    assert normal(plane() * [1, 0, 0]) is None  # a line
    assert normal(turned(plane() * [1, 0, 0])) is None
    bent = plane()
    bent[7, 2] = 0.01
    assert normal(bent) is None
    lost = plane()
    lost[3] = np.nan
    assert normal(lost) is not None
    for points in (plane(), plane(3), turned(plane())):
        assert gb.fluids.choose_surface(gb.Particles(points)) == "spheres"
    for option in ({"support": 1.0}, {"threshold": 0.3}, {"kernel": "wyvill"}, {"octree": "dense"}):
        assert gb.fluids.choose_surface(gb.Particles(plane()), **option) == "balls"


@pytest.mark.parametrize("spacing", [1e-3, 0.5, 40.0])
@pytest.mark.parametrize("n", [30, 33])  # all are tessellated, or patches
def test_the_spacing_of_flat_data(spacing, n, capsys, tmp_path):
    """A lattice's is found within 0.1 %, in any plane; jitter of a fifth changes it by 1 %."""

    def found(points):
        return gb.Scene(points, device="cpu").spacing

    points = plane(n, spacing)
    assert found(points) == pytest.approx(spacing, rel=1e-3)
    assert found(turned(points)) == pytest.approx(spacing, rel=1e-3)
    hexagonal = points * (1, 0.75**0.5, 1)
    rows = np.rint(points[:, 1] / spacing).astype(int)
    hexagonal[:, 0] = points[:, 0] + 0.5 * spacing * (rows % 2)
    expected = pytest.approx(spacing * 0.75**0.25, rel=1e-3)
    assert found(hexagonal) == expected
    path = str(tmp_path / "hexagonal.npz")
    gb.write(path, gb.Particles(hexagonal))
    facts = run_json(capsys, "info", path)
    assert facts["spacing"] == gb.Scene(hexagonal, device="cpu").fluid_spacing() == expected
    rng = np.random.default_rng(1)
    points[:, :2] += rng.uniform(-0.2, 0.2, (len(points), 2)) * spacing
    assert found(turned(points)) == pytest.approx(spacing, rel=0.01)
    points[:, :2] = rng.random((len(points), 2)) * n * spacing
    assert found(points) == pytest.approx(spacing, rel=0.03)


def test_they_are_spheres_of_half_a_spacing(backend):
    """Rays from above hit within half a spacing of a particle, and there as high as its sphere."""
    scene = gb.Scene(plane(12, 0.5), surface="spheres", spacing=0.5, **backend)
    rng = np.random.default_rng(2)
    o = np.c_[rng.uniform(-0.2, 5.7, (4000, 2)), np.full(4000, 2.0)].astype("f4")
    found = scene.intersect(o, np.tile(np.array([0, 0, -1], "f4"), (len(o), 1))).distance
    off = np.hypot(*(o[:, :2] - np.clip(np.round(o[:, :2] / 0.5), 0, 11) * 0.5).T)
    assert np.isfinite(found[off < 0.248]).all()
    assert np.isinf(found[off > 0.264]).all()  # neighbors add up where they touch
    inner = off < 0.2
    sphere = 2 - np.sqrt(0.25**2 - off[inner] ** 2)
    assert np.abs(found[inner] - sphere).max() < 0.004


def test_an_image_of_flat_data(backend):
    """From above, orthographic, upright, in exactly the particles' colors."""
    points = plane(20, 0.5)
    color = np.zeros((400, 3), "f4")
    color[points[:, 0] > 4.9, 0] = 1.0  # the right half is red, the left one black
    scene = shown_scene(gb.Particles(points[:, :2], color=color), **backend)
    frame = gb.render(scene, (120, 120), settings={"edge_samples": 0})
    image, hit = frame.image, frame.mask
    assert 0.1 < hit.mean() < 0.99
    assert set(map(tuple, image[hit])) <= {(0, 0, 0), (255, 0, 0)}
    columns = np.nonzero((image[..., 0] == 255) & hit)[1]
    assert columns.min() >= 58
    at = frame.position[hit]
    assert (np.abs(at[:, 2]) <= 0.26).all()
    smooth = gb.render(scene, (120, 120)).image
    assert (smooth != image).any()  # smooth edges by default
    lit = gb.render(scene, (120, 120), settings={"lights": [gb.Headlight(0.5)], "edge_samples": 0})
    assert not set(map(tuple, lit.image[hit])) <= {(0, 0, 0), (255, 0, 0)}


def test_any_plane_is_seen_along_its_normal(backend):
    """A sheet in x and z has the image of one in x and y, turned to the eye, with z upwards."""
    points, colors = plane(20, 0.5), np.random.default_rng(4).random((400, 3))
    settings = {"edge_samples": 0}
    seen = [
        gb.render(gb.Particles(points[:, order], color=colors), (96, 72), settings=settings).image
        for order in ([0, 1, 2], [0, 2, 1], [2, 0, 1])
    ]
    for image in seen[1:]:
        assert (np.abs(image.astype(int) - seen[0]).max(axis=2) > 1).mean() < 0.01


def test_values_of_flat_data_have_their_colors(backend):
    particles = gb.Particles(plane(), attributes={"speed": np.linspace(0, 1, 400)})
    scene = shown_scene(particles, **backend)
    frame = gb.render(scene, (64, 64), color_by="speed", range=(0, 1), settings={"edge_samples": 0})
    want = gb.colorize(frame.attribute(particles.attributes["speed"])[frame.mask], "viridis", 0, 1)
    assert np.abs(frame.color[frame.mask] - want).max() < 0.02  # the map is not linear


def test_commands_say_it(capsys, tmp_path):
    path, out = str(tmp_path / "flat.npz"), str(tmp_path / "flat.png")
    gb.write(path, gb.Particles(plane()))
    facts = run_json(capsys, "info", path)
    assert (facts["surface"], facts["why_surface"]) == ("spheres", "2-D: one plane")
    assert facts["spacing"] == pytest.approx(0.5, rel=0.02)
    done = run_json(capsys, "render", path, "-o", out, *SMALL)
    assert done["surface"] == "spheres"
    assert done["support"] == pytest.approx(0.5 * 0.5 / 0.94868, rel=0.02)
    balls = run_json(capsys, "render", path, "-o", out, *SMALL, "--surface", "balls")
    assert balls["surface"] == "balls"


@pytest.mark.parametrize(("place", "side"), [(True, 1), ("lower-right", 1), ("upper-left", -1)])
def test_a_legend_leaves_room_beside_flat_data(place, side):
    from globule.render.annotate import Annotation
    from globule.render.fit import fitted
    from globule.render.legend import strip_width

    size = (320, 240)
    scene = shown_scene(gb.Particles(plane(20, 0.5) * (1.5, 1, 1)), device="cpu")
    camera = fitted(scene, size, Annotation(legend=place))
    columns = camera.project(scene.particles.positions, size)[:, 0]
    free = size[0] - columns.max() if side > 0 else columns.min()
    assert free > strip_width(size)
    assert columns.min() > 0
    assert columns.max() < size[0]
