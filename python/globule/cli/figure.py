"""Write a figure for a paper: panels over time with one legend and a scale bar.

The images are rasters of --dpi; letters, times, legend and scale bar are text and lines, which stay
sharp. A .pdf has its fonts in it, and the command and the versions in its metadata.

One file with several frames, several files, or a quoted pattern ('frame_*.vtk') are one sequence.
--panels shows frames spread evenly over it, --frames or --times those that you choose. All panels
have one camera, one support and one range of colors. With --views, each view has a row.

The camera is orthographic and shows all particles; --fov or --eye makes it perspective. The scale
bar is true everywhere in an orthographic image; a perspective one has none unless --scale-bar asks
for it. The background is the paper unless --background, --sky or a --preset paints one.

Units and times are the files' own where they have some and no flag gives others.

The same command makes the same bytes; SOURCE_DATE_EPOCH sets a date.
It needs pip install "globule[figures]"."""

from __future__ import annotations

import argparse
import functools
import re
import shlex
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._base.colormaps import CATEGORICAL
from .._base.settings import Number, Whole
from .._base.terminal import escaped
from ..data.attributes import colormap_of
from ..fluids.likeness import shows_flat
from ..formats.frames import said
from ..pieces.scene import Scene
from ..render.annotate import Annotation, Colors
from ..render.camera import Camera, first_direction
from ..render.fit import fitted
from ..render.frame import Frame
from ..render.paper import ENDINGS, WIDTHS, Panel, Sheet, letter, need_matplotlib, versions
from ..render.presets import PRESETS, load_preset
from ..render.sequence import find_files, time_of, with_frames
from ..render.views import view_cameras
from . import annotation, flags, light, render, sequence, state, tracing
from .image import picture
from .parser import Parser
from .shared import Progress, UserError, check_device, check_output, count, mistakes, number, print_json, reading, say

SUMMARY = "panels over time, legend and scale bar, for a paper"
USAGE = "FILE [FILE ...] -o figure.pdf"
EXAMPLES = """\
  globule figure splash.npz -o splash.pdf --color-by speed --unit m
  globule figure frame_0.ply frame_1.ply -o both.pdf --figure-width double
  globule figure splash.npz -o views.svg --views front,top --aspect 2:1 --font-size 7"""
ESSENTIAL = ("--output", "--panels", "--frames", "--times", "--figure-width", "--aspect", "--color-by",
             "--legend-unit", "--unit", "--eye", "--up", "--views", "--state")  # fmt: skip

MOST = 100  # panels
PANELS = 3  # where nothing is said
WIDE = 120.0  # mm, from where on the legend stands at the right
# Flags of `render` that a figure does not have, with the values that they have without.
_ABSENT: dict[str, Any] = {
    "aov": None, "pick": None, "camera_path": None, "turntable": None, "fps": 30.0, "resume": False, "legend_at": None,
    "box": False, "step_number": None, "memory": None, "ranks": None, "frame": None,
}  # fmt: skip


def numbers(text: str) -> list[int]:
    """N,N,… whole numbers."""
    words = text.split(",")
    if not all(re.fullmatch(r"[+-]?\d{1,12}", word) for word in words):
        raise argparse.ArgumentTypeError(f"expected whole numbers with commas, got {text!r}")
    return [int(word) for word in words]


def times(text: str) -> list[float]:
    """T,T,…"""
    return [number(word) for word in text.split(",")]


def width(text: str) -> float:
    """single, double or mm."""
    if text in WIDTHS:
        return WIDTHS[text]
    try:
        return Number(20, 1000).parse(text)
    except argparse.ArgumentTypeError:
        known = "single, double or 20 to 1000 (mm)"
        raise argparse.ArgumentTypeError(f"expected {known}, got {text!r}") from None


def aspect(text: str) -> float:
    """W:H."""
    words = text.split(":")
    found = [number(word) for word in words]
    if len(found) != 2 or min(found) <= 0 or not 0.05 <= found[0] / found[1] <= 20:
        raise argparse.ArgumentTypeError(f"expected W:H such as 4:3, got {text!r}")
    return found[0] / found[1]


