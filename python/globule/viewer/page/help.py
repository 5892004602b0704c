"""What keys and mouse do."""

from __future__ import annotations

from typing import Any

from .panel import Panel

TEXT = """\
**Mouse**

| | |
|---|---|
| left drag | rotate |
| wheel | zoom |
| right drag | move |
| click | what is there |

**Keys**

| | |
|---|---|
| W A S D, Q E | fly forwards, left, back, right, down, up |
| arrows | turn |
| F | fit all |
| 1 … 6 | front, back, left, right, top, bottom |
| O | perspective or parallel rays |
| C | cutting plane on and off |
| Space | play, pause |
| P | save a picture |
| R | start and stop a recording |
| T | next tool |
| U | undo a cut of tissue |
| H | this help |
| Ctrl-K | all commands |

**Cut**: choose the tool *Cut* and draw a line across the surface, or switch a plane, box or sphere
on in *Cut* and drag its handles.

**Record**: *Save and record*, or R; the movie is downloaded when you stop.
"""


class Help(Panel):
    title = "Help (H)"

    def build(self) -> None:
        self.gui.add_markdown(TEXT)
        self.gui.add_command("Help", hotkey="H").on_trigger(self.safe(self._show))

    def _show(self, event: Any) -> None:
        gui = event.client.gui
        with gui.add_modal("Help") as modal:
            gui.add_markdown(TEXT)
            gui.add_button("Close").on_click(lambda _: modal.close())
