"""Frames of the surgery scene: `python -m bench.brain [--device cuda] [--spacing 0.002]`.

Each frame simulates 1/60 s and makes one image of 1920×1080 with shadows. From each of the times of
`--at` on, prints the time of a frame's steps and of its image (wall time; the image's pixels are on
the host), frames per second, the slowest frame, steps a frame and the fastest particle. With
`--beside`, the image of a frame's start is made while its steps run, on the same or another GPU: an
image is then a frame late.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import globule as gb
import numpy as np

from .tables.report import machine

FRAME = 1 / 60  # s


def frames(sim, snapshot, camera, settings, size: tuple[int, int], n: int) -> tuple[list[str], gb.Frame]:
    def step() -> float:
        begin = time.perf_counter()
        sim.run(FRAME)  # the last step's end is on the host then
        return time.perf_counter() - begin

    def image(scene) -> tuple[float, gb.Frame]:
        begin = time.perf_counter()
        frame = gb.render(scene, camera, size, settings)
        _ = frame.image
        return time.perf_counter() - begin, frame

    steps, images, whole, n_steps = [], [], [], sim.n_steps
    with ThreadPoolExecutor(1) as pool:
        for _ in range(n):
            begin = time.perf_counter()
            if snapshot is None:
                steps.append(step())
                seconds, frame = image(sim.scene)
            else:
                snapshot.update()
                ahead = pool.submit(step)
                seconds, frame = image(snapshot)
                steps.append(ahead.result())
            images.append(seconds)
            whole.append(time.perf_counter() - begin)
    speed = float(np.linalg.norm(sim.velocities, axis=1).max())
    row = [f"{sim.time:.2f}", f"{1e3 * np.median(steps):.1f}", f"{1e3 * np.median(images):.1f}"]
    row += [f"{1 / np.mean(whole):.1f}", f"{1e3 * max(whole):.1f}"]
    return [*row, f"{(sim.n_steps - n_steps) / n:.1f}", f"{speed:.2f}"], frame


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--spacing", type=float, default=0.002)
    parser.add_argument("--fine-fluids", action="store_true", help="blood of half the spacing")
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--surface", choices=("smooth", "balls"), default="smooth")
    parser.add_argument("--edges", type=int, default=3, help="samples at edges")
    parser.add_argument("--beside", metavar="DEVICE", help="where images are made while steps run: cuda, cuda:1")
    parser.add_argument("--at", default="0,1.1", help="simulated seconds at which frames are measured")
    parser.add_argument("-o", "--output", help="a PNG of the last image")
    options = parser.parse_args()

    size = tuple(int(v) for v in options.size.split("x"))
    sim = gb.Simulation(
        "brain-surgery", spacing=options.spacing, fine_fluids=options.fine_fluids, device=options.device
    )
    view = sim.file.view
    camera = gb.Camera(view.eye, view.look_at, view.up, view.fov)
    sim.scene.surface = options.surface
    settings = replace(
        gb.load_preset("tissue", sim.scene, view.up), samples=1, ambient_rays=0, edge_samples=options.edges
    )
    snapshot = sim.snapshot(options.beside) if options.beside else None
    print(machine(str(sim.scene.device)))
    print("   at, s  steps, ms  image, ms  frames/s  slowest, ms  steps a frame  fastest, m/s")
    for at in (float(v) for v in options.at.split(",")):
        if at > sim.time:
            sim.run(at - sim.time)
        row, frame = frames(sim, snapshot, camera, settings, size, options.frames)
        print("".join(f"{cell:>{w}}" for cell, w in zip(row, (8, 11, 11, 10, 13, 15, 14), strict=True)), flush=True)
    if options.output:
        frame.save(options.output)


if __name__ == "__main__":
    main()
