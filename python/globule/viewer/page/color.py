"""Colours of values."""

from __future__ import annotations

from .panel import Panel

NONE = "(own colours)"


class Color(Panel):
    title = "Colour by value"

    def build(self) -> None:
        names = (NONE, *self.viewer.source.color_names())
        self.add("color", "by", options=names, none=NONE)
        self.add("color", "colormap")
        self.add("color", "automatic")
        self.add("color", "low", typed=True)
        self.add("color", "high", typed=True)
        self.add("color", "legend")
        self.button("Range of now", self.take_range, "Keep the range that is shown")

    def take_range(self, browser) -> None:
        low, high = self.viewer.source.maker.range
        self.state.set(color__automatic=False, color__low=low, color__high=high)
