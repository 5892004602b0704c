"""The page: panels beside the image, each in a file of its own."""

from __future__ import annotations

import threading
from typing import Any

from ..._base.terminal import escaped
from ..desk import Desk
from ..log import log
from ..markdown import plain
from ..roles import Roles
from . import color, cuts, help, look, notes, play, save, statistics, surface, tools, volume, widgets
from . import view as view_panel

WELCOME = (
    "**Drag** to rotate, **wheel** to zoom, **right-drag** to pan.  \n"
    "**Click** the surface to read its values. **R** records a movie, **H** shows the help."
)


TICK = 0.3  # s
LONGEST_NAME = 24  # letters that fit into the panel's heading
LONGEST_COMPLAINT = 500  # characters


class Page:
    """All panels of a viewer.

    All browsers share the settings. Each browser has its own camera, tool and marks.

    Args:
        viewer: `globule.viewer.app.Viewer`.
    """

    def __init__(self, viewer: Any):
        self.viewer = viewer
        self.server = server = viewer.server
        self.roles = Roles(viewer)
        self.paint(server.gui)
        server.gui.main_panel.dock_right()
        server.gui.set_panel_label(shortened(viewer.title))
        server.scene.set_up_direction(viewer.up)
        server.scene.world_axes.visible = False
        self._first_camera()
        self.binder = widgets.Binder(server.gui, viewer.state, self.complain)
        server.gui.add_markdown(WELCOME)
        for line in viewer.warnings:
            server.gui.add_markdown(f"**{plain(line)}**")
        self.tools = tools.Tools(self)
        self.panels = [
            play.Play(self),
            volume.VolumePanel(self),
            view_panel.View(self),
            cuts.CutPanel(self),
            color.Color(self),
            notes.NotesPanel(self),
            look.LookPanel(self),
            surface.SurfacePanel(self),
            save.Save(self),
            statistics.Statistics(self),
            help.Help(self),
        ]
        self.desk = Desk(viewer)
        undo = server.gui.add_command("Undo the last change", hotkey="Z", modifier="cmd/ctrl")
        undo.on_trigger(widgets.safe(self)(lambda event: self.undo(event.client)))
        redo = server.gui.add_command("Redo the setting", hotkey="Z", modifier="cmd/ctrl+shift")
        redo.on_trigger(widgets.safe(self)(lambda event: viewer.state.history.redo()))
        threading.Thread(target=self._keep_ticking, name="globule page", daemon=True).start()

    def paint(self, gui: Any, dark: bool = False) -> None:
        """The theme of the page, of all browsers or of one; gui: `viser.GuiApi`."""
        gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium", brand_color=(26, 76, 134), dark_mode=dark
        )

    def _keep_ticking(self) -> None:
        while not self.viewer._closed.wait(TICK):
            for panel in self.panels:
                panel.tick()

    def _first_camera(self) -> None:
        camera, first = self.viewer.first_camera, self.server.initial_camera
        first.position, first.look_at, first.fov = self.viewer.placement.of_page(camera)
        first.up = camera.up

    def connected(self, browser: Any, client: Any) -> None:
        """Show the page to a new browser."""
        self.tools.connected(browser, client)
        self.desk.connected(browser)
        for panel in self.panels:
            panel.connected(browser, client)

    def disconnected(self, browser: Any) -> None:
        """Forget a browser that has left."""
        self.tools.disconnected(browser)
        self.desk.disconnected(browser)
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
            self.tools.hands[browser.client_id].text.content = said

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


def shortened(name: str) -> str:
    """A name without its middle, if it is too long for the heading."""
    if len(name) <= LONGEST_NAME:
        return name
    end = LONGEST_NAME // 2
    return f"{name[: LONGEST_NAME - end - 1]}…{name[-end:]}"
