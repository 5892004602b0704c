"""The help: mouse and keys."""

from __future__ import annotations

from .panel import Panel

TEXT = """\
**Mouse and fingers**

| | |
|---|---|
| left drag, one finger | rotate |
| wheel, two fingers | zoom |
| right drag or Shift, two fingers | pan |
| click, tap | read the values of the surface |

**Keys**

| | |
|---|---|
| W A S D, Q E | fly forwards, left, back, right, down, up |
| arrows, + and − | turn the camera, zoom |
| F | fit the view to the scene |
| 0 | the first view |
| 1 … 6 | front, back, left, right, top, bottom |
| O | perspective or orthographic |
| C | cutting plane on and off |
| Space | play, pause |
| P | save an image |
| R | start and stop a recording |
| T | next tool |
| U | undo the last cut of tissue |
| Ctrl-Z | undo; with Shift: redo |
| H | this help |
| Ctrl-K | all commands |

**Cut**: choose the tool *Cut* and draw a line across the surface. Or open *Cut*, switch on a plane,
box or sphere, and drag its handles.

**Record**: press R, or *Movie* in the toolbar. Press it again to stop; the browser then downloads
the movie.
"""


class Help(Panel):
    """The help, as a section and as a dialog."""

    title = "Help"

    def build(self) -> None:
        """Make the widgets."""
        self.gui.add_markdown(TEXT)
        self.command("Help", "H", lambda browser: self.page.desk.dialog(browser, "Help", TEXT), True)
