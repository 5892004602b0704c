"""What the page's statistics say of a simulation."""

from __future__ import annotations

from typing import Any


def facts_of(sim: Any, report: Any, running: bool) -> dict[str, Any]:
    """Time, counts and the report of the last step, in words by name."""
    facts = {"running": "yes" if running else "no"}
    for label, name, form in (
        ("time", "time", "{:.4f} s"),
        ("steps", "n_steps", "{:,}"),
        ("time step", "dt", "{:.3g} s"),
    ):
        value = getattr(sim, name, None)
        if value is not None:
            facts[label] = form.format(value)
    if (tissue := getattr(sim, "tissue", None)) is not None:
        facts["pieces"] = f"{tissue.n_pieces:,}"
    for label, name in (
        ("iterations", "iterations"),
        ("compression", "compression"),
        ("bonds", "n_bonds"),
        ("cut", "n_cut"),
        ("escaped", "n_escaped"),
    ):
        value = getattr(report, name, None)
        if value is not None:
            facts[label] = f"{value:.3g}" if isinstance(value, float) else str(value)
    return facts
