"""The panel Volume: slices, iso-surface, images of the sweep."""

from __future__ import annotations

from .panel import Panel


class VolumePanel(Panel):
    """Slices, iso-value, and the image of the sweep to show."""

    title = "Volume"
    opened = True
    _found: tuple = ()  # automatic iso-value and largest value

    def wanted(self) -> bool:
        """Whether the source has a volume."""
        return hasattr(self.viewer.source, "volume")

    def build(self) -> None:
        """Make the widgets."""
        self.add("slices", "shown")
        for name in "xyz":
            self.add("slices", name)
        self.places = self.gui.add_markdown(self.viewer.source.places(self.state))
        self.add("slices", "overlay")
        self.add("slices", "surface")
        self.add("slices", "open")
        source = self.viewer.source
        self.level = self.add("slices", "level", least=source.least_level, most=source.most_level, usual=source.level)
        if source.n_sweep_frames:
            self.add("slices", "frame")
            self.add("slices", "number", most=max(1, source.n_sweep_frames - 1))

    def tick(self) -> None:
        """Update the positions of the slices."""
        if self.wanted():
            places = self.viewer.source.places(self.state)
            if self.places.content != places:
                self.places.content = places

    def grew(self, moved: bool) -> None:
        """Adapt the automatic iso-value to the volume."""
        source = self.viewer.source
        found = source.level, source.most_level
        if self.state.slices.level is None and found != self._found:
            self._found = found
            self.level.min, self.level.max = source.least_level, source.most_level
            self.level.step = source.most_level / 200
            level = min(max(source.level, source.least_level), source.most_level)
            self.level.value = float(f"{level:.3g}")
