"""The package's modules import each other along the flow of data, and never in a circle.

Imports for types count."""

import ast
import gc
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import globule as gb
import pytest

ROOT = Path(gb.__file__).parent
# Each room may import from those before it. Sub-rooms of `formats` follow it in their own order.
ROOMS = (
    "_base", "data", "formats", "formats/pictures", "formats/volumes", "formats/sweeps", "scene",
    "fluids", "pieces", "render", "volumes", "measure", "pyvista", "ultrasound", "ultrasound/plus",
    "napari", "sim", "viewer", "_demo", "cli",
)  # fmt: skip
BY_NAME = {"", "formats.registry"}  # import modules by names in a table
SHARED = {"_core", "_base", "_demo", "__version__"}  # of the whole package


class Import(NamedTuple):
    """One name that a module imports from the package: from where, and what it is called there."""

    module: str
    name: str
    alias: str


class Module(NamedTuple):
    name: str
    nodes: list[ast.AST]
    imports: list[Import]  # inside functions and for types, too


def read_modules() -> dict[str, Module]:
    paths = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        paths[".".join(p for p in parts if p != "__init__")] = path
    found = {}
    for name, path in paths.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        package = [p for p in name.split(".") if p]
        if path.name != "__init__.py":
            package.pop()
        imports, nodes = [], list(ast.walk(tree))
        for node in nodes:
            if not isinstance(node, ast.ImportFrom) or not node.level:
                continue
            above = package[: len(package) - node.level + 1]
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                inner = f"{base}.{alias.name}" if base else alias.name
                module = inner if inner in paths else base
                imports.append(Import(module, alias.name, alias.asname or alias.name))
        found[name] = Module(name, nodes, imports)
    return found


@pytest.fixture(scope="module")
def modules() -> Iterator[dict[str, Module]]:
    gc.disable()  # it would go through a million nodes again and again
    yield read_modules()
    gc.enable()


@pytest.fixture(scope="module")
def graph(modules) -> dict[str, set[str]]:
    return {m.name: {i.module for i in m.imports} - {"", m.name} for m in modules.values()}


def room(name: str) -> str | None:
    path = name.replace(".", "/") + "/"
    held = [r for r in ROOMS if path.startswith(r + "/")]
    return max(held, key=len) if held else None


def test_no_arrow_runs_against_the_flow_of_the_rooms_nor_in_a_circle(graph):
    assert {name for name in graph if room(name) is None} == {"", "__main__"}
    against = [
        f"{name} imports {other}"
        for name, others in graph.items()
        for other in others
        if room(name) and room(other) and ROOMS.index(room(other)) > ROOMS.index(room(name))
        if not other.startswith(f"{name}.")  # a package gives names of the rooms in it
    ]
    assert against == []
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


def test_modules_import_by_name_in_tables_alone_and_no_private_name(modules):
    calls = {
        m.name
        for m in modules.values()
        for node in m.nodes
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).endswith("import_module")
        and len(node.args) == 2  # relative to a package
    }
    assert calls == BY_NAME
    found = []
    for m in modules.values():
        found += [
            f"{m.name} imports {i.module}.{i.name}"
            for i in m.imports
            if i.name.startswith("_") and i.name not in SHARED
        ]
        aliases = {i.alias for i in m.imports if i.module.rpartition(".")[2] == i.name}
        for node in m.nodes:
            if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
                owner = node.value
                if isinstance(owner, ast.Name) and owner.id in aliases - SHARED:
                    found.append(f"{m.name} takes {ast.unparse(node)}")
    assert found == []
