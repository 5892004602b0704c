"""The panel Image."""

from __future__ import annotations

from .panel import Panel


class ImagePanel(Panel):
    """Annotations, size and quality of the image."""

    title = "Image"

    def build(self) -> None:
        """Make the widgets."""
        for name in ("title", "scale_bar", "axes", "box", "unit"):
            self.add("notes", name)
        with self.gui.add_folder("Quality"):
            for name in ("samples", "rate", "sharpness", "width"):
                self.add("quality", name)
