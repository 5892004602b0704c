"""Fill tables of README.md, docs/measured.md and docs/scale.md from docs/measured.csv.

`python docs/make_measured.py`. Benches write that file (`--record MACHINE`). A table stands
between <!-- measured: NAME --> and <!-- /measured -->; TABLES says what is in it.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", ROOT / "docs" / "measured.md", ROOT / "docs" / "scale.md")
Values = dict[tuple[str, str, str, str], float]  # by bench, machine, case, quantity


class Column(NamedTuple):
    """A quantity: its title, and its numbers as text."""

    title: str
    quantity: str
    form: str = "{:,.3g}"
    factor: float = 1.0


class Table(NamedTuple):
    """What one bench measured on some machines: a row for each case."""

    bench: str
    machines: tuple[str, ...]
    columns: tuple[Column, ...]


FPS = "{:,.0f}"
TABLES = {
    "speed on a GPU": Table(
        "speed",
        ("NVIDIA H200",),
        (
            Column("pixels hit", "hit", "{:.0f} %", 100),
            Column("build", "build_ms", "{:.3g} ms"),
            Column("trace", "trace_ms", "{:.3g} ms"),
            Column("fps", "fps", FPS),
            Column("to host", "fps_to_host", FPS),
            Column("overlapped", "fps_to_host_overlapped", FPS),
            Column("bytes per particle", "bytes_per_particle"),
        ),
    ),
    "speed on a CPU": Table(
        "speed",
        ("Xeon (AVX-512), 1 thread", "Xeon (AVX-512), 2 cores", "Xeon host of the H200, 16 cores"),
        (Column("build", "build_ms", "{:.3g} ms"), Column("trace", "trace_ms", "{:.3g} ms")),
    ),
    "smooth surface on a GPU": Table(
        "surface",
        ("NVIDIA H200",),
        (
            Column("balls", "balls_ms", "{:.3g} ms"),
            Column("smooth", "smooth_ms", "{:.3g} ms"),
            Column("of which octree and kernels", "build_ms", "{:.3g} ms"),
            Column("with 3 samples at edges", "edges_ms", "{:.3g} ms"),
        ),
    ),
    "several GPUs": Table(
        "scale",
        ("NVIDIA H200",),
        (
            Column("build", "build_ms", "{:.3g} ms"),
            Column("trace", "trace_ms", "{:.3g} ms"),
            Column("composite", "composite_ms", "{:.2g} ms"),
            Column("frame", "frame_ms", "{:.3g} ms"),
            Column("a second", "fps"),
            Column("octree of each", "octree_gib", "{:.3g} GiB"),
        ),
    ),
    "simulation": Table(
        "simulate",
        ("NVIDIA H100", "Xeon (AVX-512), 2 cores"),
        (
            Column("steps/s", "steps_per_s", "{:,.4g}"),
            Column("simulated seconds per second", "simulated_per_s"),
            Column("million particle-steps/s", "particle_steps_per_s", "{:.3g}", 1e-6),
            Column("processor time per particle-step", "cpu_us", "{:.3g} µs"),
            Column("iterations, density", "iterations", "{:.1f}"),
            Column("divergence", "divergence_iterations", "{:.1f}"),
        ),
    ),
}
HEADLINE = (  # what a stranger asks first: task, bench, case
    ("image of balls", "speed", "splash, 117,649 particles, 1024×782"),
    ("image of balls", "speed", "pool, 10,000,000 particles, 1920×1080"),
    ("image of a smooth surface", "surface", "splash, 117,649 particles, 1920×1080"),
    ("image of a smooth surface", "surface", "pool, 10,000,000 particles, 1920×1080"),
    ("step of a fluid", "simulate", "splash, 117,649 particles, error 1 %"),
    ("step of a fluid", "simulate", "column, 10,000,422 particles, error 1 %"),
)
GPU = {"speed": "NVIDIA H200", "surface": "NVIDIA H200", "simulate": "NVIDIA H100"}
CPU = "Xeon (AVX-512), 2 cores"


def read() -> Values:
    """The CSV file; it is read once for all tables."""
    with open(ROOT / "docs" / "measured.csv", encoding="utf-8", newline="") as file:
        return {
            (row["bench"], row["machine"], row["case"], row["quantity"]): float(row["value"])
            for row in csv.DictReader(file)
        }


def per_second(values: Values, bench: str, machine: str, case: str) -> str:
    """Images or steps per second; "" where nobody measured."""
    found = {quantity: v for (*key, quantity), v in values.items() if key == [bench, machine, case]}
    if not found:
        return ""
    rate = found.get("fps") or found.get("steps_per_s")
    if rate is None:
        rate = 1e3 / (found.get("smooth_ms") or found["build_ms"] + found["trace_ms"])
    return f"{rate:,.0f}" if rate >= 100 else f"{rate:.2g}"


def headline(values: Values) -> list[list[str]]:
    """Rows of the README's table."""
    rows = [["per second", "particles", "NVIDIA H200 (step: H100)", "2 CPU cores (AVX-512)"]]
    for task, bench, case in HEADLINE:
        gpu = per_second(values, bench, GPU[bench], case)
        rows.append([task, case, gpu, per_second(values, bench, CPU, case)])
    return rows


def rows_of(table: Table, values: Values) -> list[list[str]]:
    """Rows of one bench's table."""
    rows = [["machine", "case", *(column.title for column in table.columns)]]
    for machine in table.machines:
        for case in dict.fromkeys(key[2] for key in values if key[:2] == (table.bench, machine)):
            cells = []
            for _, quantity, form, factor in table.columns:
                value = values.get((table.bench, machine, case, quantity))
                cells.append("" if value is None else form.format(factor * value))
            rows.append([machine, case, *cells])
    return rows


LEFT_OUT = ("frames", "bezier", "b-spline", "gaussian", "rbf", "plus", "vvn-om", "pvn-om")


def left_out(values: Values) -> list[list[str]]:
    """Errors of frames left out, a row for each sweep; the best in bold, and in how many draws."""
    rows = [["sweep", *LEFT_OUT, "`frames` is best in", "common pixels"]]
    for case in dict.fromkeys(key[2] for key in values if key[0] == "left_out"):
        found = {
            key[3]: value
            for key, value in values.items()
            if key[0] == "left_out" and key[2] == case
        }
        least = min(found[f"{name}_rms"] for name in LEFT_OUT)
        cells = []
        for name in LEFT_OUT:
            rms, low, high = (found[f"{name}_{what}"] for what in ("rms", "low", "high"))
            text = f"**{rms:.2f}**" if rms == least else f"{rms:.2f}"
            cells.append(f"{text} ({low:.2f}–{high:.2f})")
        rows.append(
            [case, *cells, f"{100 * found['frames_best']:.0f} %", f"{100 * found['common']:.0f} %"]
        )
    return rows


BUILT = {"headline": headline, "frames left out": left_out}  # tables of their own form


def filled(text: str, values: Values) -> str:
    """A page with its tables made again."""

    def make(match: re.Match[str]) -> str:
        name = match[1]
        rows = BUILT[name](values) if name in BUILT else rows_of(TABLES[name], values)
        lines = ["| " + " | ".join(row) + " |" for row in rows]
        lines.insert(1, "|" + "---|" * len(rows[0]))
        return "\n".join([f"<!-- measured: {name} -->", *lines, "<!-- /measured -->"])

    pattern = r"<!-- measured: ([\w ]+) -->\n.*?<!-- /measured -->"
    return re.sub(pattern, make, text, flags=re.S)


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(filled(page.read_text(encoding="utf-8"), read()), encoding="utf-8")
