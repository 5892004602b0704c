"""Results of benchmarks: a table on the terminal, a CSV file, the name of the machine."""

from __future__ import annotations

import csv
import os
import platform
from typing import Any

from globule._base.files import atomic_write

Row = dict[str, Any]


def write_csv(path: str, rows: list[Row]) -> None:
    """Write rows of equal keys as CSV."""
    with atomic_write(path, "w") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)


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
    return (
        f"{platform.machine()}, {os.cpu_count()} cores, {device}, "
        f"Python {platform.python_version()}"
    )
