"""What MkDocs calls: generated pages, executed tutorials, the order of the pages."""

from __future__ import annotations

import posixpath
import re
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import notebooks
import reference
import yaml
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
FENCES = re.compile(r"(^ *(```|~~~).*?^ *\2 *$)", re.M | re.S)


def on_config(config: Any) -> Any:
    """The navigation: what the folders hold, as it comes."""
    config.nav = navigation()
    return config


def navigation() -> list[Any]:
    """Home, Start, How-to, Reference, Understand, Measured and the rest, for `nav`."""
    nav: list[Any] = [
        {"Home": "index.md"},
        {
            "Start": _pages(
                "start", first=("install", "first-image", "first-volume", "first-simulation")
            )
        },
        {
            "How-to": [
                "how-to/index.md",
                *({group: pages} for group, pages in _groups("how-to").items()),
            ]
        },
        {
            "Reference": [
                *_pages("reference"),
                *({title: generated(folder)} for title, folder in GENERATED.items()),
            ]
        },
        {
            "Understand": [
                *_pages("understand", first=("architecture", "conventions")),
                {"Design notes": _pages("design")},
            ]
        },
        {"Measured": "measured.md"},
        {
            "More": [
                {"Gallery": "gallery.md"},
                {"Examples": "examples.md"},
                {"Contributing": "contributing.md"},
                {"Changes": "changes.md"},
                *sorted(p.name for p in DOCS.glob("*.md") if p.stem not in NAMED),
            ]
        },
    ]
    return [entry for entry in nav if _has_pages(entry)]


NAMED = ("index", "measured", "gallery", "contributing")
GENERATED = {"Python": "python", "Commands": "commands", "C++ headers": "headers"}


def generated(folder: str) -> list[str]:
    """The generated pages of the reference in one folder, its index first."""
    found = [path for path in reference.pages() if path.startswith(f"reference/{folder}/")]
    return sorted(found, key=lambda path: not path.endswith("/index.md"))


def _pages(folder: str, first: Iterable[str] = ()) -> list[str]:
    """A folder's pages: its index, those that are named, then by name."""
    order = ["index", *first]
    paths = sorted(p.stem for p in (DOCS / folder).glob("*.md"))
    paths.sort(key=lambda stem: order.index(stem) if stem in order else len(order))
    return [f"{folder}/{stem}.md" for stem in paths]


def _groups(folder: str) -> dict[str, list[str]]:
    """A folder's pages under the `group` of their front matter, or the first word of their name."""
    groups: dict[str, list[str]] = {}
    for path in _pages(folder):
        stem = Path(path).stem
        group = _front_matter(DOCS / path).get("group") or _title(stem.partition("-")[0])
        groups.setdefault(group, []).append(path)
    return dict(sorted(groups.items()))


def _title(word: str) -> str:
    return "C++" if word == "cpp" else word.capitalize()


def _front_matter(path: Path) -> dict[str, Any]:
    found = notebooks.FRONT_MATTER.match(path.read_text(encoding="utf-8"))
    return yaml.safe_load(found[0].strip("-\n")) or {} if found else {}


def _has_pages(entry: dict[str, Any]) -> bool:
    (held,) = entry.values()
    return bool(held) if isinstance(held, list) else (DOCS / held).exists()


def on_files(files: Files, config: Any) -> Files:
    """Generated pages, and tutorials with their outputs."""
    made: dict[str, str | bytes] = dict(reference.pages())
    made["changes.md"] = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    made["examples.md"] = examples()
    made["how-to/index.md"] = tasks()
    for path in sorted((DOCS / "start").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if notebooks.is_notebook(text):
            made |= tutorial(path.stem, text)
    for path, content in made.items():
        known = files.get_file_from_path(path)
        if known:
            files.remove(known)
        files.append(File.generated(config, path, content=content))
    return files


def tutorial(name: str, text: str) -> dict[str, str | bytes]:
    """A tutorial's page with what its cells printed and drew, its images, and the notebook."""
    notebook = notebooks.to_notebook(text)
    with tempfile.TemporaryDirectory() as folder:
        notebooks.execute(notebook, folder)
    page, images = notebooks.to_page(notebook, name)
    page += f"\n[This page as a notebook]({name}.ipynb)\n"
    content: dict[str, str | bytes] = {f"start/{name}.md": page}
    content[f"start/{name}.ipynb"] = notebooks.nbformat.writes(notebook)
    return content | {f"start/{file}": data for file, data in images.items()}


def tasks() -> str:
    """The how-to pages by group, with what each one begins with."""
    lines = ["# How-to", "", "One task a page: steps, and what comes out.", ""]
    for group, paths in _groups("how-to").items():
        lines += [f"## {group}", ""]
        for path in paths:
            text = (DOCS / path).read_text(encoding="utf-8")
            title = re.search(r"^# (.+)$", text, re.M)
            lines.append(f"- [{title[1] if title else path}]({Path(path).name})")
        lines.append("")
    return "\n".join(lines)


def examples() -> str:
    """One page with the programs of the folder examples/."""
    lines = ["# Examples", "", "Each program runs by itself in an empty folder.", ""]
    for path in sorted((ROOT / "examples").glob("[0-9]*.py")):
        title = path.stem[3:].replace("_", " ")
        code = path.read_text(encoding="utf-8").rstrip()
        lines += [f"## {path.stem[:2]} {title}", "", "```python", code, "```", ""]
    return "\n".join(lines)


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Links that leave the folder docs lead to the page made of the file, or become plain text.

    A link to a file that does not exist stays, so that the strict build names it.
    """
    here = posixpath.dirname(page.file.src_uri)
    if page.file.src_uri == "changes.md":  # names pages as they were called then
        return re.sub(r"\[([^\]]*)\]\((?![a-z]+:)[^)]*\)", r"\1", markdown)

    def mend(match: re.Match[str]) -> str:
        bang, text, link = match.groups()
        target, _, anchor = link.partition("#")
        path = posixpath.normpath(posixpath.join("docs", here, target))
        if bang or re.match(r"[a-z]+:|#", link) or path.startswith("docs/"):
            return match[0]
        for start, instead in OUTSIDE.items():
            if path.startswith(start) and files.get_file_from_path(instead):
                made = posixpath.relpath(instead, here or ".")
                return f"[{text}]({made}{'#' + anchor if anchor else ''})"
        return text if (ROOT / path).exists() else match[0]

    parts = FENCES.split(markdown)
    plain = (spaced(LINK.sub(mend, part)) for part in parts[::3])
    rest = iter(parts[1::3])
    return "".join(part + next(rest, "") for part in plain)


def spaced(text: str) -> str:
    """With a blank line before each list: Python-Markdown needs one, others do not."""
    lines, in_list = [], False
    for line in text.split("\n"):
        item = re.match(r"(?:[-*]|\d+\.) ", line)
        if item and not in_list:
            lines.append("")
        in_list = bool(item) or (in_list and line.strip() != "")
        lines.append(line)
    return "\n".join(lines)


# Files outside docs that have a page on the site.
OUTSIDE = {
    "CHANGELOG.md": "changes.md",
    "README.md": "index.md",
    "examples/cpp": "reference/cpp.md",
    "examples": "examples.md",
}
