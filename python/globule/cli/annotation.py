"""Flags of `render` for what is drawn into the image, and for several views in one image."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from typing import Any, Protocol

import numpy as np

from ..render.annotate import Annotation, Colors, bounds_of, traced_size
from ..render.camera import Camera
from ..render.canvas import LEAST_SIDE
from ..render.frame import Frame, save_png
from ..render.legend import POSITIONS
from ..render.views import VIEWS, Grid, draw_views
from . import flags
from .shared import UserError, count, mistakes, number


def start_and_step(text: str) -> tuple[float, float]:
    """START or START,STEP."""
    words = text.split(",")
    if len(words) > 2:
        raise argparse.ArgumentTypeError(f"expected START or START,STEP, got {text!r}")
    return number(words[0]), number(words[1]) if len(words) == 2 else 0.0


def views(text: str) -> tuple[str, ...]:
    """Names of views with commas between them."""
    names = tuple(text.split(","))
    for name in names:
        if name not in VIEWS:
            known = ", ".join(VIEWS)
            raise argparse.ArgumentTypeError(f"expected some of {known}, got {name!r}")
    if len(names) > 16:
        raise argparse.ArgumentTypeError(f"expected at most 16 views, got {len(names)}")
    return names


def add_views(group: Any) -> None:
    """The flag of several views."""
    flags.own(group, "--views NAME,NAME…", "several views in one image, each from its own "
        f"direction: {', '.join(VIEWS)}; orthographic but for iso", views, usual="none, one view")  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of legend and annotations."""
    group = parser.add_argument_group("annotations, drawn into the image")
    given = functools.partial(flags.add_settings, group, Annotation)
    add_words(group)
    flags.own(group, "--legend-at PLACE", "place of the legend: lower-right, lower-left, "
        "upper-right, upper-left, or outside, on a strip that takes a part of the image's width",
        POSITIONS, usual="lower-right, with --views outside")  # fmt: skip
    given("scale_bar", "box", action="store_true")
    flags.own(group, "--step-number N", "number of the first image to draw into it, rising by 1 "
        "from image to image", int)  # fmt: skip


def add_words(group: Any) -> None:
    """The flags of annotations that a figure for a paper has too."""
    given = functools.partial(flags.add_settings, group, Annotation)
    given("legend", "axes", action="store_true")
    given("legend_title", "legend_unit", "title", "unit", default="")
    flags.own(group, "--time T[,DT]", "time to draw into the first image, and from one image to "
        "the next, in the unit of --time-unit", start_and_step)  # fmt: skip
    given("time_unit", default="s")


def check(options: argparse.Namespace) -> None:
    """Refuse flags of legend and views that contradict others."""
    for name in ("legend", "legend_at", "legend_title", "legend_unit"):
        if getattr(options, name) and not options.color_by:
            raise UserError(f"--{name.replace('_', '-')}: expected --color-by beside it, got none")
    if options.range and not options.color_by:
        raise UserError("--range: expected --color-by beside it, got none")
    if options.views:
        for name in ("fit", "eye", "look_at", "ortho", "camera_path", "pick", "aov"):
            if getattr(options, name):
                flag = name.replace("_", "-")
                raise UserError(f"--views: expected no --{flag} beside --views, got both")
    if options.transparent and options.output.lower().endswith(".mp4"):
        raise UserError("--transparent: expected images, .png, got a movie")


class Pictures(Protocol):
    """What becomes of the images of a run.

    Attributes:
        annotation: of the first image.
    """

    annotation: Annotation

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) to trace for each view."""

    def write(
        self, path: str, i: int, frames: list[Frame], cameras: list[Camera], colors: Colors | None, box: Any
    ) -> None:
        """Take the views of image i. box: points (M, 3) of all images, or None."""


class Notes:
    """Annotations and views that the options ask for; mistakes show before any work.

    Attributes:
        names: of the views; one "" for a single view.
        size: (width, height) to trace for each view.
        annotation: of the first image.
    """

    def __init__(self, options: argparse.Namespace):
        check(options)
        legend = options.legend_at or options.legend_title or options.legend_unit
        time = options.time or (None, 0.0)
        with mistakes():
            self.annotation = Annotation(
                title=options.title,
                scale_bar=options.scale_bar,
                axes=options.axes,
                box=options.box,
                unit=options.unit,
                time=time[0],
                time_step=time[1],
                time_unit=options.time_unit,
                step=options.step_number,
                legend=options.legend_at or bool(options.legend or legend),
                legend_title=options.legend_title,
                legend_unit=options.legend_unit,
            )
            self.names = options.views or ("",)
            self.annotation = self.annotation.for_views(len(self.names))
            whole = options.size
            traced = traced_size(self.annotation, whole, len(self.names) > 1)
            self._grid = Grid(len(self.names), traced)
            if options.views and min(self._grid.cell) < LEAST_SIDE:
                got = f"{whole[0]}x{whole[1]}"
                raise UserError(
                    f"--size: expected at least {LEAST_SIDE} pixels a side for each of "
                    f"{count(len(self.names), 'view')}, got {got}"
                )
        self.size = self._grid.cell
        self._strip, self._header = whole[0] - traced[0], whole[1] - traced[1]

    def picture(
        self, i: int, frames: list[Frame], cameras: list[Camera], colors: Colors | None, box: Any
    ) -> np.ndarray:
        """The annotated image i of all views. box: points (M, 3) of all images, or None."""
        if self.annotation.box is True:  # of all images, or of the first: it must not jump
            ends = None if box is None else (np.min(box, axis=0), np.max(box, axis=0))
            ends = ends or bounds_of(layer.scene for layer in frames[0]._layers)
            if ends is not None:
                self.annotation = dataclasses.replace(self.annotation, box=ends)
        return draw_views(
            frames, cameras, self.names, self._grid, self.annotation.at(i), colors, None,
            self._strip, self._header,
        )  # fmt: skip

    def write(
        self, path: str, i: int, frames: list[Frame], cameras: list[Camera], colors: Colors | None, box: Any
    ) -> None:
        """Write the picture i."""
        save_png(path, self.picture(i, frames, cameras, colors, box))
