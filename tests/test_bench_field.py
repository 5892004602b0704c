"""The benchmark of particle surfaces: its truths, its judge, and what it prints."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

FIELD = Path(__file__).resolve().parents[1] / "bench" / "field"


@pytest.fixture(scope="module")
def field():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(FIELD)
        import cases
        import judging

        yield judging, cases


@pytest.mark.parametrize("name", ["ball", "pool at rest", "sheet"])
def test_truth_is_the_body_of_the_particles(field, name):
    """Rays to the particles hit it, its volume is theirs, and normals face the rays."""
    _, cases = field
    make, _ = cases.SCENES[name]
    case = make(2000)
    x = case.positions.astype(float)
    rng = np.random.default_rng(4)
    out = rng.normal(size=x.shape)
    out *= 200 / np.linalg.norm(out, axis=1, keepdims=True)
    directions = (x - out) / np.linalg.norm(x - out, axis=1, keepdims=True)
    t, normals = case.truth(out, directions)
    assert np.isfinite(t).all()
    assert (t < np.linalg.norm(x - out, axis=1)).all()
    assert ((normals * directions).sum(1) < 0).all()
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    back, _ = case.truth(out, -directions)
    assert (~np.isfinite(back) | (back < 0)).all()
    # Parallel rays that fill a square: area times mean length is the volume.
    edge, n = 1.05 * np.abs(x).max() * 3**0.5, 201
    u = ((np.arange(n) + 0.5) / n * 2 - 1) * edge
    grid = np.stack([*np.meshgrid(u, u, indexing="ij"), np.full((n, n), -500.0)], -1)
    forth = np.tile([0.0, 0.0, 1.0], (n * n, 1))
    near = case.truth(grid.reshape(-1, 3), forth)[0]
    far = case.truth(grid.reshape(-1, 3) * (1, 1, -1), -forth)[0]
    hit = np.isfinite(near)
    volume = (1000 - near[hit] - far[hit]).sum() * (2 * edge / n) ** 2
    assert volume == pytest.approx(len(x) * case.spacing**3, rel=0.02)


def test_judge_knows_balls_and_counts_what_is_wrong(field):
    judging, _ = field
    surface = judging.Surface(np.zeros((1, 3)), np.ones(1), 1.0, "union", 0.0)
    origins = np.array([[0, 0, -5.0], [0.5, 0, -5], [1.1, 0, -5]])
    directions = np.tile([0, 0, 1.0], (3, 1))
    t, normals = surface.first_hit(origins, directions)
    assert np.allclose(t[:2], [4, 5 - 0.75**0.5])
    assert np.isinf(t[2])
    assert np.allclose(normals[1], [0.5, 0, -(0.75**0.5)])
    turned = normals.copy()
    turned[0] = [np.sin(0.1), 0, -np.cos(0.1)]
    mask = np.array([True, False, True])
    found = judging.compare(mask, turned, np.arange(3), (t, normals), directions)
    assert (found["wrong"], found["hit"]) == (2, 2)
    assert found["normal"] == pytest.approx(np.degrees(0.1))
    one = judging.Surface(np.zeros((1, 3), np.float32), 2.0, 1.0, "murakami", 0.6)
    t, _ = one.first_hit(origins[:1], directions[:1])
    assert t[0] == pytest.approx(5 - 2 * (1 - 0.6**0.5) ** 0.5, abs=1e-6)


@pytest.mark.parametrize("stretched", [False, True])
def test_a_square_is_judged_by_the_particles_near_it_alone(field, stretched):
    """The hits are those of all particles, of which most are left out."""
    judging, cases = field
    rng = np.random.default_rng(9)
    x = rng.random((400, 3)).astype(np.float32)
    support = 0.05 + 0.1 * rng.random(len(x))
    if stretched:
        frames, _ = np.linalg.qr(rng.normal(size=(len(x), 3, 3)))
        lengths = np.exp(rng.uniform(-0.7, 0.7, (len(x), 3))) / support[:, None]
        support = np.einsum("nij,nj,nkj->nik", frames, lengths, frames)
    surface = judging.Surface(x, support, 1.0, "murakami", 0.3)
    size = (80, 64)
    camera = cases.cameras(cases.Case(x, 0.1), size, 1)[0]
    rays = [np.asarray(a.reshape(-1, 3), float) for a in camera.rays(size)]
    parts = judging.squares(size, len(x))
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(80 * 64))
    for part in parts:
        o, d = (a[part] for a in rays)
        near = surface.near(o, d)
        got, expected = near.first_hit(o, d), surface.first_hit(o, d)
        assert np.array_equal(got[0], expected[0])
        assert np.allclose(got[1], expected[1], atol=1e-9)
        assert len(near.positions) < 0.7 * len(x)


@pytest.mark.slow
def test_one_command(tmp_path):
    """globule draws its surfaces without a wrong pixel; a name that is not known is one line."""
    command = [sys.executable, str(FIELD), "--size", "64x48", "--particles", "500", "-o", "out"]
    some = ["--scenes", "ball,mixed radii", "--programs", "globule, balls;globule, smooth"]
    done = subprocess.run([*command, *some], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    with open(tmp_path / "out" / "results.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["program"] for row in rows] == ["globule, balls", "globule, smooth"] * 2
    drawn = [row for row in rows if not row["note"]]
    assert len(drawn) == 3  # the smooth surface has one radius
    for row in drawn:
        assert int(row["own_wrong"]) <= 1
        assert float(row["own_normal_deg"]) < 0.05
        assert float(row["peak_mib"]) > 10
    assert "threshold 0.6" in (tmp_path / "out" / "results.md").read_text(encoding="utf-8")
    assert (tmp_path / "out" / "ball-globule-balls.png").exists()
    bad = subprocess.run([*command, "--scenes", "cube"], cwd=tmp_path, capture_output=True, text=True)
    assert bad.returncode == 2
    assert "scene: expected one of ball" in bad.stderr
