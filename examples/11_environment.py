"""Chrome, brushed metal and glass under an environment image.

Writes studio.png. The image is made here; `gb.Environment` also takes a file's name:
    globule render balls.npz -o chrome.png --reflection 0.9 --sky studio.hdr --samples 8
"""

import globule as gb
import numpy as np

# A studio: a dim room, two lamps and a warm strip at the horizon. Row 0 is the zenith.
height, width = 128, 256
row, column = np.mgrid[0:height, 0:width] / [[[height]], [[width]]]
room = 0.10 + 0.35 * np.clip(1 - 2 * row, 0, 1)
image = room[..., None] * [0.75, 0.85, 1.0]
image += np.exp(-(((row - 0.5) / 0.05) ** 2))[..., None] * [0.55, 0.42, 0.30]
image[(abs(row - 0.24) < 0.10) & (abs(column - 0.28) < 0.07)] = 6.0
image[(abs(row - 0.30) < 0.06) & (abs(column - 0.72) < 0.12)] = [2.5, 3.0, 4.0]
sky = gb.Environment(image, strength=1.0, turn=20)

chrome = gb.Material(reflection=0.92, color=(0.6, 0.6, 0.6), specular=0.0)
brushed = gb.Material(reflection=0.85, roughness=0.45, color=(0.7, 0.5, 0.25), specular=0.0)
glass = gb.Material(transmission=1.0, index=1.5, absorption=(0.25, 0.05, 0.12), specular=0.0)

rng = np.random.default_rng(11)
layers = []
for x, material in ((-2.1, chrome), (0.0, glass), (2.1, brushed)):
    centers = np.clip(rng.normal(0, 0.38, (14, 3)), -0.6, 0.6) + [x, 0, 0]
    layers.append(gb.Layer(gb.Scene(gb.Particles(centers, support=0.85), threshold=0.5), material))

settings = gb.RenderSettings(
    lights=[gb.DirectionalLight((-0.9, 1.2, 0.8), (0.5, 0.5, 0.5), angle=20)],  # the larger lamp
    shadows=True,
    ambient=(0.35, 0.37, 0.40),
    sky=sky,
    ground=gb.Ground(-1.25, color=(0.62, 0.62, 0.62), other=(0.34, 0.35, 0.38), check=1.2),
    bounces=6,
)
frame = gb.render(layers, gb.Camera((0.6, 1.5, 7.5), (0, -0.15, 0), fov=34), (540, 290), settings)
frame.refine(10, progress=lambda done, total: print(f"sample {done} of {total}"))
frame.save("studio.png")
print(f"{frame.samples} samples a pixel")
