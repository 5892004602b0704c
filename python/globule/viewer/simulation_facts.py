"""What the page's statistics say of a simulation."""

from __future__ import annotations

from typing import Any


def facts_of(sim: Any, report: Any, running: bool) -> dict[str, Any]:
    """Time, counts and the report of the last step, in words by name."""
    facts = {"running": "yes" if running else "no"}
    for owner, label, name, form in (
        (sim, "time", "time", "{:.4f} s"),
        (sim, "steps", "n_steps", "{:,}"),
        (sim, "time step", "dt", "{:.3g} s"),
        (getattr(sim, "tissue", None), "pieces", "n_pieces", "{:,}"),
        (report, "iterations", "iterations", "{}"),
        (report, "compression", "compression", "{:.3g}"),
        (report, "bonds", "n_bonds", "{}"),
        (report, "cut", "n_cut", "{}"),
        (report, "escaped", "n_escaped", "{}"),
    ):
        value = getattr(owner, name, None)
        if value is not None:
            facts[label] = form.format(value)
    return facts
