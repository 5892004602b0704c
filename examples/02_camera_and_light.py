"""Your own camera, lights and background; and the distances and normals that a frame has.

Writes near.png, and depth.png, where nearer surfaces are lighter.
"""

import globule as gb
import numpy as np
from globule._demo.data import splash
from PIL import Image

positions, color, spacing = splash()
scene = gb.Scene(gb.Particles(positions, color=color, support=2 * spacing))

camera = gb.Camera(eye=(0.9, 0.7, 1.1), look_at=(0, 0.15, 0), fov=45)
settings = gb.RenderSettings(
    lights=(
        gb.DirectionalLight(direction=(-1, 1.5, 0.5), radiance=(0.9, 0.85, 0.75)),
        gb.PointLight(position=(0.5, 0.6, 0.9), radiance=(0.10, 0.15, 0.30)),
    ),
    background=(0.02, 0.03, 0.05),  # colors are linear, 1 is white
    specular=0.5,
)
frame = gb.render(scene, camera, (800, 600), settings)
frame.save("near.png")

distance = frame.distance  # along the ray, world units, infinite where missed
seen = distance[frame.mask]
shade = np.where(frame.mask, (seen.max() - distance) / np.ptp(seen), 0)
Image.fromarray((255 * shade).astype(np.uint8)).save("depth.png")
print(f"nearest {seen.min():.3f}, farthest {seen.max():.3f} from the eye")
print(f"{(frame.normal[frame.mask][:, 1] > 0.9).mean():.0%} of the visible surface faces upwards")
