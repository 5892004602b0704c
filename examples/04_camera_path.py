"""A movie along key frames of the camera, and a turntable.

Writes path.mp4 and turn_00.png to turn_05.png; without PyAV (pip install "globule[video]") only
the images. A TOML file may hold the same keys:
    globule render splash.npz -o path.mp4 --camera-path keys.toml
"""

import globule as gb
from globule._demo.data import splash

positions, color, spacing = splash(20_000)
particles = gb.Particles(positions, color=color, support=2 * spacing)

keys = [
    {"time": 0.0, "eye": (1.6, 1.2, 2.2), "look_at": (0, 0.1, 0)},
    {"time": 0.5, "eye": (0.2, 0.5, 1.4)},  # look_at, up and fov stay
    {"time": 1.0, "eye": (-1.0, 0.4, 0.8), "look_at": (0, 0.25, 0), "fov": 50},
    {"time": 1.5, "eye": (-1.9, 1.5, -1.0)},
]
try:
    path = gb.CameraPath(keys, fps=16)
    files = gb.render_sequence(particles, "path.mp4", path, (480, 360), fps=16)
    print(f"{files[0]}: {path.n_frames} frames")
except gb.MissingPackageError as error:
    print(f"no movie: {error}")

start = gb.Camera((0, 1.3, 2.9), (0, 0.2, 0))
cameras = gb.orbit(start, turns=1, n=6)
images = gb.render_sequence(particles, "turn_%02d.png", cameras, (320, 240))
print(f"{images[0]} to {images[-1]}: once around")
