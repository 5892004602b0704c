"""Plots: colors, plain axes, and small PNG files."""

from __future__ import annotations

import io
from typing import Any

from .files import atomic_write

# Distinguishable with any color vision (after Okabe and Ito 2008).
BLUE, ORANGE, GREEN, RED, PURPLE = "#1f6fb2", "#e0861a", "#178a5f", "#c8452d", "#8a4fa3"
SKY, INK, GRAY, PALE = "#9cc9ea", "#222831", "#7d858f", "#dfe3e8"
AXES = (RED, GREEN, BLUE)  # x, y, z
LARGE = 148_000  # bytes

_FONT: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.titlesize": 11.5,
    "axes.edgecolor": GRAY,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": GRAY,
    "ytick.color": GRAY,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "axes.titlelocation": "left",
}


class Figure:
    """A matplotlib figure of `width` x `height` inches; a PNG file when the block ends."""

    def __init__(self, path: Any, width: float, height: float, dpi: float):
        import matplotlib
        from matplotlib.figure import Figure as Canvas

        self.path, self.dpi = path, dpi
        self._style = matplotlib.rc_context(_FONT)
        self._style.__enter__()
        self.canvas = Canvas((width, height), dpi=dpi, facecolor="white", layout="constrained")

    def __enter__(self) -> Any:
        return self.canvas

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._save()
        finally:
            self._style.__exit__(None, None, None)

    def _save(self) -> None:
        from PIL import Image

        drawn = io.BytesIO()
        self.canvas.savefig(drawn, format="png", dpi=self.dpi)
        picture = Image.open(drawn).convert("RGB")
        for n_colors in (None, 256, 128, 64):  # a palette only if the file is large
            packed, kept = io.BytesIO(), picture
            if n_colors:
                kept = picture.quantize(n_colors, Image.Quantize.MEDIANCUT, kmeans=3, dither=Image.Dither.NONE)
            kept.save(packed, format="PNG", optimize=True)
            if packed.tell() < LARGE:
                break
        with atomic_write(self.path) as file:
            file.write(packed.getvalue())
