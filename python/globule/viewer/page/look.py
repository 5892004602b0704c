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
        self.add("look", "ambient_rays", most=32)
        self.add("look", "bounces")
        self.add("look", "exposure", least=0.1, most=4.0, step=0.05)
        self.add("look", "sky")
        self.add("look", "ground")
        self.add("look", "background", step=0.05)
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
