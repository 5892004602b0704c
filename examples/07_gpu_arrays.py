"""Arrays on a GPU, from CuPy, PyTorch or JAX, are used where they are; nothing is copied.

Writes wave.png. Without a GPU, or without any of them, the example says so and stops.
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
    try:
        import jax

        gpus = jax.devices("gpu")
        return jax.numpy, lambda array: jax.device_put(array, gpus[0])
    except (ImportError, RuntimeError):
        pass
    return None


found = device_arrays()
if found is None:
    print("skipped: no GPU with CuPy, PyTorch or JAX here")
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
    height = 0.1 * package.sin(12 * radius - 0.3 * step)
    positions = package.stack([flat[:, 0], height, flat[:, 2]], 1)  # a new array for each frame
    scene.update(positions=positions)
gb.render(scene, gb.Camera((1.5, 1.2, 2.0), (0, 0, 0)), (800, 600)).save("wave.png")
print(f"{len(scene):,} particles from {package.__name__}, built in {1e3 * scene.octree.build_seconds:.2f} ms")
