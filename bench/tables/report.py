"""Results of benchmarks: a table on the terminal, a CSV file, the name of the machine."""

from __future__ import annotations

import csv
import os
import platform
from pathlib import Path
from typing import Any

from globule._base.files import atomic_write

Row = dict[str, Any]
MEASURED = Path(__file__).resolve().parents[2] / "docs" / "measured.csv"
KEY = ("bench", "machine", "case", "quantity")


def write_csv(path: str, rows: list[Row]) -> None:
    """Write rows of equal keys as CSV."""
    with atomic_write(path, "w") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def record(bench: str, machine: str, cases: dict[str, Row], path: Path = MEASURED) -> None:
    """Write the numbers of some cases to docs/measured.csv, in the place of those that it has."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = {tuple(row[k] for k in KEY): row["value"] for row in csv.DictReader(file)}
    for case, numbers in cases.items():
        for quantity, value in numbers.items():
            if isinstance(value, int | float):
                rows[bench, machine, case, quantity] = f"{value:.4g}"
    written = [{**dict(zip(KEY, key, strict=True)), "value": value} for key, value in rows.items()]
    write_csv(str(path), written)


def print_table(title: str, rows: list[Row]) -> None:
    """Print rows of equal keys; None becomes a dash, floats get three digits."""
    lines = [list(rows[0]), *([_text(v) for v in row.values()] for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    print(f"\n{title}")
    for line in lines:
        print("  ".join(word.rjust(width) for word, width in zip(line, widths, strict=True)))


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def machine(device: str) -> str:
    """One line about the machine. device: a scene's `device.description`."""
    return f"{platform.machine()}, {os.cpu_count()} cores, {device}, Python {platform.python_version()}"
