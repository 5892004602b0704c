"""Options of `render` that say how light goes on: matter, cuts, sky, ground, a second scene."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from typing import Any

import numpy as np

from .._base.colormaps import categorical
from ..formats import FormatError
from ..formats.pictures.environment import read_environment
from ..render.frame import MAX_LAYERS, MAX_SAMPLES, Frame, Layer, RenderSettings
from ..render.lights import Environment, Ground, Sky, uniform_sky
from ..render.materials import Material
from ..render.presets import GROUNDS, PRESETS, ground_height, preset
from ..scene.scene import Scene
from . import look
from .arguments import ball, beside, between, box, ground, pixel, plane, share, whole
from .shared import UserError, check_input, mistakes, positive, read_particles

MATTER = ("reflection", "transmission", "index", "roughness", "absorption")
IMAGES = (".hdr", ".exr", ".png", ".jpg", ".jpeg")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("light").add_argument
    add("--shadows", action=argparse.BooleanOptionalAction, help="lights throw shadows")
    add(
        "--ambient-rays",
        type=whole(0, 256),
        metavar="N",
        help="rays per sample that look how open a place is (ambient occlusion)",
    )
    add(
        "--sky",
        metavar="SKY",
        help="gradient, an image (.hdr .exr .png .jpg), a colour or none; seen behind, mirrored "
        "and bent",
    )
    add(
        "--ground",
        type=ground,
        nargs="?",
        const=np.nan,
        metavar="GROUND",
        help="a plane at this height along --up (default: where the surface ends), plain or "
        "checker there, or none",
    )
    add("--exposure", type=positive, metavar="E", help="factor of the picture's light")
    add(
        "--bounces",
        type=whole(0, 32),
        metavar="N",
        help="how often light is followed where it is mirrored or goes through (default: 4)",
    )
    add(
        "--samples",
        type=whole(1, MAX_SAMPLES),
        metavar="N",
        help="rays per pixel: smooth edges and soft shadows (default: 1, with a preset 4)",
    )
    add = parser.add_argument_group("matter, instead of the particles' own").add_argument
    add("--reflection", type=share, metavar="V", help="mirror's weight straight on, 0 to 1")
    add("--transmission", type=share, metavar="V", help="share of the rest that goes through")
    add(
        "--opacity",
        type=share,
        metavar="V",
        help="1 - transmission, of what neither bends nor colours light: shows the inside",
    )
    add(
        "--index",
        type=between(1, 4),
        metavar="N",
        help="of refraction, 1 to 4 (water 1.33, glass 1.5)",
    )
    add("--roughness", type=share, metavar="V", help="of mirrored and transmitted light, 0 to 1")
    add("--absorption", type=look.color, metavar="V", help="R,G,B or V per world unit (Beer's law)")
    add(
        "--with",
        dest="beside",
        type=beside,
        action="append",
        default=[],
        metavar="FILE[:COLOR]",
        help="a second scene in the same picture, as it is: matter, cuts and supports given here "
        "are not for it; up to 3 times",
    )
    add = parser.add_argument_group("cuts; the face shows what is inside").add_argument
    add(
        "--clip",
        type=plane,
        action="append",
        default=[],
        metavar="NX,NY,NZ,D",
        help="take away the side where nx x + ny y + nz z > d; may be given several times",
    )
    add(
        "--clip-box",
        type=box,
        action="append",
        default=[],
        metavar="X0,Y0,Z0,X1,Y1,Z1",
        help="take away a box",
    )
    add(
        "--clip-sphere",
        type=ball,
        action="append",
        default=[],
        metavar="X,Y,Z,R",
        help="take away a ball",
    )
    add(
        "--crop",
        type=functools.partial(box, keep=True),
        metavar="X0,Y0,Z0,X1,Y1,Z1",
        help="keep only what is in a box",
    )
    add(
        "--crop-sphere",
        type=functools.partial(ball, keep=True),
        metavar="X,Y,Z,R",
        help="keep only what is in a ball",
    )
    add(
        "--pick",
        type=pixel,
        metavar="COLUMN,ROW",
        help="say what this pixel shows: position, particle, attributes",
    )


class Light:
    """What the options ask for; what is wrong with them shows before any work.

    Settings and scenes beside are found with the first picture's scene and stay for all pictures.
    """

    def __init__(self, options: argparse.Namespace):
        self.options = options
        self._settings: RenderSettings | None = None
        self._beside: list[Layer] = []
        crops = [crop for crop in (options.crop, options.crop_sphere) if crop]
        self.clips = [*options.clip, *options.clip_box, *options.clip_sphere, *crops]
        self._matter = _matter(options)
        self._own = look.given(options) | _given(options)
        if options.pick and not all(p < n for p, n in zip(options.pick, options.size, strict=True)):
            most = f"0,0 to {options.size[0] - 1},{options.size[1] - 1}"
            column, row = options.pick
            raise UserError(f"--pick: expected a pixel, {most}, got {column},{row}")
        if len(options.beside) >= MAX_LAYERS:
            most = MAX_LAYERS - 1
            raise UserError(f"--with: expected at most {most}, got {len(options.beside)}")
        for path, _ in options.beside:
            check_input(path)

    def settings(self, scene: Scene) -> RenderSettings:
        """The preset's, with what the options say in its place."""
        if self._settings is None:
            options, own = self.options, dict(self._own)
            looks = options.preset in PRESETS
            base = preset(options.preset, scene, options.up) if looks else RenderSettings()
            if options.ground is not None:
                own["ground"] = self._ground(base, scene)
            if options.background is not None:
                own.setdefault("sky", None)  # what is given is to be seen
            sky = own.get("sky")
            rays = own.get("ambient_rays", base.ambient_rays)
            if isinstance(sky, Environment) and base.ambient == "sky" and not rays:
                own.setdefault("ambient", sky.mean())  # a lamp must not be seen along a normal
            material = dataclasses.replace(base.material, **self._matter)
            if looks and options.color_by:
                material = dataclasses.replace(material, color=None)
            self._settings = dataclasses.replace(base, material=material, **own)
        return self._settings

    def _ground(self, base: RenderSettings, scene: Scene) -> Ground | None:
        asked = self.options.ground
        if asked == "none":
            return None
        ground = base.ground or Ground(0.0, self.options.up)
        if asked in GROUNDS:
            ground = dataclasses.replace(ground, check=GROUNDS[asked] * float(scene.octree.extent))
        given = asked not in GROUNDS and np.isfinite(asked)
        height = asked if given else ground_height(scene, self.options.up)
        return dataclasses.replace(ground, height=height)

    def layers(self, scene: Scene) -> list[Layer]:
        """The scene with its cuts, and those beside it."""
        if not self._beside:
            self._beside = [self._read(i) for i in range(len(self.options.beside))]
        return [Layer(scene, clips=self.clips), *self._beside]

    def _read(self, i: int) -> Layer:
        options = self.options
        path, color = options.beside[i]
        particles = read_particles(path)
        if particles.color is None and color is None:
            color = categorical(np.array([i + 1]))[0]
        with mistakes():
            scene = Scene(
                particles,
                options.kernel,
                options.threshold,
                device=options.device,
                threads=options.threads,
            )
        return Layer(scene, Material(color=color))

    def picked(self, frame: Frame, kept: np.ndarray) -> dict[str, Any] | None:
        """What --pick's pixel shows; `kept`: which of the file's particles the scene has."""
        seen = frame.pick(*self.options.pick)
        if seen is None:
            return None
        facts = {name: value for name, value in vars(seen).items() if name != "layer"}
        if seen.layer:
            return facts | {"file": self.options.beside[seen.layer - 1][0]}
        return facts | {"particle": int(kept[seen.particle])}


