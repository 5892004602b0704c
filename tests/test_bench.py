"""`python -m bench` and the benchmarks beside others: tables are complete, truths and judges are right."""

import csv
import importlib
import itertools
import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_helpers import refuses
from globule.volumes.volume import Volume
from waiting import PATIENCE

from bench.__main__ import main
from bench.tables import physics, physics_fluid, report, sweep_speed, ultrasound
from bench.tables.cylinders import measure_cylinders
from bench.tables.table import Setting, Table

pytestmark = pytest.mark.usefixtures("folder")


def rods(diameter: float, blur: int = 0, noise: float = 0.0, spacing: float = 0.2) -> Volume:
    """Dark rods along z at x = -12.6, 0.07 and 12.7 mm, y = 5.03 mm; each voxel's exact share."""
    fine = 5
    x = (np.arange(160 * fine) + 0.5) * spacing / fine - 16
    y = (np.arange(50 * fine) + 0.5) * spacing / fine
    inside = np.zeros((len(y), len(x)))
    for place in (-12.6, 0.07, 12.7):
        inside += (x - place) ** 2 + (y[:, None] - 5.03) ** 2 < (diameter / 2) ** 2
    plane = 180 - 150 * inside.reshape(50, fine, 160, fine).mean(axis=(1, 3))
    for _ in range(blur):
        for axis in (0, 1):
            plane = (np.roll(plane, 1, axis) + plane + np.roll(plane, -1, axis)) / 3
    rng = np.random.default_rng(0)
    values = np.clip(plane + noise * rng.normal(size=(20, *plane.shape)), 0, 255)
    place = np.diag([spacing, spacing, spacing, 1.0])
    place[:2, 3] = spacing / 2 - 16, spacing / 2
    return Volume(values.astype(np.float32), place)


@pytest.mark.parametrize("diameter", [1.5, 3.0])
@pytest.mark.parametrize(("blur", "noise"), [(0, 0), (2, 0), (0, 40), (1, 25)])
def test_rods_are_measured_without_bias(diameter, blur, noise):
    places = [(-12.6, 5), (0, 5), (12.6, 5)]
    found = measure_cylinders(rods(diameter, blur, noise), places, diameter)
    assert found.diameters.shape == (2, 3)
    assert found.separations.shape == (2, 2)
    assert found.diameters.mean() == pytest.approx(diameter, abs=0.05)
    assert found.separations.mean(axis=0) == pytest.approx([12.67, 12.63], abs=0.04)


def test_rods_that_are_not_there_are_refused():
    refuses("cylinders", measure_cylinders, rods(3.0), [(200, 0)], 3.0)


def test_removed_slices():
    reference = np.tile(np.arange(10, 40, dtype=np.uint8)[:, None, None], (1, 8, 9))
    curves = ultrasound.removed_slices(reference, ("pvn-om", "vvn-om"), 2, device="cpu")
    for method in ("pvn-om", "vvn-om"):
        means = curves.means[method]
        assert means[-1] == 1.0
        assert curves.empty[method][-1] == 1.0
        assert all(a <= b + 1e-9 for a, b in itertools.pairwise(means))
    assert curves.means["pvn-om"][0] == 0.0  # nothing removed: every voxel is its own pixel


