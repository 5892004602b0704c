"""The panel Surface and quality."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._base.arrays import to_host
from ...scene.scene import DEFAULTS
from .panel import Panel


class SurfacePanel(Panel):
    """The implicit surface, and the quality of its image."""

    title = "Surface and quality"

    def build(self) -> None:
        """Make the widgets."""
        viewer = self.viewer
        with viewer.source.lock:
            scene = viewer.source.layers(viewer.state.snapshot())[0].scene
        support = float(np.median(to_host(scene.support))) if len(scene) else 1.0
        self.threshold = self.add(
            "surface",
            "threshold",
            least=0.02,
            most=max(2.0, 3 * scene.threshold),
            step=0.01,
            usual=scene.threshold,
        )
        unit = viewer.source.unit and f", {viewer.source.unit}"
        self.add(
            "surface",
            "support",
            label=f"Support{unit}",
            least=0.25 * support,
            most=4 * support,
            usual=support,
        )
        self.add("surface", "kernel")
        self.add("surface", "root")
        self.button("Default surface", self.defaults, "Reset the four settings above")
        self.gui.add_divider()
        self.add("quality", "samples", most=64)
        self.add("quality", "rate", most=60.0, step=1.0)
        self.add("quality", "sharpness", step=1)
        self.add("quality", "width")

    def defaults(self, browser: Any) -> None:
        """Reset kernel, threshold, support and root method."""
        self.state.set(
            surface__threshold=None,
            surface__support=None,
            surface__kernel="murakami",
            surface__root="exact",
        )
        self.threshold.value = DEFAULTS["murakami"][1]
