"""Tables 6.1 and 6.2 of the thesis, made again: `python -m bench thesis`.

Frames per second by number of particles and level of the octree, 1024x782 = 800,768 rays, and the
octree's memory. Every frame moves the particles, rebuilds the octree and traces one ray per pixel.
The source's preset has a dense octree and marches; globule's default has a sparse octree and exact
roots. Both show the same particles with supports of half a leaf's edge (§3.6). The images are
equal except for the hits that marching misses. `smooth` is the default with supports of two
spacings: one closed surface.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from globule.data.particles import Particles
from globule.pieces.scene import Scene
from globule.render.camera import Camera
from globule.render.frame import Frame
from globule.render.render import render
from globule.scene.octree import Octree
from globule.scene.thesis import Thesis, default_support

from .report import Row, machine, print_table, write_csv
from .scenes import pool

COUNTS = (100, 1_432, 21_822, 145_777, 302_751)
DEPTHS = (6, 7, 8)
SIZE = (1024, 782)
THRESHOLD = 0.6
NODE_BYTES = {"dense": 16, "sparse": 32}
# (particles, depth): frames per second on a GTX 1080, Table 6.1.
SOURCE_FPS = {
    (100, 6): 164, (100, 7): 159, (100, 8): 154,
    (1_432, 6): 56, (1_432, 7): 48, (1_432, 8): 35,
    (145_777, 6): 34, (145_777, 7): 25, (145_777, 8): 22,
    (302_751, 6): 24, (302_751, 7): 14, (302_751, 8): 11,
}  # fmt: skip


def scene_of(n: int) -> tuple[np.ndarray, float]:
    """Positions (n, 3) float32 and their spacing, m; scattered for n < 1000, else a pool."""
    if n >= 1000:
        return pool(n)
    return np.random.default_rng(1).uniform(-1, 1, (n, 3)).astype(np.float32), 2 / n ** (1 / 3)


def run(
    device: str = "auto",
    threads: int = 0,
    frames: int = 0,
    particles: Sequence[int] = COUNTS,
    depths: Sequence[int] = DEPTHS,
    root: str = "march",
    output: str | None = None,
) -> list[Row]:
    """Measure, print both tables, write Table 6.1's rows, with memory, to `output` (CSV).

    Args:
        frames: number of frames to average; 0: 3 on the CPU, 100 on a GPU.
        root: root method of the source's preset, "march" or "bezier".
    """
    rows: list[Row] = []
    smooth: dict[int, float] = {}
    description = ""
    for n in particles:
        positions, spacing = scene_of(n)
        for depth in depths:
            support = default_support(positions, depth)

            def show(
                support: float, thesis: Thesis | None, depth: int = depth, p: np.ndarray = positions
            ) -> tuple[Scene, dict[str, Any]]:
                options: dict[str, Any] = {"octree": "dense", "level": depth} if thesis else {}
                scene = Scene(
                    Particles(p, support=support), threshold=THRESHOLD, device=device,
                    threads=threads, **options,
                )  # fmt: skip
                return scene, measure(scene, p, 0.05 * support, thesis, frames)

            dense, theirs = show(support, Thesis(root))
            scene, ours = show(support, None)
            if n not in smooth:
                smooth[n] = show(2 * spacing, None)[1]["fps"]
            description = scene.device.description
            source = SOURCE_FPS.get((n, depth))
            rows.append({
                "particles": n,
                "depth": depth,
                "source fps": source,
                "thesis fps": theirs["fps"],
                "build ms": theirs["build"],
                "trace ms": theirs["trace"],
                "default fps": ours["fps"],
                "default/thesis": ours["fps"] / theirs["fps"],
                "default/source": ours["fps"] / source if source else None,
                "smooth fps": smooth[n],
                "hit": ours["hit"],
                "hit differs": float((ours["mask"] != theirs["mask"]).mean()),
                **nodes("dense", dense.octree),
                **nodes("sparse", scene.octree),
            })  # fmt: skip
    speed = [k for k in rows[0] if "nodes" not in k and "MiB" not in k]
    memory = [k for k in rows[0] if k not in speed]
    print_table(
        f"Table 6.1: frames per second, {SIZE[0] * SIZE[1]:,} rays, octree rebuilt every frame; source: GTX 1080",
        [{k: row[k] for k in speed} for row in rows],
    )
    print_table(
        "Table 6.2: nodes of the octree; dense: 16 bytes a node, sparse: 32",
        [{k: row[k] for k in ("particles", "depth", *memory)} for row in rows],
    )
    print(f"\nmachine: {machine(description)}")
    if output:
        write_csv(output, [{**row, "machine": machine(description)} for row in rows])
    return rows


def nodes(kind: str, octree: Octree) -> Row:
    """Number of nodes, and their memory in MiB, of a "dense" or "sparse" octree."""
    mib = octree.n_nodes * NODE_BYTES[kind] / 2**20
    return {f"{kind} nodes": octree.n_nodes, f"{kind} MiB": mib}


def measure(scene: Scene, positions: np.ndarray, shift: float, thesis: Thesis | None, frames: int) -> dict[str, Any]:
    """Frames per second of wall time, build and trace of the last frame in ms, and its hits."""
    frames = frames or (3 if scene.device.name == "cpu" else 100)
    sets: list[Any] = [positions, positions + np.float32(shift)]
    if scene.device.name != "cpu":
        import cupy

        sets = [cupy.asarray(p) for p in sets]
    camera = Camera.fit(positions, size=SIZE)

    def frame(i: int) -> Frame:
        scene.update(positions=sets[i % 2])
        return render(scene, camera, SIZE, thesis=thesis)

    frame(1)
    scene._scene.synchronize()
    start = time.perf_counter()
    for i in range(frames):
        last = frame(i)
    scene._scene.synchronize()
    seconds = (time.perf_counter() - start) / frames
    mask = last.mask
    return {
        "fps": 1 / seconds,
        "build": 1e3 * scene.octree.build_seconds,
        "trace": 1e3 * last.trace_seconds,
        "mask": mask,
        "hit": float(mask.mean()),
    }
