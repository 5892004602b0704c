"""All flags of all commands: one meaning each, help with the default, words refused."""

import argparse
import functools
import re
import shutil
import subprocess
from collections.abc import Iterator

import numpy as np
import pytest
from cli_helpers import output_of, refused, run_json
from globule.cli import build_parser
from globule.cli.shared import UserError
from waiting import PATIENCE

LONG = ("render", "figure", "view", "simulate", "reconstruct")


def parsers(parser: argparse.ArgumentParser | None = None) -> Iterator[argparse.ArgumentParser]:
    """The parser of `globule`, and of its commands."""
    parser = parser or build_parser()
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from parsers(command)


def flags() -> list[tuple[str, argparse.Action]]:
    """Command and action of every flag."""
    return [(parser.prog, action) for parser in parsers() for action in parser._actions if action.option_strings]


def sentence(action: argparse.Action) -> str:
    """The help without what is special to a command, which stands in parentheses."""
    return re.split(r" \(|; (?=may be)", action.help)[0]


def test_a_flag_means_the_same_in_every_command():
    known: dict[str, tuple] = {}
    shared = set()
    for command, action in flags():
        for name in action.option_strings:
            kind = getattr(action.type, "__qualname__", action.type)
            if isinstance(kind, functools.partial):
                kind = (kind.func, kind.args, *kind.keywords.items())
            facts = (sentence(action), action.metavar, kind)
            assert known.setdefault(name, facts) == facts, f"{command} {name}"
            if known[name] is not facts:
                shared.add(name)
    assert {"--clip", "--size", "--level", "-o", "--device", "--threads", "--json"} <= shared


def lacks(action: argparse.Action) -> str:
    """What the help of a flag should say and does not; "" if nothing."""
    text = action.help
    if not text or text[-1] == ".":
        return "a text without a full stop"
    if action.nargs == 0 and not isinstance(action, argparse.BooleanOptionalAction):
        return ""
    default = re.search(r"default: (.*)\)", text)
    if not (default or action.required or "SHELL" in action.metavar):
        return "a default"
    value = action.default
    if value is not None and value != []:
        words = "x" if action.dest == "size" else ","
        shown = words.join(f"{v:g}" for v in value) if isinstance(value, tuple) else f"{value}"
        shown = {"0": "all cores"}.get(shown, re.sub(r"\.0$", "", shown))
        if not default[1].startswith(shown):
            return f"the default {shown}"
    unnamed = [c for c in action.choices or () if not re.search(rf"\b{re.escape(str(c))}\b", text)]
    return f"the choices {unnamed}" if unnamed and action.metavar else ""


def test_help_says_the_default():
    known = flags()
    assert len(known) > 350
    problems = [(command, a.option_strings, lacks(a)) for command, a in known if lacks(a)]
    assert problems == []


def test_a_word_that_is_no_value_is_refused_with_the_name_of_the_flag():
    """All flags that take a number, numbers, a color or one of some words."""
    wrong, n = [], 0
    for parser in parsers():
        for action in parser._actions:
            if not action.option_strings or action.nargs == 0:
                continue
            any_text = action.type in (None, str) or "FILE" in (action.metavar or "")
            if any_text and not action.choices:
                continue
            flag, n = action.option_strings[-1], n + 1
            for word in ("?", "1,x"):
                try:
                    parser.parse_args([flag, word])
                    wrong.append((parser.prog, flag, word))
                except UserError as error:
                    if flag not in str(error) or "\n" in str(error):
                        wrong.append((parser.prog, flag, word, str(error)))
    assert n > 200
    assert wrong == []


@pytest.mark.parametrize("command", LONG)
def test_help_fits_on_a_screen_and_help_all_has_all(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    short = output_of(capsys, command, "--help").out
    assert short.count("\n") <= 40
    assert max(map(len, short.splitlines())) <= 80
    assert "--help-all" in short
    assert f"\n  globule {command} " in short
    full = output_of(capsys, command, "--help-all").out
    names = {n for c, a in flags() if c == f"globule {command}" for n in a.option_strings}
    assert names > {"--device", "--threads"}
    for name in names:
        assert re.search(rf"{name}\b", full), name
    assert "--threads" not in short
    assert full.count("\n") > short.count("\n")


def test_bounds_are_two_corners(sweep, capsys):
    words = ["reconstruct", "phantom.igs.mha", "-o", "v.npz", "--device", "cpu"]
    facts = run_json(capsys, *words, "--voxel-size", "1", "--bounds", "-10,-5,2,10,12,8")
    assert np.abs(np.array(facts["volume"]["size"]) - (20, 17, 6)).max() <= 1
    assert np.abs(np.array(facts["volume"]["origin"]) - (-10, -5, 2)).max() <= 1


# Scripts for shells, and what bash completes


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_a_script_for_each_shell(shell, folder, capsys):
    pytest.importorskip("shtab")
    out, err = output_of(capsys, "--print-completion", shell)
    assert err == ""
    assert "globule" in out
    assert "reconstruct" in out
    assert "bash" in refused(capsys, "--print-completion", "fish")
    if shutil.which(shell):
        done = subprocess.run([shell, "-n"], input=out, text=True, capture_output=True)
        assert done.returncode == 0, done.stderr


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize(
    ("typed", "expected", "absent"),
    [
        (["globule", "re"], {"render", "reconstruct"}, {"view"}),
        (["globule", "render", "--oct"], {"--octree", "--octree-level"}, {"--device"}),
        (["globule", "render", "spl"], {"splash.npz"}, {"other.npz"}),
        (["globule", "render", "splash.npz", "--state", "v"], {"view.toml"}, set()),
        (["globule", "render", "splash.npz", "--root", ""], {"exact", "march", "bezier"}, set()),
        (["globule", "reconstruct", "--vox"], {"--voxel-size", "--voxels"}, set()),
    ],
    ids=lambda value: " ".join(value[1:]) if isinstance(value, list) else "",
)
def test_bash(typed, expected, absent, folder, capsys):
    pytest.importorskip("shtab")
    for name in ("splash.npz", "other.npz", "view.toml"):
        (folder / name).write_text("")
    (folder / "completion.bash").write_text(output_of(capsys, "--print-completion", "bash").out)
    words = " ".join(f"'{word}'" for word in typed)
    script = f"""
source completion.bash
COMP_WORDS=({words})
COMP_CWORD={len(typed) - 1}
"$(complete -p globule | sed 's/.*-F \\([^ ]*\\).*/\\1/')"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    done = subprocess.run(["bash", "--norc", "-c", script], capture_output=True, text=True, timeout=PATIENCE)
    assert done.stderr == ""
    assert done.returncode == 0
    found = {word.strip() for word in done.stdout.splitlines()}
    assert expected <= found
    assert not absent & found
