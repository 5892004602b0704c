"""Images in matplotlib: one in axes of your own, and a figure of several for a paper.

matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from .. import _core
from .._base.checks import named, optional
from .._base.colormaps import CATEGORICAL, colorize, map_colors
from .._base.files import atomic_write
from .._base.terminal import escaped
from ..data.particles import HERE
from .annotate import Colors, scale_bar
from .box import short
from .camera import Camera
from .display import displayed
from .frame import Frame
from .legend import tick_labels
from .trace import points_of, values_of

MM = 25.4  # in an inch
WIDTHS = {"single": 89.0, "double": 183.0}  # mm, of one column and of both
ENDINGS = (".pdf", ".svg", ".png")
_POINT = MM / 72  # mm
_GAP = 2.0  # between panels, mm
_NARROW = 42.0  # of a panel, where no number of columns is given, mm
_MOST = 30_000  # pixels a side
_BAR = 2.6  # width of a color bar, mm
_INK, _PAPER = "#14181f", "#ffffff"
_AXES = ("#c8452d", "#178a5f", "#1f6fb2")  # of x, y and z; told apart by every eye
# Text stays text, and the same figure has the same bytes.
_STYLE: dict[str, Any] = {
    "pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "globule", "font.family": "DejaVu Sans",
    "text.parse_math": False, "axes.linewidth": 0.5, "savefig.facecolor": "white",
}  # fmt: skip


def need_matplotlib() -> Any:
    """The module matplotlib. Raises MissingPackageError."""
    optional("matplotlib.figure", "figures", "matplotlib")
    return optional("matplotlib", "figures")


@named
def imshow(ax: Any, frame: Frame, *, unit: str = "", scale_bar: bool = False, directions: bool = False) -> Any:
    """Show a frame in axes of matplotlib.

        figure, ax = matplotlib.pyplot.subplots()
        shown = gb.imshow(ax, gb.render(scene, camera, color_by="speed"), unit="m")
        figure.colorbar(shown, label="speed, m/s")

    Of an orthographic camera, the axes have world units: the coordinates of the axis that runs
    along the image, or the distance from `look_at` where none does. A perspective image has no
    scale, so its axes are hidden.

    Args:
        ax: axes.
        frame: of `render`; what it annotates is drawn too.
        unit: of lengths, for the axes' names and the scale bar.
        scale_bar: draw a bar of a round length, as in `Annotation`.
        directions: draw the directions of x, y and z.

    Returns:
        The image (`matplotlib.image.AxesImage`), with color map and range of `color_by` for a color
        bar.

    Raises:
        MissingPackageError: matplotlib is not installed.
    """
    need_matplotlib()
    if not isinstance(frame, Frame):
        raise TypeError(f"frame: expected a Frame, got {type(frame).__name__}")
    if not hasattr(ax, "imshow"):
        raise TypeError(f"ax: expected axes of matplotlib, got {type(ax).__name__}")
    image, camera = frame.image, frame._camera
    flat = camera is not None and camera.height is not None and image.shape[1::-1] == frame.size
    extent, names = None, ("", "")
    if flat:
        origin = next((o for x in frame._layers if (o := getattr(x.scene, "origin", None))), HERE)
        extent, names = _places(camera, frame.size, origin)
    shown = ax.imshow(image, extent=extent, interpolation="none" if flat else "antialiased")
    if flat:
        ax.set_xlabel(", ".join(filter(None, (names[0], unit))))
        ax.set_ylabel(", ".join(filter(None, (names[1], unit))))
    else:
        ax.set_axis_off()
    if scale_bar or directions:
        if camera is None:
            raise ValueError("frame: expected one with a camera, got one of a scene in pieces")
        bottom = image[-max(1, len(image) // 8) :]
        if scale_bar:
            _draw_scale_bar(ax, camera, frame.size, unit, _ink(bottom))
        if directions:
            _draw_directions(ax, camera, frame.size)
    if frame._asked is not None:
        _give_colors(shown, Colors(*values_of(points_of(frame._layers[0].scene), *frame._asked)[1:]))
    return shown


def _places(camera: Camera, size: tuple[int, int], origin: Any) -> tuple[tuple[float, ...], tuple[str, str]]:
    """The image's ends (left, right, bottom, top), and what is counted along both sides."""
    ends, names = [], []
    for axis in camera.frame(size)[2:]:
        half = float(np.linalg.norm(axis))
        way = axis / half
        k = int(np.argmax(np.abs(way)))
        if abs(way[k]) > 1 - 1e-9:  # along x, y or z
            sign, at = math.copysign(1.0, way[k]), camera.look_at[k] + origin[k]
            ends += [at - sign * half, at + sign * half]
            names.append("xyz"[k])
        else:
            ends += [-half, half]
            names.append("")
    return tuple(ends), (names[0], names[1])


