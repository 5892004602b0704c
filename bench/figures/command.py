"""Draw the thesis's figures again, as PNG files, from the results of this code.

Without a NAME, `python -m bench figures` draws all figures. The figures need matplotlib:
pip install "globule[figures]"."""

from __future__ import annotations

import argparse
import os
import time

from globule.cli import flags
from globule.cli.parser import Parser
from globule.cli.shared import Progress, UserError, check_device, count, make_folder, positive

from . import FIGURES, caption

SUMMARY = "the figures of the thesis, drawn again"
USAGE = "[NAME ...]"
EXAMPLES = """\
  python -m bench figures 2.1 5.4 -o drawn
  python -m bench figures --list"""


def add_arguments(parser: Parser) -> None:
    """The arguments of `python -m bench figures`."""
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"figures: {' '.join(FIGURES)} (default: all)")
    flags.add(parser, "--output", "folder; default: figures", default="figures")
    parser.add_argument(
        "--dpi",
        type=positive,
        default=110.0,
        metavar="N",
        help="resolution, pixels per inch; figures are 5 to 10 inches wide (default: 110)",
    )
    flags.add(parser, "--list")
    flags.add_device(parser)


def run(options: argparse.Namespace) -> None:
    """Run `python -m bench figures`."""
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
