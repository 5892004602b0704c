"""Diagnostics of a run over time, as CSV and as plots."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence
from typing import Any

from .._base.files import atomic_write

PANELS = (
    ("energy, J", ("kinetic", "potential", "elastic")),
    ("momentum, kg m/s", ("momentum_x", "momentum_y", "momentum_z")),
    ("compression, %", ("compression", "max_compression")),
    ("particles", ("n_fluid", "n_tissue", "n_escaped", "n_removed")),
    ("bonds", ("n_bonds", "n_cut")),
    ("step, ms", ("dt",)),
)
FACTORS = {"compression": 100.0, "max_compression": 100.0, "dt": 1000.0}


def write_csv(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write diagnostics, one row a step, all digits; the file appears whole or not at all.

    Raises:
        OSError: a file that cannot be written.
    """
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with atomic_write(path, "w") as file:
        file.write(text.getvalue())


def plot(path: str | os.PathLike[str], rows: Sequence[dict[str, Any]], title: str = "") -> bool:
    """Plot diagnostics over time to a PNG; returns False where matplotlib is missing.

    Raises:
        OSError: a file that cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return False
    panels = []
    felt = tuple(dict.fromkeys(name for row in rows for name in row if name.startswith("force_")))
    for label, names in (*PANELS, ("force, N", felt)):
        # Energies are in the rows of frames only.
        curves = {name: [(r["time"], r[name]) for r in rows if name in r] for name in names}
        curves = {name: points for name, points in curves.items() if any(v for _, v in points)}
        if curves:
            panels.append((label, curves))
    figure = Figure(figsize=(10, 2.4 * max(1, (len(panels) + 1) // 2)), dpi=100)
    figure.set_layout_engine("constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=10)
    for i, (label, curves) in enumerate(panels):
        axes = figure.add_subplot((len(panels) + 1) // 2, 2, i + 1)
        for name, points in curves.items():
            time, values = zip(*points, strict=True)
            factor = FACTORS.get(name, 1.0)
            lone = "o" if len(points) == 1 else None  # a line of one point is not seen
            axes.plot(time, [factor * v for v in values], label=name, linewidth=1, marker=lone)
        axes.set_ylabel(label, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
        if len(curves) > 1:
            axes.legend(fontsize=7)
        if i >= len(panels) - 2:
            axes.set_xlabel("time, s", fontsize=8)
    with atomic_write(path) as file:
        figure.savefig(file, format="png")
    return True
