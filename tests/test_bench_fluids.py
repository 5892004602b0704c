"""The benchmark of fluids side by side: its judge, what it prints, and peers that do not start."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from waiting import PATIENCE

PEERS = Path(__file__).resolve().parents[1] / "bench" / "peers"


@pytest.fixture(scope="module")
def bench():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(PEERS)
        import fluid_judge
        import fluids

        yield fluids, fluid_judge


def lattice(n: int, d: float) -> np.ndarray:
    x = (np.arange(n) + 0.5) * d
    return np.stack(np.meshgrid(x, x, x, indexing="ij"), -1).reshape(-1, 3)


def test_sums_are_those_of_all_pairs(bench):
    _, judge = bench
    rng = np.random.default_rng(3)
    at, of, weight, d = rng.random((50, 3)), 2 * rng.random((300, 3)) - 0.5, rng.random(300), 0.11
    q = np.linalg.norm(at[:, None] - of, axis=-1) / (2 * d)
    assert np.allclose(judge.sums(at, of, weight, d), (judge.spline(q) * weight).sum(1))


def test_lattice_between_walls_is_at_rest(bench):
    """As globule's walls are made: a layer 0.555 spacings behind the faces."""
    _, judge = bench
    from globule.sim.sampling import surface
    from globule.sim.shapes import Box

    d, n = 0.05, 8
    walls = surface(Box((0, 0, 0), (n * d,) * 3), d, hollow=True)
    density = judge.relative_density(lattice(n, d), walls, d)
    assert density.max() == pytest.approx(1, abs=0.02)  # also in edges and corners
    middle = (np.abs(lattice(n, d) / d - n / 2) < 2).all(1)
    assert density[middle] == pytest.approx(1, abs=1e-6)


def test_flow_counts_what_is_lost(bench):
    _, judge = bench
    d = 0.1
    x = lattice(6, d)
    case = {
        "fluid": x, "walls": np.array([[9.0, 9, 9]]), "spacing": d, "lo": np.zeros(3),
        "hi": np.full(3, 0.6), "obstacles": np.zeros((0, 2, 3)),
    }  # fmt: skip
    v = np.tile([0.0, 2.0, 0.0], (len(x), 1))
    found = judge.flow(case, x, v)
    assert found["lost"] == 0
    assert found["kinetic"] == pytest.approx(0.5 * 1000 * 0.6**3 * 4)
    assert found["energy"] == pytest.approx(found["kinetic"] + 1000 * 0.6**3 * 9.81 * 0.3)
    assert found["most_compression"] == pytest.approx(0, abs=1e-6)
    away = x.copy()
    away[0], away[1] = np.nan, (0.3, -0.06, 0.3)
    assert judge.flow(case, away[:-1], v[:-1])["lost"] == 3
    case["obstacles"] = np.array([[[-1.0, -1, -1], [0.22, 1, 1]]])
    assert judge.flow(case, x, v)["lost"] == 72  # two of six layers


def run(tmp_path: Path, *words: str) -> tuple[subprocess.CompletedProcess, list[dict]]:
    out = tmp_path / "rows.json"
    command = [sys.executable, str(PEERS / "fluids.py"), "--cases", "column", "--threads", "1"]
    done = subprocess.run(
        [*command, "--json", str(out), "--csv", str(tmp_path / "rows.csv"), *words],
        capture_output=True, text=True, check=True, timeout=PATIENCE,
    )  # fmt: skip
    return done, json.loads(out.read_text())


@pytest.mark.slow
def test_column_of_globule(bench, tmp_path):
    words = ("--peers", "globule", "--n", "700", "--errors", "0.01", "--seconds", "0.1")
    done, (start, row) = run(tmp_path, *words)
    assert start["energy"] == pytest.approx(1000 * 2 * 9.81, rel=1e-4)  # 2 m³, 1 m high
    assert row["time"] == pytest.approx(0.1)
    assert row["steps"] == pytest.approx(0.1 / row["dt"])
    assert row["lost"] == 0
    assert row["compression"] < 0.01
    assert row["energy"] < start["energy"]
    assert row["front"] > start["front"]
    assert row["per_cpu_second"] == pytest.approx(row["particles"] * row["steps"] / row["cpu"] / 1e6)
    assert done.stdout.count(f"| column, {row['particles']} | 1.0% | 1 | globule |") == 2
    with open(tmp_path / "rows.csv", encoding="utf-8") as file:
        assert [r["program"] for r in csv.DictReader(file)] == ["start", "globule"]


def test_peers_that_do_not_start_are_told_in_a_line(bench, tmp_path, monkeypatch):
    fluids, _ = bench
    monkeypatch.setitem(fluids.PACKAGES, "SPlisHSPlasH", ["no_such_package"])
    assert fluids.environment("SPlisHSPlasH") == ({}, "pip install no_such_package")
    for name, text, said in (
        ("it_crashes", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "(signal 11)"),
        ("it_raises", "raise ImportError('no libX11')", "ImportError: no libX11"),
        ("it_needs_gl", "import os; assert 'LD_PRELOAD' in os.environ", ""),
    ):
        (tmp_path / f"{name}.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
        monkeypatch.delenv("LD_PRELOAD", raising=False)
        monkeypatch.setitem(fluids.PACKAGES, "SPlisHSPlasH", [name])
        extra, why = fluids.environment("SPlisHSPlasH")
        assert said in why
        assert bool(why) == bool(said)
        assert extra == ({} if said else fluids.SYSTEM_GL)


def test_both_compute_the_same_flow(bench, tmp_path):
    fluids, _ = bench
    _, why = fluids.environment("SPlisHSPlasH")
    if why:
        pytest.skip(why)
    words = ("--n", "2000", "--errors", "0.001", "--seconds", "0.2")
    _, (start, ours, theirs, tight) = run(tmp_path, *words)
    assert tight["divergence_iterations"] > theirs["divergence_iterations"]
    assert theirs["time"] == pytest.approx(ours["time"], rel=1e-5)
    assert theirs["unsolved"] == 0
    assert theirs["lost"] == 0
    assert theirs["kinetic"] == pytest.approx(ours["kinetic"], rel=0.02)
    assert theirs["height"] == pytest.approx(ours["height"], rel=0.005)
    assert theirs["front"] == pytest.approx(ours["front"], rel=0.03)
    assert theirs["energy"] < start["energy"]
    assert theirs["apart"] < 0.2
