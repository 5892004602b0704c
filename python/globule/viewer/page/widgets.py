"""Controls that set and show the settings."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

from ..._base.settings import Choice, Number, Setting, Switch, Text, Vector, Whole, sentence
from ..state import FAR, State, field_of

WIDGETS: dict[str, Any] = {"switch": Switch, "whole": Whole, "real": Number, "triple": Vector,
                           "choice": (Choice, Text)}  # fmt: skip
UNITS = {"degrees": "°", "pixels": "px", "frames per second": "/ s"}


class Binder:
    """The controls of all settings.

    Args:
        gui: `globule.viewer.gui.Gui`.
        state: whose settings are shown.
        on_error: called with the browser and a message.
        unit: of lengths.

    Attributes:
        widgets: by setting, such as "surface.kernel".
    """

    def __init__(self, gui: Any, state: State, on_error: Callable[[Any, str], None], unit: str = ""):
        self.gui, self.state, self.on_error = gui, state, on_error
        self.units = {**UNITS, "world units": unit}
        self.widgets: dict[str, Any] = {}
        self._shown: dict[str, Callable[[Any], Any]] = {}
        state.listen(self._follow)

    def add(self, group: str, name: str, **given: Any) -> Any:
        """Add the control of a setting.

        Args:
            group, name: of the setting.
            given: replaces facts of its field: label, least, most, step, options; `usual` is shown
                while the setting is None; `none` is the option that stands for ""; `also` returns
                further settings that a person's change makes; `factor` and `unit` of what is shown.
        """
        one = field_of(group, name)
        facts = {"unit": self.units.get(one.unit, ""), **facts_of(one), **given}
        for end in ("least", "most", "step"):
            if isinstance(facts.get(end), float):
                facts[end] = float(f"{facts[end]:.3g}")  # short enough to be read on a slider
        value = getattr(getattr(self.state, group), name)
        number = facts["kind"] in ("real", "whole")
        if number and value is not None:  # a command or a file may exceed them
            facts["least"], facts["most"] = min(facts["least"], value), max(facts["most"], value)
        to_page = self._to_page(facts)
        widget = self._make(facts, to_page(value))
        key = f"{group}.{name}"
        self.widgets[key], self._shown[key] = widget, to_page
        widget.on_update(lambda event: self._take(key, facts, event.client))
        return widget

    def _take(self, key: str, facts: dict, browser: Any) -> None:
        """Set a setting to its control's value, or to the nearest end of its range."""
        asked = self._from_page(facts, self.widgets[key].value)
        value = within(self.widgets[key], facts, asked)
        try:
            self.state.set(**{key.replace(".", "__"): value}, **facts.get("also", dict)())
        except ValueError as error:
            self.on_error(browser, str(error))
        self._follow({key})
        if value != asked and asked == asked:  # not NaN
            least, most = ends(self.widgets[key], facts)
            self.on_error(browser, outside(facts["label"], least, most, asked, value))

    def _make(self, facts: dict, value: Any) -> Any:
        gui, label, hint = self.gui, facts["label"], facts.get("hint") or None
        more = {"unit": facts["unit"] or None, "factor": facts.get("factor")}
        kind = facts["kind"]
        if kind == "switch":
            return gui.add_checkbox(label, value, hint=hint)
        if kind == "choice" and not facts["options"]:
            return gui.add_text(label, value, hint=hint)
        if kind == "choice":
            return gui.add_dropdown(label, facts["options"], initial_value=value, hint=hint)
        if kind == "triple":
            return gui.add_vector3(label, value, step=facts.get("step", 0.01), hint=hint, **more)
        least, most = facts["least"], facts["most"]
        if kind == "whole":
            return gui.add_slider(label, int(least), int(most), 1, int(value), hint=hint, **more)
        if facts.get("typed"):
            return gui.add_number(label, float(value), step=facts.get("step"), hint=hint, **more)
        step = facts.get("step") or (most - least) / 200
        return gui.add_slider(label, least, most, step, min(max(value, least), most), hint=hint, **more)

    def _to_page(self, facts: dict) -> Callable[[Any], Any]:
        def to_page(value: Any) -> Any:
            if value is None:
                value = facts.get("usual", facts.get("least"))
            if facts["kind"] == "choice" and not value and facts["options"]:
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
        if facts["kind"] == "whole" and isinstance(value, float) and value.is_integer():
            return int(value)
        return value

    def nearest(self, browser: Any, key: str, value: Any) -> Any:
        """The value to take for a setting in a file that a browser uploads.

        A length has no range of its own. It is limited to the range of its slider, since an image
        with any other value might take forever.
        """
        group, _, name = key.partition("__")
        widget = self.widgets.get(f"{group}.{name}")
        unlimited = getattr(field_of(group, name).kind, "most", 0.0) == FAR
        if value is None or not unlimited or widget is None or widget.kind != "slider":
            return value
        near = min(max(value, type(value)(widget.min)), type(value)(widget.max))
        if near != value:
            self.on_error(browser, outside(widget.label, widget.min, widget.max, value, near))
        return near

    def _follow(self, changed: set[str]) -> None:
        for key in changed & set(self.widgets):
            group, _, name = key.partition(".")
            self.widgets[key].value = self._shown[key](getattr(getattr(self.state, group), name))


def facts_of(one: Setting) -> dict[str, Any]:
    """What the control of a setting shows."""
    name = next(name for name, kinds in WIDGETS.items() if isinstance(one.kind, kinds))
    number = one.kind.each if name == "triple" else one.kind
    least, most = one.slider or (getattr(number, "least", None), getattr(number, "most", None))
    facts: dict[str, Any] = {"kind": name, "label": one.label or sentence(one.name.replace("_", " "))}
    facts |= {"hint": sentence(one.brief), "options": one.kind.choices or ()}
    facts |= {"least": least, "most": most}
    return facts | ({"step": one.step} if one.step else {})


def ends(widget: Any, facts: dict) -> tuple[float, float]:
    """Least and most value of a number's control; those of a slider may have changed."""
    slider = facts["kind"] != "triple" and not facts.get("typed")
    return (widget.min, widget.max) if slider else (facts["least"], facts["most"])


def within(widget: Any, facts: dict, value: Any) -> Any:
    """The nearest value in the range of a control; a browser may send any value."""
    if isinstance(value, tuple):
        return tuple(within(widget, facts, v) for v in value)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if facts["kind"] not in ("real", "whole", "triple") or not number or not math.isfinite(value):
        return value
    least, most = ends(widget, facts)
    return min(max(value, type(value)(least)), type(value)(most))


def outside(label: str, least: float, most: float, value: Any, taken: Any) -> str:
    """The message about a value out of range."""
    expected = f"{label}: expected {least:g} to {most:g}, got {_words(value)}."
    return f"{expected} The viewer uses {_words(taken)}."


def _words(value: Any) -> str:
    return ", ".join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value:g}"


def bounded(slider: Any) -> float:
    """The nearest value in the range of a slider; a browser may send any value."""
    value = slider.value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
        raise ValueError(f"{slider.label}: expected a number, got {value!r}")
    return min(max(value, slider.min), slider.max)


def safe(page: Any) -> Callable[[Callable], Callable]:
    """A decorator for callbacks, which shows errors in the browser that caused them."""

    def wrap(called: Callable) -> Callable:
        @functools.wraps(called)
        def inner(event: Any) -> None:
            browser = getattr(event, "client", None)
            try:
                with page.turn(browser):
                    called(event)
            except Exception as error:
                page.complain(browser, str(error) or type(error).__name__)

        return inner

    return wrap
