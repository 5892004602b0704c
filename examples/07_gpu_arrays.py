"""Arrays on a GPU, from CuPy or PyTorch, are used where they are; nothing is copied.

Writes wave.png. Without a GPU, or without either package, the example says so and stops.
"""

import globule as gb
import numpy as np


def device_arrays():
    """A package with arrays on the GPU, and how to put one there; None if there is none."""
    try:
        import cupy

        cupy.cuda.runtime.getDeviceCount()
        return cupy, cupy.asarray
    except Exception:  # not installed, or no GPU
        pass
    try:
        import torch

        if torch.cuda.is_available():
            return torch, lambda array: torch.from_numpy(array).cuda()
    except ImportError:
        pass
    return None


found = device_arrays()
if found is None:
    print("skipped: no GPU with CuPy or PyTorch here")
    raise SystemExit
package, to_device = found

n = 400
grid = np.stack(np.meshgrid(np.linspace(-1, 1, n), [0], np.linspace(-1, 1, n)), axis=-1)
flat = to_device(np.ascontiguousarray(grid.reshape(-1, 3), np.float32))
try:
    scene = gb.Scene(gb.Particles(flat, support=5 / n), device="cuda")
except RuntimeError as error:  # globule was built without CUDA
    print(f"skipped: {error}")
    raise SystemExit from None

radius = (flat[:, 0] ** 2 + flat[:, 2] ** 2) ** 0.5
for step in range(30):
    positions = flat + 0.0  # a new array; the scene must not see a half-written one
    positions[:, 1] = 0.1 * package.sin(12 * radius - 0.3 * step)
    scene.update(positions=positions)
gb.render(scene, gb.Camera((1.5, 1.2, 2.0), (0, 0, 0)), (800, 600)).save("wave.png")
print(
    f"{len(scene):,} particles from {package.__name__}, built in "
    f"{1e3 * scene.octree.build_seconds:.2f} ms"
)
