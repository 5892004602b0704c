"""Particles that a Warp kernel moves, drawn where they are: nothing is copied.

Writes twist.png. On a GPU if Warp and globule both have one, else on the CPU. Needs
`pip install warp-lang`.
"""

import globule as gb
import numpy as np

try:
    import warp as wp
except ImportError:
    print("skipped: no Warp here (pip install warp-lang)")
    raise SystemExit from None
wp.config.quiet = True
try:
    gb.Scene(np.zeros((1, 3)), support=1, device="cuda")
    place, device = wp.get_device("cuda:0"), "cuda"
except (RuntimeError, ValueError):
    place, device = wp.get_device("cpu"), "cpu"


@wp.kernel
def twist(rest: wp.array(dtype=wp.vec3), angle: float, moved: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    x = rest[i]
    moved[i] = wp.quat_rotate(wp.quat_from_axis_angle(wp.vec3(0.0, 1.0, 0.0), angle * x[1]), x)


side, tall = np.linspace(-0.3, 0.3, 13), np.linspace(-1, 1, 41)
grid = np.stack(np.meshgrid(side, tall, side), -1).reshape(-1, 3)
rest = wp.array(grid, dtype=wp.vec3, device=place)
moved = wp.clone(rest)
scene = gb.Scene(gb.Particles(moved, support=0.1), device=device)
for step in range(10):
    wp.launch(twist, len(rest), inputs=[rest, 0.2 * step], outputs=[moved], device=place)
    scene.update(positions=moved)
gb.render(scene, size=(480, 480)).save("twist.png")
print(f"{len(scene):,} particles of Warp on {rest.device}")
