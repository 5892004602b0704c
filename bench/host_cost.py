"""What a frame costs beside the device's work:
`python -m bench.host_cost [--device cuda] [-o host.csv]`.

So few particles and pixels that checking, packing and the calls themselves are what is left. "host"
is the whole call's time less what the device says that it took; the best of several rounds.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable
from typing import Any

import globule as gb
import numpy as np

from .tables.report import machine, print_table, write_csv

SIZE = (1, 1)


def microseconds(call: Callable[[], Any], device_seconds: Callable[[Any], float], n: int) -> dict:
    """Time a call, all of it and the host's share, in the best of 7 rounds."""
    best = np.inf
    for _ in range(7):
        start = time.perf_counter()
        for _ in range(n):
            last = call()
        best = min(best, (time.perf_counter() - start) / n)
    device = np.inf
    for _ in range(n):
        last = call()
        device = min(device, device_seconds(last))
    return {"all, µs": 1e6 * best, "host, µs": 1e6 * (best - device)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--particles", type=int, default=64)
    parser.add_argument("--calls", type=int, default=300)
    parser.add_argument("-o", "--output", help="CSV file")
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    n = options.particles
    positions = rng.random((n, 3)).astype(np.float32)
    where = {"device": options.device, "threads": options.threads}
    scene = gb.Scene(positions, support=0.3, **where)
    fields = {
        "support": rng.uniform(0.25, 0.3, n), "weight": rng.uniform(0.9, 1, n),
        "color": rng.random((n, 3)), "reflection": rng.random(n),
    }  # fmt: skip
    rich = gb.Scene(gb.Particles(positions, **fields), **where)
    if scene.device.name != "cpu":
        import cupy

        positions = cupy.asarray(positions)
    camera, settings = gb.Camera.fit(scene, size=SIZE), gb.RenderSettings()
    cut = [gb.ClipPlane((1, 0, 0), 0.5)]
    layers = [gb.Layer(scene, gb.Material(transmission=1.0)), gb.Layer(rich, clips=cut)]
    turn = itertools.count()

    def moved() -> gb.Camera:
        return gb.Camera(np.add(camera.eye, 1e-6 * next(turn)), camera.look_at)

    def update_and_render() -> gb.Frame:
        scene.update(positions=positions)
        return gb.render(scene, camera, SIZE, settings)

    def built(of: gb.Scene) -> Callable[[Any], float]:
        return lambda _: of.octree.build_seconds

    def traced(frame: gb.Frame) -> float:
        return frame.trace_seconds

    calls: dict[str, tuple[Callable[[], Any], Callable[[Any], float]]] = {
        "update, positions": (lambda: scene.update(positions=positions), built(scene)),
        "update, positions; four other fields": (
            lambda: rich.update(positions=positions), built(rich)),
        "update, Particles": (lambda: scene.update(gb.Particles(positions)), built(scene)),
        "render, settings as before": (
            lambda: gb.render(scene, camera, SIZE, settings), traced),
        "render, default settings": (lambda: gb.render(scene, camera, SIZE), traced),
        "render, another camera": (lambda: gb.render(scene, moved(), SIZE, settings), traced),
        "render, other settings": (
            lambda: gb.render(scene, camera, SIZE, gb.RenderSettings(bounces=3)), traced),
        "render, two layers, a cut": (
            lambda: gb.render(layers, camera, SIZE, settings), traced),
        "update and render": (
            update_and_render, lambda f: f.trace_seconds + scene.octree.build_seconds),
    }  # fmt: skip
    rows = [{"call": name, **microseconds(*parts, n=options.calls)} for name, parts in calls.items()]
    print_table(machine(scene.device.description), rows)
    if options.output:
        write_csv(options.output, rows)


if __name__ == "__main__":
    main()
