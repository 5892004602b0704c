"""The panel Volume: slices, iso-surface, images of the sweep."""

from __future__ import annotations

from .panel import Panel


class VolumePanel(Panel):
    """Slices, iso-value, and the image of the sweep to show."""

    title = "Volume"
    _found: tuple = ()  # automatic iso-value and largest value

    def wanted(self) -> bool:
        """Whether the source has a volume."""
        return hasattr(self.viewer.source, "volume")

    def build(self) -> None:
        """Make the widgets."""
        self.add("slices", "shown")
        self.slices = [self.add("slices", name, unit="mm") for name in "xyz"]
        self.add("slices", "flat")
        self.gray = [self.add("slices", name, **ends) for name, ends in self._ends().items()]
        for name in ("overlay", "surface", "open"):
            self.add("slices", name)
        source = self.viewer.source
        self.level = self.add("slices", "level", least=source.least_level, most=source.most_level, usual=source.level)
        if source.n_sweep_frames:
            self.add("slices", "frame")
            self.add("slices", "number", most=max(1, source.n_sweep_frames - 1))

    def _ends(self) -> dict[str, dict[str, float]]:
        """Of window and level, by the values of the volume."""
        low, high = self.viewer.source.gray
        width = high - low
        return {
            "window": {"least": 0.01 * width, "most": 2 * width, "usual": width},
            "center": {"least": low - width / 2, "most": high, "usual": (low + high) / 2},
        }

    def tick(self) -> None:
        """Positions of slices in millimeters, of the volume that is shown now."""
        if self.wanted():
            for slider, whole in zip(self.slices, self.viewer.source.lengths().tolist(), strict=True):
                slider.factor = round(whole, 3) or 1.0

    def grew(self, moved: bool) -> None:
        """Adapt the automatic iso-value to the volume."""
        source = self.viewer.source
        for slider, (least, most, usual) in zip(self.gray, map(dict.values, self._ends().values()), strict=True):
            slider.min, slider.max, slider.step = least, most, (most - least) / 200
            if self.state.slices.window is self.state.slices.center is None:
                slider.value = usual
        found = source.level, source.most_level
        if self.state.slices.level is None and found != self._found:
            self._found = found
            self.level.min, self.level.max = source.least_level, source.most_level
            self.level.step = source.most_level / 200
            level = min(max(source.level, source.least_level), source.most_level)
            self.level.value = float(f"{level:.3g}")
