"""The pages of the reference that are made from the code: Python, commands, C++ headers.

Each function returns {path below docs: Markdown}. Sphinx's autodoc fills the Python pages from
docstrings.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import re
import textwrap
from pathlib import Path

import globule as gb
from globule._base.settings import Each, Setting, schema_of, settings_of
from globule.cli import build_parser
from globule.sim.instruments import Key
from globule.sim.scene_bodies import Boundary, Fluid, Solid
from globule.sim.scene_file import SceneFile
from globule.viewer.state import state_schema

ROOT = Path(__file__).resolve().parents[2]
HEADERS = ROOT / "include" / "globule"

# The rooms of the package: file name, title, what the page is about.
AREAS = {
    "scene": (
        "scene",
        "Particles and scenes",
        "Particles, their octree, and the field that they make.",
    ),
    "render": (
        "render",
        "Images",
        "From a scene to an image: camera, light, materials, cuts, movies.",
    ),
    "formats": ("files", "Files", "Readers and writers of particles, meshes and tomographies."),
    "fluids": (
        "fluids",
        "Fluids",
        "Which surface shows a fluid's particles, and what makes it smoother.",
    ),
    "volumes": ("volumes", "Volumes", "Regular grids of voxels: files, slices, iso-surfaces."),
    "measure": (
        "measure",
        "Measurements",
        "Samples, gauges, meshes, volumes and areas, projections.",
    ),
    "ultrasound": (
        "ultrasound",
        "Ultrasound",
        "Tracked sweeps and their reconstruction to a volume.",
    ),
    "sim": ("simulation", "Simulation", "Fluids, tissue and instruments."),
    "viewer": ("viewer", "Viewer", "The live viewer in the browser."),
    "_base": (
        "package",
        "Package",
        "The folders of the installed C++ library, and definitions that all areas share.",
    ),
}
FULL = {"render": "globule.render.render.render"}  # `globule.render` is a package, too
TOGETHER = {"data": "scene", "pieces": "scene"}  # rooms that have one page
ELSEWHERE = {"colorize": "render"}  # names that stand on another page than their module's
# What calls return and take without being a name of `gb`.
ALSO = {
    "scene": ["pieces.pieces.Pieces", "scene.octree.Octree", "scene.thesis.Thesis"],
    "render": ["render.frame.Picked", "render.views.Views"],
    "sim": [
        "sim.arrays.Arrays",
        "sim.operate.BondedTissue",
        "sim.tools.Tools",
        "sim.tools.Tool",
        "sim.steer.Steer",
        "sim.foam.Foam",
        "sim.record.Record",
        "sim.emitter.Emitter",
    ],
    "viewer": ["viewer.app.Viewer"],
}


def public() -> list[str]:
    """The names of `gb` and of its spaces: "Scene", "measure.sample" …"""
    own = [name for name in gb.__all__ if not inspect.ismodule(getattr(gb, name))]
    spaces = [name for name in gb.__all__ if name not in own]
    return own + [f"{space}.{name}" for space in spaces for name in getattr(gb, space).__all__]


def room(name: str) -> str:
    """The room of the package that a public name is documented with."""
    space, _, own = name.rpartition(".")
    module = space or getattr(gb, own).__module__.split(".")[1]
    return ELSEWHERE.get(name, TOGETHER.get(module, module))


def python_pages() -> dict[str, str]:
    """One page per area; together they hold every public name."""
    pages, rows = {}, []
    for key, (file, title, about) in AREAS.items():
        names = sorted(
            (n for n in public() if room(n) == key),
            key=lambda n: ("." in n, n.rpartition(".")[2][0].islower(), n),
        )
        lines = [f"# {title}", "", about, ""]
        for name in names:
            lines += _directive(FULL.get(name, f"globule.{name}"))
        if key in ALSO:
            lines += ["## Beyond `gb`", "", "Import these from their module.", ""]
            for path in ALSO[key]:
                lines += _directive(f"globule.{path}")
        pages[f"reference/python/{file}.md"] = "\n".join(lines)
        listed = ", ".join(f"{{py:obj}}`{n} <{FULL.get(n, f'globule.{n}')}>`" for n in names)
        rows.append(f"| [{title}]({file}.md) | {listed} |")
    files = [file for file, _, _ in AREAS.values()]
    mistakes = (gb.__doc__ or "").partition("\n\n")[2]
    about = f"All names of `import globule as gb` and of its spaces. {mistakes}"
    pages["reference/python/index.md"] = _index("Python", about, "area | names", rows, files)
    return pages


def _directive(path: str) -> list[str]:
    """What Sphinx's autodoc turns into the documentation of one name."""
    module, _, name = path.rpartition(".")
    thing = getattr(importlib.import_module(module), name)
    kind = "class" if inspect.isclass(thing) else "function" if callable(thing) else "data"
    kind = "module" if inspect.ismodule(thing) else kind
    return ["```{eval-rst}", f".. auto{kind}:: {path}", "```", ""]


