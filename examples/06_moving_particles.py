"""Particles that move: any object with `particles` and `step()` can be shown, frame by frame.

Writes fountain_00.png to fountain_11.png. The octree is rebuilt for every frame; the scene
keeps its memory.
"""

import globule as gb
import numpy as np


class Fountain:
    """Twelve jets of drops; each drop starts again when it has fallen."""

    def __init__(self, n: int = 6000):
        rng = np.random.default_rng(6)
        angle = 2 * np.pi * rng.integers(0, 12, n) / 12 + rng.normal(0, 0.03, n)
        outwards, upwards = rng.normal(0.9, 0.03, n), rng.normal(3.3, 0.06, n)
        self.speed = np.stack([outwards * np.cos(angle), upwards, outwards * np.sin(angle)], axis=1)
        self.age = rng.uniform(0, 0.68, n)

    @property
    def particles(self) -> gb.Particles:
        t = self.age[:, None]
        positions = self.speed * t - np.float64([0, 4.9, 0]) * t**2
        fresh = 1 - t / 0.68
        color = fresh * [0.55, 0.85, 1.0] + (1 - fresh) * [0.05, 0.2, 0.6]
        return gb.Particles(positions, color=color, support=0.045)

    def step(self) -> None:
        self.age = (self.age + 0.02) % 0.68


camera = gb.Camera(eye=(0.3, 0.9, 2.2), look_at=(0, 0.27, 0), fov=38)
files = gb.render_sequence(Fountain(), "fountain_%02d.png", camera, size=(360, 360), n_frames=12, threshold=0.4)
print(f"{files[0]} to {files[-1]}")
