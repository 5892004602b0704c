"""The page: the sections of the inspector, each in a file of its own, and what stands over the image."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

from ..._base.terminal import escaped
from ..desk import Desk
from ..gui import Gui
from ..log import log
from ..roles import AT_ONCE, LOOK
from . import color, cuts, help, look, notes, play, save, statistics, surface, tools, volume, widgets
from . import view as view_panel

TICK = 0.3  # s
LONGEST_COMPLAINT = 500  # characters


class Page:
    """All panels of a viewer.

    All browsers share the settings. Each browser has its own camera, tool and marks.

    Args:
        viewer: `globule.viewer.app.Viewer`.
    """

    def __init__(self, viewer: Any):
        self.viewer = viewer
        self.gui = Gui()
        self.binder = widgets.Binder(self.gui, viewer.state, self.complain, viewer.source.unit)
        self.tools = tools.Tools(self)
        self.panels = [
            color.Color(self),
            surface.SurfacePanel(self),
            volume.VolumePanel(self),
            play.Play(self),
            cuts.CutPanel(self),
            view_panel.View(self),
            look.LookPanel(self),
            notes.ImagePanel(self),
            save.Save(self),
            statistics.Statistics(self),
            help.Help(self),
        ]
        self.desk = Desk(viewer, self.gui)
        undo = self.gui.add_command("Undo the last change", "Ctrl+Z")
        undo.on_trigger(widgets.safe(self)(lambda event: self.undo(event.client)))
        redo = self.gui.add_command("Redo the setting", "Ctrl+Shift+Z")
        redo.on_trigger(widgets.safe(self)(lambda event: viewer.state.history.redo()))
        threading.Thread(target=self._keep_ticking, name="globule page", daemon=True).start()

    def _keep_ticking(self) -> None:
        while not self.viewer._closed.wait(TICK):
            for panel in self.panels:
                panel.tick()

    def connected(self, browser: Any, client: Any, tool: str = "") -> None:
        """Show the page to a new browser; tool: that it had before a reload."""
        self.tools.connected(browser, client)
        hand = self.tools.hands[browser.client_id]
        if tool in hand.choices:
            hand.use(tool)
        self.desk.browsers[browser.client_id] = browser
        for line in self.viewer.warnings:
            self.desk.note(browser, "Not shown", line)

    @contextlib.contextmanager
    def turn(self, browser: Any) -> Iterator[None]:
        """An action of a browser (None: the program's).

        Raises ValueError if a browser that looks does `AT_ONCE` others already.
        """
        client = None if browser is None else self.viewer.clients.get(browser.client_id)
        if client is None or client.role != LOOK:
            yield
            return
        if not client.turns.acquire(blocking=False):
            raise ValueError(f"page: {AT_ONCE} actions are in progress; wait until one has ended")
        try:
            yield
        finally:
            client.turns.release()

    def disconnected(self, browser: Any, client: Any) -> None:
        """Forget a browser that has left."""
        self.desk.left(browser, client)
        self.tools.disconnected(browser)
        for panel in self.panels:
            panel.disconnected(browser)

    @property
    def cut_is_newest(self) -> bool:
        """Whether `undo` takes back a cut of tissue."""
        return self.viewer.source.cut_is_newest(self.viewer.state.history.lengths[0])

    def undo(self, browser: Any) -> None:
        """Take back the last setting or the last cut of tissue, whichever is newer."""
        if not self.cut_is_newest:
            self.viewer.state.history.undo()
            return
        said = self.viewer.source.undo()
        self.viewer.engine.notify()
        if browser is not None and browser.client_id in self.tools.hands:
            self.tools.hands[browser.client_id].say(said)

    def complain(self, browser: Any, message: str) -> None:
        """Show an error to the browser that caused it (None: to all) and log it as one line; of a
        browser that causes many, some."""
        client = None if browser is None else self.viewer.clients.get(browser.client_id)
        if browser is not None and (client is None or not client.complaints.take()):
            return  # it has left, or was told enough
        message = message if len(message) <= LONGEST_COMPLAINT else f"{message[:LONGEST_COMPLAINT]} …"
        log.warning("%s", escaped(message))
        for one in [client] if client is not None else list(self.viewer.clients.values()):
            one.sink.error(message)
