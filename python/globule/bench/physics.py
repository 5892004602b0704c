"""What the simulation must meet: expected against measured, as a table, CSV, a page and a plot."""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ..device import choose
from ..files import atomic_write
from .report import machine, write_csv
from .table import shown

SUMMARY = "the simulation's truths: expected against measured"
# Functions of (device, threads) whose rows have truth, expected, measured and ok.
EXPERIMENTS = {
    "globule.bench.physics_fluid": (
        "neighbors", "hydrostatic", "dam_break", "poiseuille", "taylor_green", "momentum",
        "free_fall", "emitter", "laplace", "oscillation",
    ),
    "globule.bench.physics_tissue": ("run",),
}  # fmt: skip
PAGE = """\
# Physics, checked

Made by `globule bench physics -o docs`: {n} truths, {n_met} met; {machine}.
The experiments are `globule.bench.physics_fluid` and `globule.bench.physics_tissue`; the tests run
the small ones.
A truth with a limit instead of a value (compression, drift) lists the limit as expected.

{table}

{unmet}
![Measured by expected](images/physics.png)
"""


def run(
    device: str = "auto", threads: int = 0, output: str | None = None, quick: bool = False
) -> list[dict[str, Any]]:
    """Run all experiments and print their rows; with `output`, FOLDER/NAME.csv, write that, and
    NAME.md and images/NAME.png beside it. `quick` leaves the slow ones out."""
    description = machine(choose(device).description)
    rows: list[dict[str, Any]] = []
    width = 58
    print(f"{'truth':<{width}} {'expected':>10} {'measured':>10}")
    for name, experiment in experiments():
        start = time.perf_counter()
        options = {"quick": quick} if name == "run" else {}
        for row in experiment(device, threads, **options):
            row = dict(row) if isinstance(row, Mapping) else row._asdict()
            rows.append(row)
            met = "" if row["ok"] else "  not met"
            expected, measured = shown(row["expected"]), shown(row["measured"])
            print(f"{row['truth']:<{width}} {expected:>10} {measured:>10}{met}", flush=True)
        print(f"{'':<{width}} {time.perf_counter() - start:>9.1f} s", flush=True)
    if output:
        write_csv(output, rows)
        stem, _ = os.path.splitext(output)
        with atomic_write(f"{stem}.md", "w") as file:
            file.write(page(rows, description))
        folder, name = os.path.split(stem)
        os.makedirs(os.path.join(folder, "images"), exist_ok=True)
        plot(os.path.join(folder, "images", f"{name}.png"), rows)
    return rows


def experiments() -> Iterator[tuple[str, Callable[..., Any]]]:
    for module, names in EXPERIMENTS.items():
        for name in names:
            yield name, getattr(importlib.import_module(module), name)


def page(rows: list[dict[str, Any]], description: str) -> str:
    """The documentation's page."""
    lines = ["| truth | expected | measured | |", "|---|---|---|---|"]
    for row in rows:
        met = "" if row["ok"] else "**not met**"
        expected, measured = shown(row["expected"]), shown(row["measured"])
        lines.append(f"| {row['truth']} | {expected} | {measured} | {met} |")
    unmet = [row["truth"] for row in rows if not row["ok"]]
    said = "Not met: " + "; ".join(unmet) + ".\n" if unmet else ""
    n_met = len(rows) - len(unmet)
    return PAGE.format(
        n=len(rows), n_met=n_met, machine=description, table="\n".join(lines), unmet=said
    )


def plot(path: str, rows: list[dict[str, Any]]) -> None:
    """Measured over expected, where that is a number other than 0; needs matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return
    ratios = [
        (row["truth"], float(row["measured"]) / float(row["expected"]), row["ok"])
        for row in rows
        if isinstance(row["expected"], (int, float)) and row["expected"]
    ]
    figure = Figure(figsize=(8, 0.6 + 0.19 * len(ratios)), dpi=80)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for i, (_, ratio, ok) in enumerate(ratios):
        shade = "tab:blue" if ok else "tab:red"
        axes.plot(min(max(ratio, 0.0), 2.0), -i, "o", color=shade, markersize=4)
    axes.axvline(1.0, color="gray", linewidth=0.8)
    axes.set_yticks([-i for i in range(len(ratios))], [truth for truth, *_ in ratios], fontsize=6)
    axes.set_xlim(-0.05, 2.05)
    axes.set_xlabel("measured / expected (red: not met; ends: beyond)", fontsize=8)
    axes.tick_params(axis="x", labelsize=7)
    axes.grid(alpha=0.3)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
