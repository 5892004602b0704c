"""Frames per second of the 302,751-particle pool by how much of the picture it fills:
`python -m bench.views [--device cuda]`."""

from __future__ import annotations

import argparse
import time

import globule as gb
import numpy as np

from .speed import SIZES
from .tables.scenes import pool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    positions, spacing = pool()
    size = SIZES["pool-302751"]
    scene = gb.Scene(positions, support=2 * spacing, threshold=0.6, device=options.device)
    if scene.device.name != "cpu":
        import cupy

        positions = cupy.asarray(positions)
        scene.update(positions=positions)
    fit = gb.Camera.fit(scene, size=size)
    eye, middle = np.array(fit.eye), np.array(fit.look_at)
    for farther in (0.5, 0.75, 1.0, 1.25, 1.5, 2.0):
        camera = gb.Camera(middle + (eye - middle) * farther, middle)
        gb.render(scene, camera, size)
        n = 300 if scene.device.name != "cpu" else 5
        start = time.perf_counter()
        for _ in range(n):
            scene.update(positions=positions)
            frame = gb.render(scene, camera, size)
        frame.trace_seconds  # noqa: B018  waits for the device
        fps = n / (time.perf_counter() - start)
        print(f"distance x{farther}: {frame.mask.mean():.1%} of the pixels hit, {fps:.0f} fps")


if __name__ == "__main__":
    main()
