"""The demo's data set, made again: a frame of the dam break, packed small.

Writes python/globule/dam_break.npz: positions in 64ths of the spacing, in the octree's order and as
differences, which compress well, and speeds in 255ths of the highest.
"""

from pathlib import Path

import globule as gb
import numpy as np

SPACING, SECONDS = 0.4 / 27, 1.3
TARGET = Path(__file__).resolve().parents[1] / "python/globule/dam_break.npz"

sim = gb.Simulation("dam-break", spacing=SPACING)
sim.run(SECONDS)
fluid = sim.shown_particles
scene = gb.Scene(fluid, device="cpu")
_, order = scene.octree.sorted_keys(len(fluid))
fluid = fluid[order]
x, y, z = fluid.positions.T
upright = np.stack([x - x.mean(), z, -(y - y.mean())], axis=1)  # y up, as the demo's camera
steps = np.round(upright * (64 / SPACING)).astype(np.int64)
speed = np.linalg.norm(fluid.attributes["velocity"], axis=1)
np.savez_compressed(
    TARGET,
    spacing=SPACING,
    steps=np.diff(steps, axis=0, prepend=0).astype(np.int16),
    top_speed=speed.max(),
    speed=np.round(255 * speed / speed.max()).astype(np.uint8),
)
print(f"{TARGET.name}: {len(fluid):,} particles, {TARGET.stat().st_size:,} bytes")
