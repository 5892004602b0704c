"""Flags of `render` for light, material, cuts, sky, ground and a second scene."""

from __future__ import annotations

import argparse
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from .._base.colormaps import categorical
from .._base.settings import SHARE
from .._base.terminal import plain_number
from ..data.particles import HERE
from ..fluids.likeness import shows_flat
from ..formats import FormatError
from ..pieces.scene import Scene
from ..pieces.shown import shown_scene
from ..render.clips import ClipBox
from ..render.fit import corners_of
from ..render.frame import Frame
from ..render.layers import MAX_LAYERS, Layer
from ..render.lights import Environment, Ground, Sky, uniform_sky
from ..render.materials import Material
from ..render.presets import GROUNDS, PRESETS, ground_height, load_preset
from ..render.settings import RenderSettings, extent_of, for_flat_data, for_values
from ..scene.mesh import Mesh
from ..scene.rigid_bodies import RigidBodies
from . import flags, look, meshes
from .arguments import ball, beside, box, ground
from .shared import UserError, check_input, mistakes, read_particles

JUST_BELOW = 1e-3  # of the extent of a floor, whose own face the ground must not be
MATTER = ("reflection", "transmission", "index", "roughness", "absorption")
IMAGES = (".hdr", ".exr", ".png", ".jpg", ".jpeg")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of light, material and cuts."""
    group = parser.add_argument_group("light")
    add, preset = group.add_argument, ", or the preset's"
    flags.add_settings(group, RenderSettings, "shadows", note=preset, action=argparse.BooleanOptionalAction)
    flags.add_settings(group, RenderSettings, "ambient_rays", "bounces", note=preset)
    flags.add_settings(group, RenderSettings, "exposure")
    flags.add_settings(group, RenderSettings, "samples", note=", with a preset other than flat 4")
    flags.own(group, "--sky SKY", "light from all around, visible behind the surface, reflected "
        "and refracted: gradient, an image (.hdr .exr .png .jpg), a color, or none",
        usual="none, or the preset's")  # fmt: skip
    add(
        "--ground",
        type=ground,
        nargs="?",
        const=np.nan,
        metavar="GROUND",
        help="ground plane: its height along --up in world units, plain or checker (where the "
        "surface ends), or none (default: none, or the preset's)",
    )
    group = parser.add_argument_group("material, instead of the particles' own")
    add = group.add_argument
    flags.add_settings(group, Material, *MATTER)
    flags.own(group, "--opacity V", "1 - transmission of a surface that neither refracts nor "
        "colors light, 0 to 1; shows the inside", SHARE.parse,
        usual="--transmission counts")  # fmt: skip
    flags.own(group, "--with FILE[:COLOR]", "particles or mesh of a second scene in the same "
        "image; material, cuts, support and reading flags do not apply to the second scene; may be "
        "repeated up to 3 times", beside, [], dest="beside", action="append")  # fmt: skip
    group = parser.add_argument_group("cuts; the cut face shows the inside")
    add = group.add_argument
    flags.add(group, "--clip", "may be repeated; default: none", action="append", default=[])
    flags.own(group, "--clip-box X0,Y0,Z0,X1,Y1,Z1", "cut away a box, given by its lowest and "
        "highest corner, world units; may be repeated", box, [], action="append")  # fmt: skip
    flags.own(group, "--clip-sphere X,Y,Z,R", "cut away a ball, given by center and radius, world "
        "units; may be repeated", ball, [], action="append")  # fmt: skip
    flags.own(group, "--crop X0,Y0,Z0,X1,Y1,Z1", "keep only the inside of a box, and show that, "
        "world units", functools.partial(box, keep=True), usual="all")  # fmt: skip
    flags.own(group, "--crop-sphere X,Y,Z,R", "keep only the inside of a ball, world units",
        functools.partial(ball, keep=True), usual="all")  # fmt: skip


class Light:
    """Settings, layers and clips that the options ask for; mistakes show before any work.

    Settings and the scenes of --with are made with the first image's scene and stay for all images.
    """

    def __init__(self, options: argparse.Namespace):
        self.options = options
        self._settings: RenderSettings | None = None
        self._beside: list[Layer] | None = None
        self.messages: list[str] = []  # about the meshes
        self._moving: list[RigidBodies] = []
        crops = [crop for crop in (options.crop, options.crop_sphere) if crop]
        self.clips = [*options.clip, *options.clip_box, *options.clip_sphere, *crops]
        self._matter = _matter(options)
        self._own = look.given(options) | _given(options)
        if options.pick and not all(p < n for p, n in zip(options.pick, options.size, strict=True)):
            most = f"0,0 to {options.size[0] - 1},{options.size[1] - 1}"
            column, row = options.pick
            raise UserError(f"--pick: expected a pixel, {most}, got {column},{row}")
        if len(options.beside) >= MAX_LAYERS:
            n = MAX_LAYERS - 1
            raise UserError(f"--with: expected at most {n} files, got {len(options.beside)}")
        n = len(options.beside) + len(meshes.files(options))
        if n >= MAX_LAYERS:
            raise UserError(f"--mesh: expected at most {MAX_LAYERS - 1} files with --with, got {n}")
        for path, _ in options.beside:
            check_input(path)
        meshes.check_meshes(options)

    def begin(self, scene: Scene | Mesh) -> None:
        """Make the settings and the layers beside by the scene of the frame that leads."""
        self._settings = None
        self.layers(scene)
        self.settings(scene)

    def settings(self, scene: Scene | Mesh) -> RenderSettings:
        """The preset's settings, changed by the options."""
        if self._settings is None:
            options, own = self.options, dict(self._own)
            looks = options.preset in PRESETS
            base = load_preset(options.preset, scene, options.up) if looks else RenderSettings()
            own["ground"] = self._ground(base, scene)
            if options.background is not None:
                own.setdefault("sky", None)  # a sky would hide the background
            sky = own.get("sky")
            rays = own.get("ambient_rays", base.ambient_rays)
            if isinstance(sky, Environment) and base.ambient == "sky" and not rays:
                own.setdefault("ambient", sky.mean())  # a lamp must not be seen along a normal
            material = dataclasses.replace(base.material, **self._matter)
            settings = dataclasses.replace(base, material=material, **own)
            if shows_flat(scene):
                settings = for_flat_data(settings)
            if options.color_by:
                settings = for_values(settings)
                if (settings.material.transmission or 0) >= 1:
                    through = "light goes through the surface, which shows no colors"
                    self.messages.append(f"--color-by: {through}; --transmission 0 or another --preset shows them")
            self._settings = settings
        return self._settings

    def _ground(self, base: RenderSettings, scene: Scene | Mesh) -> Ground | None:
        asked, up = self.options.ground, self.options.up
        if asked == "none" or (asked is None and base.ground is None):
            return None
        ground = base.ground or Ground(0.0, up)
        if asked in GROUNDS:
            ground = dataclasses.replace(ground, check=GROUNDS[asked] * extent_of(scene))
        if asked not in (None, *GROUNDS) and np.isfinite(asked):
            return dataclasses.replace(ground, height=asked)
        beside = (one.scene for one in self.layers(scene)[1:])  # a floor or a hopper stands on the ground, too
        heights = (ground_height(one, up) - JUST_BELOW * extent_of(one) for one in beside if extent_of(one))
        return dataclasses.replace(ground, height=min([ground_height(scene, up), *heights]))

    def layers(self, scene: Scene | Mesh) -> list[Layer]:
        """The scene with its cuts, and the scenes of --with and --mesh."""
        if self._beside is None:
            beside = [self._read(i) for i in range(len(self.options.beside))]
            particles = scene.particles if isinstance(scene, Scene) else None
            found, self.messages, self._moving = meshes.layers(self.options, self.clips, particles)
            self._beside = [*beside, *found]
        return [Layer(scene, clips=self.clips), *self._beside]

    def place(self, path: str, i: int) -> None:
        """Move what moves to where it is in the image of a file, the i-th."""
        meshes.place(self._moving, path, i)

    def hiding(self, frames: Sequence[Frame]) -> str:
        """What to say where only opaque things of --with and --mesh are seen; "" elsewhere."""
        beside = self._beside or []
        if not beside or any(one.material.transmission for one in beside if one.material):
            return ""
        seen = {int(k) for frame in frames for k in np.unique(frame._layer[frame.mask])}
        hiding = [k - 1 for k in sorted(seen) if k <= len(beside)]
        if 0 in seen or not hiding:
            return ""
        options = self.options
        files = [*(path for path, _ in options.beside), *meshes.files(options)]
        name = files[hiding[0]]
        glass = f"--mesh {name}:glass or " if name in dict(options.meshes) else ""
        return f"no pixel shows the particles, only {name}: try {glass}--clip"

    def around(self, scene: Scene | Mesh, box: Any) -> Any:
        """Points (M, 3) that the fitted camera shows: those of `box`, or the scene's, inside of
        --crop, and --mesh; None: the scene's alone."""
        if self.options.crop:
            box = _inside(self.options.crop, scene, box)
        shown = [x.scene for x in self.layers(scene)[1:] if isinstance(x.scene, Mesh)]
        if not shown:
            return box
        if box is None:
            box = corners_of(scene) if isinstance(scene, Mesh) else scene.particles.bounds()
            box = np.array(np.meshgrid(*np.transpose(box))).reshape(3, -1).T
        return np.concatenate([box, *map(corners_of, shown)])

    def _read(self, i: int) -> Layer:
        options = self.options
        path, color = options.beside[i]
        if meshes.is_mesh(path, options):
            return Layer(meshes.read_mesh(path, options), Material(color=color))
        particles = read_particles(path, origin=options.origin or HERE)
        if particles.color is None and color is None:
            color = categorical(np.array([i + 1]))[0]
        with mistakes():
            scene = shown_scene(
                particles,
                kernel=options.kernel,
                threshold=options.threshold,
                device=options.device,
                threads=options.threads,
            )
        return Layer(scene, Material(color=color))

    def picked(self, frame: Frame, kept: np.ndarray) -> dict[str, Any] | None:
        """What the pixel of --pick shows. kept: (K,) the particles' indices in the file."""
        seen = frame.pick(*self.options.pick)
        if seen is None:
            return None
        facts = {name: value for name, value in vars(seen).items() if name != "layer"}
        facts = {name: value for name, value in facts.items() if value is not None}
        if seen.layer:
            files = [*(path for path, _ in self.options.beside), *meshes.files(self.options)]
            return facts | {"file": files[seen.layer - 1]}
        return facts | ({} if seen.particle is None else {"particle": int(kept[seen.particle])})