def test_reference_volume_is_there_without_optional_packages(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    values, name = ultrasound.reference_volume(quick=True)
    assert "phantom" in name
    assert values.ndim == 3
    assert values.max() > 100


@pytest.mark.slow
def test_command(capsys, monkeypatch):
    monkeypatch.setattr(ultrasound, "CYLINDER_METHODS", ("pvn-om",))  # the fast one
    assert main(["ultrasound", "4.3", "--quick", "-o", "out", "--device", "cpu"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("4.3  cylinder phantom")
    assert "source" in out
    assert "ours" in out
    with open("out/4.3.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    for row in rows:
        assert abs(float(row["ours"]) - float(row["true"])) < 0.06
    assert sorted(p.name for p in Path("out").iterdir()) == ["4.3.csv"]


def test_json(capsys, monkeypatch):
    def one(setting: Setting):
        yield Table("4.3", "t", ("a", "b"), [(1, None)])

    monkeypatch.setitem(ultrasound.TABLES, "4.3", one)
    assert main(["ultrasound", "4.3", "-o", "out", "--json", "--device", "cpu"]) == 0
    assert json.loads(capsys.readouterr().out)["4.3"]["rows"] == [[1, None]]
    assert Path("out/4.3.csv").read_text(encoding="utf-8") == "a,b\n1,\n"


def test_mistakes(capsys):
    assert main(["ultrasound", "9.9"]) == 2
    assert "4.3" in capsys.readouterr().err
    assert not Path("bench").exists()
    Path("file").write_text("", encoding="utf-8")
    assert main(["ultrasound", "4.3", "-o", "file"]) == 2


@pytest.mark.slow
def test_speed_of_a_sweep(monkeypatch):
    monkeypatch.setattr(sweep_speed, "SIZE", (64, 48))
    monkeypatch.setattr(sweep_speed, "FRAMES", 6)
    monkeypatch.setattr(sweep_speed, "_RUNS", 1)
    (table,) = sweep_speed.sweep_speed(Setting("out", device="cpu", quick=True))
    rows = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    assert [row["what"] for row in rows][:2] == ["nearest binning", "binning, holes to 9³"]
    assert all(row["ours s"] > 0 for row in rows)
    assert rows[0]["PLUS/ours"] == pytest.approx(0.041 / rows[0]["ours s"])


def test_tables_go_into_the_page(tmp_path, monkeypatch):
    """docs/make_ultrasound.py replaces what stands between the marks of a name, nothing else."""
    source = Path(__file__).parents[1] / "docs" / "make_ultrasound.py"
    script = tmp_path / "make_ultrasound.py"
    script.write_text(source.read_text())
    page = tmp_path / "measured.md"
    page.write_text("<!-- cpu -->\nkept\n<!-- /cpu -->\n<!-- gpu -->\nold\n<!-- /gpu -->\nc\n")
    columns = ["frames", "size", "method", "source s", "ours s", "on device s"]
    rows = [[131, 128, m, None, 0.5, 0.25] for m in ultrasound.METHODS]
    note = ["source: GTX 1080; ours: a GPU"]
    tables = {"4.1": {"columns": columns, "rows": rows, "notes": note}}
    (tmp_path / "bench.json").write_text(json.dumps(tables))
    monkeypatch.setattr(sys, "argv", [str(script), f"gpu={tmp_path}"])
    runpy.run_path(str(script), run_name="__main__")
    text = page.read_text()
    assert "kept" in text
    assert "old" not in text
    assert text.endswith("c\n")
    assert "**a GPU**" in text
    assert "| 131 | 128³ | 0.5 | 0.5 | 0.5 | 0.5 | 0.25 | – | – |" in text


def test_recorded_numbers_take_the_place_of_older_ones(tmp_path):
    path = tmp_path / "measured.csv"
    path.write_text("bench,machine,case,quantity,value\nspeed,A,x,fps,10\nspeed,B,x,fps,20\n")
    report.record("speed", "A", {"x": {"fps": 12.3456, "hash": "f00"}, "y": {"n": 3}}, path)
    lines = path.read_bytes().decode().split("\n")
    assert lines[1:-1] == ["speed,A,x,fps,12.35", "speed,B,x,fps,20", "speed,A,y,n,3"]


def rows(device, threads):
    return [physics_fluid.near("speed", 2.0, 1.9, 0.1), physics_fluid.at_most("drift", 0.2, 0.5)]


def test_a_page_says_what_is_not_met(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(physics, "experiments", lambda quick: [("Fluids", rows)])
    words = ["physics", "-o", str(tmp_path), "--device", "cpu"]
    assert main(words) == 0
    assert "drift" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert [row["measured"] for row in found["physics"]] == [1.9, 0.5]
    assert found["csv"] == str(tmp_path / "physics.csv")
    assert "drift" in err
    with open(tmp_path / "physics.csv", encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    assert [row["measured"] for row in found] == ["1.9", "0.5"]
    text = (tmp_path / "physics.md").read_text()
    assert "2 truths, 1 met" in text
    assert "Not met: drift." in text
    assert "## Fluids" in text
    assert "| drift | ≤ 0.2 | 0.5 | **not met** |" in text


def test_a_plot_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    physics.plot(tmp_path / "p.png", [{"part": "Fluids", **r._asdict()} for r in rows("cpu", 0)])
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"


BENCH = Path(__file__).resolve().parents[1] / "bench"


def programs(folder: str, *names: str):
    """Modules of a folder of programs that import each other by their names."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCH / folder)
        yield [importlib.import_module(name) for name in names]


@pytest.fixture(scope="module")
def field():
    yield from programs("field", "judging", "cases")


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
    command = [sys.executable, str(BENCH / "field"), "--size", "64x48", "--particles", "500", "-o", "out"]
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


@pytest.fixture(scope="module")
def bench():
    yield from programs("peers", "fluids", "fluid_judge")


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
    assert (found["lost"], found["kinetic"]) == (0, pytest.approx(0.5 * 1000 * 0.6**3 * 4))
    assert found["energy"] == pytest.approx(found["kinetic"] + 1000 * 0.6**3 * 9.81 * 0.3)
    assert found["most_compression"] == pytest.approx(0, abs=1e-6)
    away = x.copy()
    away[0], away[1] = np.nan, (0.3, -0.06, 0.3)
    assert judge.flow(case, away[:-1], v[:-1])["lost"] == 3
    case["obstacles"] = np.array([[[-1.0, -1, -1], [0.22, 1, 1]]])
    assert judge.flow(case, x, v)["lost"] == 72  # two of six layers


def run(tmp_path: Path, *words: str) -> tuple[subprocess.CompletedProcess, list[dict]]:
    out = tmp_path / "rows.json"
    command = [sys.executable, str(BENCH / "peers" / "fluids.py"), "--cases", "column", "--threads", "1"]
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
