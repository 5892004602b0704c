"""A splash as water and as blood: presets set material, light and surroundings.

Writes water.png and blood.png. The command line does the same:
    globule render splash.npz -o water.png --preset water --samples 8
"""

import dataclasses

import globule as gb
from globule._demo.data import splash

positions, _, spacing = splash(30_000)
scene = gb.Scene(gb.Particles(positions, support=2 * spacing))
camera = gb.Camera(eye=(1.05, 0.95, 1.7), look_at=(0, 0.12, 0))

water = gb.load_preset("water", scene)  # a RenderSettings, scaled to the scene
print(f"water: {water.material}")
gb.render(scene, camera, (480, 360), water).save("water.png")

# `dataclasses.replace` changes a part of the settings, or of their material.
blood = gb.load_preset("blood", scene)
thinner = dataclasses.replace(blood.material, absorption=tuple(0.6 * a for a in blood.material.absorption))
blood = dataclasses.replace(blood, material=thinner, samples=2)
frame = gb.render(scene, camera, (480, 360), blood)
frame.refine(2)  # two samples a pixel more; the first two are kept
frame.save("blood.png")
print(f"blood: {frame.samples} samples a pixel")
