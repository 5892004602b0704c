"""The base class of all panels."""

from __future__ import annotations

from typing import Any

import numpy as np

from .widgets import safe


class Panel:
    """A section of the inspector; panels with one title share it.

    Args:
        page: `globule.viewer.page.Page`.

    Attributes:
        title: of the section.
    """

    title = ""

    def __init__(self, page: Any):
        self.page, self.viewer = page, page.viewer
        self.gui, self.state, self.add = page.gui, page.viewer.state, page.binder.add
        self.safe = safe(page)
        if not self.wanted():
            return
        with self.gui.add_folder(self.title):
            self.build()

    def wanted(self) -> bool:
        """Whether the source needs this panel."""
        return True

    def build(self) -> None:
        """Make the controls."""

    def button(self, label: str, called: Any, hint: str = "", private: bool = False, key: str = "") -> Any:
        """A button; `called` gets the browser (`globule.viewer.desk.Browser`) in which it was pressed.

        private: it changes only this browser's view, so that those who look may press it.
        key: of a command with the same name.
        """
        if key:
            self.command(label, key, called, private)
        button = self.gui.add_button(label, hint, private=private)
        button.on_click(self.safe(lambda event: called(event.client)))
        return button

    def command(self, label: str, key: str, called: Any, private: bool = False) -> None:
        """A command with a key; `called` and `private` as for `button`."""
        command = self.gui.add_command(label, key)
        command.on_trigger(self.safe(lambda event: called(event.client)))
        command.private = private

    def grew(self, moved: bool) -> None:
        """React to a source that has grown; moved: the page's units have changed."""

    def tick(self) -> None:
        """Called a few times per second."""

    def handles(self, browser: Any) -> list[dict[str, Any]]:
        """The handles in a browser's image; see `handle`."""
        return []

    def pulled(self, name: str, at: Any, axes: Any) -> None:
        """React to a person who has moved a handle: its place (3,) and unit axes (3, 3), world."""

    def disconnected(self, browser: Any) -> None:
        """React to a browser that has left."""

    def close(self) -> None:
        """React to the end of the viewer."""


def handle(name: str, label: str, at: Any, axes: Any, **more: bool) -> dict[str, Any]:
    """A handle for the page: arrows from a place (3,) along axes (n, 3), world, which move it.

    turns: it has rings, too. swings: a drag turns its one arrow instead.
    """
    at, axes = np.asarray(at, float).tolist(), np.asarray(axes, float).tolist()
    return {"name": name, "label": label, "at": at, "axes": axes, **more}