def _index(title: str, about: str, header: str, rows: list[str], files: list[str]) -> str:
    """A page with a table of pages."""
    tree = ["```{toctree}", ":hidden:", "", *files, "```", ""]
    rule = "|---|---|"
    return "\n".join([f"# {title}", "", about, "", f"| {header} |", rule, *rows, "", *tree])


def parsers(parser: argparse.ArgumentParser | None = None) -> dict[str, argparse.ArgumentParser]:
    """Every command's parser by its words: "render", "bench thesis" …"""
    parser = parser or build_parser()
    found = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, sub in action.choices.items():
                found[name] = sub
                found |= {f"{name} {deeper}": p for deeper, p in parsers(sub).items()}
    return found


def command_pages() -> dict[str, str]:
    """One page per command, with every flag of its parser."""
    pages, rows = {}, []
    for words, parser in parsers().items():
        file = words.replace(" ", "-") + ".md"
        pages[f"reference/commands/{file}"] = _command(words, parser)
        rows.append(f"| [`globule {words}`]({file}) | {_cell(_summary(parser))} |")
    about = (
        "`globule COMMAND --help` prints the flags of everyday use, `--help-all` prints all. "
        "These pages list all."
    )
    files = [words.replace(" ", "-") for words in parsers()]
    title = "command | what it does"
    pages["reference/commands/index.md"] = _index("Commands", about, title, rows, files)
    return pages


def _summary(parser: argparse.ArgumentParser) -> str:
    return " ".join((parser.description or "").strip().split("\n\n")[0].split())


def _command(words: str, parser: argparse.ArgumentParser) -> str:
    lines = [
        f"# globule {words}",
        "",
        (parser.description or "").strip(),
        "",
        "```text",
        _usage(words, parser),
        "```",
        "",
    ]
    for group in parser._action_groups:
        rows = [_row(action) for action in group._group_actions if _shown(action)]
        if rows:
            title = {"positional arguments": "Arguments", "options": "Options"}.get(
                group.title or "", group.title
            )
            lines += [f"## {title[:1].upper()}{title[1:]}", "", group.description or "", ""]
            lines += ["| flag | meaning |", "|---|---|", *rows, ""]
    lines += [getattr(parser, "notes", ""), ""]
    examples = getattr(parser, "examples", "") or (parser.epilog or "").partition("\n")[2]
    if examples:
        lines += ["## Examples", "", "```sh", textwrap.dedent(examples).strip(), "```", ""]
    return "\n".join(lines)


def _usage(words: str, parser: argparse.ArgumentParser) -> str:
    """The command's words, what must be given, and "[options]"."""
    needed, options = [], ""
    for action in parser._actions:
        if not action.option_strings:
            needed.append(parser._get_formatter()._format_args(action, action.dest.upper()))
        elif action.required:
            needed.append(f"{action.option_strings[0]} {_value(action)}")
        elif _shown(action):
            options = "[options]"
    return " ".join(["globule", words, *needed, options]).strip()


def _shown(action: argparse.Action) -> bool:
    """Whether it is neither the help nor a list of commands."""
    kinds = (argparse._HelpAction, argparse._SubParsersAction)
    return not isinstance(action, kinds) and action.dest != argparse.SUPPRESS


def _row(action: argparse.Action) -> str:
    value = _value(action)
    if action.nargs == 0:
        flags = [f"`{flag}`" for flag in action.option_strings]
    else:
        flags = [f"`{flag} {value}`" for flag in action.option_strings] or [f"`{value}`"]
    text = action.help or ""
    if "%(" in text:
        text %= {**vars(action), "prog": "globule"}
    return f"| {_cell(', '.join(flags))} | {_cell(text.replace('%%', '%'))} |"


def _value(action: argparse.Action) -> str:
    names = ",".join(map(str, action.choices)) if action.choices else ""
    value = action.metavar or ("{" + names + "}" if names else action.dest.upper())
    return " ".join(value) if isinstance(value, tuple) else value


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def header_pages() -> dict[str, str]:
    """One page per public C++ header, from its comments."""
    pages, rows = {}, []
    for path in sorted(HEADERS.glob("*.hpp")):
        about, entities = read_header(path.read_text(encoding="utf-8"))
        lines = [
            f"# {path.name}",
            "",
            about,
            "",
            f"```cpp\n#include <globule/{path.name}>\n```",
            "",
        ]
        for name, words, code in entities:
            lines += [f"## {name}", "", words, "", f"```cpp\n{code}\n```", ""]
        pages[f"reference/headers/{path.stem}.md"] = "\n".join(lines)
        rows.append(f"| [`globule/{path.name}`]({path.stem}.md) | {_cell(about)} |")
    about = "`#include <globule/globule.hpp>` includes all but `mpi.hpp`, which needs MPI."
    files = sorted(path.stem for path in HEADERS.glob("*.hpp"))
    title = "header | what it holds"
    pages["reference/headers/index.md"] = _index("C++ headers", about, title, rows, files)
    return pages


