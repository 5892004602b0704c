"""Frame sources: what is shown, and how it goes on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..render.camera import Camera
from ..render.frame import Layer, RenderSettings
from ..render.presets import preset
from ..scene.particles import Particles
from ..scene.scene import Scene
from .locks import FairLock
from .overlay import Mark, Plate
from .scenes import SceneMaker, color_names
from .state import State


@dataclass
class Origin:
    """How what is shown can be had without the viewer.

    before: words of a command that makes the file of `words`, if it has to be made. words: what
    `globule render` reads; of what lives `globule view`, as nobody else can show it. code: Python
    that makes `particles`. left: what all these leave out. unsaid: options that the command cannot
    have with such a file.
    """

    words: list[str]
    code: list[str]
    before: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    lives: bool = False
    unsaid: tuple[str, ...] = ()


@dataclass
class Probed:
    """What was clicked beside the surface. words: its name to its value."""

    position: tuple[float, float, float]
    words: dict[str, str]


OPTIONS = {
    "level": "--level",
    "labels": "--label",
    "spacing": "--resample",
    "calibration": "--calibration",
    "plus": "--plus",
}


class Source:
    """Something to look at. Whoever holds `lock` may trace its layers; nobody changes them then.

    `version` counts the changes of what is shown. `advance` takes one step in time and says how
    many seconds it should have lasted, None where there is nothing more to do.
    """

    kind = "scene"
    n_frames = 0  # of a sequence
    grows = False  # whether only time shows what it is, and where
    up: Any = (0.0, 1.0, 0.0)  # towards the sky, where nobody says otherwise
    camera: Camera | None = None  # where to begin, if the source says so
    preset: str | None = None  # how it looks, if the source says so
    settings: dict[str, Any] = {}  # for `State.set`, the same
    has_tissue = False  # that a stroke of the tool Cut cuts
    unit = ""  # of lengths, where it is known

    def __init__(self, name: str) -> None:
        self.name = name
        self.files: list[str] = []  # that it was read from
        self.reading: dict[str, Any] = {}  # how: options of `read` or `read_sweep`
        self.lock = FairLock()
        self.version = 0
        self.maker = SceneMaker()
        self._preset: tuple | None = None

    def layers(self, state: State) -> list[Layer]:
        """What is to be traced; with `lock` held."""
        raise NotImplementedError

    def particles(self) -> Particles:
        """Those of the first layer, for colours, statistics and the camera."""
        raise NotImplementedError

    def origin(self, state: State) -> Origin:
        """How what is shown can be had without the viewer; with `lock` held."""
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
        return Origin(
            [file, *self.option_words()],
            [f"particles = gb.read({', '.join([repr(file), *self.option_code()])})"],
        )

    def option_words(self) -> list[str]:
        """How it was read, as options of commands."""
        words = []
        for name, value in self.reading.items():
            for one in value if isinstance(value, (list, tuple)) else [value]:
                words += [OPTIONS[name], str(one)]
        return words

    def option_code(self) -> list[str]:
        """The same as arguments."""
        return [f"{name}={value!r}" for name, value in self.reading.items()]

    def preset_settings(self, name: str, scene: Scene, up: Any) -> RenderSettings:
        """A preset scaled to the scene that was first seen with it, so that light and ground stay
        where they are while particles move."""
        if self._preset is None or self._preset[:2] != (name, tuple(up)):
            self._preset = name, tuple(up), preset(name, scene, up)
        return self._preset[2]

    def plates(self, state: State) -> list[Plate]:
        """Images in space that are seen with it."""
        return []

    def marks(self) -> list[Mark]:
        """What is drawn over all pictures of it; with `lock` held."""
        return []

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner of what is shown, world."""
        try:
            return self.particles().bounds()
        except ValueError:  # no particles yet
            return np.full(3, -1.0), np.full(3, 1.0)

    def outline(self) -> np.ndarray | None:
        """Points (M, 3) that a camera is to see; None: the particles with their surface."""
        return None

    def color_names(self) -> list[str]:
        return color_names(self.particles())

    def advance(self, state: State) -> float | None:
        return None

    def stand_still(self) -> None:
        """No more steps until somebody asks again."""

    def status(self) -> str:
        """What it does now, in a line for the page; waits for nobody."""
        return ""

    def probe(
        self, state: State, camera: Camera, size: tuple[int, int], screen: Any, nearest: float
    ) -> Probed | None:
        """What else than the surface is seen at a place of the picture, nearer than so far; with
        `lock` held."""
        return None

    def facts(self) -> dict[str, Any]:
        """What the statistics say besides: words to numbers or texts."""
        return {}

    def close(self) -> None:
        """Give back files and connections."""


class SceneSource(Source):
    """Particles, a scene, or layers, that stand still unless the user's program changes them."""

    def __init__(
        self,
        name: str,
        shown: Particles | Scene | list[Layer],
        device: str = "auto",
        threads: int = 0,
    ):
        super().__init__(name)
        self._beside: list[Layer] = []
        self._material = None
        self._clips: tuple = ()
        if isinstance(shown, list):
            first, *self._beside = (
                item if isinstance(item, Layer) else Layer(item) for item in shown
            )
            shown, self._material, self._clips = first.scene, first.material, tuple(first.clips)
        given = shown if isinstance(shown, Scene) else None
        self._scene = given
        self._particles = None if given is not None else shown
        self.maker = SceneMaker(device, threads, given)

    def particles(self) -> Particles:
        return self._particles if self._scene is None else self._scene.particles

    def layers(self, state: State) -> list[Layer]:
        scene = self.maker.scene(self.particles(), state)
        return [Layer(scene, self._material, self._clips), *self._beside]

    def update(self, particles: Particles | Any) -> None:
        """Show other particles from now on."""
        if not isinstance(particles, Particles):
            particles = Particles(particles)
        with self.lock:
            self._scene, self._particles = None, particles
            self.version += 1


def box_corners(lo: Any, hi: Any) -> np.ndarray:
    """(8, 3)."""
    return np.array(np.meshgrid(*zip(lo, hi, strict=True))).reshape(3, -1).T
