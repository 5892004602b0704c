"""Speed of light: `python -m bench.light [--device cuda] [-o light.csv]`.

The pool of 750,000 particles at 1920×1080 on a GPU, the splash at 1024×782 on a CPU; every frame
rebuilds the octree from positions that moved; "at rest": only the picture is made again. Prints a
table with each row's time as a multiple of the plain picture's.
"""

from __future__ import annotations

import argparse
import time
import zlib

import globule as gb
import numpy as np

from .speed import load
from .tables.report import write_csv
from .tables.scenes import pool

WATER = gb.Material(transmission=1.0, index=1.33, absorption=(0.4, 0.1, 0.05))
SETTINGS = {
    "plain": gb.RenderSettings(),
    "shadow": gb.RenderSettings(shadows=True),
    "shadow + 4 ambient rays": gb.RenderSettings(shadows=True, ambient_rays=4),
    "mirror, depth 4": gb.RenderSettings(material=gb.Material(reflection=0.3), sky=gb.Sky()),
    "reflection + refraction, depth 4": gb.RenderSettings(material=WATER, sky=gb.Sky()),
    "reflection + refraction + shadow": gb.RenderSettings(material=WATER, sky=gb.Sky(), shadows=True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--frames", type=int, default=0)
    parser.add_argument("--only", default="", help="rows whose name has this in it")
    parser.add_argument("-o", "--output", help="CSV file")
    options = parser.parse_args()
    gpu = gb.Scene(np.zeros((1, 3)), device=options.device).device.name != "cpu"
    size = (1920, 1080) if gpu else (1024, 782)
    positions, spacing = pool(750_000) if gpu else load("splash")
    camera = gb.Camera.fit(positions, size=size)
    sets = [positions]
    if gpu:
        import cupy

        sets = [cupy.asarray(positions)]
        sets.append(sets[0] + cupy.float32(0.1 * spacing))
    scene = gb.Scene(
        gb.Particles(sets[0], support=2 * spacing), threshold=0.6, device=options.device, threads=options.threads
    )
    rows: list[dict] = []
    for name, settings in SETTINGS.items():
        if options.only not in name:
            continue
        frames = options.frames or (60 if gpu else 3)
        for i in range(3):
            scene.update(positions=sets[i % len(sets)])
            frame = gb.render(scene, camera, size, settings)
        scene._scene.synchronize()
        times = []
        start = time.perf_counter()
        for i in range(frames):
            begin = time.perf_counter()
            scene.update(positions=sets[i % len(sets)])
            frame = gb.render(scene, camera, size, settings)
            if not gpu:
                times.append(time.perf_counter() - begin)
        scene._scene.synchronize()
        seconds = float(np.median(times)) if times else (time.perf_counter() - start) / frames
        start = time.perf_counter()
        for _ in range(frames):
            frame = gb.render(scene, camera, size, settings)
        scene._scene.synchronize()
        at_rest = (time.perf_counter() - start) / frames
        rows.append(
            {
                "light": name,
                "particles": len(scene),
                "size": f"{size[0]}x{size[1]}",
                "hit": round(float(frame.mask.mean()), 3),
                "ms": round(1e3 * seconds, 2),
                "fps": round(1 / seconds, 1),
                "fps at rest": round(1 / at_rest, 1),
                "times plain": round(seconds * 1e3 / rows[0]["ms"], 2) if rows else 1.0,
                "hash": f"{zlib.crc32(frame.picture.tobytes()):08x}",
                "device": scene.device.description,
            }
        )
        print("  ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    if options.output:
        write_csv(options.output, rows)


if __name__ == "__main__":
    main()
