"""The command line: `globule COMMAND …`, one module per command.

Exit status: 0 done; 2 the user's mistake (one line that names it, nothing written);
130 interrupted, 143 by SIGTERM; 1 anything else.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from .._base.memory import GIGABYTE, limits, set_limits
from .._base.terminal import Plain
from . import (
    calibrate,
    convert,
    demo,
    figure,
    flags,
    gauge,
    info,
    measure,
    mesh,
    project,
    reconstruct,
    register,
    render,
    simulate,
    slice,
    track,
    view,
)
from .completion import SHELLS, script
from .parser import Parser
from .shared import UserError, join_negative, say, text_of, warn

# Who uses them: the title in `globule --help`, and the commands' modules.
GROUPS = {
    "everyone": (render, figure, view, convert, info),
    "measured from the surface": (slice, gauge, mesh, track, project),
    "simulation": (simulate,),
    "tracked ultrasound": (reconstruct, calibrate, register, measure),
    "to try it out": (demo,),
}
COMMANDS = tuple(module for modules in GROUPS.values() for module in modules)


class _Overview(Parser):
    """The parser of `globule` itself, whose help groups the commands by who uses them."""

    def _sections(self, everything: bool) -> list[tuple[str | None, str | None, list[Any]]]:
        commands: Any = self._action_groups[0]._group_actions[0]
        options = self._action_groups[1]
        known = {action.dest: action for action in commands._choices_actions}
        parts: list[tuple[str | None, str | None, list[Any]]] = [
            (title, None, [known[_name(module)] for module in modules]) for title, modules in GROUPS.items()
        ]
        return [*parts, (options.title, None, options._group_actions)]


def build_parser() -> Parser:
    """The parser of all commands."""
    parser = _Overview(
        prog="globule",
        usage="globule COMMAND [options]\n       globule COMMAND --help",
        description="Mesh-free visualization: particles in, smooth exact surfaces out.",
    )
    parser.examples = "  globule demo\n  globule render splash.npz -o splash.png"
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    parser.add_argument(
        "--print-completion",
        choices=SHELLS,
        metavar="SHELL",
        help=f"print the completion script of a shell and exit: {', '.join(SHELLS)}",
    )
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", parser_class=Parser, prog="globule")
    for module in COMMANDS:
        name, about = _name(module), module.__doc__ or ""
        command = commands.add_parser(
            name,
            help=module.SUMMARY,
            usage=" ".join(f"globule {name} {module.USAGE} [options]".split()),
            description=about.partition("\n\n")[0],
        )
        command.notes = about.partition("\n\n")[2]
        command.examples = module.EXAMPLES
        command.has_short_help()
        command.set_defaults(run=module.run, parser=command)
        module.add_arguments(command)
        if module is not demo:
            flags.add_limits(command)
        command.essential = getattr(module, "ESSENTIAL", ())
    return parser


def _name(module: Any) -> str:
    return module.__name__.rpartition(".")[2]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; never exits by itself."""
    return status_of(_run, sys.argv[1:] if argv is None else list(argv))


def status_of(run: Callable[[list[str]], None], argv: list[str]) -> int:
    """Run a program of ours and return its exit status."""
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(_plain_stdout()):
            warnings.showwarning = _once()
            run(argv)
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
        return _fail(1, text_of(error))


def _run(argv: list[str]) -> None:
    parser = build_parser()
    argv = join_negative(argv)
    options = parser.parse_args(argv)
    if options.version:
        from .. import __version__

        print(f"globule {__version__}")
        return
    if options.print_completion:
        print(script(parser, options.print_completion))
        return
    if options.command is None:
        parser.print_help()
        raise UserError("expected a command, got none")
    if hasattr(options, "prepare"):
        options.parser.set_defaults(**options.prepare(options))
        options = parser.parse_args(argv)
    options.argv = argv
    before = limits()
    if memory := getattr(options, "max_memory", None):
        set_limits(**{**before, "memory": memory * GIGABYTE})
    if ratio := getattr(options, "max_ratio", None):
        set_limits(**{**limits(), "ratio": ratio})
    try:
        options.run(options)
    except UserError as error:
        raise UserError(_with_flag(options, error)) from error
    finally:
        set_limits(**before)


def _with_flag(options: argparse.Namespace, error: UserError) -> str:
    """The message of an error; the library's name of a value becomes the flag that gave it."""
    word, _, rest = str(error).partition(": ")
    if isinstance(error.__cause__, (TypeError, ValueError, MemoryError)):
        for action in options.parser._actions:
            name = next((n for n in action.option_strings if n.startswith("--")), "")
            given = getattr(options, action.dest, None) != action.default
            if name and given and word in (action.dest, name[2:].replace("-", "_")):
                return f"{name}: {rest}"
    return str(error)


def _plain_stdout() -> Any:
    """The standard output, if there is one, which names in files cannot give orders."""
    return sys.stdout and Plain(sys.stdout)


def _once() -> Callable[..., None]:
    """What shows the library's warnings, and others', as one line each; the same one once a run."""
    said = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if (text := str(message)) not in said:
            said.add(text)
            warn(text)

    return show


def _fail(status: int, problem: object) -> int:
    if os.environ.get("GLOBULE_TRACEBACK", "") not in ("", "0"):
        import traceback

        traceback.print_exc()
    say(f"error: {problem}")
    return status


def _drop_stdout() -> None:
    """The reader of our output has left: the interpreter must not complain when it flushes."""
    with contextlib.suppress(AttributeError, OSError, ValueError):  # stdout is no file
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
