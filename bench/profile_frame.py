"""A few frames of one scene for a profiler: `ncu python -m bench.profile_frame pool-302751`."""

import sys

import cupy
import globule as gb

from .speed import SIZES, load

name = sys.argv[1]
positions, spacing = load(name)
camera = gb.Camera.fit(positions, size=SIZES[name])
scene = gb.Scene(gb.Particles(cupy.asarray(positions), support=2 * spacing), threshold=0.6, device="cuda")
for _ in range(3):
    scene.update(positions=scene.particles.positions)
    frame = gb.render(scene, camera, SIZES[name])
scene._scene.synchronize()
