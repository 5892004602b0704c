"""Slices through a volume, its surface, and frames of the sweep in place."""

from __future__ import annotations

from .panel import Panel


class VolumePanel(Panel):
    title = "Volume"
    opened = True
    _found: tuple = ()  # the level that is shown, and the most

    def wanted(self) -> bool:
        return hasattr(self.viewer.source, "volume")

    def build(self) -> None:
        self.add("slices", "shown")
        for name in "xyz":
            self.add("slices", name)
        self.places = self.gui.add_markdown(self.viewer.source.places(self.state))
        self.add("slices", "overlay")
        self.add("slices", "surface")
        self.add("slices", "open")
        source = self.viewer.source
        self.level = self.add(
            "slices", "level", least=source.least_level, most=source.most_level, usual=source.level
        )
        if source.n_sweep_frames:
            self.add("slices", "frame")
            self.add("slices", "number", most=max(1, source.n_sweep_frames - 1))

    def tick(self) -> None:
        """Where the slices are."""
        if self.wanted():
            places = self.viewer.source.places(self.state)
            if self.places.content != places:
                self.places.content = places

    def grew(self, moved: bool) -> None:
        """The level that is found follows the values that come."""
        source = self.viewer.source
        found = source.level, source.most_level
        if self.state.slices.level is None and found != self._found:
            self._found = found
            self.level.min, self.level.max = source.least_level, source.most_level
            self.level.step = source.most_level / 200
            level = min(max(source.level, source.least_level), source.most_level)
            self.level.value = float(f"{level:.3g}")
