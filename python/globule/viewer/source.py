"""Sources of frames: what the viewer shows, and how it changes in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from .._base.terminal import place_text
from ..data.attributes import attribute_names
from ..data.particles import UP, Particles
from ..formats.frames import FrameOf
from ..pieces.scene import Scene
from ..render.annotate import bounds_of
from ..render.camera import Camera
from ..render.layers import Layer, need_one_origin
from ..render.presets import load_preset
from ..render.settings import RenderSettings
from ..scene.mesh import Mesh
from .locks import FairLock
from .overlay import Flat, Mark, Plate
from .scenes import SceneMaker
from .state import State


@dataclass
class Origin:
    """How to get the same particles without the viewer.

    Attributes:
        words: arguments of `globule render`; for a live source, of `globule view`.
        code: Python lines that make `particles`.
        before: a command that makes the file of `words`, if it is needed.
        left: names of what command and code omit.
        lives: the source changes in time, and only `globule view` can show it.
        unsaid: options that the command does not have for such a file.
        scene: Python code that makes `scene`, if it is not one of `particles`.
        beside: Python code of each further layer.
    """

    words: list[str]
    code: list[str]
    before: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    lives: bool = False
    unsaid: tuple[str, ...] = ()
    scene: str = ""
    beside: list[str] = field(default_factory=list)


@dataclass
class Probed:
    """A clicked point that is not on the surface.

    Attributes:
        position: (x, y, z), world.
        words: names to values, for the panel.
    """

    position: tuple[float, float, float]
    words: dict[str, str]


NO_PARTICLES = Particles(np.empty((0, 3), np.float32), support=1.0)
OPTIONS = {
    "level": "--level",
    "labels": "--label",
    "spacing": "--resample",
    "frame": "--frame",
    "species": "--species",
    "where": "--where",
    "center": "--center",
    "min_component": "--min-component",
    "origin": "--origin",
    "scale": "--scale",
    "radius_is": "--radius-is",
    "columns": "--columns",
    "atom_style": "--atom-style",
    "calibration": "--calibration",
    "plus": "--plus",
}


class Source:
    """A source of frames. A thread that holds `lock` may trace its layers; nothing changes them.

    Args:
        name: for titles.

    Attributes:
        lock: see above.
        version: counts the changes of the content.
        files: that the source was read from.
        reading: keywords with which the files were read.
        maker: of the scene.
        beside: layers after the first one, which the settings do not change.
        troubles: errors that did not stop the time, which the engine reports and removes.
        kind: "scene", "sequence", "simulation", "volume" or "sweep".
        n_frames: of a sequence.
        grows: size and place become known in time only.
        up, camera, preset, settings: how the viewer starts, if nothing else is asked for.
        fov: vertical field of view of the first camera, degrees, without `camera`.
        has_tissue: strokes of the tool Cut cut tissue.
        has_foam: the layer after the first one is a simulation's foam.
        unit: of lengths, "" if unknown.
    """

    kind = "scene"
    n_frames = 0
    grows = False
    up: Any = UP
    camera: Camera | None = None
    fov = 40.0
    preset: str | None = None
    settings: Mapping[str, Any] = MappingProxyType({})  # for `State.set`
    has_tissue = False
    has_foam = False
    unit = ""

    def __init__(self, name: str) -> None:
        self.name = name
        self.files: list[str] = []
        self.reading: dict[str, Any] = {}
        self.lock = FairLock()
        self.version = 0
        self.maker = SceneMaker()
        self._preset: tuple | None = None
        self.troubles: list[Exception] = []
        self.beside: list[Layer] = []

    def layers(self, state: State) -> list[Layer]:
        """The layers to trace. The caller holds `lock`."""
        raise NotImplementedError

    def scene(self, state: State) -> Any:
        """The scene or mesh of the first layer. The caller holds `lock`."""
        return self.layers(state)[0].scene

    def particles(self) -> Particles:
        """The particles of the first layer, for colors, statistics and the camera."""
        raise NotImplementedError

    def origin(self, state: State) -> Origin:
        """How to get the same particles without the viewer. The caller holds `lock`."""
        return self._read_from(self.files[0] if self.files else None)

    def _read_from(self, file: str | None) -> Origin:
        if file is None:
            return Origin(
                ["particles.npz"],
                [
                    '# in your program before: gb.write("particles.npz", particles)',
                    'particles = gb.read("particles.npz")',
                ],
            )
        words, code = self.option_words(), self.option_code()
        if isinstance(file, FrameOf):
            words += ["--frame", str(file.frame)]
            code.append(f"frame={file.frame}")
        arguments = ", ".join([repr(str(file)), *code])
        return Origin([str(file), *words], [f"particles = gb.read({arguments})"])

    def option_words(self) -> list[str]:
        """`reading` as options of a command."""
        words = []
        for name, value in self.reading.items():
            if isinstance(value, dict):
                value = ",".join(f"{field}={column}" for field, column in value.items())
            elif name == "origin":
                value = place_text(value)
            if value is True:
                words.append(OPTIONS[name])
                continue
            for one in value if isinstance(value, (list, tuple)) else [value]:
                words += [OPTIONS[name], str(one)]
        return words

    def option_code(self) -> list[str]:
        """`reading` as Python keywords."""
        return [f"{name}={value!r}" for name, value in self.reading.items()]

    def preset_settings(self, name: str, scene: Scene | Mesh, up: Any) -> RenderSettings:
        """The settings of a preset, scaled to the first scene that was shown with it.

        Lights and ground therefore keep their place while particles move.
        """
        if self._preset is None or self._preset[:2] != (name, tuple(up)):
            self._preset = name, tuple(up), load_preset(name, scene, up)
        return self._preset[2]

    def plates(self, state: State) -> list[Plate]:
        """Flat images in space to draw with the layers. The caller holds `lock`."""
        return []

    def flats(self, state: State) -> list[Flat]:
        """Images to draw flat along the lower edge. The caller holds `lock`."""
        return []

    def marks(self) -> list[Mark]:
        """Marks to draw over all images. The caller holds `lock`."""
        return []

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of the content, world."""
        try:
            return self.particles().bounds()
        except ValueError:  # no particles yet
            return np.full(3, -1.0), np.full(3, 1.0)

    def outline(self) -> np.ndarray | None:
        """Points (M, 3), world, for a camera to show; None: the particles with their surface."""
        return None

    def color_names(self) -> list[str]:
        """The fields and attributes by which particles can be colored."""
        return attribute_names(self.particles())

    def advance(self, state: State) -> float | None:
        """Take one step in time.

        Returns:
            The seconds that the step should last; None if there is nothing to do.
        """
        return None

    def stand_still(self) -> None:
        """Take no more steps until the person asks for one."""

    def status(self) -> str:
        """One line for the page about what the source does now; never waits for `lock`."""
        return ""

    def probe(self, state: State, camera: Camera, size: tuple[int, int], screen: Any, nearest: float) -> Probed | None:
        """What lies in front of the surface at a place of the image. The caller holds `lock`.

        Args:
            size: (width, height) of the image.
            screen: the place, (0, 0) to (1, 1).
            nearest: distance of the surface along the ray, world units.
        """
        return None

    def note_settings(self, n: int) -> None:
        """Note after a cut how many changes of settings came before it."""

    def cut_is_newest(self, n: int) -> bool:
        """Whether a cut can be undone that came after the last of n changes of settings."""
        return False

    def cut_along(self, points: list, camera: Camera) -> str:
        """Cut tissue along a stroke; returns a sentence for the page. Called with `has_tissue`."""
        raise NotImplementedError

    def facts(self) -> dict[str, Any]:
        """Further rows of the statistics: names to values."""
        return {}

    def close(self) -> None:
        """Close files and connections."""


