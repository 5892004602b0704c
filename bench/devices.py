"""Two GPUs: `python -m bench.devices`.

Frames a second of a scene on one GPU, and of two scenes on two, asked for by one thread and by two;
every frame rebuilds its octree.
"""

from __future__ import annotations

import threading
import time

import globule as gb

from .tables.scenes import pool

SIZE, FRAMES = (1024, 782), 600


def main() -> None:
    import cupy

    points, spacing = pool(302_751)
    camera = gb.Camera.fit(points, size=SIZE)

    def make(device: int):
        with cupy.cuda.Device(device):
            moved = [cupy.asarray(points + k * 0.1 * spacing) for k in (0, 1)]
        scene = gb.Scene(gb.Particles(moved[0], support=2 * spacing), threshold=0.6,
                         device=f"cuda:{device}")  # fmt: skip
        return scene, moved

    def draw(some, frames: int) -> None:
        for i in range(frames):
            for scene, moved in some:
                scene.update(positions=moved[i % 2])
                gb.render(scene, camera, SIZE)
        for scene, _ in some:
            scene._scene.synchronize()

    def rate(run, frames: int) -> float:
        run(50)
        start = time.perf_counter()
        run(frames)
        return frames / (time.perf_counter() - start)

    def apart(frames: int) -> None:
        threads = [threading.Thread(target=draw, args=([one], frames)) for one in both]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    both = [make(0), make(1)]
    alone = [rate(lambda n, k=k: draw([both[k]], n), FRAMES) for k in (0, 1)]
    together = 2 * rate(lambda n: draw(both, n), FRAMES)
    in_threads = 2 * rate(apart, FRAMES)
    print(f"one scene on either GPU: {alone[0]:.0f} and {alone[1]:.0f} fps")
    print(f"both, one thread: {together:.0f} fps, {together / max(alone):.2f} times")
    print(f"both, two threads: {in_threads:.0f} fps, {in_threads / max(alone):.2f} times")


if __name__ == "__main__":
    main()