def read_header(text: str) -> tuple[str, list[tuple[str, str, str]]]:
    """A header's first comment, and (name, comment, code) of what it declares.

    A declaration ends where its braces are closed and its last line ends in ; or }. The comment
    lines right above belong to it.
    """
    about = " ".join(re.match(r"(?://.*\n)*", text)[0].replace("//", "").split())
    body = re.sub(r"^#.*(?:\\\n.*)*\n", "", text, flags=re.M)
    inside = re.findall(
        r"^namespace globule(?:::\w+)? \{\n(.*?)^\} +// namespace", body, flags=re.M | re.S
    )
    entities = []
    for words, code in _declarations("\n".join(inside)):
        kind = re.match(
            r"(?:template\s*<.*?>\s*)?(class|struct|enum(?: class)?)\s+(?:GLOBULE_API\s+)?(\w+)",
            code,
        )
        if kind and code.rstrip().endswith("};"):
            public = re.sub(r"^private:.*(?=^};)", "", code, flags=re.M | re.S)
            entities.append((kind[2], words, public))
        elif not kind:
            entities.append((_name(code), words, code))
    return about, entities


def _declarations(text: str) -> list[tuple[str, str]]:
    found, words, code, depth = [], [], [], 0
    for line in text.splitlines():
        bare = line.strip()
        if not code and (not bare or re.fullmatch(r"}?;?|public:", bare)):
            words = words if bare else []
        elif not code and bare.startswith("//"):
            words.append(re.sub(r"^//[/!]? ?", "", bare))
        else:
            code.append(line.rstrip())
            plain = re.sub(r"//.*|\"[^\"]*\"", "", line)
            depth += sum(plain.count(c) for c in "{(") - sum(plain.count(c) for c in "})")
            if depth == 0 and re.search(r"[;}]\s*$", plain):
                found.append((_escaped(words), "\n".join(code)))
                words, code = [], []
    return found


def _escaped(words: list[str]) -> str:
    return re.sub(r"([*_<])", r"\\\1", "\n".join(words))


def _name(code: str) -> str:
    plain = re.sub(r"//.*|template\s*<[^>]*>|\[\[.*?\]\]", "", code)
    match = re.search(r"(operator\S+?|~?\w+)\s*\(", plain) or re.search(
        r"using (\w+)|(\w+)\s*(?:\{|=|;)", plain
    )
    return next(group for group in match.groups() if group) if match else plain.split()[-1]


def scene_pages() -> dict[str, str]:
    """The page of a scene's keys, with a table for each of its tables; its JSON Schema, and that of
    a state file of the viewer."""
    parts = {"The scene": SceneFile}
    for name, one in settings_of(SceneFile).items():
        if isinstance(one.kind, Each):
            parts[f"[[{name}]]"] = one.kind.kind
        elif isinstance(one.kind, type):
            parts[f"[{name}]"] = one.kind
    parts["Key frames"] = Key
    lines = []
    for title, table in parts.items():
        about = "" if table is SceneFile else " ".join((table.__doc__ or "").split())
        lines += [f"## {title}", "", about, "", *_key_rows({"": table}), ""]
    known = settings_of(Fluid) | settings_of(Boundary) | settings_of(Solid)
    shapes = {name: one.kind for name, one in known.items() if isinstance(one.kind, type)}
    lines += ["## Shapes and files", "", *_key_rows(shapes)]
    text = (ROOT / "docs/reference/scene-keys.md").read_text(encoding="utf-8")
    found = {"reference/scene-keys.md": text.replace("<!-- tables of keys -->", "\n".join(lines))}
    for file, made in (("scene", schema_of(SceneFile)), ("state", state_schema())):
        draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
        found[f"reference/{file}.schema.json"] = json.dumps(draft | made, indent=1)
    return found


def _key_rows(tables: dict[str, type]) -> list[str]:
    """A row for all keys of one meaning, those that must be given first and bold."""
    lines = ["| key | meaning | unit, limits | default |", "|---|---|---|---|"]
    for title, table in tables.items():
        rows: dict[tuple[str, ...], list[str]] = {}
        for name, one in sorted(settings_of(table).items(), key=lambda item: not item[1].required):
            limits = "" if isinstance(one.kind, type) else one.kind.limits
            unit = ", ".join(part for part in (one.unit, limits) if part)
            cells = _cell(one.help), unit, one.usual or _toml(one)
            rows.setdefault(cells, []).append(f"**{name}**" if one.required else name)
        first = f"{title}: " if title else ""
        lines += [f"| {first}{', '.join(names)} | {' | '.join(c)} |" for c, names in rows.items()]
    return lines


def _toml(one: Setting) -> str:
    """A default as a scene has it."""
    if one.required or (isinstance(one.kind, type) and one.default is ...):
        return ""
    if one.default in (None, ..., ""):
        return "none"
    if isinstance(one.default, tuple):
        return f"[{', '.join(f'{v:g}' for v in one.default)}]"
    return f"{one.default:g}" if isinstance(one.default, float) else json.dumps(one.default)


def pages() -> dict[str, str]:
    """All generated pages of the reference."""
    return {**python_pages(), **command_pages(), **header_pages(), **scene_pages()}