def say_picked(options: argparse.Namespace, seen: dict[str, Any] | None) -> str:
    """One line about what was picked."""
    where = f"pixel {options.pick[0]},{options.pick[1]}"
    if seen is None:
        return f"{where}: nothing"
    words = [
        f"position {_text(seen['position'])}",
        f"distance {seen['distance']:.6g}",
        f"normal {_text(seen['normal'])}",
        f"particle {seen['particle']:,}",
    ]
    words += [f"{name} {_text(value)}" for name, value in seen["attributes"].items()]
    return f"{where}: {', '.join(words)}" + (f" of {seen['file']}" if "file" in seen else "")


def _text(value: Any) -> str:
    return ",".join(f"{v:.6g}" for v in np.ravel(value))


def _matter(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of Material that are given."""
    matter = {name: getattr(options, name) for name in MATTER}
    matter = {name: value for name, value in matter.items() if value is not None}
    if options.opacity is None:
        return matter
    if options.transmission is not None:
        raise UserError("--opacity: expected no --transmission beside it, got both")
    clear = {"index": 1.0, "reflection": 0.0, "absorption": 0.0}
    return {"transmission": 1 - options.opacity} | clear | matter


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of RenderSettings that are given, without those that need a scene."""
    names = {
        "shadows": "shadows",
        "ambient_rays": "ambient_rays",
        "bounces": "bounces",
        "samples": "samples",
        "exposure": "exposure",
    }
    given = {field: getattr(options, name) for name, field in names.items()}
    given = {name: value for name, value in given.items() if value is not None}
    return given if options.sky is None else given | {"sky": _sky(options)}


def _sky(options: argparse.Namespace) -> Sky | Environment | None:
    text = options.sky
    if text == "none":
        return None
    if text == "gradient":
        return Sky(up=options.up)
    if text.lower().endswith(IMAGES):
        try:
            return Environment(read_environment(text), up=options.up)
        except (FormatError, ValueError) as error:
            raise UserError(f"--sky: {error}") from error
        except OSError as error:
            raise UserError(f"--sky: {text}: {error.strerror or error}") from error
    try:
        return uniform_sky(look.color(text))
    except argparse.ArgumentTypeError as error:
        known = f"gradient, none, a colour or a file ending in {' '.join(IMAGES)}"
        raise UserError(f"--sky: expected {known}, got {text!r}") from error
