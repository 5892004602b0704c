"""Tutorials: Markdown pages whose Python and shell blocks are the cells of a notebook."""

from __future__ import annotations

import base64
import os
import re
import sys
from pathlib import Path

import globule as gb
import nbformat
from nbclient import NotebookClient

FENCE = re.compile(r"^```(python|sh)\n(.*?)^```\n?", re.M | re.S)
FRONT_MATTER = re.compile(r"\A---\n.*?^---\n", re.M | re.S)
PATIENCE = 120  # s a cell


def is_notebook(markdown: str) -> bool:
    """Whether the page says `notebook: true` in its front matter."""
    front = FRONT_MATTER.match(markdown)
    return bool(front and re.search(r"^notebook: true$", front[0], re.M))


def to_notebook(markdown: str) -> nbformat.NotebookNode:
    """The page as a notebook without outputs."""
    text = FRONT_MATTER.sub("", markdown)
    cells, end = [], 0
    for fence in [*FENCE.finditer(text), None]:
        prose = text[end : fence.start() if fence else None].strip()
        if prose:
            cells.append(nbformat.v4.new_markdown_cell(prose))
        if fence:
            code = fence[2].strip()
            if fence[1] == "sh":
                code = re.sub(r"^(?=\S)", "!", code, flags=re.M)
            cells.append(nbformat.v4.new_code_cell(code))
            end = fence.end()
    for i, cell in enumerate(cells):
        cell["id"] = str(i)  # the same bytes at each build
    notebook = nbformat.v4.new_notebook(cells=cells)
    notebook.metadata.kernelspec = {
        "name": "python3",
        "display_name": "Python 3",
        "language": "python",
    }
    return notebook


def execute(notebook: nbformat.NotebookNode, folder: str) -> None:
    """Run all cells in `folder`; raises CellExecutionError at the first that fails."""
    where, quiet = {"metadata": {"path": folder}}, ["--log-level=ERROR"]
    client = NotebookClient(notebook, timeout=PATIENCE, resources=where, extra_arguments=quiet)
    client.execute(env=environment())
    for cell in notebook.cells:
        if cell.cell_type == "code":
            streams = [output for output in cell.outputs if "text" in output]
            shown = [output for output in cell.outputs if "text" not in output]
            for output in streams[:1]:
                output["text"] = printed("".join(part["text"] for part in streams))
            cell.outputs = streams[:1] + shown


def printed(text: str) -> str:
    """What a terminal shows in the end: progress lines that were overwritten are gone."""
    text = re.sub(r"[^\n]*\r(?!\n)", "", text.replace("\r\n", "\n"))
    return re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", text)


def environment() -> dict[str, str]:
    """The environment in which `globule`, as module and command, is this one."""
    first = {"PATH": Path(sys.executable).parent, "PYTHONPATH": Path(gb.__file__).parents[1]}
    return os.environ | {k: f"{v}{os.pathsep}{os.environ.get(k, '')}" for k, v in first.items()}


def to_page(notebook: nbformat.NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """Markdown with the outputs, and the images by file name."""
    lines, images = [], {}
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            lines += [cell.source, ""]
            continue
        language = "sh" if cell.source.startswith("!") else "python"
        lines += [f"```{language}", re.sub("^!", "", cell.source, flags=re.M), "```", ""]
        shown = ""
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                file = f"{name}-{len(images) + 1}.png"
                images[file] = base64.b64decode(data["image/png"])
                lines += [f"![]({file})", ""]
            else:
                shown += output.get("text") or data.get("text/plain", "")
        if shown.strip():
            lines += ["```text", shown.strip("\n"), "```", ""]
    return "\n".join(lines), images