def add_arguments(parser: Parser) -> None:
    """The arguments of `globule figure`."""
    parser.add_argument("particles", nargs="+", metavar="FILE", help="particles, mesh or volume")
    flags.add(parser, "--output", "figure.pdf, .svg or .png", required=True)
    group = parser.add_argument_group("panels")
    which = group.add_mutually_exclusive_group()
    flags.own(which, "--panels N", "number of panels, frames spread evenly from the first to the last",
        Whole(1, MOST).parse, usual=str(PANELS))  # fmt: skip
    flags.own(which, "--frames N,N…", "numbers of the frames to show, from 0; -1: the last", numbers,
        usual="spread evenly")  # fmt: skip
    flags.own(which, "--times T,T…", "times to show, each by the frame that is nearest, in the unit "
        "of the files or of --time", times, usual="spread evenly")  # fmt: skip
    flags.own(group, "--per-row N", "panels side by side", Whole(1, MOST).parse,
        usual="as many as are 42 mm wide")  # fmt: skip
    flags.own(group, "--aspect W:H", "width of a panel by its height", aspect,
        usual="as the content, 1:2 to 3:1; 4:3 with --eye or --fov")  # fmt: skip
    group.add_argument("--letters", action=argparse.BooleanOptionalAction,
        help="put (a), (b) … above the panels (default: with several)")  # fmt: skip
    group = parser.add_argument_group("page")
    flags.own(group, "--figure-width WIDTH", "width of the figure: single (a column, 89 mm), double "
        "(both columns, 183 mm) or a number, mm", width, usual="single")  # fmt: skip
    flags.own(group, "--dpi N", "pixels of the images, per inch", Whole(50, 2400).parse, 300)
    flags.own(group, "--font-size POINTS", "size of all text, points", Number(3, 72).parse, 8.0)
    flags.add(parser, "--state", "default: none")
    flags.add(parser, "--json")
    render.add_look(parser)
    group = parser.add_argument_group("words and scale")
    annotation.add_words(group)
    words = flags.of(Annotation, "scale_bar", action=argparse.BooleanOptionalAction)
    words["help"] += " (default: on for orthographic cameras)"
    group.add_argument("--scale-bar", **words)
    flags.add_reading(parser, of_frames=False)
    flags.add_device(parser.add_argument_group("machine"))
    parser.set_defaults(**_ABSENT, prepare=functools.partial(state.defaults, parser))


class Panels:
    """Keeps the images of a run, in place of `annotation.Notes`, which writes each.

    Attributes:
        sheet: where they will be; its panels get the shape of what they show.
        annotation: what the fitted camera leaves room for.
        found: of each frame, the panels of its views.
        colors: of all panels.
    """

    def __init__(self, options: argparse.Namespace, sheet: Sheet):
        self.sheet = sheet
        with mistakes():
            self.annotation = Annotation(axes=options.axes)
        self.found: list[list[Panel]] = []
        self.colors: Colors | None = None
        self._paper = not options.transparent

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) to trace for each panel."""
        return self.sheet.size

    def write(
        self, path: str, i: int, frames: list[Frame], cameras: list[Camera], colors: Colors | None, box: Any
    ) -> None:
        """Keep the images of a frame."""
        images = [on_paper(frame.image) if self._paper else frame.image for frame in frames]
        self.found.append([Panel(image, camera) for image, camera in zip(images, cameras, strict=True)])
        if colors is not None:
            before = self.colors.kinds if self.colors else ()
            self.colors = colors._replace(kinds=tuple(sorted({*before, *colors.kinds})))


def on_paper(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3 or 4) uint8 in front of white, (H, W, 3)."""
    share = image[..., 3:].astype(np.float32) / 255 if image.shape[2] == 4 else 1
    return np.rint(image[..., :3] * share + 255 * (1 - share)).astype(np.uint8)


