"""Colors from an attribute, a legend, and exact values at every pixel.

Writes speed.png. The same on the command line:
    globule render splash.npz -o speed.png --color-by speed --colormap magma --legend
"""

import globule as gb
import numpy as np
from globule._demo.data import splash

positions, _, spacing = splash()
radius = np.hypot(positions[:, 0], positions[:, 2])
speed = np.abs(positions[:, 1]) + 0.3 * np.exp(-((radius - 0.45) ** 2) / 0.02)

particles = gb.Particles(positions, support=2 * spacing, attributes={"speed": speed})
scene = gb.Scene(particles)
frame = gb.render(scene, (800, 600), color_by="speed", colormap="magma")  # range=(lo, hi), too
lo, hi = gb.value_range([particles], "speed")
gb.save_png("speed.png", gb.add_legend(frame.image, "magma", lo, hi, "speed"))

# Where several metaballs meet, attributes are blended by their share of the field.
values = frame.attribute(speed)  # (H, W), NaN where missed
print(f"particles {lo:.3f} to {hi:.3f}, visible {np.nanmin(values):.3f} to {np.nanmax(values):.3f}")
