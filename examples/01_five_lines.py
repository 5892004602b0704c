"""Particles from a file to a picture, in five lines.

Writes splash.png. The file is made first, so that the example needs no data.
"""

import globule as gb
from globule._demo.data import splash

positions, color, _ = splash()
gb.write("splash.ply", gb.Particles(positions, color=color))

particles = gb.read("splash.ply")  # .vtk .vtp .vtu .bgeo .ply .xyz .csv .npz .npy .txt
scene = gb.Scene(particles)  # support and threshold from the particles' spacing
frame = gb.render(scene, size=(800, 600))  # a camera that sees all of them
frame.save("splash.png")
print(f"{len(particles):,} particles, {frame.mask.mean():.0%} of the picture, {scene.octree}")
