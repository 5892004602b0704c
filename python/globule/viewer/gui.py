"""The controls of the inspector, which all browsers share; programs add their own (`viewer.gui`).

A control is plain values. `Desk` sends those that have changed to each browser, whose script shows
them, and brings back what a person does with them.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import numbers
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

PROGRAM = "Program"  # the section of controls that stand in no folder
MOST_TEXT = 10_000  # characters in a field
# What the page is told of a control
SHOWN = ("kind", "label", "hint", "value", "min", "max", "step", "options", "unit", "factor", "content", "visible",
         "disabled", "color", "section", "group", "order", "private")  # fmt: skip


@dataclass
class Event:
    """What a person did with a control.

    Attributes:
        client: the browser; None: the program did it.
        target: the control.
    """

    client: Any
    target: Any

    @property
    def client_id(self) -> int | None:
        """The number of the browser."""
        return None if self.client is None else self.client.client_id


class Control:
    """A control. Assigning to its attributes changes the page, and calls none of the functions that
    a person's changes call.

    Attributes:
        value: of a field; of a group of buttons the last one that was pressed.
        label, hint, visible, disabled, min, max, step, options, content, color: what is shown.
        private: it changes the browser's own view only, so that those who look may use it.
    """

    kind: str
    label: str
    hint: str | None
    value: Any
    min: Any
    max: Any
    step: Any
    options: Any
    content: Any
    color: Any
    factor: Any
    key: str
    visible: bool
    disabled: bool
    private: bool
    number: int
    stamp: int
    _gui: Gui
    _called: list[Callable[[Event], Any]]

    def __init__(self, gui: Gui, number: int, **facts: Any):
        vars(self).update(dict.fromkeys(SHOWN), visible=True, disabled=False, private=False)
        vars(self).update(facts, _gui=gui, number=number, stamp=0, _called=[])

    def __setattr__(self, name: str, value: Any) -> None:
        if name in SHOWN and vars(self).get(name) != value:
            vars(self)[name] = value
            self._gui.changed(self)
        elif name not in SHOWN:
            vars(self)[name] = value

    def on_update(self, called: Callable[[Event], Any]) -> Callable[[Event], Any]:
        """Call a function with an `Event` after each change by a person; usable as a decorator."""
        self._called.append(called)
        return called

    on_click = on_trigger = on_update

    def holds(self, value: Any) -> bool:
        """Whether a browser may have sent a value: it may send anything."""
        if self.kind == "button":
            return value in (None, True)
        if self.options:
            return isinstance(value, str) and value in self.options
        return is_like(self.value, value)

    def take(self, browser: Any, value: Any) -> None:
        """Take what a person did. Raises ValueError."""
        if self.kind == "markdown" or self.disabled or not self.holds(value):
            raise ValueError(f"{self.label}: expected a value that the control can hold, got {str(value)[:40]}")
        if self.kind == "vector":
            value = tuple(float(v) for v in value)
        if self.kind not in ("button", "command"):
            self.value = value
        for called in list(self._called):
            called(Event(browser, self))

    def shown(self) -> dict[str, Any]:
        """The control for the page, as JSON has it."""
        known = {name: vars(self)[name] for name in SHOWN}
        return {"id": self.number} | {name: plain(value) for name, value in known.items() if value is not None}

    def remove(self) -> None:
        """Take it from the page."""
        self._gui.forget(self)


class Gui:
    """The controls of all browsers; the methods make them, in the order in which they stand."""

    def __init__(self) -> None:
        self.controls: dict[int, Control] = {}
        self.commands: dict[str, Control] = {}
        self.stamp = 0  # counts the changes
        self.on_change: Callable[[], Any] = lambda: None
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._place = threading.local()

    def changed(self, control: Control) -> None:
        """Note that a control has changed."""
        with self._lock:
            self.stamp += 1
            vars(control)["stamp"] = self.stamp
        self.on_change()

    def forget(self, control: Control) -> None:
        """Remove a control."""
        self.controls.pop(control.number, None)
        self.on_change()

    def since(self, stamp: int) -> list[Control]:
        """The controls that have changed since a count of changes."""
        return [control for control in list(self.controls.values()) if control.stamp > stamp]

    @contextlib.contextmanager
    def add_folder(self, label: str, **_: Any) -> Iterator[Any]:
        """A section of the inspector, or inside of one a group with a heading."""
        before = getattr(self._place, "names", ())
        self._place.names = (*before, label)
        try:
            yield self
        finally:
            self._place.names = before

    def _add(self, kind: str, label: str, hint: str | None = None, **facts: Any) -> Any:
        section, group = (*getattr(self._place, "names", ()), "", "")[:2]
        made = Control(self, next(self._numbers), kind=kind, label=label, hint=hint or None, **facts)
        vars(made).update(section=section or PROGRAM, group=group or None)
        self.controls[made.number] = made
        self.changed(made)
        return made

    def add_checkbox(self, label: str, initial_value: bool, hint: str | None = None, **more: Any) -> Any:
        """A switch."""
        return self._add("switch", label, hint, value=bool(initial_value), **more)

    def add_slider(
        self, label: str, min: Any, max: Any, step: Any, initial_value: Any, hint: str | None = None, **more: Any
    ) -> Any:
        """A slider with a field for its number."""
        return self._add("slider", label, hint, value=initial_value, min=min, max=max, step=step, **more)

    def add_number(
        self, label: str, initial_value: Any, min: Any = None, max: Any = None, step: Any = None,
        hint: str | None = None, **more: Any,
    ) -> Any:  # fmt: skip
        """A field for a number."""
        return self._add("number", label, hint, value=initial_value, min=min, max=max, step=step, **more)

    def add_text(self, label: str, initial_value: str, hint: str | None = None, **more: Any) -> Any:
        """A field for a text."""
        return self._add("text", label, hint, value=initial_value, **more)

    def add_vector3(
        self, label: str, initial_value: Any, step: Any = None, hint: str | None = None, **more: Any
    ) -> Any:
        """Three fields for numbers."""
        return self._add("vector", label, hint, value=tuple(map(float, initial_value)), step=step, **more)

    def add_dropdown(
        self, label: str, options: Any, initial_value: str | None = None, hint: str | None = None, **more: Any
    ) -> Any:
        """A list of which one is chosen."""
        options = tuple(options)
        return self._add("choice", label, hint, value=initial_value or options[0], options=options, **more)

    def add_button(self, label: str, hint: str | None = None, **more: Any) -> Any:
        """A button."""
        return self._add("button", label, hint, **more)

    def add_button_group(self, label: str, options: Any, hint: str | None = None, **more: Any) -> Any:
        """Several buttons; `value` is the one that was pressed last."""
        options = tuple(options)
        return self._add("buttons", label, hint, value=options[0], options=options, **more)

    def add_markdown(self, content: str, **more: Any) -> Any:
        """A text: bold, tables, code."""
        return self._add("markdown", "", content=content, **more)

    def add_command(self, label: str, hotkey: str = "", hint: str | None = None) -> Any:
        """A command with a key, which the list of all commands (Ctrl-K) has, too."""
        made = Control(self, next(self._numbers), kind="command", label=label, hint=hint or None, value=None)
        vars(made)["key"] = hotkey
        self.commands[label] = made
        return made


def is_like(known: Any, value: Any) -> bool:
    """Whether a value that came can stand in the place of a known one."""
    if isinstance(known, (bool, np.bool_)) or isinstance(value, bool):
        return isinstance(known, (bool, np.bool_)) and isinstance(value, bool)
    if isinstance(known, numbers.Real):
        if not isinstance(value, (int, float)):
            return False
        return abs(value) < 2.0**63 if isinstance(known, numbers.Integral) else value == value and abs(value) < math.inf
    if isinstance(known, tuple):
        return isinstance(value, (list, tuple)) and len(value) == len(known) and all(map(is_like, known, value))
    if known is None:
        return value is None
    return isinstance(known, str) and isinstance(value, str) and len(value) <= MOST_TEXT


def plain(value: Any) -> Any:
    """A value as JSON has it."""
    return value.item() if isinstance(value, np.generic) else list(value) if isinstance(value, tuple) else value
