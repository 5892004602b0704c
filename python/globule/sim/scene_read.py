"""Reading scenes: TOML, a dict or Python becomes a checked `SceneFile`, or a one-line error."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path as File
from typing import Any

from .._base.checks import near, shown
from .._base.checks import positive as positive_number
from .._base.settings import Problem, read_table, settings_of
from .._base.structured import parse_toml, read_text
from .scene_bodies import BOUNDARY_SHAPES, RIGID_SHAPES, SOLID_SHAPES
from .scene_file import LISTS, SceneFile
from .schema import SceneError, exactly_one
from .sources import check_files
from .toml_lines import key_lines

SHIPPED = ("dam-break", "droplet", "poiseuille", "beam", "cut-block", "brain-surgery")
FOLDER = File(__file__).parent / "scenes"


def shipped(name: str) -> File:
    """The file of a scene that comes with the package."""
    return FOLDER / f"{name}.toml"


def check_places(scene: SceneFile) -> None:
    """Refuse a scene file whose particles come from nowhere; in Python, `add` may bring them.

    Raises:
        Problem: a scene without bodies, or a body without a shape.
    """
    if not (scene.fluids or scene.solids or scene.rigids):
        raise Problem((), "expected fluids, solids or rigids, got none")
    for kind, shapes in (
        ("solids", SOLID_SHAPES), ("boundaries", BOUNDARY_SHAPES), ("rigids", RIGID_SHAPES),
    ):  # fmt: skip
        for i, table in enumerate(getattr(scene, kind)):
            try:
                exactly_one(table, shapes)
            except ValueError as error:
                raise Problem((kind, i), str(error)) from None


def read_scene(scene: Any, spacing: float | None = None, **keys: Any) -> SceneFile:
    """A scene with all its values checked.

    Args:
        scene: the name of a shipped scene, the path of a TOML file, a dict with the keys of a scene
            file, or a `SceneFile`.
        spacing: m, instead of the scene's own.
        keys: other keys of a scene, instead of the scene's own, as in a dict or as tables.

    Raises:
        SceneError: a wrong key or value; the message names file and line if the scene is a file.
        OSError: a file that cannot be read.
    """
    if spacing is not None:
        try:
            keys["spacing"] = positive_number("spacing", spacing)
        except (TypeError, ValueError):
            got = shown(spacing)
            raise SceneError(f"spacing: expected a number above 0, got {got}") from None
    name, folder = "", ""
    lines: dict[tuple, int] = {}
    if not isinstance(scene, (dict, SceneFile)):
        path = shipped(scene) if scene in SHIPPED else File(scene)
        name, folder = os.fspath(path), os.path.dirname(path)
        try:
            scene, lines = _parsed(path)
        except OSError as error:
            expected = f"expected a .toml file or one of {', '.join(SHIPPED)}"
            hint = near(name, SHIPPED) if isinstance(error, FileNotFoundError) else ""
            hint = hint or f": {error.strerror}"
            raise type(error)(f"SCENE: {expected}, got {name}{hint}") from None
    try:
        if isinstance(scene, SceneFile):
            scene = {name: getattr(scene, name) for name in settings_of(SceneFile)}
        found = read_table(SceneFile, {**scene, **keys})
        if name:
            check_places(found)
        for kind in LISTS:
            for i, item in enumerate(getattr(found, kind)):
                for source in ("mesh", "tomography", "particles", "distance"):
                    try:
                        check_files(getattr(item, source, None), folder)
                    except Problem as problem:
                        place = (kind, i, source, *problem.path)
                        raise Problem(place, problem.message) from None
        return found
    except Problem as problem:
        lines = {place: line for place, line in lines.items() if place[0] not in keys}
        raise SceneError(f"{_located(name, lines, problem.path)}{problem}") from None


@contextmanager
def errors_of(scene: Any) -> Iterator[None]:
    """What is wrong with a scene of a file is said with the file's name."""
    try:
        yield
    except ValueError as error:
        if not isinstance(scene, (str, os.PathLike)) or scene in SHIPPED:
            raise
        name = os.fspath(scene)
        if str(error).startswith(name):
            raise
        raise SceneError(f"{name}: {error}") from error


def as_dict(table: Any) -> Any:
    """A checked table as a dict in TOML's words, which `read_scene` reads again."""
    if isinstance(table, (list, tuple)):
        return [as_dict(item) for item in table]
    if not is_dataclass(table):
        return table
    found = {}
    for name in settings_of(type(table)):
        if (value := getattr(table, name)) not in (None, ""):
            found[name] = as_dict(value)
    return found


def _parsed(path: File) -> tuple[dict[str, Any], dict]:
    try:
        words = read_text(path)
        return parse_toml(words), key_lines(words.replace("\r\n", "\n"))
    except ValueError as error:
        line = re.search(r"at line (\d+)", str(error))
        where = f"{path}:{line[1]}" if line else path
        raise SceneError(f"{where}: expected TOML, got: {error}") from None


def _located(name: str, lines: dict, path: tuple) -> str:
    """The file and the line of a key, or of the nearest table around it."""
    while path and path not in lines:
        path = path[:-1]
    return f"{name}:{lines[path]}: " if path else f"{name}: " if name else ""
