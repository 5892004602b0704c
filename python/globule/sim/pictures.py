"""Images of a running simulation, with the camera and look of its scene's view."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np

from .._base.colormaps import colorize
from ..formats.pictures.video import need_av
from ..pieces.scene import Scene
from ..render.camera import Camera, first_direction
from ..render.fit import fit_camera
from ..render.frame import Frame
from ..render.image_sequence import KeptScene, MovieFrames
from ..render.layers import beside, scene_like
from ..render.presets import load_preset
from ..render.render import render
from ..render.settings import RenderSettings, for_values
from .scene_file import SceneFile


class Eye:
    """The camera and light of a scene's images.

    The first image that shows particles decides what depends on them (a camera that sees all, the
    ground's height, the reach of light), and it stays.

    Args:
        scene: its `view` is used.
        size: (width, height) pixels, instead of the view's own.
    """

    def __init__(self, scene: SceneFile, size: tuple[int, int] | None = None):
        self.view = scene.view
        width, height = scene.view.size
        self.size = size or (int(width), int(height))
        self._camera: Camera | None = None
        self._settings: RenderSettings | None = None
        self._kept = KeptScene()
        if self.view.eye is not None and self.view.look_at is not None:
            self._camera = Camera(self.view.eye, self.view.look_at, self.view.up, self.view.fov)

    def picture(self, sim: Any) -> Frame:
        """An image of the simulation as it is now."""
        scene = self._shown(sim)
        if self._settings is None:  # nothing yet to scale light or camera by
            camera = self._camera or Camera((0, -1, 0), (0, 0, 0), self.view.up)
            return render(scene, camera, self.size)
        layers = [scene, sim.foam.layer()] if len(sim.foam) else scene
        return render(layers, self._camera, self.size, self._settings)

    def settled(self, sim: Any) -> bool:
        """Whether camera and light are decided, which happens where there are particles."""
        self._shown(sim)
        return self._settings is not None

    def _shown(self, sim: Any) -> Scene:
        scene = sim.scene if self.view.speeds is None else self._by_speed(sim)
        if self._settings is None and any(s.octree.n_inside for s in (scene, *beside(scene))):
            light = self._light(scene)
            self._settings = light if self.view.speeds is None else for_values(light)
            self._camera = self._camera or self._fitted(scene)
        return scene

    def _fitted(self, scene: Scene) -> Camera:
        up = self.view.up
        towards = first_direction(up)
        return fit_camera(scene, self.size, direction=towards, up=up, fov=self.view.fov)

    def _light(self, scene: Scene) -> RenderSettings:
        if self.view.look is None:
            return RenderSettings()
        settings = load_preset(self.view.look, scene, self.view.up)
        if self.view.ground is None or settings.ground is None:
            return settings
        return replace(settings, ground=replace(settings.ground, height=self.view.ground))

    def _by_speed(self, sim: Any) -> Scene:
        """The particles colored by their speed."""
        assert self.view.speeds is not None
        particles = sim.shown_particles
        speed = np.linalg.norm(particles.attributes["velocity"], axis=1)
        particles.color = colorize(speed, "viridis", *self.view.speeds)
        return self._kept.show(particles, lambda p: scene_like(sim.scene, p))


class Pictures:
    """Every frame's image, into a folder or a movie.

    Args:
        scene: its `view` is used.
        folder: for 00000.png and so on; None: no files.
        movie: an .mp4; None: no movie.
        size: (width, height) pixels, instead of the view's own.
        resume: go on with the frames of a movie that is there.

    Raises:
        ImportError: a movie without PyAV.
    """

    def __init__(
        self,
        scene: SceneFile,
        folder: str | None = None,
        movie: str | None = None,
        size: tuple[int, int] | None = None,
        resume: bool = False,
    ):
        self.eye = Eye(scene, size)
        self.folder = folder
        self.movie = None
        if movie:
            need_av()
            self.movie = MovieFrames(movie, resume)

    @property
    def wanted(self) -> bool:
        """Whether there is a folder or a movie to write to."""
        return bool(self.folder or self.movie)

    def begin_again(self, sim: Any, fps: float, until: float) -> None:
        """Decide light and camera as an uninterrupted run does, by its first image that shows
        particles. sim: the scene at its start; it runs while it is empty, until at most `until`, s,
        at `fps` frames per second."""
        frame = 0
        while not self.eye.settled(sim) and (frame + 1) / fps <= until:
            frame += 1
            sim.run_to(frame / fps)

    def add(self, number: int, sim: Any) -> list[str]:
        """Take the image of frame `number`; returns the paths of the files that stay."""
        if not self.wanted:
            return []
        frame = self.eye.picture(sim)
        kept = []
        if self.folder:
            os.makedirs(self.folder, exist_ok=True)
            kept = [os.path.join(self.folder, f"{number:05d}.png")]
            frame.save(kept[0])
        if self.movie:
            self.movie.open()
            frame.save(self.movie.path(number))
        return kept

    def finish(self, n_frames: int, fps: float) -> list[Any]:
        """Encode the movie of `n_frames` at `fps`; returns its path in a list."""
        if not self.movie:
            return []
        self.movie.encode(n_frames, fps)
        return [self.movie.movie]
