"""A command and a Python program that make the same image without the viewer."""

from __future__ import annotations

import dataclasses
import shlex
from typing import Any

from ..data.attributes import colormap_of
from ..render.camera import Camera
from ..render.clips import ClipBox, ClipPlane
from .overlay import annotation_of
from .picture import clips_of, preset_look, seen_settings, sun_direction
from .scenes import scene_options
from .source import Source
from .state import State


def command_line(source: Source, state: State, camera: Camera, size: tuple[int, int], up: Any) -> str:
    """A `globule render` command; for a live source, a `globule view` command.

    A comment at the end lists what the command omits. The caller holds the source's lock.
    """
    origin = source.origin(state)
    left = list(origin.left) + ["the measurement"] * state.measure.shown
    left += [name for name in origin.unsaid if getattr(state.surface, name) is not None]
    if origin.lives:
        first = _first_words(state, camera, origin.unsaid)
        words = ["globule", "view", *origin.words, *first]
        left += ["light, cuts and samples"] if _lit(source, state, up) else []
    else:
        sky = seen_settings(source, state, source.scene(state), up).sky
        words = ["globule", "render", *origin.words, "-o", "picture.png"]
        words += ["--size", f"{size[0]}x{size[1]}"]
        words += render_words(state, camera, up, sky is None, origin.unsaid)
    before = f"{shlex.join(origin.before)} && " if origin.before else ""
    return before + shlex.join(words) + (f"  # without: {', '.join(left)}" if left else "")


def render_words(state: State, camera: Camera | None, up: Any, no_sky: bool, unsaid: tuple[str, ...] = ()) -> list[str]:
    """The flags of `globule render` for these settings.

    Args:
        camera: None leaves the camera to `globule render`.
        up: (3,) direction to the sky.
        no_sky: whether the background is visible.
        unsaid: "threshold" and "support", where the input has no such flags.
    """
    words = _first_words(state, camera, unsaid) + _light_words(state, up) + _cut_words(state)
    seen = no_sky and state.look.background != type(state.look)().background
    words += ["--background", _three(state.look.background)] if seen else []
    words += _note_words(state)
    return [*words, "--samples", str(state.quality.samples)]


def _first_words(state: State, camera: Camera | None, unsaid: tuple[str, ...]) -> list[str]:
    """What `render` and `view` have in common."""
    surface, color = state.surface, state.color
    words = []
    if camera is not None:
        words += ["--eye", _three(camera.eye), "--look-at", _three(camera.look_at)]
        words += ["--up", _three(camera.up)]
        angle = ("--fov", camera.fov) if camera.height is None else ("--ortho", camera.height)
        words += [angle[0], _text(angle[1])]
    words += _changed(surface, shape="surface", kernel="kernel")
    words += _changed(surface, **{n: n for n in ("threshold", "support") if n not in unsaid})
    words += _changed(state.look, preset="preset")
    if color.by:
        words += ["--color-by", color.by, "--colormap", color.colormap]
        words += [] if color.automatic else ["--range", f"{_text(color.low)},{_text(color.high)}"]
    return words


def _lit(source: Source, state: State, up: Any) -> bool:
    """Whether there are settings for which `view` has no options."""
    look = preset_look(source, state, state.look.preset, up)
    return look != state.look or bool(clips_of(state.cuts)) or state.surface.root != "exact"


def _light_words(state: State, up: Any) -> list[str]:
    look = state.look
    words = _changed(state.surface, root="root")
    words += ["--shadows" if look.shadows else "--no-shadows"]
    words += ["--ambient-rays", str(look.ambient_rays), "--bounces", str(look.bounces)]
    words += _changed(look, sky="sky", exposure="exposure", ground="ground")
    if look.matter == "own":
        for name in ("reflection", "transmission", "index", "roughness"):
            words += [f"--{name}", _text(getattr(look, name))]
    if look.lights == "own":
        words += ["--light", "head"] if look.headlight else []
        words += ["--light", f"dir:{_three(sun_direction(look, up))},{_text(look.angle)}"]
    return words


def _note_words(state: State) -> list[str]:
    """Legend and annotations."""
    words = _changed(state.notes, title="title", scale_bar="scale-bar", axes="axes", box="box", unit="unit")
    if state.color.by and state.color.legend:
        words += ["--legend"] + _changed(
            state.color, legend_at="legend-at", legend_title="legend-title", legend_unit="legend-unit"
        )
    return words


def _changed(group: Any, **flags: str) -> list[str]:
    """The flags of the settings of a group, by their names, that differ from their defaults."""
    words, plain = [], type(group)()
    for name, flag in flags.items():
        value = getattr(group, name)
        if value != getattr(plain, name):
            words += [f"--{flag}"] if value is True else [f"--{flag}", _said(value)]
    return words


def _said(value: str | float) -> str:
    """The value of a flag: a leading hyphen would make a text a flag."""
    if not isinstance(value, str):
        return _text(value)
    return f" {value}" if value.startswith("-") else value


