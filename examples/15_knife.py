"""Tissue under the knife: an elastic block is cut in two, and the free piece falls.

Writes knife.png: before the cut, after the cut, and after the fall.
"""

import globule as gb
import numpy as np

sim = gb.Simulation({
    "spacing": 0.0025,  # m
    "domain": {"lo": [-0.05, -0.05, -0.06], "hi": [0.1, 0.1, 0.08]},
    "solids": [{
        "name": "block",
        "box": {"lo": [0, 0, 0], "hi": [0.04, 0.02, 0.02]},
        "young": 40000,  # Pa
        "fixed": [{"box": {"lo": [0, 0, 0], "hi": [0.005, 0.02, 0.02]}}],
        "color": "#c0625a",
    }],
})  # fmt: skip
camera = gb.Camera(eye=(0.08, -0.12, 0.06), look_at=(0.02, 0.01, 0.0), up=(0, 0, 1), fov=35)

images = [gb.render(sim.scene, camera, size=(260, 220)).image]
before = sim.n_bonds
edge = np.array([[0.0212, -0.01, 0.04], [0.0212, 0.03, 0.04]])  # (K, 3) m, a line of points
n_cut = sim.cut((edge, edge - [0, 0, 0.08]))  # all bonds between the line's two places
print(f"{n_cut} of {before:,} bonds cut; {sim.n_pieces} pieces")
images.append(gb.render(sim.scene, camera, size=(260, 220)).image)

free = sim.piece == np.unique(sim.piece)[1]  # a piece has the number of its first particle
height = sim.positions[free, 2].mean()
sim.advance(0.08)
fallen = height - sim.positions[free, 2].mean()
print(f"the free piece fell {1e3 * fallen:.1f} mm in 0.08 s")
images.append(gb.render(sim.scene, camera, size=(260, 220)).image)
gb.save_png("knife.png", np.hstack(images))