def _inside(crop: ClipBox, scene: Scene | Mesh, box: Any) -> Any:
    """The corners (8, 3) of the part of a box of points, or of the scene's, that a crop keeps; the
    box itself where it keeps nothing."""
    points = box
    if points is None:
        owner = scene if isinstance(scene, Mesh) else scene.particles
        try:
            points = np.array(owner.bounds())
        except ValueError:  # no finite position
            return box
    lo = np.maximum(points.min(axis=0), crop.lo)
    hi = np.minimum(points.max(axis=0), crop.hi)
    if (lo > hi).any():
        return box
    return box_corners(lo, hi)


def say_picked(options: argparse.Namespace, seen: dict[str, Any] | None) -> str:
    """One line about the picked pixel."""
    where = f"pixel {options.pick[0]},{options.pick[1]}"
    if seen is None:
        return f"{where}: nothing"
    words = [
        f"position {_text(seen['position'])}",
        f"distance {seen['distance']:.6g}",
        f"normal {_text(seen['normal'])}",
        f"particle {seen['particle']:,}" if "particle" in seen else f"triangle {seen['face']:,}",
    ]
    words += [f"{name} {_text(value)}" for name, value in seen["attributes"].items()]
    return f"{where}: {', '.join(words)}" + (f" of {seen['file']}" if "file" in seen else "")


def _text(value: Any) -> str:
    return ",".join(plain_number(v) for v in np.ravel(value))


def _matter(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of Material that the options set."""
    matter = {name: getattr(options, name) for name in MATTER}
    matter = {name: value for name, value in matter.items() if value is not None}
    if options.opacity is None:
        return matter
    if options.transmission is not None:
        raise UserError("--opacity: expected no --transmission beside --opacity, got both")
    clear = {"index": 1.0, "reflection": 0.0, "absorption": 0.0}
    return {"transmission": 1 - options.opacity} | clear | matter


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """The fields of RenderSettings that the options set, without those that need a scene."""
    names = ("shadows", "ambient_rays", "bounces", "samples", "exposure", "transparent")
    given = {name: getattr(options, name) for name in names}
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
            return Environment(text, up=options.up)
        except (FormatError, ValueError) as error:
            raise UserError(f"--sky: {error}") from error
        except OSError as error:
            raise UserError(f"--sky: {text}: {error.strerror or error}") from error
    try:
        return uniform_sky(look.color(text))
    except argparse.ArgumentTypeError as error:
        known = f"gradient, none, a color or a file ending in {' '.join(IMAGES)}"
        raise UserError(f"--sky: expected {known}, got {text!r}") from error
