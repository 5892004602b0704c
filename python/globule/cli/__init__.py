"""The command line: `globule COMMAND …`, one module per command.

Exit status: 0 done; 2 the user's mistake (one line naming it, nothing written); 130 interrupted,
143 by SIGTERM; 1 anything else.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from . import bench, calibrate, convert, demo, figures, info, reconstruct, render, simulate, view
from .shared import UserError, join_negative, say, warn

COMMANDS = (render, view, simulate, reconstruct, calibrate, convert, info, figures, bench, demo)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> None:  # type: ignore[override]
        raise UserError(f"{message} (`{self.prog} --help` shows how)")


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(
        prog="globule",
        description="Mesh-free visualization: particles in, smooth exact surfaces out.",
        epilog="example:\n  globule demo",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="store_true", help="print the version and leave")
    commands = parser.add_subparsers(metavar="COMMAND", dest="command")
    for module in COMMANDS:
        name = module.__name__.rpartition(".")[2]
        command = commands.add_parser(
            name,
            help=module.SUMMARY,
            description=module.__doc__,
            epilog=f"examples:\n{module.EXAMPLES}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; never exits by itself."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            _run(sys.argv[1:] if argv is None else list(argv))
        if sys.stdout:
            sys.stdout.flush()  # here, so that a closed pipe is noticed here
        return 0
    except SystemExit as stop:  # argparse after --help
        return int(stop.code or 0)
    except UserError as error:
        return _fail(2, error)
    except KeyboardInterrupt:
        say("interrupted")
        return 130
    except BrokenPipeError:
        _drop_stdout()
        return 1
    except MemoryError as error:
        return _fail(1, f"not enough memory{f': {error}' if str(error) else ''}")
    except Exception as error:
        return _fail(1, str(error) or type(error).__name__)


def _run(argv: list[str]) -> None:
    parser = build_parser()
    options = parser.parse_args(join_negative(argv))
    if options.version:
        from .. import __version__

        print(f"globule {__version__}")
    elif options.command is None:
        parser.print_help()
        raise UserError("expected a command, got none")
    else:
        options.run(options)


def _show_warning(message: Warning | str, kind: type[Warning], *place: Any) -> None:
    """The library's warnings, and others', as one line."""
    warn(str(message))


def _fail(status: int, problem: object) -> int:
    if os.environ.get("GLOBULE_TRACEBACK", "") not in ("", "0"):
        import traceback

        traceback.print_exc()
    say(f"error: {problem}")
    return status


def _drop_stdout() -> None:
    """Whoever read our output has left: the interpreter must not complain when it flushes."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (AttributeError, OSError, ValueError):
        pass  # stdout is no file
