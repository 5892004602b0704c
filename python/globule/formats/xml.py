"""XML for every format that uses it: no declarations, hence no entities, and lines to report."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

from .errors import FormatError, bad

_MOST_NESTED = 32
_MOST_ELEMENTS = 200_000  # each takes some hundred bytes of memory, and its tag may have four


class Element(ElementTree.Element):
    """An element that knows the `line` of the file, from 1, on which it starts."""

    line = 0
    file: Any = None  # of an element that another file includes


def parse_xml(path: Any, text: bytes) -> Any:
    """The root `Element` of an XML text.

    A DOCTYPE may name a definition, which is not opened. Raises FormatError naming the line: for
    text that is not XML, declarations in a DOCTYPE, entities, and more than 32 nested or 200,000
    elements.
    """
    builder: Any = ElementTree.TreeBuilder(element_factory=Element)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    depth = n_elements = 0

    def refuse(*_: Any) -> None:
        where = f"line {parser.CurrentLineNumber}"
        raise bad(path, where, "expected a DOCTYPE without declarations, and no entities, got one")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, n_elements
        depth, n_elements = depth + 1, n_elements + 1
        if depth > _MOST_NESTED:
            where = f"line {parser.CurrentLineNumber}"
            raise bad(path, where, f"expected at most {_MOST_NESTED} nested elements, got more")
        if n_elements > _MOST_ELEMENTS:
            where = f"line {parser.CurrentLineNumber}"
            raise bad(path, where, f"expected at most {_MOST_ELEMENTS:,} elements, got more")
        builder.start(tag, attributes).line = parser.CurrentLineNumber

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.EntityDeclHandler = parser.SkippedEntityHandler = refuse
    parser.ElementDeclHandler = parser.AttlistDeclHandler = parser.NotationDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        where = f"line {error.lineno}, column {error.offset + 1}"
        raise bad(path, where, f"expected XML, got {expat.ErrorString(error.code)}") from None
    except (LookupError, ValueError) as error:  # an encoding that Python does not know
        if isinstance(error, FormatError):
            raise
        raise bad(path, "line 1", f"expected XML, got {error}") from None
    return builder.close()