def run(options: argparse.Namespace) -> None:
    """Run `globule figure`."""
    start = time.perf_counter()
    check_output("-o", options.output, ENDINGS)
    annotation.check(options)
    render.check_camera(options)
    check_device(options)
    facts = options.facts = {}
    with Progress(1) as progress:
        with mistakes():
            need_matplotlib()
            files = find_files(options.particles)
            progress.show("looking for frames")
            files = with_frames(files, **reading(options))
        chosen = _chosen(options, files, progress)
        options.particles = [files[k] for k in chosen]
        sheet = _sheet(options, len(chosen))
        options.size = sheet.size
        render.check_inputs(options)
        series = sequence.Series(options, None, options.particles)
        panels = Panels(options, sheet)
        with mistakes():
            lit = _lit(options)
            thesis = tracing.settle(options)
            render.camera(options, None, panels)
        find = functools.partial(_cameras, options, lit, panels)
        progress.n_steps = 4 * len(chosen)
        reports = []
        series.survey(progress)
        none: list[str | None] = [None] * len(chosen)
        for i, path, image, _ in series.pictures([options.output] * len(chosen), none):
            report = picture(options, lit, panels, thesis, progress, series, i, path, image, None, find)
            assert report is not None
            reports.append(report)
        clock = [_time(options, k, facts.get(path)) for k, path in zip(chosen, options.particles, strict=True)]
        told = _write(options, panels, clock)
    told["frames"] = [r | {"images": [], "number": k, "time": t}
                      for r, k, t in zip(reports, chosen, clock, strict=True)]  # fmt: skip
    told["times"] = {"total": time.perf_counter() - start}
    if options.json:
        print_json(told)
        return
    wide, high = told["size_mm"]
    n = sum(map(len, panels.found))
    what = f"{count(n, 'panel')} of {panels.size[0]}x{panels.size[1]} pixels on {wide:g} x {high:g} mm"
    print(f"{options.output}: {what}, {told['times']['total']:.2f} s in all on {reports[0]['device']}")


def _chosen(options: argparse.Namespace, files: list[str], progress: Progress) -> list[int]:
    """The numbers of the frames to show."""
    n = len(files)
    if options.times is not None:
        found = _nearest(options, files, progress)
    elif options.frames is not None:
        for k in options.frames:
            if not -n <= k < n:
                raise UserError(f"--frames: expected numbers of {count(n, 'frame')}, {-n} to {n - 1}, got {k}")
        found = [k % n for k in options.frames]
    else:
        if options.panels is not None and options.panels > n:
            say(f"note: --panels {options.panels}, of {count(n, 'frame')}: a panel for each")
        wanted = min(options.panels or PANELS, n)
        found = sorted({round(k) for k in np.linspace(0, n - 1, wanted)})
    flag = "--times" if options.times is not None else "--frames"
    if len({*found}) < len(found):
        twice = next(k for k in found if found.count(k) > 1)
        raise UserError(f"{flag}: expected another frame for each panel, got frame {twice} twice")
    if len(found) * len(options.views or ("",)) > MOST:
        raise UserError(f"{flag}: expected at most {MOST} panels, got {len(found) * len(options.views or ('',))}")
    return found


def _nearest(options: argparse.Namespace, files: list[str], progress: Progress) -> list[int]:
    """The numbers of the frames that are nearest to --times."""
    clock = []
    for k, path in enumerate(files):
        progress.show(f"looking for times: {said(path)}")
        with mistakes():
            found = None if options.time else time_of(path, **reading(options))
        clock.append(_time(options, k, (found, {})))
        if clock[-1] is None:
            raise UserError(f"--times: expected a time in each file, got none in {path}; --time T,DT gives times")
    known = np.array(clock, np.float64)
    room = np.ptp(known) / max(1, 2 * (len(known) - 1))
    for t in options.times:
        if not known.min() - room <= t <= known.max() + room:
            raise UserError(f"--times: expected {known.min():.6g} to {known.max():.6g}, got {t:g}")
    return [int(np.argmin(np.abs(known - t))) for t in options.times]


def _time(options: argparse.Namespace, k: int, facts: Any) -> float | None:
    """The time of frame k by --time, else by its file."""
    if options.time:
        return options.time[0] + k * options.time[1]
    return facts[0] if facts else None


def _sheet(options: argparse.Namespace, n_frames: int, shape: float = 4 / 3) -> Sheet:
    """Where everything will be. shape: width of a panel by its height where --aspect gives none."""
    n_views = len(options.views or ("",))
    if options.letters is None:
        options.letters = n_frames * n_views > 1
    legend = ""
    if options.color_by:
        listed = colormap_of(options.color_by, options.colormap) in CATEGORICAL
        legend = "right" if listed or (options.figure_width or WIDTHS["single"]) >= WIDE else "below"
    per_row = n_frames if n_views > 1 and options.per_row is None else options.per_row
    flat = options.views or options.ortho or not (options.eye or options.fov)
    bars = options.scale_bar if options.scale_bar is not None else flat
    captions = options.letters or n_frames * n_views > 1 or options.time is not None
    try:
        return Sheet(
            n_frames * n_views, options.figure_width or WIDTHS["single"], options.dpi, options.aspect or shape,
            per_row, options.font_size, legend, captions, (n_views if bars else 0),
            options.title,
        )  # fmt: skip
    except ValueError as error:
        raise UserError(f"--figure-width: {str(error).partition(': ')[2]}") from error


