"""The panel Surface and quality."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._base.arrays import to_host
from ...pieces.scene import Scene
from .panel import Panel


class SurfacePanel(Panel):
    """The implicit surface."""

    title = "Layer"

    def build(self) -> None:
        """Make the widgets."""
        with self.viewer.source.lock:
            scene = self.viewer.source.scene(self.state.snapshot())
        if isinstance(scene, Scene):
            self._surface(scene)

    def _surface(self, scene: Scene) -> None:
        support = float(np.median(to_host(scene.support))) if len(scene) else 1.0
        self.threshold = self.add(
            "surface",
            "threshold",
            least=0.02,
            most=max(2.0, 3 * scene.threshold),
            step=0.01,
            usual=scene.threshold,
            also=self._stay,
        )
        self.add("surface", "support", least=0.25 * support, most=4 * support, usual=support)
        self.add("surface", "shape")
        self.add("surface", "kernel")
        self.add("surface", "root")
        self.button("Default surface", self.defaults, "Reset the five settings above")

    def _stay(self) -> dict[str, str]:
        """Keep a smooth surface smooth while a person moves its threshold."""
        shown = self.viewer.source.maker.last_scene
        smooth = shown is not None and shown.surface == "smooth"
        return {"surface__shape": "smooth"} if smooth else {}

    def defaults(self, browser: Any) -> None:
        """Reset kind of surface, kernel, threshold, support and root method."""
        plain = vars(type(self.state.surface)())
        self.state.set(**{f"surface__{name}": value for name, value in plain.items()})
        with self.viewer.source.lock:
            scene = self.viewer.source.scene(self.state.snapshot())
            self.threshold.value = scene.threshold
