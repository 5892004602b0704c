"""Completion scripts of shells, made from the parsers by shtab."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from .shared import UserError

SHELLS = ("bash", "zsh", "tcsh")
# Metavars of arguments that name a file or folder, which the shell completes.
PATHS = ("PATH", "FILE", "FILE.toml", "FILE.npz", "FILE.mp4", "CONFIG.xml", "TABLE", "IMAGE.png",
         "IMAGE", "FOLDER", "SWEEP", "MARKS", "SCENE", "IN", "OUT")  # fmt: skip


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The completion script of a shell, one of `SHELLS`.

    Raises UserError without shtab.
    """
    try:
        import shtab
    except ImportError as error:
        raise UserError(
            f"--print-completion: expected the package shtab, got none: {sys.executable} -m pip install shtab"
        ) from error
    _mark(parser, shtab.FILE)
    return shtab.complete(parser, shell)


def _mark(parser: argparse.ArgumentParser, files: dict[str, Any]) -> None:
    for action in parser._actions:
        if action.metavar in PATHS:
            action.complete = files  # type: ignore[attr-defined]  # what shtab looks for
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _mark(command, files)
