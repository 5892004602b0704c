"""Sphinx's settings, and how docstrings become its reStructuredText."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import globule as gb

project = "globule"
copyright = "the globule contributors"
version = release = gb.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_heading_anchors = 4
suppress_warnings = ["myst.header"]  # the changelog's sections

autodoc_default_options = {"members": True, "inherited-members": "tuple,str,int,Exception"}
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}  # not the many types that it stands for
napoleon_use_rtype = False
add_module_names = False
python_maximum_signature_line_length = 90
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_title = "globule"
html_logo = "static/favicon.svg"
html_favicon = "static/favicon.svg"
html_static_path = ["static"]
html_css_files = ["globule.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_search_summary = False  # a page from disk may not fetch others
html_theme_options = {
    "header_links_before_dropdown": 7,
    "logo": {"text": "globule"},
    "navbar_align": "left",
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "show_nav_level": 2,
}
html_sidebars = {page: [] for page in ("index", "measured", "gallery")}

FIELD = re.compile(r"(\w+(?:, \w+)*)(?:: | {2,})(\S.*)")


def blocks(lines: list[str]) -> Iterator[str]:
    """Fields, one `name: text` or `name  text` a line, as lists; indented paragraphs as code."""
    paragraph: list[str] = []
    in_section = False
    for line in [*lines, ""] if lines[-1:] != [""] else lines:
        if line.strip():
            in_section |= bool(re.fullmatch(r"[A-Z]\w+:", line))
            paragraph.append(line)
        else:
            if paragraph and not in_section and paragraph[0].startswith("    "):
                yield from ("::", "")
            yield from (*_items(paragraph), line)
            paragraph = []


def _items(paragraph: list[str]) -> list[str]:
    items: list[str] = []
    for line in paragraph:
        field = FIELD.fullmatch(line)
        if field:
            names = ", ".join(f"`{name}`" for name in field[1].split(", "))
            items.append(f"- {names}: {field[2]}")
        elif items and line.startswith("  "):
            items.append("  " + line.strip())
        else:
            return paragraph
    return items


def marked(text: str) -> str:
    """With code as links and literals, and what else reStructuredText takes for markup escaped."""
    parts = re.split(r"`([^`]+)`", text)
    parts[::2] = [re.sub(r"([*|]|(?<=\w)_(?!\w))", r"\\\1", part) for part in parts[::2]]
    for i in range(1, len(parts), 2):
        code = " ".join(parts[i].split())
        name = code.removeprefix("gb.").removeprefix("globule.")
        known = name in gb.__all__
        text = f":py:obj:`{code} <globule.{name}>`" if known else f"``{code}``"
        parts[i] = text + "\\ " * parts[i + 1][:1].isalnum()  # `Layer`s
    return "".join(parts)


def docstring(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Napoleon reads the result."""
    lines[:] = marked("\n".join(blocks(lines))).split("\n")


def signature(app: Any, what: str, name: str, thing: Any, options: Any, *parts: str) -> Any:
    """Names of type aliases as the code has them."""
    return [part and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", part) for part in parts]


def skip(app: Any, what: str, name: str, thing: Any, skipped: bool, options: Any) -> bool | None:
    """Fields of named tuples say no more than their class."""
    return True if (getattr(thing, "__doc__", None) or "").startswith("Alias for field") else None


def setup(app: Any) -> None:
    """What Sphinx calls first."""
    app.connect("autodoc-process-docstring", docstring, priority=100)
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-skip-member", skip)
