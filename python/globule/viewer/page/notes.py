"""The panel Annotations."""

from __future__ import annotations

from .panel import Panel


class NotesPanel(Panel):
    """Title, scale bar, axes and bounding box."""

    title = "Image"

    def build(self) -> None:
        """Make the widgets."""
        for name in ("title", "scale_bar", "axes", "box", "unit"):
            self.add("notes", name)
