"""A simulation described in Python, and changed while it runs: wind, a drop, a new viscosity.

Writes steer.png, before and after.
"""

import globule as gb
import numpy as np

sim = gb.Simulation({
    "spacing": 0.02,  # m
    "domain": {"lo": [0, 0, 0], "hi": [0.6, 0.3, 0.5], "walls": True},
    "fluids": [
        {"name": "water", "box": {"lo": [0, 0, 0], "hi": [0.6, 0.3, 0.12]}, "color": "#3f86d8"},
        {"name": "milk", "color": "#f2ede0"},  # no particles yet
    ],
})  # fmt: skip
camera = gb.Camera(eye=(0.3, -1.0, 0.55), look_at=(0.3, 0.15, 0.12), up=(0, 0, 1), fov=38)

corners = np.indices((5, 5, 5)).reshape(3, -1).T * 0.02
ids = sim.add(corners + [0.26, 0.11, 0.32], phase="milk", velocities=(0, 0, -1))
before = gb.render(sim.scene, camera, size=(360, 260)).image

while sim.time < 0.25:
    if sim.time > 0.1:  # wind on the particles above the water
        high = sim.ids[sim.positions[:, 2] > 0.14]
        sim.apply_force((0.02, 0, 0), ids=high)  # N on each
    sim.step()

sim.phases["water"].viscosity = 5.0  # Pa s; any value may change between steps
sim.phases["water"].implicit = True
sim.phases["water"].color = (0.75, 0.4, 0.05)
velocities = sim.velocities
velocities *= 0.5
sim.velocities = velocities
sim.advance(0.1)

after = gb.render(sim.scene, camera, size=(360, 260)).image
gb.save_png("steer.png", np.hstack([before, after]))
found = np.linalg.norm(sim.velocities[np.searchsorted(sim.ids, ids)], axis=1)
print(f"{len(sim):,} particles after {sim.n_steps} steps; the milk moves at {found.mean():.2f} m/s")
