"""The package's modules import each other along the flow of data, and never in a circle."""

from __future__ import annotations

import ast
from pathlib import Path

import globule as gb
import pytest

ROOT = Path(gb.__file__).parent
# Each room may import from those before it. Sub-rooms of `formats` follow it in their own order.
ROOMS = (
    "_base",
    "scene",
    "formats",
    "formats/pictures",
    "formats/volumes",
    "formats/sweeps",
    "render",
    "pieces",
    "volumes",
    "measure",
    "pyvista",
    "ultrasound",
    "ultrasound/plus",
    "napari",
    "sim",
    "viewer",
    "_demo",
    "cli",
)


def modules() -> dict[str, Path]:
    """Every module by its dotted name below the package; a package by its folder's."""
    found = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(p for p in parts if p != "__init__")] = path
    return found


def imports(name: str, path: Path, known: dict[str, Path]) -> set[str]:
    """What a module imports of the package, inside functions too, but not for types alone."""
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    package = [p for p in package if p]
    found = set()
    for node in runtime_nodes(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        above = package[: len(package) - node.level + 1]
        base = ".".join([*above, *([node.module] if node.module else [])])
        for alias in node.names:
            inner = f"{base}.{alias.name}" if base else alias.name
            found.add(inner if inner in known else base)
    return found - {"", name}


def runtime_nodes(tree: ast.AST):
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from runtime_nodes(node)


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    known = modules()
    return {name: imports(name, path, known) for name, path in known.items()}


def room(name: str) -> str | None:
    path = name.replace(".", "/") + "/"
    held = [r for r in ROOMS if path.startswith(r + "/")]
    return max(held, key=len) if held else None


def test_every_module_has_a_room(graph):
    assert {name for name in graph if room(name) is None} == {"", "__main__"}


def test_no_arrow_runs_against_the_flow(graph):
    against = [
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in others
        if room(name) and room(other) and ROOMS.index(room(other)) > ROOMS.index(room(name))
    ]
    assert against == []


def test_no_circle(graph):
    done, path = set(), []

    def visit(name: str) -> None:
        if name in path:
            pytest.fail("circle: " + " -> ".join([*path[path.index(name) :], name]))
        if name in done:
            return
        path.append(name)
        for other in sorted(graph[name]):
            visit(other)
        done.add(path.pop())

    for name in graph:
        if name:  # the package itself imports all
            visit(name)
