"""The base class of all panels."""

from __future__ import annotations

from typing import Any

from .widgets import safe


class Panel:
    """A part of the page.

    Args:
        page: `globule.viewer.page.Page`.

    Attributes:
        title: heading.
        opened: the panel is open at the start.
    """

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
        """Whether the source needs this panel."""
        return True

    def build(self) -> None:
        """Make the widgets."""

    def button(self, label: str, called: Any, hint: str = "", private: bool = False, key: str = "") -> Any:
        """A button; `called` gets the browser (`viser.ClientHandle`) in which it was pressed.

        private: it changes only this browser's view, so that those who look may press it.
        key: of a command with the same name.
        """
        if key:
            self.command(label, key, called, private)
        button = self.gui.add_button(label, hint=hint or None)
        button.on_click(self.safe(lambda event: called(event.client)))
        return self.page.roles.private(button) if private else button

    def command(self, label: str, key: str, called: Any, private: bool = False) -> None:
        """A command with a key; `called` and `private` as for `button`."""
        command = self.gui.add_command(label, hotkey=key)
        command.on_trigger(self.safe(lambda event: called(event.client)))
        if private:
            self.page.roles.private(command)

    def dialog(self, browser: Any, title: str, text: str) -> None:
        """Show Markdown to a browser until it is closed."""
        gui = browser.gui
        with gui.add_modal(title) as modal:
            gui.add_markdown(text)
            gui.add_button("Close").on_click(self.safe(lambda _: modal.close()))

    def grew(self, moved: bool) -> None:
        """React to a source that has grown; moved: the page's units have changed."""

    def tick(self) -> None:
        """Called a few times per second."""

    def connected(self, browser: Any, client: Any) -> None:
        """React to a new browser."""

    def took(self, browser: Any) -> None:
        """React to a browser that has taken another mouse tool."""

    def disconnected(self, browser: Any) -> None:
        """React to a browser that has left."""

    def close(self) -> None:
        """React to the end of the viewer."""
