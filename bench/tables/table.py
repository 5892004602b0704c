"""Tables of a benchmark: printed, and written as CSV."""

from __future__ import annotations

import csv
import io
import os
from typing import Any, NamedTuple

from globule._base.files import atomic_write


class Table(NamedTuple):
    """A table: its name in the source ("4.1"), title, names of columns, rows and notes."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """The table as text for a terminal."""
        cells = [[shown(value) for value in row] for row in (self.columns, *self.rows)]
        widths = [max(len(row[k]) for row in cells) for k in range(len(self.columns))]
        lines = ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in cells]
        lines.insert(1, "  ".join("-" * width for width in widths))
        return "\n".join([f"{self.name}  {self.title}", *lines, *self.notes])

    def markdown(self) -> str:
        """The table in Markdown."""
        cells = [[shown(value) for value in row] for row in (self.columns, *self.rows)]
        lines = ["| " + " | ".join(row) + " |" for row in cells]
        lines.insert(1, "|" + "---|" * len(self.columns))
        return "\n".join(lines)

    def write(self, folder: str) -> str:
        """Write FOLDER/NAME.csv with all digits, and return its path."""
        path = os.path.join(folder, f"{self.name}.csv")
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(["" if value is None else value for value in row] for row in self.rows)
        with atomic_write(path, "w") as file:
            file.write(text.getvalue())
        return path


def shown(value: Any) -> str:
    """The text of a cell: four significant digits, a dash for None."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return str(value)


class Setting(NamedTuple):
    """Folder to write to, device, threads, quick (small sizes only), say(text) for progress."""

    folder: str
    device: str = "auto"
    threads: int = 0
    quick: bool = False
    say: Any = lambda text: None
