"""One small call of every part, for tools that make a program slow:

compute-sanitizer --tool racecheck python tests/tour.py cuda
"""

import sys

import globule as gb
import numpy as np
from globule.scene.thesis import Thesis
from sweep_helpers import small_sweep

SIZE = (64, 48)


def scenes(device: str) -> None:
    points = np.random.default_rng(1).random((3000, 3), np.float32)
    color, camera = points.copy(), gb.Camera.fit(points, size=SIZE)
    water = gb.Material(transmission=0.9, index=1.33)
    light = gb.RenderSettings(shadows=True, ambient_rays=2, bounces=2, samples=2, material=water)
    for options in ({}, {"octree": "dense", "level": 4}, {"key_bits": 64}):
        scene = gb.Scene(gb.Particles(points, color=color), support=0.1, device=device, **options)
        for settings in (gb.RenderSettings(), light):
            gb.render(scene, camera, SIZE, settings).picture  # noqa: B018
        scene.field(points[:100])
        scene.gradient(points[:100])
        scene.neighbors(points[:100], 0.1)
        print("scene", options, flush=True)
    gb.render(scene, camera, SIZE, clips=[gb.ClipSphere((0.5, 0.5, 0.5), 0.2)]).refine(2)
    dense = gb.Scene(points, support=0.1, device=device, octree="dense", level=4)
    gb.render(dense, camera, SIZE, thesis=Thesis())
    print("pictures", flush=True)


def volumes(device: str) -> None:
    sweep = small_sweep()
    for method in ("pvn-om", "vvn-om", "pvn", "vvn", "bezier"):
        gb.ultrasound.reconstruct(sweep, method=method, spacing=1.0, device=device)
    gb.ultrasound.reconstruct(sweep, compounding="median", spacing=1.0, device=device)
    live = gb.ultrasound.Reconstructor(1.0, device=device)
    for i in range(len(sweep)):
        live.add(sweep.frames[i], sweep.world_from_image[i])
    live.volume()
    print("volumes", flush=True)


def simulations(device: str) -> None:
    for name, spacing in (("droplet", 0.001), ("cut-block", 0.01)):
        sim = gb.Simulation(name, spacing=spacing, device=device)
        for _ in range(3):
            sim.step()
        gb.render(sim.scene, size=SIZE).picture  # noqa: B018
        print("simulation", name, flush=True)


if __name__ == "__main__":
    for part in (scenes, volumes, simulations):
        part(sys.argv[1] if len(sys.argv) > 1 else "cpu")
