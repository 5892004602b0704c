"""Measure what the source's tables report, print it beside their numbers, and write it as CSV."""

from __future__ import annotations

import argparse
import os
from importlib import import_module

from .shared import UserError, add_device, check_device

SUMMARY = "the source's tables, measured again"
EXAMPLES = "  globule bench --list"

TABLES = {"thesis": "globule.bench.thesis"}  # name: module with SUMMARY and run()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("names", nargs="*", metavar="NAME",
                        help=f"which: {' '.join(TABLES)} (default: all)")
    parser.add_argument("-o", "--output", metavar="FOLDER",
                        help="also write NAME.csv to this folder, made if it is not there")
    parser.add_argument("--list", action="store_true", help="say what each one measures")
    add_device(parser)


def run(options: argparse.Namespace) -> None:
    names = list(dict.fromkeys(options.names)) or list(TABLES)
    for name in names:
        if name not in TABLES:
            raise UserError(f"NAME: expected some of {' '.join(TABLES)}, got {name}")
    if options.list:
        print("\n".join(f"{name}  {import_module(TABLES[name]).SUMMARY}" for name in names))
        return
    check_device(options)
    if options.output:
        try:
            os.makedirs(options.output, exist_ok=True)
        except OSError as error:
            message = f"-o: expected a folder, got {options.output}: {error.strerror}"
            raise UserError(message) from error
    for name in names:
        output = os.path.join(options.output, f"{name}.csv") if options.output else None
        import_module(TABLES[name]).run(options.device, options.threads, output=output)
