"""What hand and instruments feel of tissue, for the page: of the last step, without a wait."""

from __future__ import annotations

import math
from typing import Any

from .markdown import plain

PULL = "pull_force"  # column of a simulation's record: the hand's force, N
BY_NAME = "force_"  # begins the columns of graspers and pushers
SMALL = 0.01  # N; smaller forces are said in mN


def newtons(force: float) -> str:
    """A force (N) in words, with two digits."""
    value, unit = (force, "N") if force >= SMALL else (1e3 * force, "mN")
    rounded = float(f"{value:.1e}")
    decimals = max(0, 1 - math.floor(math.log10(rounded))) if rounded else 0
    return f"{rounded:.{decimals}f} {unit}"


def forces(simulation: Any) -> dict[str, float]:
    """Force (N) of each instrument in the last step, by name; "hand": of the tool Grasp."""
    rows = getattr(getattr(simulation, "record", None), "diagnostics", None)
    last = rows[-1:] if rows else []  # a reset in another thread may empty the rows meanwhile
    return {name: row[column] for row in last for name, column in by_name(row).items()}


def by_name(row: dict[str, float]) -> dict[str, str]:
    """The columns of forces in a row of a record, by what they are called on the page."""
    return {
        "hand" if column == PULL else column.removeprefix(BY_NAME): column
        for column in row
        if column == PULL or column.startswith(BY_NAME)
    }


def force_words(felt: dict[str, float]) -> str:
    """Forces (N) by name as a line of Markdown, without a hand that holds nothing; "": none."""
    shown = [f"{plain(name)}: {newtons(force)}" for name, force in felt.items() if force or name != "hand"]
    return " · ".join(["**Force**", *shown]) if shown else ""
