"""The parser of a command: two lengths of help, mistakes as `UserError`."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence
from typing import Any

from .._base.checks import near
from .shared import UserError

_LONGEST = 500  # letters of a message that repeats what was given
ALWAYS = ("--help", "--help-all", "--version")


class Parser(argparse.ArgumentParser):
    """`--help` lists the essential flags with the first examples, `--help-all` lists everything.

    Attributes:
        essential: option strings that `--help` lists, in this order; empty: all.
        examples: commands, one a line; `--help` shows the first two.
        notes: paragraphs that only `--help-all` shows.
    """

    def __init__(self, **named: Any):
        named |= {"add_help": False, "allow_abbrev": False}
        super().__init__(formatter_class=_Formatter, **named)
        self._positionals.title = "arguments"
        self.essential: tuple[str, ...] = ()
        self.examples = self.notes = ""
        self.add_argument("-h", "--help", action=_Help, help="print this help and exit")

    def has_short_help(self) -> None:
        """Add `--help-all`, and print all there."""
        self.add_argument("--help-all", action=_Help, dest="help", help="print the help with all options and exit")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse, but what is not known is a mistake of this command."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            word = unknown[0].partition("=")[0]
            self.error(f"unrecognized arguments: {' '.join(unknown)}{near(word, self._option_string_actions)}")
        return found, unknown

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        if action.option_strings and action.nargs is None and arg_strings == ["--"]:
            raise argparse.ArgumentError(action, "expected a value, got '--'")  # argparse drops it
        return super()._get_values(action, arg_strings)

    def error(self, message: str) -> Any:
        """Raise UserError with the message of argparse."""
        short = message if len(message) <= _LONGEST else f"{message[:_LONGEST]} …"
        raise UserError(f"{short} (`{self.prog} --help` lists the options)")

    def format_help(self) -> str:
        """The text of `--help`."""
        return self.help_text(not self.essential)

    def help_text(self, everything: bool) -> str:
        """The text of `--help`, or of `--help-all`."""
        text = self._get_formatter()
        text.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        text.add_text(self.description)
        if everything:
            text.add_text(self.notes)
        for title, about, actions in self._sections(everything):
            text.start_section(title)
            text.add_text(about)
            text.add_arguments(actions)
            text.end_section()
        lines = self.examples.splitlines()
        shown = lines if everything else lines[:2]
        if shown:
            text.add_text("\n".join(["examples:" if len(shown) > 1 else "example:", *shown]))
        return text.format_help()

    def _sections(self, everything: bool) -> list[tuple[str | None, str | None, list[Any]]]:
        """Title, text and arguments of each part of the help."""
        if everything:
            return [(g.title, g.description, g._group_actions) for g in self._action_groups]
        places = [a for a in self._actions if not a.option_strings]
        known = self._option_string_actions
        flags = [known[name] for name in (*ALWAYS, *self.essential) if name in known]
        return [("arguments", None, places), ("options", None, flags)]


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Names of an option before its value, "-o, --output PATH", and room for them."""

    def __init__(self, prog: str):
        super().__init__(prog, max_help_position=22)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Paragraphs as wide as the terminal; those with indented lines as they are."""
        blocks = text.split("\n\n")
        return "\n\n".join(block if "\n  " in f"\n{block}" else textwrap.fill(block, width) for block in blocks)

    def _format_action_invocation(self, action: argparse.Action) -> str:
        if not action.option_strings or action.nargs == 0:
            return super()._format_action_invocation(action)
        value = self._format_args(action, self._get_default_metavar_for_optional(action))
        return f"{', '.join(action.option_strings)} {value}"


class _Help(argparse.Action):
    """Print the help and exit."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str = ""):
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, default=argparse.SUPPRESS, help=help)

    def __call__(self, parser: Any, namespace: Any, values: Any, option: Any = None) -> None:
        print(parser.help_text(option == "--help-all" or not parser.essential), end="")
        parser.exit()
