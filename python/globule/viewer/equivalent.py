"""What gives the same picture without the viewer: a command line, and Python."""

from __future__ import annotations

import dataclasses
import shlex
from typing import Any

from ..camera import Camera
from .picture import clips_of, settings_of, sun_direction
from .source import Source
from .state import Look, State


def command_line(
    files: list[str], state: State, camera: Camera, size: tuple[int, int], up: Any
) -> str:
    """`globule render …`; what the command cannot say follows as a comment."""
    words = ["globule", "render", *(files or ["PARTICLES"]), "-o", "picture.png",
             "--size", f"{size[0]}x{size[1]}",
             "--eye", _three(camera.eye), "--look-at", _three(camera.look_at),
             "--up", _three(camera.up), "--fov", _text(camera.fov)]
    surface, look, color = state.surface, state.look, state.color
    words += ["--kernel", surface.kernel] if surface.kernel != "murakami" else []
    for option, value in (("--threshold", surface.threshold), ("--support", surface.support)):
        words += [option, _text(value)] if value is not None else []
    words += ["--root", surface.root] if surface.root != "exact" else []
    words += ["--preset", look.preset] if look.preset != "plain" else []
    words += ["--shadows"] if look.shadows else []
    words += ["--ambient-rays", str(look.ambient_rays), "--bounces", str(look.depth)]
    words += ["--sky", "gradient"] if look.sky == "gradient" else []
    if look.background != Look().background:
        words += ["--background", _three(look.background)]
    words += ["--ground"] if look.ground == "plain" else []
    if look.matter == "own":
        for name in ("reflection", "transmission", "index", "roughness"):
            words += [f"--{name}", _text(getattr(look, name))]
    if look.lights == "own":
        words += ["--light", "head"] if look.headlight else []
        sun = _three(sun_direction(look, up))
        words += ["--light", f"dir:{sun},{_text(look.angle)}"]
    if color.by:
        words += ["--color-by", color.by, "--colormap", color.colormap]
        words += [] if color.automatic else ["--range", f"{_text(color.low)},{_text(color.high)}"]
        words += ["--legend"] if color.legend else []
    cuts = state.cuts
    for clip in clips_of(cuts):
        kind = type(clip).__name__
        if kind == "ClipPlane":
            words += ["--clip", f"{_three(clip.normal)},{_text(clip.offset)}"]
        elif kind == "ClipBox":
            words += ["--crop" if clip.keep else "--clip-box",
                      f"{_three(clip.lo)},{_three(clip.hi)}"]
        elif not clip.keep:
            words += ["--clip-sphere", f"{_three(clip.center)},{_text(clip.radius)}"]
    words += ["--samples", str(state.quality.samples)]
    left = []
    left += ["exposure"] if look.exposure != 1 else []
    left += ["sky: none"] if look.sky == "none" and look.preset != "plain" else []
    left += ["ground: " + look.ground] if look.ground in ("none", "checker") else []
    left += ["keep the sphere's inside"] if cuts.sphere and cuts.keep_sphere else []
    left += ["shadows off"] if look.preset != "plain" and not look.shadows else []
    note = f"  # without: {', '.join(left)}" if left else ""
    return shlex.join(words) + note


def python_code(
    source: Source, state: State, camera: Camera, size: tuple[int, int], up: Any, scene: Any
) -> str:
    """A program that makes the picture."""
    surface, files = state.surface, source.files
    options = [f"kernel={surface.kernel!r}", f"threshold={float(scene.threshold)!r}"]
    options += [f"support={surface.support!r}"] if surface.support is not None else []
    settings = settings_of(state.look, source, scene, up)
    settings = dataclasses.replace(settings, samples=state.quality.samples)
    plain = type(settings)()
    changes = [
        f"    {field.name}={_code(getattr(settings, field.name))},"
        for field in dataclasses.fields(settings)
        if getattr(settings, field.name) != getattr(plain, field.name)
    ]
    clips = ", ".join(_code(clip) for clip in clips_of(state.cuts))
    file = files[0] if files else "PARTICLES"
    lines = ["import globule as gb", "", f"particles = gb.read({file!r})"]
    if state.color.by:
        lo, hi = state.color.low, state.color.high
        ends = "values.min(), values.max()" if state.color.automatic else f"{lo!r}, {hi!r}"
        lines += ["from globule.attributes import attribute_values",
                  "from globule.colormaps import colorize",
                  f"values = attribute_values(particles, {state.color.by!r})",
                  f"particles.color = colorize(values, {state.color.colormap!r}, {ends})"]
    lines += [f"scene = gb.Scene(particles, {', '.join(options)})",
              f"camera = {_code(camera)}",
              "settings = gb.RenderSettings(", *changes, ")",
              f"clips = [{clips}]",
              f"frame = gb.render(scene, camera, {tuple(size)}, settings, clips)",
              'frame.save("picture.png")']
    return "\n".join(lines) + "\n"


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