def _lit(options: argparse.Namespace) -> light.Light:
    """Light in front of nothing, which becomes the paper, unless something paints a background or
    is seen through."""
    given = options.transparent
    clear = options.transmission or options.opacity not in (None, 1.0)
    clear = clear or any(word in PRESETS for _, word in options.meshes)
    plain = options.color_by and not options.light and options.ambient is None and options.exposure in (None, 1)
    if given or clear or options.sky or options.background is not None:
        pass
    elif plain and options.preset in (None, "flat"):
        options.background = (1.0, 1.0, 1.0)  # exactly white where no tone curve is
    else:
        options.transparent = True
        if options.preset in PRESETS:
            point = Scene(np.zeros((1, 3), np.float32), support=1.0, device="cpu", threads=1)
            look = load_preset(options.preset, point, options.up)
            options.transparent = not (look.sky or look.material.transmission)
    lit = light.Light(options)
    options.transparent = given
    return lit


def _cameras(options: argparse.Namespace, lit: light.Light, panels: Panels, scene: Any, around: Any) -> list[Camera]:
    """The cameras of all views of a frame; orthographic unless the options say otherwise."""
    if options.eye or ((options.fov or options.ortho) and not options.views):
        return render.cameras(options, lit, panels, scene, around)
    around = lit.around(scene, around)
    towards: dict[str, Any] = {} if shows_flat(scene) else {"direction": first_direction(options.up), "up": options.up}

    def cameras(size: tuple[int, int], room: Annotation | None = None) -> list[Camera]:
        if options.views:
            return view_cameras(scene, options.views, size, options.up, options.fov or render.FOV, around, room)
        return [fitted(scene, size, room, around, orthographic=True, **towards)]

    if not options.aspect:  # in an image that is long and thin, only one side counts
        wide, high = cameras((10_000, 1)), cameras((1, 10_000))
        sides = [(b.height / 10_000, a.height) for a, b in zip(wide, high, strict=True) if a.height and b.height]
        if sides:
            across, up = (max(side) for side in zip(*sides, strict=True))
            panels.sheet = _sheet(options, len(options.particles), min(max(across / up, 0.5), 3.0))
            options.size = panels.size
    return cameras(panels.size, panels.annotation)


def _write(options: argparse.Namespace, panels: Panels, clock: Sequence[float | None]) -> dict[str, Any]:
    """Write the figure; what it shows, for the report."""
    sheet = panels.sheet
    names = options.views or ("",)
    n_frames = len(clock)
    units: dict[str, str] = {}
    for _, more in options.facts.values():
        units = {**more, **units}
    unit = options.unit or units.get("positions", "")
    shown = [(v, i) for v in range(len(names)) for i in range(n_frames)]
    places, drawn = [], []
    for k, (v, i) in enumerate(shown):
        when = "" if clock[i] is None or not (n_frames > 1 or options.time) else _when(options, clock[i])
        panel = panels.found[i][v]
        name = names[v] if len(names) > 1 else ""
        drawn.append(panel._replace(words=", ".join(filter(None, (name, when)))))
        marks = {"letter": letter(k) if options.letters else None, "view": names[v] or None, "frame": i}
        places.append(marks | {"words": drawn[-1].words, "corner": sheet.corner(k)})
    flat = [v for v in range(len(names)) if panels.found[0][v].camera.height is not None]
    bars = [v * n_frames for v in (range(len(names)) if options.scale_bar else flat) if options.scale_bar is not False]
    label, colors = "", panels.colors
    if colors is not None:
        legend_unit = options.legend_unit or units.get(options.color_by, "")
        label = ", ".join(filter(None, (options.legend_title or colors.name, legend_unit)))
    command = escaped(shlex.join(["globule", *options.argv]))
    by = versions()
    told = sheet.save(
        options.output, drawn, colors=colors, label=label, unit=unit, bars=bars, directions=options.axes,
        letters=options.letters, info={"command": command, "versions": by},
    )  # fmt: skip
    legend = colors and {"colormap": colors.colormap, "range": [colors.lo, colors.hi], "label": label}
    return {"figure": options.output, **told, "dpi": sheet.dpi, "panel_size": sheet.size, "panels": places,
            "legend": legend, "unit": unit, "command": command, "versions": by}  # fmt: skip


def _when(options: argparse.Namespace, t: float | None) -> str:
    """The time of a panel in words."""
    return "" if t is None else f"t = {t:.4g} {options.time_unit}".rstrip()