def _give_colors(shown: Any, colors: Colors) -> None:
    """Color map and range for a color bar of an image that has its colors already."""
    from matplotlib.colors import ListedColormap, Normalize

    lo, hi = sorted((colors.lo, colors.hi))
    table = _colors_of(colors, 256)
    shown.set_cmap(ListedColormap(table[:: 1 if colors.hi >= colors.lo else -1] / 255, colors.colormap))
    shown.set_norm(Normalize(lo, hi))


def _colors_of(colors: Colors, n: int) -> np.ndarray:
    """(n, 3) uint8, sRGB, from the first to the last value."""
    if colors.colormap not in CATEGORICAL:
        return map_colors(colors.colormap, n)
    return displayed(colorize(np.linspace(colors.lo, colors.hi, n), colors.colormap, colors.lo, colors.hi))


def _ink(pixels: np.ndarray) -> str:
    """A dark or a light color that is seen in front of these pixels (H, W, C) uint8."""
    light = np.asarray(pixels[..., :3], np.float64).mean()
    if pixels.shape[2] == 4:  # on white
        share = pixels[..., 3:] / 255
        light = float((pixels[..., :3] * share + 255 * (1 - share)).mean())
    return _INK if light > 110 else _PAPER


def _draw_scale_bar(ax: Any, camera: Camera, size: tuple[int, int], unit: str, ink: str) -> None:
    """Draw the scale bar of an image of a size into the lower right corner of its axes."""
    length, pixels = scale_bar(camera, size)
    share, pad = pixels / size[0], 0.03
    start, above = 1 - pad - share, pad * size[0] / size[1]
    how = {"transform": ax.transAxes, "color": ink, "clip_on": False}
    ax.plot([start, start + share], [above, above], lw=1.6, solid_capstyle="butt", scalex=False, scaley=False, **how)
    text, middle = f"{short(length)} {unit}".rstrip(), (start + share / 2, above)
    how = {"color": ink, "fontsize": 8, "ha": "center", "va": "bottom"}
    ax.annotate(text, middle, (0, 1.6), "axes fraction", "offset points", **how)


def _draw_directions(ax: Any, camera: Camera, size: tuple[int, int], font: float = 8.0) -> None:
    """Draw the directions of x, y and z into the lower left corner of axes."""
    _, forward, right, up = camera.frame(size)
    ways = np.stack([right / np.linalg.norm(right), up / np.linalg.norm(up)], axis=1)  # (3, 2)
    box = ax.get_window_extent()
    font = min(font, 0.07 * min(box.width, box.height) * 72 / ax.figure.dpi)  # of small panels
    long, start = 1.9 * font, np.full(2, 2.4 * font)  # points
    for axis in np.argsort(-forward, kind="stable"):
        color, place = _AXES[axis], start - 0.7 * font
        if np.linalg.norm(ways[axis]) > 0.25:  # else along the line of sight
            tip, place = start + long * ways[axis], start + (long + 0.7 * font) * ways[axis]
            arrow = {"arrowstyle": "-|>", "color": color, "lw": 1, "shrinkA": 0, "shrinkB": 0, "mutation_scale": font}
            ax.annotate("", tip, start, "axes points", "axes points", arrowprops=arrow, annotation_clip=False)
        how = {"color": color, "fontsize": font, "ha": "center", "va": "center"}
        ax.annotate("xyz"[axis], (0, 0), place, "axes points", "axes points", annotation_clip=False, **how)


