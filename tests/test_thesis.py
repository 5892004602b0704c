"""The thesis's own tracing: right within its stated limits, and wrong where the thesis shows it."""

import dataclasses
import functools
import json

import globule as gb
import numpy as np
import pytest
from globule.cli import main
from globule.scene.thesis import Thesis, default_support, work
from quick import every
from scenes import Case, cloud, lattice, unit
from scenes import case as whole_case

from bench.__main__ import main as bench
from bench.tables import thesis as tables

BEZIER = ["one", "sheet", "sheet_edge", "hundred", "orthographic", "inside", "carved", "mixed",
          "one wyvill", "cloud wyvill", "weights murakami", "weights wyvill"]  # fmt: skip
MARCH = ["sheet", "hundred", "orthographic", "inside", "carved", "cloud nishimura",
         "cloud blinn", "cloud wendland_c2", "weights cubic_spline"]  # fmt: skip


@functools.cache
def case(name: str) -> Case:
    c = whole_case(name)
    rays = {k: getattr(c, k)[::3] for k in ("origins", "directions", "depth")}
    return dataclasses.replace(c, **rays)


def depth_for(c: Case) -> int:
    """Deepest octree whose leaves are no smaller than the largest support."""
    extent = float(np.ptp(c.positions, axis=0).max())
    return int(np.clip(np.floor(np.log2(extent / np.max(c.support))), 0, 6)) if extent else 0


def dense(c: Case, **options) -> gb.Scene:
    return c.scene(**{"octree": "dense", "level": depth_for(c), **options})


@functools.cache
def clear(name: str) -> np.ndarray:
    """Rays that do not graze: the oracle's answer stays the same, its depth within a twentieth of
    the support, when the threshold goes up or down by 1e-4 of it."""
    c = case(name)
    original, depth = c.threshold, []
    for share in (1 - 1e-4, 1, 1 + 1e-4):
        c.threshold = original * share
        depth.append(np.minimum(c.first_hit(c.origins, c.directions), 1e9))
    c.threshold = original
    return np.ptp(depth, axis=0) < 0.05 * np.min(c.support)


def check(name: str, scene: gb.Scene, thesis: Thesis) -> None:
    c, sure = case(name), clear(name)
    depth, normal, _ = scene.intersect(c.origins, c.directions, thesis)
    hit = np.isfinite(c.depth)
    wrong = np.nonzero(sure & (np.isfinite(depth) != hit))[0]
    assert len(wrong) == 0, (len(wrong), wrong[:5], c.depth[wrong[:5]], depth[wrong[:5]])
    both = sure & hit
    assert both.sum() > 0.5 * hit.sum()
    points = c.origins[both] + c.depth[both, None] * c.directions[both].astype(np.float64)
    error = np.abs(depth[both] - c.depth[both]) / c.smallest(points)
    assert error.max() < 1e-3, (error.max(), (error >= 1e-3).sum())
    np.testing.assert_array_equal(normal[~np.isfinite(depth)], 0)
    gradient = c.field(points)[1]
    steep = np.linalg.norm(gradient, axis=1)
    cosine = -(normal[both] * gradient).sum(1) / steep
    assert (cosine > 0.999)[steep > 0.2 * np.abs(c.weight).max() / np.median(c.support)].all()


@pytest.mark.few_backends
@pytest.mark.parametrize("name", every(3, BEZIER))
def test_bezier_clipping_is_exact(backend, name):
    """But for rays that graze: all is float32."""
    check(name, dense(case(name), **backend), Thesis("bezier"))


@pytest.mark.few_backends
@pytest.mark.parametrize("name", every(3, MARCH))
def test_marching_with_small_steps(backend, name):
    """Steps of 1/50 support, 1/800 near the surface: only chords shorter than that may be missed,
    on which the field rises by less than 1e-4 over the threshold."""
    check(name, dense(case(name), **backend), Thesis(step=0.02))


@pytest.mark.parametrize("root", ["march", "bezier"])
def test_without_exterior_spheres(backend, root):
    check("hundred", dense(case("hundred"), **backend), Thesis(root, 0.02, exterior=False))


def down(x):
    return np.float32(np.stack([x, 0 * x, 0 * x + 4], 1)), np.tile(np.float32([0, 0, -1]), (len(x), 1))


