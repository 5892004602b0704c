"""XPath and XInclude, as far as writers of XDMF use them.

A path is `/Xdmf/Domain/Grid[@Name="a"][1]/*[self::Topology or self::Geometry]`, or begins with //.
"""

from __future__ import annotations

import os
import re
from typing import Any

from .errors import bad, shown
from .size import whole_file
from .vtk_parts import below
from .xml import parse_xml

_STEP = re.compile(r"(//?)([\w:.-]+|\*)((?:\[[^\[\]]*\])*)")
_MOST_FILES, _MOST_ELEMENTS, _MOST_VISITS = 8, 200_000, 20_000_000


def find_all(path: Any, root: Any, xpath: str) -> list[Any]:
    """The elements of a document at an XPath. Raises FormatError for one that is not understood."""
    found, at = [None], 0  # None: the document
    for step in _STEP.finditer(xpath.strip()):
        if step.start() != at:
            break
        at = step.end()
        found = [e for one in found for e in _step(path, root, one, step)]
    if at < len(xpath.strip()) or at == 0:
        raise bad(path, "", f"expected a path like /Xdmf/Domain/Grid[1], got {shown(xpath)}")
    return found


def _step(path: Any, root: Any, element: Any, step: re.Match) -> list[Any]:
    children = [root] if element is None else list(element)
    if step[1] == "//":
        children = [e for child in children for e in child.iter()]
    found = [e for e in children if step[2] in ("*", e.tag)]
    for text in re.findall(r"\[([^\[\]]*)\]", step[3]):
        text = text.strip()
        if text.isascii() and text.isdigit() and len(text) < 16:
            found = found[int(text) - 1 : int(text)] if int(text) else []
        elif match := re.fullmatch(r"@([\w:.-]+)\s*=\s*(\"[^\"]*\"|'[^']*')", text):
            found = [e for e in found if e.get(match[1]) == match[2][1:-1]]
        elif re.fullmatch(r"self::[\w:.-]+(\s+or\s+self::[\w:.-]+)*", text):
            tags = re.findall(r"self::([\w:.-]+)", text)
            found = [e for e in found if e.tag in tags]
        else:
            raise bad(path, "", f"expected [number], [@Name='…'] or [self::…], got {shown(text)}")
    return found


def include(path: Any, root: Any, files: tuple[str, ...] = ()) -> None:
    """Put what `xi:include` elements name in their place: elements of this document, or of files
    below its folder.

    Raises FormatError for what includes itself, and for too much of it.
    """
    n = sum(1 for _ in root.iter())
    known: dict[tuple[str, str], list[Any]] = {}
    targets: dict[int, list[Any]] = {}
    for element in [e for e in root.iter() if e.tag.rpartition(":")[2] == "include"]:
        key = element.get("href", ""), element.get("xpointer", "")
        if key not in known:
            if n * len(known) > _MOST_VISITS:
                raise bad(path, f"line {element.line}", "expected fewer different includes")
            known[key] = _targets(path, root, element, files)
        targets[id(element)] = known[key]
    if targets:
        _replace(path, root, targets, {})


def _targets(path: Any, root: Any, element: Any, files: tuple[str, ...]) -> list[Any]:
    where, href = f"line {element.line}", element.get("href", "")
    if href:
        place = below(path, href)
        if place in files or len(files) >= _MOST_FILES:
            raise bad(path, where, f"expected no include of itself, got {shown(href)}")
        root = parse_xml(place, whole_file(place, 20.0))
        here = os.path.realpath(str(path))
        include(place, root, (*files, here))
        for one in root.iter():
            one.file = one.file or place
    pointer = element.get("xpointer", "").strip()
    match = re.fullmatch(r"xpointer\((.*)\)", pointer, re.DOTALL)
    if not pointer and href:
        return [root]
    if not match:
        raise bad(path, where, f"expected xpointer(/Xdmf/…), got {shown(pointer)}")
    found = find_all(path, root, match[1])
    if not found:
        raise bad(path, where, f"expected elements at {shown(match[1])}, got none")
    return found


def _replace(path: Any, element: Any, targets: dict[int, list[Any]], sizes: dict[int, int]) -> int:
    """Elements below an element, with what is included; 0 in `sizes` where it is being counted."""
    key = id(element)
    if key in sizes:
        if not sizes[key]:
            raise bad(path, f"line {element.line}", "expected no include of itself, got one")
        return sizes[key]
    sizes[key], size = 0, 1
    children: list[Any] = []
    for child in element:
        children += targets.get(id(child), [child])
    for child in children:
        size += _replace(path, child, targets, sizes)
        if size > _MOST_ELEMENTS:
            problem = f"expected at most {_MOST_ELEMENTS:,} included elements, got more"
            raise bad(path, f"line {element.line}", problem)
    element[:] = children
    sizes[key] = size
    return size