class SceneSource(Source):
    """Particles, a scene, or layers, which only the program changes."""

    def __init__(
        self, name: str, shown: Particles | Scene | Mesh | list[Layer], device: str = "auto", threads: int = 0
    ):
        super().__init__(name)
        self._material = None
        self._clips: tuple = ()
        if isinstance(shown, list):
            given = [item if isinstance(item, Layer) else Layer(item) for item in shown]
            need_one_origin(given)
            # Settings of the page are those of particles, wherever they stand.
            given.sort(key=lambda layer: isinstance(layer.scene, Mesh))
            first, *self.beside = given
            found, self._material, self._clips = first.scene, first.material, tuple(first.clips)
        else:
            found = shown
        self._shown: Particles | Scene | Mesh = found
        self.up = found.up
        self.maker = SceneMaker(device, threads, found if isinstance(found, Scene) else None)

    def particles(self) -> Particles:
        """The particles, or those of the scene; of a mesh none."""
        if isinstance(self._shown, Mesh):
            return NO_PARTICLES
        return self._shown.particles if isinstance(self._shown, Scene) else self._shown

    def layers(self, state: State) -> list[Layer]:
        """The layers to trace, particles first. The caller holds `lock`."""
        scene: Any = self._shown
        if not isinstance(scene, Mesh):
            scene = self.maker.scene(self.particles(), state)
        return [Layer(scene, self._material, self._clips), *self.beside]

    @property
    def is_mesh(self) -> bool:
        """Whether the first layer is a mesh."""
        return isinstance(self._shown, Mesh)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of all layers, world."""
        shown: Any = self._shown
        found = bounds_of([shown, *(layer.scene for layer in self.beside)])
        return super().bounds() if found is None else found

    def outline(self) -> np.ndarray | None:
        """The corners of all layers, where there are several or a mesh."""
        if self.beside or isinstance(self._shown, Mesh):
            return box_corners(*self.bounds())
        return None

    def color_names(self) -> list[str]:
        """The fields and attributes by which the particles can be colored."""
        return [] if isinstance(self._shown, Mesh) else super().color_names()

    def origin(self, state: State) -> Origin:
        """The file, or how a program makes the mesh."""
        if not isinstance(self._shown, Mesh):
            found = super().origin(state)
            found.left += ["the other layers"] if self.beside else []
            return found
        file = self.files[0] if self.files else "mesh.ply"
        made = [] if self.files else ["# mesh.ply: the mesh, written by your program"]
        left = ["the other layers"] if self.beside else []
        return Origin([file], made, left=left, scene=f"gb.Mesh({file!r})")

    def update(self, particles: Particles | Any) -> None:
        """Show other `Particles` or positions (N, 3) from now on."""
        if not isinstance(particles, Particles):
            particles = Particles(particles)
        with self.lock:
            self._shown = particles
            self.version += 1
