"""Colors from an attribute: a color map on the particles, and exact values at every pixel.

Writes speed.png. The command line does the first part too:
    globule render splash.npz -o speed.png --color-by speed --colormap magma
"""

import globule as gb
import numpy as np
from globule._base.colormaps import colorize
from globule._demo.data import splash

positions, _, spacing = splash()
radius = np.hypot(positions[:, 0], positions[:, 2])
speed = np.abs(positions[:, 1]) + 0.3 * np.exp(-((radius - 0.45) ** 2) / 0.02)

particles = gb.Particles(positions, support=2 * spacing, attributes={"speed": speed})
lo, hi = gb.value_range([particles], "speed")
particles.color = colorize(speed, "magma", lo, hi)

scene = gb.Scene(particles)
frame = gb.render(scene, size=(800, 600))
frame.save("speed.png")

# Where several metaballs meet, attributes blend like the field: the nearer, the more.
values = frame.attribute(speed)  # (H, W), NaN where nothing was hit
print(f"particles {lo:.3f} to {hi:.3f}, seen {np.nanmin(values):.3f} to {np.nanmax(values):.3f}")
