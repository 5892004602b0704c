"""`--state view.toml`: the settings that the viewer saved, for `view` and `render`."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ..data.particles import UP
from ..pieces.scene import Scene
from ..render.camera import Camera
from ..render.presets import load_preset
from ..render.sequence import find_files
from ..viewer.equivalent import render_words
from ..viewer.state import State
from .shared import join_negative, mistakes, readable, say
from .volumes import is_surface

# What a flag that is given beside --state takes the place of: the state's values of these.
REPLACED = {
    "fit": ("eye", "look_at", "ortho"),
    "camera_path": ("eye", "look_at", "ortho"),
    "fov": ("ortho",),
    "views": ("eye", "look_at", "ortho"),
    "opacity": ("transmission", "reflection", "index"),
    "transmission": ("opacity",),
    "background": ("sky",),
    "color_by": ("range",),
}


def read_state(path: str) -> tuple[State, Camera | None]:
    """The settings in a file that the viewer saved, and the camera if the file has one."""
    state = State()
    with readable(path):
        return state, state.load(path)


def defaults(parser: argparse.ArgumentParser, options: argparse.Namespace) -> dict[str, Any]:
    """What --state says of the options of `render` that no flag sets: the options of the command
    that the viewer prints."""
    if not options.state:
        return {}
    state, camera = read_state(options.state)
    with mistakes():
        volumes = [path for path in find_files(options.particles) if is_surface(path, options)]
    up = (options.up or UP) if camera is None else camera.up
    unsaid = ("threshold", "support") if volumes else ()
    with mistakes(options.state):
        words = render_words(state, camera, up, _no_sky(state, up), unsaid)
    if volumes:
        if state.slices.level:
            words += ["--level", repr(state.slices.level)]
        if state.slices.shown:
            say(f"note: {options.state}: the image has no slices, which only the viewer shows")
    words = _known(parser, join_negative(words), options.state)
    saved = parser.parse_args(["FILE", "-o", "PATH", *words])
    flags = {word.partition("=")[0] for word in words}
    named = {a.dest for a in parser._actions if flags.intersection(a.option_strings)}
    given = {
        action.dest
        for action in parser._actions
        if getattr(options, action.dest, None) != parser.get_default(action.dest)
    }
    gone = given.union(*(REPLACED.get(name, ()) for name in given))
    return {name: getattr(saved, name) for name in named - gone}


def _known(parser: argparse.ArgumentParser, words: list[str], path: str) -> list[str]:
    """The flags of `render` and their values without those that another command does not have."""
    kept: list[str] = []
    left: list[str] = []
    for word in words:
        if word.startswith("--"):
            into = kept if word.partition("=")[0] in parser._option_string_actions else left
        into.append(word)
    if gone := [word for word in left if word.startswith("--")]:
        say(f"note: {path}: without {', '.join(gone)}, which only `globule render` has")
    return kept


def _no_sky(state: State, up: Any) -> bool:
    """Whether the background is visible, as in the viewer."""
    if state.look.sky != "preset" or state.look.preset == "plain":
        return state.look.sky != "gradient"
    point = Scene(np.zeros((1, 3), np.float32), support=1.0, device="cpu", threads=1)
    return load_preset(state.look.preset, point, up).sky is None