# A figure


class Panel(NamedTuple):
    """One image of a figure: (H, W, 3 or 4) uint8, its camera, and the words after its letter."""

    image: np.ndarray
    camera: Camera
    words: str = ""


@dataclass
class Sheet:
    """Where things are in a figure for a paper; all of a size that is known before any image is.

    Args:
        n_panels: in all.
        width: of the figure, mm.
        dpi: pixels of the images, per inch.
        aspect: width of a panel by its height.
        per_row: panels side by side; default: as many as are at least 42 mm wide.
        font: size of the text, points.
        legend: "", "right" or "below".
        captions: whether panels have letters or words above them.
        bar_rows: rows, from the first on, with room for a scale bar below their panels.
        title: over all.

    Raises ValueError for panels that would be less than 32 pixels wide or high.
    """

    n_panels: int
    width: float = WIDTHS["single"]
    dpi: int = 300
    aspect: float = 4 / 3
    per_row: int | None = None
    font: float = 8.0
    legend: str = ""
    captions: bool = True
    bar_rows: int = 0
    title: str = ""
    size: tuple[int, int] = field(init=False)  # of a panel, pixels
    whole: tuple[int, int] = field(init=False)  # of the figure, pixels

    def __post_init__(self) -> None:
        n = self.n_panels
        if self.per_row is None:
            rows = math.ceil(n / max(1, int(self.width // _NARROW)))
            self.per_row = math.ceil(n / rows)
        self.per_row = min(self.per_row, n)
        self.rows = math.ceil(n / self.per_row)
        width, gap, line = self._pixels(self.width), self._pixels(_GAP), self._line
        self._strip = round(gap + self._pixels(_BAR + 1) + 4 * self._em + line) if self.legend == "right" else 0
        room = width - self._strip - gap * (self.per_row - 1)
        across = room // self.per_row
        self.size = across, round(across / self.aspect)
        if min(self.size) < 32:
            raise ValueError(f"width: expected panels of at least 32 pixels a side, got {self.size[0]}x{self.size[1]}")
        self._top = round(1.5 * line) if self.title else 0
        self._row = self.size[1] + gap + (line if self.captions else 0)
        below = round(self._pixels(_BAR + 1) + 2 * line) + gap if self.legend == "below" else 0
        self.bar_rows = min(self.bar_rows, self.rows)
        self.whole = width, self._top + self.rows * self._row + self.bar_rows * line - gap + below
        if max(self.whole) > _MOST:
            raise ValueError(f"width: expected at most {_MOST:,} pixels a side, got {self.whole[0]}x{self.whole[1]}")

    def _pixels(self, mm: float) -> int:
        return round(mm / MM * self.dpi)

    @property
    def _em(self) -> float:
        return self.font * _POINT / MM * self.dpi

    @property
    def _line(self) -> int:
        return math.ceil(1.35 * self._em)

    @property
    def mm(self) -> tuple[float, float]:
        """Width and height of the figure, mm."""
        return self.whole[0] * MM / self.dpi, self.whole[1] * MM / self.dpi

    def corner(self, i: int) -> tuple[int, int]:
        """Column and row of the pixel in the upper left corner of panel i."""
        row, column = divmod(i, self.per_row or 1)
        above = self._line if self.captions else 0
        y = self._top + row * self._row + min(row, self.bar_rows) * self._line + above
        return column * (self.size[0] + self._pixels(_GAP)), y

    def save(
        self,
        path: str | os.PathLike[str],
        panels: Sequence[Panel],
        *,
        colors: Colors | None = None,
        label: str = "",
        unit: str = "",
        bars: Sequence[int] = (),
        directions: bool = False,
        letters: bool = True,
        info: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """Write the figure, .pdf, .svg or .png; whole or not at all. The same figure has the same
        bytes: a date is in it only where SOURCE_DATE_EPOCH is set.

        Args:
            colors: of all panels, for the legend.
            label: of the legend.
            unit: of lengths.
            bars: numbers of the panels with a scale bar, in rows that have room.
            directions: whether the first panel of them, or of all, shows x, y and z.
            letters: whether panels are (a), (b) …
            info: what the file says of itself: command, versions.

        Returns what was drawn: size in mm, lengths of the scale bars.
        """
        matplotlib = need_matplotlib()
        ending = os.path.splitext(path)[1].lower()
        with _style(matplotlib):
            figure = matplotlib.figure.Figure([n / self.dpi for n in self.whole], dpi=self.dpi, facecolor="white")
            lengths = []
            for i, panel in enumerate(panels):
                column, row = self.corner(i)
                ax = self._axes(figure, column, row, *self.size)
                ax.imshow(panel.image, interpolation="none", aspect="auto")
                ax.set_axis_off()
                words = " ".join(filter(None, [f"({letter(i)})" if letters else "", panel.words]))
                self._text(figure, column, row - 0.3 * self._em, words, self.size[0], va="baseline")
                if i in bars:
                    lengths.append(self._draw_bar(figure, i, panel.camera, unit))
                if directions and i == min(bars, default=0):
                    _draw_directions(ax, panel.camera, self.size, self.font)
            if self.title:
                self._text(
                    figure, self.whole[0] / 2, 0.2 * self._em, self.title, self.whole[0], 1.15, ha="center", va="top"
                )
            if colors is not None and self.legend:
                self._draw_legend(figure, colors, label)
            drawn = io.BytesIO()
            figure.savefig(drawn, format=ending[1:], dpi=self.dpi, metadata=_metadata(ending, self.title, info or {}))
        with atomic_write(path) as file:
            file.write(drawn.getvalue())
        return {"size_mm": [round(v, 2) for v in self.mm], "scale_bars": lengths}

    def _axes(self, figure: Any, x: float, y: float, width: float, height: float) -> Any:
        """Axes of a rectangle, pixels from the upper left corner."""
        w, h = self.whole
        return figure.add_axes((x / w, 1 - (y + height) / h, width / w, height / h))

    def _text(self, figure: Any, x: float, y: float, words: str, room: float, grow: float = 1.0, **how: Any) -> None:
        """Write words at a pixel; smaller where they are longer than `room`, pixels."""
        words = escaped(words)  # no font has line ends, and no .svg may hold control characters
        if words:
            w, h = self.whole
            size = self.font * min(grow, room / _text_width(words, self._em))
            figure.text(x / w, 1 - y / h, words, fontsize=size, color=_INK, **how)

    def _draw_bar(self, figure: Any, i: int, camera: Camera, unit: str) -> float:
        """Draw the scale bar of panel i below it, in front of nothing; its length, world units."""
        from matplotlib.lines import Line2D

        length, pixels = scale_bar(camera, self.size)
        column, row = self.corner(i)
        right, below = column + self.size[0], row + self.size[1] + 0.65 * self._line
        places = [(right - pixels) / self.whole[0], right / self.whole[0]]
        heights = [1 - below / self.whole[1]] * 2
        figure.add_artist(Line2D(places, heights, lw=1.6, color=_INK, solid_capstyle="butt"))
        text = f"{short(length)} {unit}".rstrip()
        self._text(figure, right - pixels - 0.4 * self._em, below, text, self.size[0], ha="right", va="center_baseline")
        return length

    def _draw_legend(self, figure: Any, colors: Colors, label: str) -> None:
        kinds = [(v, escaped(text)) for v, text in colors.kinds]
        if colors.colormap in CATEGORICAL and not kinds:
            kinds = [(float(k), str(k)) for k in range(math.ceil(colors.lo), min(math.floor(colors.hi), 99) + 1)]
        gap, bar, tick = self._pixels(_GAP), self._pixels(_BAR), self._pixels(0.7)
        if self.legend == "below":
            long = round(0.6 * self.whole[0])
            top = self.whole[1] - bar - self._pixels(1) - 2 * self._line
            ax = self._axes(figure, (self.whole[0] - long) / 2, top, long, bar)
            ticks = tick_labels(colors.lo, colors.hi, max(2, int(long / (4.5 * self._em))))
            ax.imshow(_colors_of(colors, 256)[None], aspect="auto", extent=(0, 1, 0, 1), interpolation="none")
            ax.set(yticks=[], xlim=(0, 1), ylim=(0, 1))
            ax.set_xticks([share for share, _ in ticks], [text for _, text in ticks])
            x, y = self.whole[0] / 2, self.whole[1] - 0.3 * self._em
            self._text(figure, x, y, label, self.whole[0], ha="center", va="baseline")
        else:
            top, bottom = self.corner(0)[1], self.corner(self.n_panels - 1)[1] + self.size[1]
            left = self.whole[0] - self._strip + gap
            high = min(bottom - top - self._line, self._pixels(60))  # the ends' text needs room
            if kinds:
                high = min(bottom - top, round(len(kinds) * 1.4 * self._em))
            ax = self._axes(figure, left, (top + bottom - high) / 2, bar, high)
            if kinds:
                strip = displayed(colorize([v for v, _ in kinds], colors.colormap, colors.lo, colors.hi))[:, None]
                ticks = [(1 - (i + 0.5) / len(kinds), text) for i, (_, text) in enumerate(kinds)]
            else:
                strip = _colors_of(colors, 256)[::-1, None]
                ticks = tick_labels(colors.lo, colors.hi, max(2, int(high / (2 * self._em))))
            ax.imshow(strip, aspect="auto", extent=(0, 1, 0, 1), interpolation="none")
            ax.set(xticks=[], xlim=(0, 1), ylim=(0, 1))
            ax.yaxis.tick_right()
            ax.set_yticks([share for share, _ in ticks], [text for _, text in ticks])
        wide = max(_text_width(text, self._em) for _, text in ticks)
        room = self._strip - gap - bar - self._line - 2 * tick
        shrunk = min(1.0, room / wide) if self.legend == "right" else 1.0
        if kinds:
            shrunk = min(shrunk, high / (1.3 * len(kinds) * self._em))
        if self.legend == "right":
            x = left + bar + 2 * tick + shrunk * wide + 0.4 * self._em
            self._text(figure, x, (top + bottom) / 2, label, bottom - top, rotation=90, ha="left", va="center")
        points = 72 / self.dpi
        ax.tick_params(length=tick * points, width=0.5, pad=tick * points, labelsize=self.font * shrunk, colors=_INK)
        if kinds:
            ax.tick_params(length=0)


def letter(i: int) -> str:
    """a, b … z, aa, ab …"""
    before = letter(i // 26 - 1) if i >= 26 else ""
    return before + "abcdefghijklmnopqrstuvwxyz"[i % 26]


def _text_width(text: str, em: float) -> float:
    from matplotlib.textpath import TextPath

    return float(TextPath((0, 0), text, size=em).get_extents().width) if text.strip() else 1.0


@contextlib.contextmanager
def _style(matplotlib: Any) -> Iterator[None]:
    """matplotlib's own defaults and ours, whatever the user's settings are."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def versions() -> str:
    """What made a figure: globule, matplotlib, NumPy, Python."""
    import platform

    parts = {"globule": _core.version, "matplotlib": need_matplotlib().__version__, "numpy": np.__version__}
    return ", ".join(f"{name} {v}" for name, v in (parts | {"python": platform.python_version()}).items())


def _metadata(ending: str, title: str, info: Mapping[str, str]) -> dict[str, Any]:
    """The words of a file about itself."""
    command, by = info.get("command", ""), info.get("versions") or versions()
    found: dict[str, Any] = {"Title": escaped(title)} if title else {}
    if ending == ".png":
        return found | {"Software": by, "Description": command}
    found |= {"Creator": f"globule {_core.version}", "Keywords": by}
    found["Description" if ending == ".svg" else "Subject"] = command
    return (
        found if "SOURCE_DATE_EPOCH" in os.environ else found | {"Date" if ending == ".svg" else "CreationDate": None}
    )
