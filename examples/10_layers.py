"""Several scenes in one image: vessels and a lump in translucent tissue, divided by an attribute.

Writes layers.png, and open.png, where only the tissue is cut.
"""

import dataclasses

import globule as gb
import numpy as np

rng = np.random.default_rng(5)


def branches(start, heading, radius, length):
    """Points along a vessel that divides until it is thin, with the distance between them."""
    steps = np.arange(0, length, 0.02)
    bend = rng.normal(0, 0.25, 3)
    path = start + np.outer(steps, heading) + np.outer(steps**2, bend)
    found = [np.column_stack([path, np.full(len(path), 2.2 * radius)])]
    if radius > 0.018:
        for _ in range(2):
            turned = heading + 0.4 * rng.normal(0, 1, 3)
            turned /= np.linalg.norm(turned)
            found += branches(path[-1], turned, 0.74 * radius, 0.8 * length)
    return found


vessels = np.concatenate(branches(np.array([0, -1, 0]), np.array([0, 1, 0]), 0.07, 0.6))
axis = np.arange(-1.2, 1.2, 0.06)
grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
grid += rng.uniform(-0.012, 0.012, grid.shape)
body = grid[np.linalg.norm(grid / (1.05, 1.0, 0.8), axis=1) < 1 + 0.04 * np.sin(5 * grid[:, 0])]
lump = np.array([0.45, 0.1, 0.35]) + rng.normal(0, 0.07, (80, 3))

positions = np.concatenate([body, vessels[:, :3], lump])
counts = [len(body), len(vessels), len(lump)]
support = np.concatenate([np.full(counts[0], 0.13), vessels[:, 3], np.full(counts[2], 0.12)])
particles = gb.Particles(positions, support=support, attributes={"phase": np.repeat([0, 1, 2], counts)})

skin = gb.Material(transmission=0.75, index=1.0, color=(0.80, 0.45, 0.38), absorption=0.1)
red = gb.Material(color=(0.55, 0.02, 0.02), specular=0.6)
yellow = gb.Material(color=(0.75, 0.55, 0.08))
layers = gb.split_layers(particles, "phase", {0: skin, 1: red, 2: yellow})

look = gb.load_preset("tissue", layers[0].scene)
settings = dataclasses.replace(look, lights=gb.RenderSettings.lights)  # white, not warm
camera = gb.Camera((1.2, 0.9, 3.4), (0, 0, 0), fov=34)
gb.render(layers, camera, (420, 380), settings).save("layers.png")

front = gb.ClipPlane(normal=(0.2, 0, 1), offset=0.1)
opaque = dataclasses.replace(skin, transmission=0.0)
cut = dataclasses.replace(layers[0], clips=[front], material=opaque)
gb.render([cut, *layers[1:]], camera, (420, 380), settings).save("open.png")
print(f"{len(body):,} particles of tissue, {len(vessels):,} of vessels, {len(lump)} of the lump")
