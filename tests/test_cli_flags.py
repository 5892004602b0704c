"""All flags of all commands: one meaning each, help with unit and default, old spellings."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Iterator

import numpy as np
import pytest
from cli_helpers import SMALL, run_json
from globule.cli import build_parser, look, main
from globule.cli.arguments import beside, ground

UNITS = re.compile(
    r"\b(pixels?|world units?|degrees|mm|meters|seconds|gigabytes|supports|voxels|gray levels|"
    r"frames per "
    r"second|bits|halvings|per inch|number of|unit|direction|0 to 1|1 to 4)\b"
)
LONG = ("render", "view", "simulate", "reconstruct")


def parsers(parser: argparse.ArgumentParser | None = None) -> Iterator[argparse.ArgumentParser]:
    """The parser of `globule`, of its commands, and of the names below `globule bench`."""
    parser = parser or build_parser()
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from parsers(command)


def flags() -> list[tuple[str, argparse.Action]]:
    """Command and action of every flag, without old spellings."""
    return [
        (parser.prog, action)
        for parser in parsers()
        for action in parser._actions
        if action.option_strings and action.help != argparse.SUPPRESS
    ]


def sentence(action: argparse.Action) -> str:
    """The help without what is special to a command, which stands in parentheses."""
    return re.split(r" \(|; (?=may be)", action.help)[0]


def test_a_flag_means_the_same_in_every_command():
    known: dict[str, tuple] = {}
    shared = set()
    for command, action in flags():
        for name in action.option_strings:
            kind = getattr(action.type, "__qualname__", action.type)
            facts = (sentence(action), action.metavar, kind)
            assert known.setdefault(name, facts) == facts, f"{command} {name}"
            if known[name] is not facts:
                shared.add(name)
    assert {"--clip", "--size", "--level", "-o", "--device", "--threads", "--json"} <= shared


@pytest.mark.parametrize(("command", "action"), flags(), ids=lambda v: getattr(v, "dest", v))
def test_help_says_unit_and_default(command, action):
    text = action.help
    assert text, action
    assert text[-1] != "."
    if action.nargs == 0 and not isinstance(action, argparse.BooleanOptionalAction):
        return
    default = re.search(r"default: (.*)\)", text)
    assert default or action.required or "SHELL" in action.metavar, text
    value = action.default
    if value is not None and value != []:
        words = "x" if action.dest == "size" else ","
        shown = words.join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value}"
        shown = {"0": "all cores"}.get(shown, re.sub(r"\.0$", "", shown))
        assert default[1].startswith(shown), text
    if action.type not in (None, look.light, look.color, beside, ground):
        assert UNITS.search(text), text
    if action.choices and action.metavar:
        for choice in action.choices:
            assert re.search(rf"\b{re.escape(str(choice))}\b", text), text


@pytest.mark.parametrize("command", LONG)
def test_help_fits_on_a_screen_and_help_all_has_all(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main([command, "--help"]) == 0
    short = capsys.readouterr().out
    assert short.count("\n") <= 40
    assert max(map(len, short.splitlines())) <= 80
    assert "--help-all" in short
    assert f"\n  globule {command} " in short
    assert main([command, "--help-all"]) == 0
    full = capsys.readouterr().out
    names = {n for c, a in flags() if c == f"globule {command}" for n in a.option_strings}
    assert names > {"--device", "--threads"}
    for name in names:
        assert re.search(rf"{name}\b", full), name
    assert "--threads" not in short
    assert full.count("\n") > short.count("\n")


@pytest.mark.parametrize(
    ("words", "old", "new"),
    [
        (["render", "cube.npz", "-o", "a.png", "--depth", "4", *SMALL], "--depth",
         "--octree-level"),
        (["calibrate", "--delay", "--sweep", "phantom.igs.mha", "--most", "0.2"], "--most",
         "--max-delay"),
        (["simulate", "dam-break", "--seconds", "0.05", "--spacing", "0.08", "--no-frames",
          "--size", "40x30", "--pictures", "p"], "--pictures", "--images"),
        (["figures", "--list"], "globule figures", "globule bench figures"),
        (["bench", "4.3", "--list"], "globule bench TABLE", "globule bench ultrasound TABLE"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)  # fmt: skip
def test_old_spellings_work_with_a_note(words, old, new, particles, sweep, capsys):
    main(words)
    notes = [line for line in capsys.readouterr().err.splitlines() if "note: " in line]
    assert notes == [f"globule: note: {old} is now {new}; the next version refuses {old}"]
    if words[0] == "simulate":
        assert os.listdir("p")


def test_old_spellings_do_what_the_new_ones_do(sweep, capsys):
    words = ["reconstruct", "phantom.igs.mha", "-o", "v.npz", "--device", "cpu"]
    bounds = "-10,-5,2,10,12,8"
    for old, new in (
        (["--spacing", "1.5", "--region", bounds, "--clip", "2,3,40,30"],
         ["--voxel-size", "1.5", "--bounds", bounds, "--image-region", "2,3,40,30"]),
        (["--size", "20"], ["--voxels", "20"]),
    ):  # fmt: skip
        assert main([*words, "--json", *old]) == 0
        out, err = capsys.readouterr()
        assert err.count("note: ") == err.count("\n") == len(old) // 2
        facts = run_json(capsys, *words, *new)
        assert f'"{facts["hashes"]["values"]}"' in out
    assert max(facts["volume"]["size"]) == 20


def test_bounds_are_two_corners(sweep, capsys):
    words = ["reconstruct", "phantom.igs.mha", "-o", "v.npz", "--device", "cpu"]
    facts = run_json(capsys, *words, "--voxel-size", "1", "--bounds", "-10,-5,2,10,12,8")
    assert np.abs(np.array(facts["volume"]["size"]) - (20, 17, 6)).max() <= 1
    assert np.abs(np.array(facts["volume"]["origin"]) - (-10, -5, 2)).max() <= 1
