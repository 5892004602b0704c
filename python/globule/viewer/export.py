"""What is seen as a Jupyter notebook."""

from __future__ import annotations

import json
from typing import Any

INTRODUCTION = """\
# {title}

These cells make the image that the viewer showed. They need globule{more}.
"""
SHOW = """\
from IPython.display import Image

Image("picture.png")
"""


def notebook(title: str, command: str, code: str) -> str:
    """A Jupyter notebook (nbformat 4.5) as text.

    Args:
        title: heading.
        command: the `globule render` command that makes the same image.
        code: the Python program, which writes picture.png.
    """
    command = command.partition("  # ")[0]
    needed = command.partition(" && ")[0] if " && " in command else ""
    more = f" and the files of `{needed}`" if needed else ""
    cells = [
        ("markdown", INTRODUCTION.format(title=title, more=more)),
        ("code", code),
        ("code", SHOW),
        ("markdown", f"In a terminal, this command makes the same image:\n\n```sh\n{command}\n```\n"),
    ]
    facts = {
        "cells": [_cell(i, kind, text) for i, (kind, text) in enumerate(cells)],
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(facts, indent=1) + "\n"


def _cell(number: int, kind: str, text: str) -> dict[str, Any]:
    cell: dict[str, Any] = {
        "cell_type": kind,
        "id": f"cell-{number}",
        "metadata": {},
        "source": text.rstrip("\n").splitlines(keepends=True),
    }
    if kind == "code":
        cell |= {"execution_count": None, "outputs": []}
    return cell
