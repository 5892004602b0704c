"""Widgets of settings: what a person changes goes to the state, and what changes there is shown."""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Callable
from typing import Any

from viser import GuiSliderHandle

from ..state import FAR, State, field_of

PATIENCE = 2.0  # s that a number outside of its ends may stay: it may be the beginning of another


class Binder:
    """Widgets by the setting that they show, as "surface.kernel".

    A browser tells every key that is pressed in a field. So nothing is written back into a field
    whose own change is followed, which would end up between the digits; and what is outside of the
    ends waits until it stays.
    """

    def __init__(self, gui: Any, state: State, on_error: Callable[[Any, str], None]):
        self.gui, self.state, self.on_error = gui, state, on_error
        self.widgets: dict[str, Any] = {}
        self._shown: dict[str, Callable[[Any], Any]] = {}
        self._waiting: dict[str, threading.Timer] = {}
        self._lock = threading.RLock()  # what was typed last counts last
        self._own = threading.local()  # .key: the setting that this thread takes from its widget
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
        if facts["kind"] == "real" and value is not None:  # as the command or a file has it
            facts["least"], facts["most"] = min(facts["least"], value), max(facts["most"], value)
        to_page = self._to_page(facts)
        widget = self._make(facts, to_page(value))
        key = f"{group}.{name}"
        self.widgets[key], self._shown[key] = widget, to_page

        @widget.on_update
        def _(event: Any) -> None:
            if event.client is not None:  # else set by us
                self._take(key, facts, event.client)

        return widget

    def _take(self, key: str, facts: dict, browser: Any, stayed: bool = False) -> None:
        """The setting becomes what its widget says; what is outside of the ends only if it has
        stayed, and then the nearest there is."""
        with self._lock:
            waiting = self._waiting.pop(key, None)
            if waiting is not None:
                waiting.cancel()
            asked = self._from_page(facts, self.widgets[key].value)
            value = within(self.widgets[key], facts, asked)
            beyond = value != asked and asked == asked  # not NaN
            if beyond and not stayed:
                later = threading.Timer(PATIENCE, self._take, (key, facts, browser, True))
                later.daemon = True
                self._waiting[key] = later
                later.start()
                return
            self._own.key = key
            try:
                self.state.set(**{key.replace(".", "__"): value})
            except ValueError as error:
                self.on_error(browser, str(error))
            finally:
                self._own.key = None
        if beyond:
            least, most = ends(self.widgets[key], facts)
            self.on_error(browser, outside(facts["label"], least, most, asked, value))

    def _make(self, facts: dict, value: Any) -> Any:
        gui, label, hint = self.gui, facts["label"], facts.get("hint") or None
        kind = facts["kind"]
        if kind == "switch":
            return gui.add_checkbox(label, value, hint=hint)
        if kind == "choice":
            return gui.add_dropdown(label, facts["options"], initial_value=value, hint=hint)
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

    def nearest(self, browser: Any, key: str, value: Any) -> Any:
        """What a setting in a file that a browser brings becomes: lengths, which have no ends of
        their own, stay between those of their slider; pictures of others might take for ever."""
        group, _, name = key.partition("__")
        widget = self.widgets.get(f"{group}.{name}")
        unlimited = field_of(group, name).metadata.get("most") == FAR
        if value is None or not unlimited or not isinstance(widget, GuiSliderHandle):
            return value
        near = min(max(value, type(value)(widget.min)), type(value)(widget.max))
        if near != value:
            self.on_error(browser, outside(widget.label, widget.min, widget.max, value, near))
        return near

    def _follow(self, changed: set[str]) -> None:
        for key in changed & set(self.widgets) - {getattr(self._own, "key", None)}:
            group, _, name = key.partition(".")
            value = self._shown[key](getattr(getattr(self.state, group), name))
            if self.widgets[key].value != value:
                self.widgets[key].value = value


def ends(widget: Any, facts: dict) -> tuple[float, float]:
    """Least and most of a number's widget: a slider's own, which may have moved."""
    slider = facts["kind"] != "triple" and not facts.get("typed")
    return (widget.min, widget.max) if slider else (facts["least"], facts["most"])


def within(widget: Any, facts: dict, value: Any) -> Any:
    """The nearest value between a widget's ends, which a browser need not keep to."""
    if isinstance(value, tuple):
        return tuple(within(widget, facts, v) for v in value)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if facts["kind"] not in ("real", "whole", "triple") or not number or not math.isfinite(value):
        return value
    least, most = ends(widget, facts)
    return min(max(value, type(value)(least)), type(value)(most))


def outside(label: str, least: float, most: float, value: Any, taken: Any) -> str:
    """The sentence for a value that is not between its ends."""
    return f"{label}: expected {least:g} to {most:g}, got {_words(value)}: {_words(taken)} is taken"


def _words(value: Any) -> str:
    return ", ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"


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
