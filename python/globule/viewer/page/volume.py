"""Slices through a volume, its surface, and frames of the sweep in place."""

from __future__ import annotations

from .panel import Panel


class VolumePanel(Panel):
    title = "Volume"
    opened = True

    def wanted(self) -> bool:
        return hasattr(self.viewer.source, "volume")

    def build(self) -> None:
        self.add("slices", "shown")
        for name in "xyz":
            self.add("slices", name)
        self.add("slices", "overlay")
        self.add("slices", "surface")
        source = self.viewer.source
        self.add("slices", "level", least=source.least_level, most=source.most_level,
                 usual=source.level)
        if source.n_sweep_frames:
            self.add("slices", "frame")
            self.add("slices", "number", most=max(1, source.n_sweep_frames - 1))
