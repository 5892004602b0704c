"""globule against POV-Ray's blob on the same particles, camera and field:
`python bench/peers/against_povray.py [--scenes splash,pool-302751] [--size 1024x782]`.

Prints, for each scene, CPU seconds of both (ours: octree and picture on one thread; POV-Ray's: its
whole process, and its tracing alone), the pixels whose hit or miss differs, and depth differences.
Skips with a line where POV-Ray is not installed.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
import globule as gb  # noqa: E402
import povray  # noqa: E402

from bench.speed import load, write_csv  # noqa: E402


def measure(name: str, size: tuple[int, int]) -> dict:
    positions, spacing = load(name)
    camera = gb.Camera.fit(positions, size=size)
    scene = gb.Scene(gb.Particles(positions, support=2 * spacing), threshold=0.6, device="cpu", threads=1)
    gb.render(scene, camera, size)
    times = []
    for _ in range(5):
        start = time.process_time()
        scene.update(positions=positions)
        frame = gb.render(scene, camera, size)
        times.append(time.process_time() - start)
    view = {"eye": camera.eye, "look_at": camera.look_at, "up": camera.up, "fov": camera.fov}
    with tempfile.TemporaryDirectory() as folder:
        depth_scene = Path(folder) / "depth.pov"
        near, far = povray.write_scene(depth_scene, positions, 2 * spacing, 1.0, 0.6, view, "depth")
        image, cpu, _ = povray.run(depth_scene, size)
        traced = povray.render_seconds()
    mask, depth = povray.hit_mask_and_depth(image, near, far)
    found = povray.compare(mask, depth, frame.distance)
    ours = float(np.median(times))
    return {"scene": name, "particles": len(positions), "ours_cpu_s": ours, "povray_cpu_s": cpu,
            "povray_trace_s": traced, "ratio": cpu / ours, **found,
            "depth_max_in_supports": found["depth_max"] / (2 * spacing)}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", default="splash,pool-302751")
    parser.add_argument("--size", default="1024x782")
    parser.add_argument("-o", "--output", help="CSV file")
    options = parser.parse_args()
    if povray.find_povray() is None:
        print("povray: not installed (Debian: apt-get install povray), comparison skipped")
        return
    width, _, height = options.size.partition("x")
    rows = [measure(name, (int(width), int(height))) for name in options.scenes.split(",")]
    for row in rows:
        print("  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))
    if options.output:
        write_csv(options.output, rows)


if __name__ == "__main__":
    main()
