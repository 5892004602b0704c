"""Draw the thesis's figures anew, as PNG files, from what this code computes.

Without a NAME all of them. Needs matplotlib: pip install "globule[figures]"."""

from __future__ import annotations

import argparse
import os
import time

from ..figures import FIGURES, caption
from .shared import (
    Progress,
    UserError,
    add_device,
    check_device,
    count,
    make_folder,
    positive,
)

SUMMARY = "the thesis's figures, made again"
EXAMPLES = "  globule figures 2.1 5.4 -o drawn\n  globule figures --list"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"which: {' '.join(FIGURES)} (default: all)"
    )
    parser.add_argument(
        "-o",
        "--output",
        default="figures",
        metavar="FOLDER",
        help="folder to write to, made if it is not there (default: figures)",
    )
    parser.add_argument(
        "--dpi",
        type=positive,
        default=110.0,
        metavar="N",
        help="pixels per inch; figures are 5 to 10 inches wide (default: 110)",
    )
    parser.add_argument("--list", action="store_true", help="say what each one shows")
    add_device(parser)


def run(options: argparse.Namespace) -> None:
    names = list(dict.fromkeys(options.names)) or list(FIGURES)
    for name in names:
        if name not in FIGURES:
            raise UserError(f"NAME: expected some of {' '.join(FIGURES)}, got {name}")
    if options.list:
        print("\n".join(f"{name}  {caption(name)}" for name in names))
        return
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        message = 'figures need matplotlib, which is not installed: pip install "globule[figures]"'
        raise UserError(message) from error
    check_device(options)
    make_folder("-o", options.output)
    start = time.perf_counter()
    with Progress(len(names)) as progress:
        for name in names:
            progress.step(f"figure {name}")
            path = os.path.join(options.output, f"{name}.png")
            FIGURES[name](path, options.device, options.dpi)
    seconds = time.perf_counter() - start
    print(f"{options.output}: {count(len(names), 'figure')}, {seconds:.1f} s")