def test_large_steps_miss_what_is_thin_and_make_terraces(backend):
    """Rays near the rim of two fused balls: the surface's chords are shorter than the step."""
    c = Case(np.array([[0, 0, 0], [0, 0, -0.7]], np.float32), support=1.0, threshold=0.3)
    o, d = down(np.linspace(0.5, 0.75, 400))
    expected, scene = np.isfinite(c.first_hit(o, d)), dense(c, **backend)

    def hits(thesis):
        return np.isfinite(scene.intersect(o, d, thesis)[0])

    coarse = hits(Thesis(step=2.0))
    assert (coarse <= expected).all()
    assert coarse.sum() < 0.2 * expected.sum()
    assert (hits(Thesis(step=0.01)) != expected).sum() <= 1
    c = Case(np.array([[-0.4, 0, 0], [0.4, 0, 0]], np.float32), support=1.0, threshold=0.3)
    o, d = down(np.linspace(-0.9, 0.9, 300))
    expected, scene = c.first_hit(o, d), dense(c, **backend)

    def late(**choice):
        return scene.intersect(o, d, Thesis(exterior=False, **choice))[0] - expected

    terraces = late(step=0.2, thresholds=0, refine=False)
    assert terraces.min() > -1e-4
    assert 0.15 < terraces.max() <= 0.2 + 1e-4
    assert np.abs(late(step=0.2, thresholds=0)).max() < 1e-4
    assert np.abs(late(step=0.2, thresholds=5, refine=False)).max() < 0.1 * terraces.max()


def both_ways(positions, backend):
    """Pictures without and with ghosts, which is the exact one: metaballs, leaves of edge 0.5."""
    space = {"octree": "dense", "level": 2, "bounds": ((-1, -1, -1), (1, 1, 1))}
    scene = gb.Scene(positions, support=0.5, threshold=0.4, **space, **backend)
    camera = gb.Camera((0.5, 0.6, 3.2), (0, 0, 0), fov=50)
    without, ghosts, exact = (
        gb.render(scene, camera, (120, 120), thesis=t) for t in (Thesis("bezier", ghosts=False), Thesis("bezier"), None)
    )
    np.testing.assert_array_equal(ghosts.mask, exact.mask)
    np.testing.assert_allclose(ghosts.distance, exact.distance, atol=1e-3)
    return without, exact


@pytest.mark.parametrize("depth", [0, 1, 2, 3])
def test_ghosts_are_enough_up_to_a_leaf(backend, depth):
    """Support equal to the leaf's edge at any depth; surfaces outside the cube too (Fig. 6.5)."""
    p = cloud(200, 70)
    extent = float(np.ptp(p, axis=0).max())
    c = Case(p, support=np.float32(0.999 * extent / 2**depth), threshold=0.8 if depth > 1 else 20.0)
    rng = np.random.default_rng(71)
    target = rng.uniform(-1.1, 1.1, (600, 3)) * (1 if depth else 3)
    d = unit(rng.normal(size=(600, 3)))
    o = (target - 5 * d).astype(np.float32)
    expected, scene = c.first_hit(o, d), c.scene(octree="dense", level=depth, **backend)
    found = scene.intersect(o, d, Thesis("bezier"))[0]
    assert (np.isfinite(found) != np.isfinite(expected)).sum() <= 1
    both = np.isfinite(found) & np.isfinite(expected)
    assert 50 < both.sum() < 600
    assert (np.abs(found[both] - expected[both]) > 1e-3 * c.support).sum() <= 1


@pytest.mark.few_backends
@pytest.mark.parametrize("root", ["march", "bezier"])
def test_the_face_rule_changes_nothing(backend, root):
    for name in ("carved", "hundred"):
        scene = dense(case(name), **backend)
        camera = gb.Camera((7, 9, 12) if name == "carved" else (2, 1, 3), (0, 0, 0))
        on, off = (gb.render(scene, camera, (96, 96), thesis=Thesis(root, face_rule=rule)) for rule in (True, False))
        assert on.mask.any()
        np.testing.assert_array_equal(on.distance, off.distance)
        np.testing.assert_array_equal(on.picture, off.picture)


