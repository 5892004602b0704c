"""Repeat the thesis's tables and figures, and check the simulation against known answers.

Each NAME has flags of its own: `python -m bench NAME --help`. All names write CSV files into the
folder of -o, and PNG files if matplotlib is installed."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from globule.cli import flags, status_of
from globule.cli.parser import Parser
from globule.cli.shared import Progress, UserError, check_device, make_folder, print_json

from .figures import command as figures
from .tables.table import Setting
from .tables.ultrasound import TABLES

EXAMPLES = """\
  python -m bench ultrasound --list
  python -m bench figures 2.1 -o drawn"""

ABOUT = {
    "thesis": "Tables 6.1 and 6.2: frames per second and memory of the octree",
    "ultrasound": "Tables 4.1 to 4.3, Figures 4.6 and 4.7: time, memory and accuracy",
    "physics": "the simulation against known answers",
    "figures": figures.SUMMARY,
}


def build_parser() -> Parser:
    """The parser of all names."""
    parser = Parser(
        prog="python -m bench", usage="python -m bench NAME [options]", description=(__doc__ or "").partition("\n\n")[0]
    )
    parser.notes = (__doc__ or "").partition("\n\n")[2]
    parser.examples = EXAMPLES
    flags.add(parser, "--list")
    names = parser.add_subparsers(metavar="NAME", dest="name", parser_class=Parser, prog="python -m bench")
    for name, (usage, add, run, examples) in _NAMES.items():
        command = names.add_parser(
            name,
            usage=f"python -m bench {name}{usage} [options]",
            description=f"{ABOUT[name][0].upper()}{ABOUT[name][1:]}.",
            help=ABOUT[name],
        )
        command.examples = examples
        command.has_short_help()
        add(command)
        command.set_defaults(run=run, parser=command)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one and return its exit status; never exits by itself."""
    return status_of(_run, sys.argv[1:] if argv is None else list(argv))


def _run(argv: list[str]) -> None:
    options = build_parser().parse_args(argv)
    if options.name:
        options.run(options)
    elif options.list:
        print("\n".join(f"{name:<10}  {about}" for name, about in ABOUT.items()))
    else:
        raise UserError(f"NAME: expected one of {', '.join(_NAMES)}, got none")


def _add_common(parser: Parser, quick: bool = True) -> None:
    flags.add(parser, "--output", "folder; default: build/bench", default="build/bench")
    flags.add(parser, "--json")
    if quick:
        flags.add(parser, "--quick")
    flags.add_device(parser)


def _add_thesis(parser: Parser) -> None:
    _add_common(parser, quick=False)


def _add_ultrasound(parser: Parser) -> None:
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"tables: {' '.join(TABLES)} (default: all)")
    flags.add(parser, "--list")
    _add_common(parser)


def _run_rows(options: argparse.Namespace) -> None:
    """Run a benchmark that prints its rows itself: with --json on stderr."""
    check_device(options)
    make_folder("-o", options.output)
    name = options.name
    given = {"quick": options.quick} if name == "physics" else {}
    given["output"] = os.path.join(options.output, f"{name}.csv")
    module = importlib.import_module(f".tables.{name}", __package__)
    with contextlib.redirect_stdout(sys.stderr if options.json else sys.stdout):
        rows = module.run(options.device, options.threads, **given)
    if options.json:
        print_json({name: rows, "csv": given["output"]})


def _run_ultrasound(options: argparse.Namespace) -> None:
    jobs = _jobs(options.tables or list(TABLES))
    if options.list:
        print("\n".join(sorted(name for _, wanted in jobs for name in wanted)))
        return
    check_device(options)
    make_folder("-o", options.output)
    made = []
    with Progress(len(jobs)) as progress:
        for function, wanted in jobs:
            progress.step(", ".join(sorted(wanted)))

            def show(text: str, progress: Progress = progress) -> None:
                progress.done -= 1
                progress.step(text)

            setting = Setting(options.output, options.device, options.threads, options.quick, show)
            for table in function(setting):
                if table.name in wanted:
                    path = table.write(options.output)
                    made.append((table, path))
                    progress.clear()
                    if not options.json:
                        print(f"{table.text()}\n{path}\n", flush=True)
    if options.json:
        print_json({table.name: {**table._asdict(), "csv": path} for table, path in made})


def _jobs(names: list[str]) -> list[tuple[Callable[[Setting], Any], set[str]]]:
    """The functions to run, each once, and which of their tables are wanted."""
    jobs: dict[Any, set[str]] = {}
    for name in names:
        if name not in TABLES:
            raise UserError(f"TABLE: expected {', '.join(TABLES)}, got {name!r}")
        jobs.setdefault(TABLES[name], set()).add(name)
    return list(jobs.items())


_NAMES: dict[str, tuple[Any, ...]] = {
    "thesis": ("", _add_thesis, _run_rows, ""),
    "ultrasound": (" [TABLE ...]", _add_ultrasound, _run_ultrasound,
                   "  python -m bench ultrasound --list\n"
                   "  python -m bench ultrasound 4.3 --quick -o tables"),
    "physics": ("", _add_common, _run_rows, ""),
    "figures": (" [NAME ...]", figures.add_arguments, figures.run, figures.EXAMPLES),
}  # fmt: skip

if __name__ == "__main__":
    sys.exit(main())
