"""Simulations with known answers: a table, a CSV file, a page and a plot."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from globule._base.device import choose
from globule._base.files import atomic_write
from globule.sim.simulation import Simulation

from . import (
    physics_bodies,
    physics_crown,
    physics_cuts,
    physics_flows,
    physics_fluid,
    physics_friction,
    physics_memory,
    physics_orders,
    physics_solid,
    physics_tissue,
)
from .report import machine, write_csv
from .table import shown

PAGE = """\
# Physics, checked

Made by `{command}`: {n} truths, {n_met} met; {machine}.
The experiments are `bench.tables.physics_fluid`, `physics_flows`, `physics_bodies`,
`physics_crown`, `physics_orders`, `physics_tissue`, `physics_solid`, `physics_memory`, `physics_friction` and
`physics_cuts`; the tests run the small ones.

{tables}
{unmet}
![Measured by expected](images/physics.png)
"""


def run(device: str = "auto", threads: int = 0, output: str | None = None, quick: bool = False) -> list[dict[str, Any]]:
    """Run all experiments, print their rows, and return them.

    Args:
        device, threads: as for `Simulation`.
        output: FOLDER/NAME.csv to write, with FOLDER/NAME.md and FOLDER/images/NAME.png.
        quick: skip the slow experiments.
    """
    description = machine(choose(device).description)
    rows: list[dict[str, Any]] = []
    width = 58
    print(f"{'truth':<{width}} {'expected':>10} {'measured':>10}")
    for part, experiment in experiments(quick):
        start = time.perf_counter()
        for row in experiment(device, threads):
            row = {"part": part, **(row if isinstance(row, Mapping) else row._asdict())}
            rows.append(row)
            met = "" if row["ok"] else "  not met"
            expected, measured = expectation(row), shown(row["measured"])
            print(f"{row['truth']:<{width}} {expected:>10} {measured:>10}{met}", flush=True)
        print(f"{'':<{width}} {time.perf_counter() - start:>9.1f} s", flush=True)
    if output:
        write_csv(output, rows)
        stem, _ = os.path.splitext(output)
        with atomic_write(f"{stem}.md", "w") as file:
            file.write(page(rows, description, quick))
        folder, name = os.path.split(stem)
        os.makedirs(os.path.join(folder, "images"), exist_ok=True)
        plot(os.path.join(folder, "images", f"{name}.png"), rows)
    return rows


def expectation(row: Mapping[str, Any]) -> str:
    """The expected value of a row as text; a limit other than 0 has its sign."""
    sign = {"at most": "≤ ", "at least": "≥ "}.get(row["limit"], "")
    return (sign if row["expected"] else "") + shown(row["expected"])


def experiments(quick: bool) -> Iterator[tuple[str, Callable[[str, int], Any]]]:
    """Parts of the page, and functions (device, threads) that return rows."""
    fluids: list[Callable[[str, int], Any]] = [
        neighbors,
        *physics_fluid.EXPERIMENTS,
        partial(physics_fluid.poiseuille, implicit=True),
        *physics_flows.EXPERIMENTS,
        *physics_bodies.EXPERIMENTS,
        partial(physics_crown.run, quick=quick),
    ]
    yield from (("Fluids", experiment) for experiment in fluids)
    yield from (("At two resolutions", experiment) for experiment in physics_orders.EXPERIMENTS)
    yield "Tissue of springs, and the knife", partial(physics_tissue.run, quick=quick)
    yield "Solids", partial(physics_solid.run, quick=quick)
    yield "Solids that relax or yield", physics_memory.run
    yield "Friction and contact of tissue", partial(physics_friction.run, quick=quick)
    yield "Friction and contact of tissue", partial(physics_cuts.run, quick=quick)


def neighbors(device: str = "cpu", threads: int = 0) -> list[physics_fluid.Row]:
    """Neighbor lists of the solver against brute force, before and after adding and removing."""
    rng = np.random.default_rng(1)
    domain, fluids = {"lo": (0, 0, 0), "hi": (1, 1, 1)}, [{"name": "water"}]
    sim = Simulation({"spacing": 0.05, "domain": domain, "fluids": fluids}, device, threads)
    sim.add(rng.random((2000, 3)).astype(np.float32))
    wrong = [_wrong_lists(sim)]
    sim.add(0.5 * rng.random((500, 3)).astype(np.float32))
    sim.remove(rng.choice(2500, 700, replace=False))
    wrong.append(_wrong_lists(sim))
    names = "neighbors: lists unlike brute force", "the same after adding and removing"
    return [physics_fluid.at_most(name, 0, n) for name, n in zip(names, wrong, strict=True)]


def _wrong_lists(sim: Simulation) -> int:
    """Number of particles whose list differs from the particles within two spacings."""
    ids, offsets, found = sim.arrays.neighbors()
    known, positions = sim.ids, sim.positions
    squared = np.float32(2 * sim.settings.spacing) ** 2
    n_wrong = 0
    for k, id_ in enumerate(ids):
        apart = positions - positions[np.searchsorted(known, id_)]
        near = known[(np.square(apart).sum(axis=1) < squared) & (known != id_)]
        n_wrong += not np.array_equal(np.sort(found[offsets[k] : offsets[k + 1]]), near)
    return n_wrong


def by_part(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """The rows of each part, in order."""
    parts: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        parts.setdefault(row["part"], []).append(row)
    return parts


def page(rows: list[dict[str, Any]], description: str, quick: bool = False) -> str:
    """The page of the documentation, Markdown."""
    lines = []
    for part, its in by_part(rows).items():
        lines += [f"## {part}", "| truth | expected | measured | |", "|---|---|---|---|"]
        for row in its:
            met = "" if row["ok"] else "**not met**"
            truth = row["truth"].replace("|", "\\|")
            lines.append(f"| {truth} | {expectation(row)} | {shown(row['measured'])} | {met} |")
        lines.append("")
    unmet = [row["truth"] for row in rows if not row["ok"]]
    said = "Not met: " + "; ".join(unmet) + ".\n" if unmet else ""
    n_met = len(rows) - len(unmet)
    command = "python -m bench physics" + (" --quick" if quick else "")
    return PAGE.format(
        command=command, n=len(rows), n_met=n_met, machine=description, tables="\n".join(lines), unmet=said
    )


def plot(path: str, rows: list[dict[str, Any]]) -> None:
    """Plot measured over expected, a panel for each part, to a PNG, if matplotlib is installed.

    Rows whose expected value is a limit or 0 have no ratio and are left out, and so are those
    whose two numbers are the same (counts).
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return
    parts = {
        part: [
            (row["truth"], float(row["measured"]) / float(row["expected"]), row["ok"])
            for row in its
            if row["expected"] and not row["limit"] and row["measured"] != row["expected"]
        ]
        for part, its in by_part(rows).items()
    }
    parts = {part: ratios for part, ratios in parts.items() if ratios}
    if not parts:
        return
    heights = [len(ratios) + 1.5 for ratios in parts.values()]
    figure = Figure(figsize=(9, 0.8 + 0.2 * sum(heights)), dpi=110)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(parts), 1, sharex=True, squeeze=False, height_ratios=heights)
    for axes, (part, ratios) in zip(panels[:, 0], parts.items(), strict=True):
        for i, (_, ratio, ok) in enumerate(ratios):
            inside = _LEAST <= ratio <= _MOST
            mark = "o" if inside else "<" if ratio < _LEAST else ">"
            shade = "tab:blue" if ok else "tab:red"
            axes.plot(min(max(ratio, _LEAST), _MOST), -i, mark, color=shade, markersize=5)
        axes.axvline(1.0, color="gray", linewidth=0.8)
        axes.set_yticks([-i for i in range(len(ratios))], [truth for truth, *_ in ratios])
        axes.set_ylim(0.7 - len(ratios), 0.7)
        axes.set_title(part, fontsize=9, loc="left")
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
    panels[-1, 0].set_xlim(_LEAST - 0.01, _MOST + 0.01)
    panels[-1, 0].set_xlabel("measured / expected; red: not met; triangles: beyond", fontsize=8)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")


_LEAST, _MOST = 0.75, 1.25  # of the plot