def test_averaged_normals_and_surfaces_that_reach_into_other_leaves(backend):
    """Fig. 5.8: on a flat face they follow each ball; one ball alone has the same normals."""
    up, rng = np.array([[0, 0, -1]], np.float32), np.random.default_rng(72)
    o = np.concatenate([rng.uniform(-2, 2, (300, 2)), np.full((300, 1), 8)], 1).astype(np.float32)
    scene = dense(Case(lattice(8, 8, 8), support=2.0), **backend)

    def normals(scene, origins, averaged):
        d = np.repeat(up, len(origins), 0)
        return scene.intersect(origins, d, Thesis("bezier", averaged_normals=averaged))[1]

    gradient, averaged = normals(scene, o, False), normals(scene, o, True)
    np.testing.assert_allclose(np.linalg.norm(averaged, axis=1), 1, atol=1e-5)
    assert gradient[:, 2].min() > 0.99
    assert averaged[:, 2].min() < 0.98
    ball = dense(Case(np.zeros((1, 3), np.float32), support=3.0), **backend)
    o = o[np.linalg.norm(o[:, :2], axis=1) < 1.2]
    np.testing.assert_allclose(normals(ball, o, True), normals(ball, o, False), atol=1e-5)
    without, exact = both_ways([[0.02, 0.25, 0.25]], backend)
    assert without.mask.sum() < 0.8 * exact.mask.sum()
    # Fig. 5.6b: without ghosts each leaf shows its own ball, with a groove between.
    without, exact = both_ways([[-0.18, 0.25, 0.25], [0.18, 0.25, 0.25]], backend)
    bridge = exact.mask & (np.abs(exact.position[..., 0]) < 0.02)
    assert bridge.sum() > 20
    assert not without.mask[bridge].all()


def test_work_and_crowded_leaves(backend):
    """Exterior spheres save evaluations, empty space costs nothing, and a lone ball no search."""
    c = case("hundred")
    scene = dense(c, **backend)
    leaves, sums = work(scene, c.origins, c.directions, Thesis())
    more = work(scene, c.origins, c.directions, Thesis(exterior=False))[1]
    assert leaves.max() > 2
    assert 0 < sums.sum() < 0.9 * more.sum()
    assert (sums[leaves == 0] == 0).all()
    assert work(scene, c.origins, c.directions, Thesis(step=0.05))[1].sum() > 2 * sums.sum()
    sums = work(dense(case("one"), **backend), case("one").origins, case("one").directions, Thesis())[1]
    assert sums.max() <= 1  # whether the ray begins inside, where it begins near the ball
    p = np.random.default_rng(73).normal(size=(700, 3)).astype(np.float32) * np.float32(0.2)
    c, rng = Case(p, support=0.5, threshold=14.0), np.random.default_rng(74)
    d = unit(rng.normal(size=(100, 3)))
    o = (rng.uniform(-0.6, 0.6, (100, 3)) - 4 * d).astype(np.float32)
    expected, scene = c.first_hit(o, d), dense(c, **backend)
    for thesis in (Thesis("bezier"), Thesis(step=0.05)):
        found = scene.intersect(o, d, thesis)[0]
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
        np.testing.assert_allclose(found, expected, atol=1e-3 * 0.5)


@pytest.mark.parametrize("positions", [np.zeros((0, 3)), np.full((2, 3), np.nan)])
def test_nothing_to_see(backend, positions):
    scene = gb.Scene(gb.Particles(positions.astype(np.float32), support=1.0), octree="dense", **backend)
    assert not gb.render(scene, gb.Camera((0, 0, 3), (0, 0, 0)), (16, 16), thesis=Thesis()).mask.any()


def test_default_support():
    p = np.array([[0, 0, 0], [8, 4, 2]], np.float32)
    assert (default_support(p, 3), default_support(gb.Particles(p), 0)) == (0.5, 4)


RAY = np.zeros((1, 3), np.float32), np.float32([[0, 0, 1]])


