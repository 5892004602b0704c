"""What all panels share."""

from __future__ import annotations

from typing import Any

from .widgets import safe


class Panel:
    """Part of the page; `title` is its heading, and it may be open from the start."""

    title = ""
    opened = False

    def __init__(self, page: Any):
        self.page, self.viewer = page, page.viewer
        self.gui, self.state, self.add = page.server.gui, page.viewer.state, page.binder.add
        self.safe = safe(page)
        if not self.wanted():
            return
        with self.gui.add_folder(self.title, expand_by_default=self.opened) as self.folder:
            self.build()

    def wanted(self) -> bool:
        """Whether the source has any use for it."""
        return True

    def build(self) -> None:
        """Make the widgets."""

    def button(self, label: str, called: Any, hint: str = "", icon: Any = None) -> Any:
        """A button; `called` gets the browser that pressed it."""
        button = self.gui.add_button(label, hint=hint or None, icon=icon)
        button.on_click(self.safe(lambda event: called(event.client)))
        return button

    def grew(self, moved: bool) -> None:
        """More of what is shown has come; moved: so that the page's units are others now."""

    def tick(self) -> None:
        """A few times a second."""

    def connected(self, browser: Any, client: Any) -> None:
        """A browser has come."""

    def disconnected(self, browser: Any) -> None:
        """A browser has left."""

    def close(self) -> None:
        """The viewer ends."""
