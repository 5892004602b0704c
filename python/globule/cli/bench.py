"""Make the source's tables again: its numbers, ours and the ratio, as text and CSV, figures as PNG.

TABLE is a chapter (`ultrasound`) or a table's or figure's number; without any, all are made."""

from __future__ import annotations

import argparse
import importlib
import os
from collections.abc import Callable
from typing import Any

from ..bench.table import Setting
from .shared import Progress, UserError, add_device, check_device, make_folder, print_json

SUMMARY = "the source's tables, made again"
EXAMPLES = "  globule bench --list"

# A module has TABLES: number -> function of a Setting that yields Tables.
MODULES = {"ultrasound": "globule.bench.ultrasound"}
# A module has SUMMARY and run().
RUNS = {"thesis": "globule.bench.thesis", "physics": "globule.bench.physics"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "tables", nargs="*", metavar="TABLE", help=f"{', '.join((*RUNS, *MODULES))}, 4.1 …"
    )
    parser.add_argument(
        "-o",
        "--output",
        default="bench",
        metavar="DIR",
        help="folder for .csv and .png, made if it is not there (default: bench)",
    )
    parser.add_argument("--quick", action="store_true", help="small sizes only: a minute")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--list", action="store_true", help="say what there is")
    add_device(parser)


def run(options: argparse.Namespace) -> None:
    names = options.tables or [*RUNS, *MODULES]
    jobs = _jobs([name for name in names if name not in RUNS])
    runs = {name: importlib.import_module(RUNS[name]) for name in RUNS if name in names}
    if options.list:
        for name, module in runs.items():
            print(f"{name}  {module.SUMMARY}")
        print("\n".join(sorted(f"{number}  ultrasound" for _, wanted in jobs for number in wanted)))
        return
    check_device(options)
    make_folder("-o", options.output)
    for name, module in runs.items():
        output = os.path.join(options.output, f"{name}.csv")
        given = {"quick": options.quick} if name == "physics" else {}
        module.run(options.device, options.threads, output=output, **given)
    made = []
    with Progress(len(jobs)) as progress:
        for function, wanted in jobs:
            progress.step(", ".join(sorted(wanted)))

            def say(text: str, progress: Progress = progress) -> None:
                progress.done -= 1
                progress.step(text)

            setting = Setting(options.output, options.device, options.threads, options.quick, say)
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
    known = {}
    for module in MODULES:
        for number, function in importlib.import_module(MODULES[module]).TABLES.items():
            known[number] = (module, function)
    jobs: dict[Any, set[str]] = {}
    for name in names:
        found = {number for number, (module, _) in known.items() if name in (number, module)}
        if not found:
            expected = ", ".join((*RUNS, *MODULES, *sorted(known)))
            raise UserError(f"TABLE: expected {expected}, got {name!r}")
        for number in sorted(found):
            jobs.setdefault(known[number][1], set()).add(number)
    return list(jobs.items())
