"""The panel Color by value."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..picture import settings_of
from .panel import Panel


def opaque(viewer: Any, by: str) -> dict[str, Any]:
    """Settings that go with another setting "color by": through water no colors are seen.

    Args:
        viewer: `globule.viewer.app.Viewer`.
        by: the new setting; "": the particles' own colors, and the preset's material again.
    """
    look = viewer.state.look
    made = look.matter == "own" and look.transmission == look.reflection == 0
    if not by:
        return {"look__matter": "preset"} if made else {}
    with viewer.source.lock:
        scene = viewer.source.scene(viewer.state.snapshot())
        material = settings_of(look, viewer.source, scene, viewer.up).material
    if not material.transmission:
        return {}
    return {"look__matter": "own", "look__transmission": 0.0, "look__reflection": 0.0}


class Color(Panel):
    """Attribute, color map, range and legend."""

    title = "Layer"

    def build(self) -> None:
        """Make the widgets."""
        begin = len(self.gui.controls)
        self.add("color", "colormap")
        automatic: Any = self.add(
            "color", "automatic", also=lambda: {} if automatic.value else self._shown("low", "high")
        )
        self.ends = {
            name: self.add("color", name, typed=True, also=lambda other=other: self._typed(other))
            for name, other in (("low", "high"), ("high", "low"))
        }
        for name in ("legend", "legend_at", "legend_title", "legend_unit"):
            self.add("color", name)
        self.button("Keep this range", self.take_range, "Do not adapt the range to the values")
        self.of_colors = list(self.gui.controls.values())[begin:]
        self.tick()

    def take_range(self, browser: Any) -> None:
        """Make the current automatic range the fixed one."""
        low, high = self.viewer.source.maker.range
        self.state.set(color__automatic=False, color__low=low, color__high=high)

    def _shown(self, *names: str) -> dict[str, Any]:
        """Settings that keep these ends of the automatic range, if one is shown."""
        if not (self.state.color.automatic and self.state.color.by):
            return {}
        ends = dict(zip(("low", "high"), self.viewer.source.maker.range, strict=True))
        return {f"color__{name}": ends[name] for name in names}

    def _typed(self, other: str) -> dict[str, Any]:
        """Settings that go with an end that a person has typed: the other end stays as shown."""
        return {"color__automatic": False, **self._shown(other)}

    def tick(self) -> None:
        """Show the automatic range."""
        color = self.state.color
        for control in self.of_colors:
            control.visible = bool(color.by)
        if not (color.automatic and color.by):
            return
        low, high = self.viewer.source.maker.range
        digits = 2 - int(np.floor(np.log10(high - low))) if 0 < high - low < np.inf else 2
        for widget, value in zip(self.ends.values(), (low, high), strict=True):
            value = round(value, max(0, digits))
            if widget.value != value:
                widget.value = value
