"""Colors from an attribute, a legend, and exact values at every pixel.

Writes speed.png. The same on the command line:
    globule render splash.npz -o speed.png --color-by speed --colormap magma \\
        --legend-at outside --legend-unit m/s
"""

import globule as gb
import numpy as np
from globule._demo.data import splash

positions, _, spacing = splash()
radius = np.hypot(positions[:, 0], positions[:, 2])
speed = np.abs(positions[:, 1]) + 0.3 * np.exp(-((radius - 0.45) ** 2) / 0.02)

particles = gb.Particles(positions, support=2 * spacing, attributes={"speed": speed})
notes = gb.Annotation(legend="outside", legend_unit="m/s")
frame = gb.render(particles, (800, 600), color_by="speed", colormap="magma", annotate=notes)
frame.save("speed.png")

# Where several metaballs meet, attributes are blended by their share of the field.
values = frame.attribute(speed)  # (H, W), NaN where missed
lo, hi = gb.find_value_range([particles], "speed")
print(f"particles {lo:.3f} to {hi:.3f}, visible {np.nanmin(values):.3f} to {np.nanmax(values):.3f}")