def _cut_words(state: State) -> list[str]:
    words = []
    for clip in clips_of(state.cuts):
        if isinstance(clip, ClipPlane):
            words += ["--clip", f"{_three(clip.normal)},{_text(clip.offset)}"]
        elif isinstance(clip, ClipBox):
            corners = f"{_three(clip.lo)},{_three(clip.hi)}"
            words += ["--crop" if clip.keep else "--clip-box", corners]
        else:
            ball = f"{_three(clip.center)},{_text(clip.radius)}"
            words += ["--crop-sphere" if clip.keep else "--clip-sphere", ball]
    return words


def python_code(source: Source, state: State, camera: Camera, size: tuple[int, int], up: Any) -> str:
    """A program that makes the image. The caller holds the source's lock."""
    origin, surface, color = source.origin(state), state.surface, state.color
    scene = source.scene(state)
    made = origin.scene or f"gb.Scene(particles, {_scene_words(source, scene, state)})"
    if origin.beside:
        made = f"[{', '.join([made, *origin.beside])}]"
    settings = dataclasses.replace(seen_settings(source, state, scene, up), samples=state.quality.samples)
    plain = type(settings)()
    changes = [
        f"    {field.name}={_code(getattr(settings, field.name))},"
        for field in dataclasses.fields(settings)
        if not _same(getattr(settings, field.name), getattr(plain, field.name))
    ]
    thesis = f", Thesis(root={surface.root!r})" if surface.root != "exact" else ""
    lines = ["import globule as gb", *_imports(state), "", *origin.code]
    colormap = colormap_of(color.by, color.colormap)
    if color.by:
        ends = "values.min(), values.max()" if color.automatic else f"{color.low!r}, {color.high!r}"
        lines += [
            f"values = attribute_values(particles, {color.by!r})",
            f"ends = {ends}",
            f"particles.color = gb.colorize(values, {colormap!r}, *ends)",
        ]
    more = ""
    by_pixel = bool(color.by) and settings.is_flat  # a `color_by`, which takes one scene
    if by_pixel and not origin.beside:
        more += f", color_by={color.by!r}, colormap={colormap!r}, range=ends"
    notes = dataclasses.replace(annotation_of(state), legend=False, legend_title="", legend_unit="")
    if notes.draws:
        more += f", annotate={_code(notes)}"
    lines += [
        f"scene = {made}",
        f"camera = {_code(camera)}",
        "settings = gb.RenderSettings(",
        *changes,
        ")",
        f"clips = [{', '.join(_code(clip) for clip in clips_of(state.cuts))}]",
        f"frame = gb.render(scene, camera, {tuple(size)}, settings, clips{thesis}{more})",
    ]
    if color.by and color.legend:
        words = repr(color.legend_title or color.by)
        words += f", unit={color.legend_unit!r}" if color.legend_unit else ""
        words += f", position={color.legend_at!r}" if color.legend_at != "lower-right" else ""
        lines += [
            f"picture = gb.add_legend(frame.picture, {colormap!r}, *ends, {words})",
            'gb.save_png("picture.png", picture)',
        ]
    else:
        lines += ['frame.save("picture.png")']
    left = list(origin.left) + ["the measurement"] * state.measure.shown
    left += ["colors of blended values"] * (by_pixel and bool(origin.beside))
    lines += [f"# without: {', '.join(left)}"] if left else []
    return "\n".join(lines) + "\n"


def _scene_words(source: Source, scene: Any, state: State) -> str:
    """The arguments of `Scene` after the particles."""
    surface, smooth = state.surface, scene.surface == "smooth"
    options = {
        **({} if smooth else {"kernel": surface.kernel}),
        "threshold": float(scene.threshold),
        **scene_options(source.particles(), surface.kernel, surface.support, surface.root, scene.surface),
    }
    return ", ".join(f"{name}={_code(value)}" for name, value in options.items())


def _imports(state: State) -> list[str]:
    lines = ["from globule.scene.thesis import Thesis"] * (state.surface.root != "exact")
    if state.color.by:
        lines += ["from globule.data.attributes import attribute_values"]
    return lines


def _code(value: Any) -> str:
    """A value as Python code, with `gb.` before classes and without defaults."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        words = []
        for field in dataclasses.fields(value):
            v = getattr(value, field.name)
            if field.default is dataclasses.MISSING or not _same(v, field.default):
                words.append(f"{field.name}={_code(v)}")
        return f"gb.{type(value).__name__}({', '.join(words)})"
    if isinstance(value, (tuple, list)):
        inner = ", ".join(_code(v) for v in value)
        return f"({inner}{',' if len(value) == 1 else ''})"
    if hasattr(value, "tolist"):
        return _code(value.tolist())
    return repr(value)


def _same(a: Any, b: Any) -> bool:
    try:
        return bool(a == b)
    except ValueError:  # arrays
        return False


def _text(value: float) -> str:
    return f"{value:.9g}"


def _three(values: Any) -> str:
    return ",".join(_text(float(v)) for v in values)
