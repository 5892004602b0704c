"""From a file of particles to an image, in five lines. `gb.render("splash.ply")` does it in one.

Writes splash.png. The example makes the file first and needs no data.
"""

import globule as gb
from globule._demo.data import splash

positions, color, _ = splash()
gb.write("splash.ply", gb.Particles(positions, color=color))

particles = gb.read("splash.ply")  # .vtk .vtp .vtu .bgeo .ply .xyz .csv .npz .npy .txt
scene = gb.Scene(particles)  # support and threshold from the particles' spacing
frame = gb.render(scene, size=(800, 600))  # the default camera sees all of them
frame.save("splash.png")
print(f"{len(particles):,} particles, {frame.mask.mean():.0%} of the image, {scene.octree}")
