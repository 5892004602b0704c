"""The panel Material and light."""

from __future__ import annotations

from typing import Any

from ..picture import preset_look
from .panel import Panel


class LookPanel(Panel):
    """Preset, material, lights and surroundings."""

    title = "Material and light"

    def build(self) -> None:
        """Make the widgets."""
        self.add("look", "preset").on_update(self.safe(self._preset))
        self.add("look", "shadows")
        self.add("look", "ambient_rays")
        self.add("look", "bounces")
        self.add("look", "exposure")
        self.add("look", "sky")
        self.add("look", "ground")
        self.add("look", "background")
        with self.gui.add_folder("Own material", expand_by_default=False):
            for name in ("matter", "reflection", "transmission", "index", "roughness"):
                self.add("look", name)
        with self.gui.add_folder("Own lights", expand_by_default=False):
            for name in ("lights", "azimuth", "elevation", "angle", "headlight"):
                self.add("look", name)

    def _preset(self, event: Any) -> None:
        if event.client is not None:
            use_preset(self.viewer, event.target.value)


def use_preset(viewer: Any, name: str) -> None:
    """Set a preset with all its settings; `viewer`: `globule.viewer.app.Viewer`."""
    with viewer.source.lock:
        look = preset_look(viewer.source, viewer.state.snapshot(), name, viewer.up)
    names = (
        "preset",
        "matter",
        "lights",
        "sky",
        "ground",
        "shadows",
        "bounces",
        "ambient_rays",
        "exposure",
    )
    viewer.state.set(**{f"look__{name}": getattr(look, name) for name in names})
