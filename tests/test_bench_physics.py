"""`python -m bench physics`: rows become a table, a page and a plot; what is not met is said."""

import csv
import json

import pytest

from bench.__main__ import main
from bench.tables import physics, physics_fluid


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
