"""What gives the same picture without the viewer: a command line, and Python."""

from __future__ import annotations

import dataclasses
import shlex
from typing import Any

from ..render.camera import Camera
from ..render.clips import ClipBox, ClipPlane
from .picture import clips_of, preset_look, seen_settings, sun_direction
from .scenes import scene_options
from .source import Source
from .state import State


def command_line(
    source: Source, state: State, camera: Camera, size: tuple[int, int], up: Any
) -> str:
    """`globule render …`, or `globule view …` of what lives; what the command cannot say follows
    as a comment. With the source's lock held."""
    origin = source.origin(state)
    words, left = _first_words(state, camera, origin.unsaid), list(origin.left)
    left += [name for name in origin.unsaid if getattr(state.surface, name) is not None]
    if origin.lives:
        words = ["globule", "view", *origin.words, *words]
        left += ["light, cuts and samples"] if _lit(source, state, up) else []
    else:
        words = [
            "globule",
            "render",
            *origin.words,
            "-o",
            "picture.png",
            "--size",
            f"{size[0]}x{size[1]}",
            *words,
        ]
        words += _light_words(state, up) + _cut_words(state)
        settings = seen_settings(source, state, source.layers(state)[0].scene, up)
        seen = settings.sky is None and state.look.background != type(state.look)().background
        words += ["--background", _three(state.look.background)] if seen else []
        words += ["--legend"] if state.color.by and state.color.legend else []
        words += ["--samples", str(state.quality.samples)]
    before = f"{shlex.join(origin.before)} && " if origin.before else ""
    return before + shlex.join(words) + (f"  # without: {', '.join(left)}" if left else "")


def _first_words(state: State, camera: Camera, unsaid: tuple[str, ...]) -> list[str]:
    """What `render` and `view` have in common."""
    surface, color = state.surface, state.color
    words = [
        "--eye",
        _three(camera.eye),
        "--look-at",
        _three(camera.look_at),
        "--up",
        _three(camera.up),
    ]
    words += (
        ["--fov", _text(camera.fov)] if camera.height is None else ["--ortho", _text(camera.height)]
    )
    words += ["--kernel", surface.kernel] if surface.kernel != "murakami" else []
    for name in ("threshold", "support"):
        value = getattr(surface, name)
        words += [f"--{name}", _text(value)] if value is not None and name not in unsaid else []
    words += ["--preset", state.look.preset] if state.look.preset != "plain" else []
    if color.by:
        words += ["--color-by", color.by, "--colormap", color.colormap]
        words += [] if color.automatic else ["--range", f"{_text(color.low)},{_text(color.high)}"]
    return words


def _lit(source: Source, state: State, up: Any) -> bool:
    """Whether more is set than `view` has options for."""
    look = preset_look(source, state, state.look.preset, up)
    return look != state.look or bool(clips_of(state.cuts)) or state.surface.root != "exact"


def _light_words(state: State, up: Any) -> list[str]:
    look = state.look
    words = ["--root", state.surface.root] if state.surface.root != "exact" else []
    words += ["--shadows" if look.shadows else "--no-shadows"]
    words += ["--ambient-rays", str(look.ambient_rays), "--bounces", str(look.depth)]
    words += ["--sky", look.sky] if look.sky != "preset" else []
    words += ["--exposure", _text(look.exposure)] if look.exposure != 1 else []
    words += ["--ground", look.ground] if look.ground != "preset" else []
    if look.matter == "own":
        for name in ("reflection", "transmission", "index", "roughness"):
            words += [f"--{name}", _text(getattr(look, name))]
    if look.lights == "own":
        words += ["--light", "head"] if look.headlight else []
        words += ["--light", f"dir:{_three(sun_direction(look, up))},{_text(look.angle)}"]
    return words


def _cut_words(state: State) -> list[str]:
    words = []
    for clip in clips_of(state.cuts):
        if isinstance(clip, ClipPlane):
            words += ["--clip", f"{_three(clip.normal)},{_text(clip.offset)}"]
        elif isinstance(clip, ClipBox):
            words += [
                "--crop" if clip.keep else "--clip-box",
                f"{_three(clip.lo)},{_three(clip.hi)}",
            ]
        else:
            words += [
                "--crop-sphere" if clip.keep else "--clip-sphere",
                f"{_three(clip.center)},{_text(clip.radius)}",
            ]
    return words


def python_code(
    source: Source, state: State, camera: Camera, size: tuple[int, int], up: Any
) -> str:
    """A program that makes the picture; with the source's lock held."""
    origin, surface, color = source.origin(state), state.surface, state.color
    scene = source.layers(state)[0].scene
    options = {
        "kernel": surface.kernel,
        "threshold": float(scene.threshold),
        **scene_options(source.particles(), surface.kernel, surface.support, surface.root),
    }
    settings = dataclasses.replace(
        seen_settings(source, state, scene, up), samples=state.quality.samples
    )
    plain = type(settings)()
    changes = [
        f"    {field.name}={_code(getattr(settings, field.name))},"
        for field in dataclasses.fields(settings)
        if not _same(getattr(settings, field.name), getattr(plain, field.name))
    ]
    thesis = f", gb.Thesis(root={surface.root!r})" if surface.root != "exact" else ""
    lines = ["import globule as gb", *_imports(state), "", *origin.code]
    if color.by:
        ends = "values.min(), values.max()" if color.automatic else f"{color.low!r}, {color.high!r}"
        lines += [
            f"values = attribute_values(particles, {color.by!r})",
            f"ends = {ends}",
            f"particles.color = colorize(values, {color.colormap!r}, *ends)",
        ]
    words = ", ".join(f"{name}={_code(value)}" for name, value in options.items())
    lines += [
        f"scene = gb.Scene(particles, {words})",
        f"camera = {_code(camera)}",
        "settings = gb.RenderSettings(",
        *changes,
        ")",
        f"clips = [{', '.join(_code(clip) for clip in clips_of(state.cuts))}]",
        f"frame = gb.render(scene, camera, {tuple(size)}, settings, clips{thesis})",
    ]
    if color.by and color.legend:
        lines += [
            f"picture = add_legend(frame.picture, {color.colormap!r}, *ends, {color.by!r})",
            'save_png("picture.png", picture)',
        ]
    else:
        lines += ['frame.save("picture.png")']
    lines += [f"# without: {', '.join(origin.left)}"] if origin.left else []
    return "\n".join(lines) + "\n"


def _imports(state: State) -> list[str]:
    if not state.color.by:
        return []
    lines = [
        "from globule.scene.attributes import attribute_values",
        "from globule import colorize",
    ]
    return lines + ["from globule import add_legend, save_png"] * state.color.legend


def _code(value: Any) -> str:
    """A value as Python with `gb.` before our classes, without what is usual."""
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