@pytest.mark.parametrize(("call", "message"), [
    (lambda: Thesis("newton"), "root: expected march or bezier, got 'newton'"),
    (lambda: Thesis(step=0), "step: expected a number from 0.0001 to 10000, got 0"),
    (lambda: Thesis(thresholds=-1), "thresholds: expected a whole number from 0 to 16, got -1"),
    (lambda: default_support(cloud(9), 9), "level: expected 0 to 8, got 9"),
    (lambda: default_support(cloud(1), 3), "positions: expected some extent, got 0"),
    (lambda: gb.Scene(cloud(9)).intersect(*RAY, Thesis()), 'a scene with octree="dense"'),
    (lambda: gb.render(gb.Scene(cloud(9), "nishimura", octree="dense"), thesis=Thesis("bezier")),
     r"kernel: expected murakami or wyvill .* got 'nishimura'"),
    (lambda: gb.render(gb.Scene(cloud(9), octree="dense"), thesis="march"), "got 'march'"),
])  # fmt: skip
def test_mistakes_are_named(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gb.write("ball.npz", gb.Particles(cloud(500, 75), support=0.2))
    gb.write("plain.npz", gb.Particles(cloud(500, 75)))


def picture(capsys, *words):
    small = ["--size", "60x40", "--device", "cpu", "--json", "--aov", "a.npz"]
    assert main(["render", *words, "-o", "a.png", *small]) == 0
    out, err = capsys.readouterr()
    return json.loads(out), np.load("a.npz")["mask"], err


def test_roots_and_the_preset_on_the_command_line(folder, capsys):
    exact = picture(capsys, "ball.npz")[1]
    for root in ("march", "bezier"):
        report, mask, err = picture(capsys, "ball.npz", "--root", root)
        assert report["root"] == root
        assert not err
        assert (mask != exact).mean() < 0.01
    assert picture(capsys, "ball.npz", "--root", "march", "--step", "1")[1].sum() < exact.sum()
    assert "try --octree-level 3" in picture(capsys, "ball.npz", "--root", "march", "--octree-level", "6")[2]
    extent = float(np.ptp(cloud(500, 75), axis=0).max())
    report, _, err = picture(capsys, "plain.npz", "--preset", "thesis", "--octree-level", "3")
    assert (report["support"], report["root"]) == (pytest.approx(extent / 16), "march")
    assert not err
    report = picture(capsys, "ball.npz", "--preset", "thesis", "--root", "bezier")[0]
    assert (report["support"], report["root"]) == (pytest.approx(0.2), "bezier")
    _, dust, err = picture(capsys, "plain.npz", "--preset", "thesis")
    assert err.count("\n") == 1
    assert "globule: warning: supports are half a leaf, " in err
    depth, support = err.split("--octree-level ")[1].split()[0], err.split("--support ")[1].strip()
    for more in (["--octree-level", depth], ["--support", support]):
        _, mask, err = picture(capsys, "plain.npz", "--preset", "thesis", *more)
        assert not err
        assert mask.sum() > 4 * dust.sum()


@pytest.mark.parametrize(("words", "message"), [
    (["--step", "1"], "--step: expected --root march beside --step, got --root exact"),
    (["--root", "bezier", "--step", "1"], "--step: expected --root march"),
    (["--root", "march", "--step", "1e9"], "step: expected 0.0001 to 10000"),
    (["--root", "march", "--octree", "sparse"], "--octree: expected dense with --root march"),
    (["--root", "bezier", "--kernel", "nishimura"], "--kernel: expected murakami or wyvill"),
    (["--preset", "thesis", "--octree-level", "9"], "level: expected 0 to 8"),
    (["--root", "newton"], "newton"),
])  # fmt: skip
def test_refused_options(folder, capsys, words, message):
    assert main(["render", "plain.npz", "-o", "a.png", *words]) == 2
    err = capsys.readouterr().err
    assert err.startswith("globule: error: ")
    assert message in err
    assert err.count("\n") == 1


def test_the_tables(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tables, "SIZE", (120, 90))
    path = tmp_path / "tables.csv"
    rows = tables.run(device="cpu", frames=1, particles=(100,), depths=(2,), output=str(path))
    assert rows[0]["dense nodes"] == 73
    assert rows[0]["hit differs"] < 1e-3
    assert rows[0]["hit"] > 0.01
    assert len(path.read_text().splitlines()) == 2
    assert "Table 6.2" in capsys.readouterr().out
    # The command.
    asked = []
    monkeypatch.setattr(tables, "run", lambda *given, **named: asked.append((given, named)))
    assert bench(["thesis", "--device", "cpu", "-o", str(tmp_path / "a")]) == 0
    assert (asked, bench(["--list"])) == ([(("cpu", 0), {"output": str(tmp_path / "a/thesis.csv")})], 0)
    assert "thesis      Tables 6.1 and 6.2" in capsys.readouterr().out
    assert bench(["9.9"]) == 2
    assert "thesis" in capsys.readouterr().err
    assert len(asked) == 1
