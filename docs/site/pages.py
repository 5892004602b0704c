"""The site's pages: those of docs/, those made of the code, and an index for each section."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path

import notebooks
import reference

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
OUTSIDE = {  # files that have a page elsewhere on the site; what else is outside becomes plain text
    "README.md": "index.md",
    "CHANGELOG.md": "changes.md",
    "examples": "examples.md",
    "examples/cpp": "reference/cpp.md",
}
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
SECTIONS = {  # title: its pages first, in this order; the folder's others follow by name
    "start": ("Start", ["install", "first-image", "first-volume", "first-simulation"]),
    "how-to": ("How-to", []),
    "reference": ("Reference", ["python/index", "commands/index", "headers/index"]),
    "understand": ("Understand", ["architecture", "conventions"]),
}
GROUPS = {"cpp": "C++", "files": "Files"}
GROUPS |= dict.fromkeys(("paraview", "blender", "slicer"), "Other programs")


def write(folder: Path) -> None:
    """All sources of the site, into an empty folder."""
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns("site", "*.py"), dirs_exist_ok=True)
    made = {**reference.pages(), "examples.md": examples(), "index.md": home()}
    made["changes.md"] = at_docs(ROOT / "CHANGELOG.md")
    rest = {path.stem for path in DOCS.glob("*.md")} - {"measured", "gallery"}
    made["more.md"] = "# More\n" + toctree([*sorted(rest), "examples", "changes"])
    for section in SECTIONS:
        made[f"{section}/index.md"] = index(section)
    for path in sorted((DOCS / "start").glob("*.md")):
        text = path.read_text(encoding="utf-8")
        if notebooks.is_notebook(text):
            made |= tutorial(path.stem, text)
    for path, content in made.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, bytes):
            (folder / path).write_bytes(content)
        else:
            (folder / path).write_text(content, encoding="utf-8")


def at_docs(path: Path) -> str:
    """A page of the repository's folder, with links as from docs/; each must lead to a file."""

    def mend(match: re.Match[str]) -> str:
        bang, text, link = match.groups()
        name, sign, anchor = link.partition("#")
        if ":" in name or not name:
            return match[0]
        if not (path.parent / name).exists():
            raise FileNotFoundError(f"{path.name}: no file for the link {link}")
        inside = name.removeprefix("docs/") if name.startswith("docs/") else OUTSIDE.get(name)
        if inside and (ROOT / name).is_dir() and name.startswith("docs/"):
            inside += "/index.md"
        return f"{bang}[{text}]({inside}{sign}{anchor})" if inside else text

    return LINK.sub(mend, path.read_text(encoding="utf-8"))


def home() -> str:
    """README.md with the site's sections."""
    tabs = [*(f"{section}/index" for section in SECTIONS), "measured", "gallery", "more"]
    return at_docs(ROOT / "README.md") + toctree(tabs, hidden=True)


def index(section: str) -> str:
    """A section's page: a list of its pages."""
    title, first = SECTIONS[section]
    text = f"# {title}\n\n"
    if section == "how-to":
        for group, pages in groups().items():
            text += toctree(pages, caption=group)
        return text
    stems = sorted(path.stem for path in (DOCS / section).glob("*.md") if path.stem not in first)
    text += toctree([*first, *stems])
    if section == "understand":
        notes = sorted(path.stem for path in (DOCS / "design").glob("*.md"))
        text += toctree([f"../design/{stem}" for stem in notes], caption="Design notes")
    return text


def groups() -> dict[str, list[str]]:
    """The how-to pages under the first word of their name."""
    found: dict[str, list[str]] = {}
    for path in sorted((DOCS / "how-to").glob("*.md")):
        word = path.stem.partition("-")[0]
        found.setdefault(GROUPS.get(word, word.capitalize()), []).append(path.stem)
    return found


def toctree(pages: list[str], caption: str = "", hidden: bool = False) -> str:
    """A list of pages, for Sphinx."""
    options = [":maxdepth: 1"] + [f":caption: {caption}"] * bool(caption) + [":hidden:"] * hidden
    return "\n".join(["", "```{toctree}", *options, "", *pages, "```", ""])


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


def examples() -> str:
    """One page with the programs of the folder examples/."""
    lines = ["# Examples", "", "Each program runs by itself in an empty folder.", ""]
    for path in sorted((ROOT / "examples").glob("[0-9]*.py")):
        title = path.stem[3:].replace("_", " ")
        code = path.read_text(encoding="utf-8").rstrip()
        lines += [f"## {path.stem[:2]} {title}", "", "```python", code, "```", ""]
    return "\n".join(lines)
