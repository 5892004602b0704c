"""The reference is complete: every name, every command with every flag, every C++ declaration."""

from __future__ import annotations

import argparse
import importlib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs" / "site"))

import conf  # noqa: E402
import reference  # noqa: E402


def test_every_public_name_is_on_one_page():
    pages = reference.python_pages()
    text = "\n".join(text for path, text in pages.items() if not path.endswith("index.md"))
    full = {path: name for name, path in reference.FULL.items()}
    found = re.findall(r"^\.\. auto\w+:: (globule\.[\w.]+)$", text, flags=re.M)
    names = [full.get(path, path.removeprefix("globule.")) for path in found]
    also = {path for paths in reference.ALSO.values() for path in paths}
    assert sorted(n for n in names if n not in also) == sorted(reference.public())


def test_the_names_beyond_gb_exist():
    for paths in reference.ALSO.values():
        for path in paths:
            module, _, name = path.rpartition(".")
            assert getattr(importlib.import_module(f"globule.{module}"), name).__doc__


def test_every_command_has_a_page_with_every_flag():
    pages = reference.command_pages()
    commands = reference.parsers()
    assert {"render", "view", "convert", "info", "simulate", "reconstruct"} <= commands.keys()
    for words, parser in commands.items():
        text = pages[f"reference/commands/{words.replace(' ', '-')}.md"]
        for action in parser._actions:
            if action.dest == "help" or argparse.SUPPRESS in (action.dest, action.help):
                continue
            for flag in action.option_strings[-1:]:
                assert re.search(rf"^\| .*`{flag}[ `].* \|$", text, flags=re.M), flag


def test_every_declaration_of_the_headers_is_on_its_page():
    pages = reference.header_pages()
    for path in reference.HEADERS.glob("*.hpp"):
        text = pages[f"reference/headers/{path.stem}.md"]
        code = path.read_text(encoding="utf-8")
        declared = re.findall(r"^(?:class|struct|enum class) (?:GLOBULE_API )?(\w+)\b[^;]*$", code, flags=re.M)
        declared += re.findall(r"^(?:GLOBULE_API|inline|constexpr) [^=;{]*?(\w+)\(", code, flags=re.M)
        for name in declared:
            assert f"## {name}\n" in text, f"{path.name}: {name}"
        assert "private:" not in text


def test_docstrings_become_restructured_text():
    lines = ["One `Scene`s *x*.", "", "    code", "", "a: first", "b, c  both,", "    and more", ""]
    section = ["Args:", "    x: `y`", "", "It: is", "so.", ""]
    text = [*lines, *section]
    conf.docstring(None, "", "", None, None, text)
    assert text == [
        *("One :py:obj:`Scene <globule.Scene>`\\ s \\*x\\*.", "", "::", "", "    code", ""),
        *("- ``a``: first", "- ``b``, ``c``: both,", "  and more", ""),
        *("Args:", "    x: ``y``", "", "It: is", "so.", ""),
    ]
