"""`python -m bench`: the tables are complete and the measurements behind them are right."""

from __future__ import annotations

import csv
import itertools
import json
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from globule.volumes.volume import Volume

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
    with pytest.raises(ValueError, match="cylinders"):
        measure_cylinders(rods(3.0), [(200, 0)], 3.0)


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


def test_times_and_memory(monkeypatch):
    info = {"bytes": 2**20, "bin_seconds": 0.25, "fill_seconds": 0.5}
    volume = Volume(np.ones((2, 2, 2), np.uint8), np.eye(4), info=info)
    asked = []
    monkeypatch.setattr(ultrasound, "_sweep", lambda n: n)
    monkeypatch.setattr(ultrasound, "reconstruct", lambda s, m, size, **_: asked.append((s, m, size)) or volume)
    times, memory = ultrasound.times_and_memory(Setting("out", device="cpu"))
    assert (times.name, memory.name) == ("4.1", "4.2")
    assert len(times.rows) == 36
    assert len(memory.rows) == 18
    assert {(131, "pvn-om", (512,) * 3), (51, "vvn", (128,) * 3)} <= set(asked)
    first = dict(zip(times.columns, times.rows[0], strict=True))
    assert first["source s"] == 0.72
    assert first["octree, source"] == pytest.approx(4.98 / 0.72)
    assert first["on device s"] == 0.75
    assert first["source/ours"] == pytest.approx(0.72 / first["ours s"])
    assert memory.rows[0][3:5] == (1390, 1.0)


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
