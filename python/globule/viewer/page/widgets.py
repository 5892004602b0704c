"""Widgets of settings: what a person changes goes to the state, and what changes there is shown."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from ..state import State, field_of


class Binder:
    """Widgets by the setting that they show, as "surface.kernel"."""

    def __init__(self, gui: Any, state: State, on_error: Callable[[Any, str], None]):
        self.gui, self.state, self.on_error = gui, state, on_error
        self.widgets: dict[str, Any] = {}
        self._shown: dict[str, Callable[[Any], Any]] = {}
        state.listen(self._follow)

    def add(self, group: str, name: str, **given: Any) -> Any:
        """A widget for a setting; `given` replaces what its field says: label, least, most, step,
        options; `usual` is shown where the setting is open."""
        field = field_of(group, name)
        facts = {**field.metadata, **given}
        for end in ("least", "most", "step"):
            if isinstance(facts.get(end), float):
                facts[end] = float(f"{facts[end]:.3g}")  # short enough to be read on a slider
        value = getattr(getattr(self.state, group), name)
        to_page = self._to_page(facts)
        widget = self._make(facts, to_page(value))
        key = f"{group}.{name}"
        self.widgets[key], self._shown[key] = widget, to_page

        @widget.on_update
        def _(event: Any) -> None:
            if event.client is None:  # set by us
                return
            try:
                self.state.set(**{f"{group}__{name}": self._from_page(facts, widget.value)})
            except ValueError as error:
                self.on_error(event.client, str(error))

        return widget

    def _make(self, facts: dict, value: Any) -> Any:
        gui, label, hint = self.gui, facts["label"], facts.get("hint") or None
        kind = facts["kind"]
        if kind == "switch":
            return gui.add_checkbox(label, value, hint=hint)
        if kind == "choice":
            return gui.add_dropdown(
                label, facts["options"], initial_value=value, hint=hint)
        if kind == "triple":
            return gui.add_vector3(label, value, step=facts.get("step", 0.01), hint=hint)
        least, most = facts["least"], facts["most"]
        if kind == "whole":
            return gui.add_slider(label, int(least), int(most), 1, int(value), hint=hint)
        if facts.get("typed"):
            return gui.add_number(label, float(value), step=facts.get("step"), hint=hint)
        step = facts.get("step") or (most - least) / 200
        return gui.add_slider(label, least, most, step, min(max(value, least), most), hint=hint)

    def _to_page(self, facts: dict) -> Callable[[Any], Any]:
        def to_page(value: Any) -> Any:
            if value is None:
                value = facts.get("usual", facts.get("least"))
            if facts["kind"] == "choice" and not value:
                return facts["options"][0]
            if facts["kind"] == "triple":
                return tuple(float(v) for v in value)
            if facts["kind"] in ("real", "whole") and not facts.get("typed"):
                return min(max(value, facts["least"]), facts["most"])
            return value

        return to_page

    @staticmethod
    def _from_page(facts: dict, value: Any) -> Any:
        if facts["kind"] == "choice" and value == facts.get("none"):
            return ""
        if facts["kind"] == "triple":
            return tuple(float(v) for v in value)
        return value

    def _follow(self, changed: set[str]) -> None:
        for key in changed & set(self.widgets):
            group, _, name = key.partition(".")
            value = self._shown[key](getattr(getattr(self.state, group), name))
            if self.widgets[key].value != value:
                self.widgets[key].value = value


def bounded(slider: Any) -> float:
    """A slider's value within its ends, which a browser need not keep to."""
    value = slider.value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
        raise ValueError(f"{slider.label}: expected a number, got {value!r}")
    return min(max(value, slider.min), slider.max)


def safe(page: Any) -> Callable[[Callable], Callable]:
    """A decorator for callbacks: what goes wrong is said in the page that asked."""

    def wrap(called: Callable) -> Callable:
        @functools.wraps(called)
        def inner(event: Any) -> None:
            try:
                called(event)
            except Exception as error:
                page.complain(getattr(event, "client", None), str(error) or type(error).__name__)

        return inner

    return wrap
