"""Particles that a Warp kernel moves on a GPU, drawn where they are: nothing is copied.

Writes twist.png. Needs `pip install warp-lang`. Without a GPU, the example says so and stops.
"""

import ctypes

import globule as gb
import numpy as np

try:
    ctypes.CDLL("libcuda.so.1")
    import warp as wp
except (OSError, ImportError) as error:
    print(f"skipped: no GPU, or no Warp here ({error})")
    raise SystemExit from None


@wp.kernel
def twist(rest: wp.array(dtype=wp.vec3), angle: float, moved: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    x = rest[i]
    moved[i] = wp.quat_rotate(wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle * x[1]), x)


side, tall = np.linspace(-0.3, 0.3, 13), np.linspace(-1, 1, 41)
grid = np.stack(np.meshgrid(side, tall, side), -1).reshape(-1, 3)
rest = wp.array(grid, dtype=wp.vec3, device="cuda:0")
moved = wp.clone(rest)
try:
    scene = gb.Scene(gb.Particles(moved, support=0.1), device="cuda")
except RuntimeError as error:  # globule was built without CUDA
    print(f"skipped: {error}")
    raise SystemExit from None
for step in range(10):
    wp.launch(twist, len(rest), inputs=[rest, 0.2 * step], outputs=[moved], device="cuda:0")
    scene.update(positions=moved)
gb.render(scene, size=(480, 480)).save("twist.png")
print(f"{len(scene):,} particles of Warp on {rest.device}")
