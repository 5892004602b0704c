"""Matter, light and surroundings."""

from __future__ import annotations

from typing import Any

from ...presets import PRESETS, preset
from ...render import RenderSettings
from .panel import Panel


class LookPanel(Panel):
    title = "Material and light"

    def build(self) -> None:
        self.add("look", "preset").on_update(self.safe(self._preset))
        self.add("look", "shadows")
        self.add("look", "ambient_rays", most=32)
        self.add("look", "depth")
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
    """A preset with all that belongs to it, instead of what was set before."""
    settings = RenderSettings()
    if name in PRESETS:
        with viewer.source.lock:
            scene = viewer.source.layers(viewer.state.snapshot())[0].scene
        settings = preset(name, scene, viewer.up)
    viewer.state.set(
        look__preset=name, look__matter="preset", look__lights="preset", look__sky="preset",
        look__ground="preset", look__shadows=settings.shadows, look__depth=settings.depth,
        look__ambient_rays=settings.ambient_rays, look__exposure=settings.exposure,
    )
