"""Particles of a fluid: as balls, as ellipsoids along the surface (Yu and Turk 2013), and as
the smooth surface that encloses their volume.

Writes balls.png, ellipsoids.png and smooth.png. The command line does the same:
    globule render splash.npz -o balls.png --surface balls
    globule render splash.npz -o ellipsoids.png --anisotropic
    globule render splash.npz -o smooth.png
"""

import globule as gb
import numpy as np
from globule._demo.data import splash

positions, _, spacing = splash(30_000)
# The particles of a simulation are less even than the demo's.
rng = np.random.default_rng(12)
positions = positions + rng.uniform(-0.35, 0.35, positions.shape) * spacing
particles = gb.Particles(positions, support=2 * spacing)

# Each kernel is flattened across the surface and stretched along it. Each position moves towards
# the mean of its neighbors. Particles with few neighbors get small kernels.
found = gb.fluids.find_anisotropy(particles)
smooth = gb.Particles(found.centers, anisotropy=found.G)

camera = gb.Camera(eye=(1.05, 0.95, 1.7), look_at=(0, 0.12, 0))
settings = gb.RenderSettings(shadows=True, specular=0.4, samples=2)
scenes = {
    "balls": gb.Scene(particles),
    "ellipsoids": gb.Scene(smooth),
    "smooth": gb.Scene(positions, surface="smooth", spacing=spacing),
}
for name, scene in scenes.items():
    frame = gb.render(scene, camera, (480, 360), settings)
    frame.save(f"{name}.png")
    print(f"{name}: {frame.mask.mean():.0%} of the image")
axes = 1 / np.linalg.eigvalsh(found.G)
print(f"longest over shortest axis: {np.median(axes[:, 0] / axes[:, 2]):.1f} on average")
