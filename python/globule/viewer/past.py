"""States of a simulation to go back to: before cuts, and along the timeline."""

from __future__ import annotations

from typing import Any

MOST = 64  # states of the timeline
BYTES = 512 << 20  # of them in sum
MOST_UNDONE = 5  # strokes that can be undone
UNDO_BYTES = 1 << 30  # of the states for undo


def taken(sim: Any) -> dict[str, Any]:
    """The state of a simulation (`globule.Simulation`); {} for another object."""
    if not hasattr(sim, "arrays"):
        return {}
    emitters = {name: (e.emitted, e._volume) for name, e in sim.emitters.items()}
    arrays, foam = sim.arrays.state(), sim.foam._state()
    return {
        "arrays": arrays,
        "foam": foam,
        "bytes": sum(a.nbytes for a in (*arrays.values(), *foam.values())),
        "steps": int(sim.n_steps),
        "emitters": emitters,
        "counts": (sim.record.n_removed, sim.record.n_cut),
    }


def restore(sim: Any, state: dict[str, Any]) -> None:
    """Go to a state that `taken` returned; instruments follow their keys again.

    The record keeps its rows; see `forget_rows`.
    """
    sim.arrays.set_state(state["arrays"])
    sim.foam._take_up(state["foam"])
    sim.record.n_removed, sim.record.n_cut = state["counts"]
    for tool in sim.tools.values():
        tool.start(sim.time)
    for name, (emitted, volume) in state["emitters"].items():
        sim.emitters[name]._emitted, sim.emitters[name]._volume = emitted, volume


def forget_rows(sim: Any) -> None:
    """Take from the record what comes after the simulation's time."""
    rows = sim.record.diagnostics
    rows[:] = [row for row in rows if row["time"] <= sim.time]


class Past:
    """States along a simulation's time, evenly spaced in steps.

    When they become too many, every other one goes, and the space between two doubles. The first
    and the newest state stay.
    """

    def __init__(self) -> None:
        self._kept: list[dict[str, Any]] = []
        self._every = 1

    @property
    def last(self) -> int:
        """The step of the newest state; 0: there is none to go to."""
        kept = self._kept  # another thread may replace it
        return kept[-1]["steps"] if kept else 0

    def note(self, sim: Any, always: bool = False) -> None:
        """Keep the state of now if it is due; later states are no longer true and go."""
        steps = getattr(sim, "n_steps", 0)
        due = always or not self._kept or steps - self._kept[-1]["steps"] >= self._every
        self._kept = [state for state in self._kept if state["steps"] <= steps - due]
        if not (due and (state := taken(sim))):
            return
        self._kept = [*self._kept, state]
        while len(self._kept) > MOST or (len(self._kept) > 2 and self._bytes() > BYTES):
            self._kept = [*self._kept[:-1:2], self._kept[-1]]
            self._every *= 2

    def near(self, steps: int) -> dict[str, Any]:
        """The kept state that is nearest to a step."""
        return min(self._kept, key=lambda state: abs(state["steps"] - steps))

    def clear(self) -> None:
        """Forget all."""
        self._kept, self._every = [], 1

    def _bytes(self) -> int:
        return sum(state["bytes"] for state in self._kept)


class Strokes:
    """The states before the last cuts by hand."""

    def __init__(self) -> None:
        self._before: list[dict[str, Any]] = []

    def keep(self, state: dict[str, Any]) -> None:
        """Keep the state before a cut; the oldest go."""
        self._before = [*self._before, state][-MOST_UNDONE:] if state else []
        while sum(one["bytes"] for one in self._before) > UNDO_BYTES:
            del self._before[0]

    def pop(self) -> dict[str, Any]:
        """The state before the last cut.

        Raises:
            ValueError: there is no cut to undo.
        """
        if not self._before:
            raise ValueError("undo: expected a cut with the tool Cut, got none (the last 5 can be undone)")
        return self._before.pop()

    def forget_after(self, steps: int) -> None:
        """Forget cuts after a step."""
        self._before = [state for state in self._before if state["steps"] <= steps]

    def note_settings(self, n: int) -> None:
        """Note the number of settings that could be undone when the last cut was made."""
        if self._before:
            self._before[-1].setdefault("settings", n)

    def is_newest(self, n: int) -> bool:
        """Whether the last cut is newer than all `n` settings that can be undone."""
        return bool(self._before) and self._before[-1].get("settings", n) >= n

    def clear(self) -> None:
        """Forget all."""
        self._before = []
