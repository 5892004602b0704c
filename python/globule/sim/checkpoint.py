"""Checkpoints: a simulation's whole state in one .npz file, from which it goes on bit by bit."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np

from .._base.structured import parse_json
from ..formats.numpy_format import read_archive, write_arrays

VERSION = 8


def path_of(name: str | os.PathLike[str]) -> str:
    """The path of a state's file: its name, with .npz at the end."""
    name = os.fspath(name)
    if not os.path.basename(name):
        raise ValueError(f"name: expected a file's name, got {name!r}")
    return name if name.lower().endswith(".npz") else f"{name}.npz"


def save(name: str | os.PathLike[str], arrays: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
    """Write arrays and facts (what JSON can hold); the file appears whole or not at all."""
    if os.path.isdir(name):
        raise IsADirectoryError(f"{os.fspath(name)}: expected a file, got a folder")
    words = json.dumps({"version": VERSION, **facts})
    content: dict[str, Any] = {"_facts": np.frombuffer(words.encode(), np.uint8), **arrays}
    write_arrays(path_of(name), content)


def load(name: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays and facts of a checkpoint.

    Raises:
        OSError: a file that cannot be read.
        ValueError: a file that is no checkpoint, or one of another version.
    """
    path = path_of(name)
    if path != os.fspath(name) and os.path.isfile(name) and not os.path.exists(path):
        expected = "expected a checkpoint of a simulation, .npz"
        raise ValueError(f"{os.fspath(name)}: {expected}, got another file")
    with open(path, "rb"):  # the usual OSErrors
        pass
    try:
        arrays = read_archive(path)
        facts = dict(parse_json(arrays.pop("_facts").tobytes()))
    except (ValueError, KeyError, TypeError) as error:
        got = "another archive" if isinstance(error, KeyError) else str(error).removeprefix(f"{path}: ")
        raise ValueError(f"{path}: expected a checkpoint of a simulation, got {got}") from None
    if facts.pop("version", None) != VERSION:
        raise ValueError(f"{path}: expected version {VERSION} of a checkpoint, got another; run it again")
    return arrays, facts
