"""Questions about a scene: the field and its gradient anywhere, rays, and neighbors.

Prints the answers.
"""

import globule as gb
import numpy as np
from globule._demo.data import splash

positions, _, spacing = splash(20_000)
scene = gb.Scene(gb.Particles(positions, support=2 * spacing))

# Rays straight down meet the surface where the field is the threshold.
x, z = np.meshgrid(np.linspace(-0.8, 0.8, 9), np.linspace(-0.8, 0.8, 9))
origins = np.stack([x.ravel(), np.full(x.size, 2.0), z.ravel()], axis=1).astype(np.float32)
down = np.broadcast_to(np.float32([0, -1, 0]), origins.shape).copy()
distance, normal, _ = scene.intersect(origins, down)
hit = np.isfinite(distance)
points = origins[hit] + distance[hit, None] * down[hit]
off = np.abs(scene.field(points) - scene.threshold).max()
print(
    f"{hit.sum()} of {len(hit)} rays hit; heights {points[:, 1].min():.3f} to "
    f"{points[:, 1].max():.3f}; the field is off the threshold by {off:.1e} at most"
)

# The normal is the gradient, turned outwards.
gradient = scene.gradient(points)
outwards = -gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
print(f"normals and gradients differ by {np.abs(outwards - normal[hit]).max():.1e} at most")

# Neighbors within a radius, as compressed rows.
offsets, indices = scene.neighbors(positions, 2 * spacing)
n_neighbors = np.diff(offsets.astype(np.int64)) - 1  # a particle finds itself too
print(f"{n_neighbors.mean():.1f} neighbors within two spacings; {(n_neighbors == 0).sum()} alone")
row = indices[offsets[0] : offsets[1]]
distance = np.linalg.norm(positions[row] - positions[0], axis=1)
print(f"the first particle's are at most {distance.max() / spacing:.2f} spacings away")
