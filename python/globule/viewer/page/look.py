"""The panel Material and light."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...render.camera import view_axes
from ..picture import preset_look, sun_direction
from ..roles import STEER
from .panel import Panel, handle

_OF_PRESETS = ("matter", "lights", "sky", "ground", "shadows", "bounces", "ambient_rays", "exposure")


class LookPanel(Panel):
    """Preset, material, lights and surroundings."""

    title = "Light"

    def build(self) -> None:
        """Make the widgets."""
        preset: Any = self.add("look", "preset", also=lambda: _changes(self.viewer, preset.value))
        self.add("look", "shadows")
        self.add("look", "ambient_rays")
        self.add("look", "bounces")
        self.add("look", "exposure")
        self.add("look", "sky")
        self.add("look", "ground")
        self.add("look", "background")
        with self.gui.add_folder("Own material"):
            for name in ("matter", "reflection", "transmission", "index", "roughness"):
                self.add("look", name)
        with self.gui.add_folder("Own lights"):
            for name in ("lights", "azimuth", "elevation", "angle", "headlight"):
                self.add("look", name)

    def handles(self, browser: Any) -> list[dict[str, Any]]:
        """The direction of the sun, while a browser that steers shows this section."""
        shown = self.page.desk.model.sections.get(browser.client_id) == self.title
        if not shown or self.state.look.lights != "own" or self.viewer.clients[browser.client_id].role != STEER:
            return []
        return [handle("sun", "Sun", self.viewer.middle, [sun_direction(self.state.look, self.viewer.up)], swings=True)]

    def pulled(self, name: str, at: Any, axes: Any) -> None:
        """Turn the sun."""
        x, y, z = np.stack(view_axes(self.viewer.up)) @ axes[0] / (np.linalg.norm(axes[0]) or 1)
        azimuth, elevation = np.degrees([np.arctan2(x, z), np.arcsin(np.clip(y, -1, 1))]).tolist()
        self.state.set(look__azimuth=azimuth, look__elevation=elevation)


def use_preset(viewer: Any, name: str) -> None:
    """Set a preset with all its settings; `viewer`: `globule.viewer.app.Viewer`."""
    viewer.state.set(look__preset=name, **_changes(viewer, name))


def _changes(viewer: Any, name: str) -> dict[str, Any]:
    """The other settings that a preset has."""
    with viewer.source.lock:
        look = preset_look(viewer.source, viewer.state.snapshot(), name, viewer.up)
    return {f"look__{name}": getattr(look, name) for name in _OF_PRESETS}
