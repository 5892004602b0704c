"""Speed of triangle meshes: `python -m bench.mesh [--device cuda] [--triangles 1000000]`.

A wavy ball of even triangles half in the pool of 302,751 particles, at 1920×1080 with shadows.
Prints the image's time for each row, and frames per second. The octree and the hierarchy stay; in
"mesh moves" each frame has another pose, in "both rebuilt" new particles and vertices. The ball of
"poles" has meridians: a thousand slivers meet at each of its poles.
"""

from __future__ import annotations

import argparse
import time

import globule as gb
import numpy as np

from .tables.scenes import pool


def ball(n_triangles: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a closed, wavy ball of about that many even triangles: a cube's faces,
    blown up."""
    n = max(1, round((n_triangles / 12) ** 0.5))
    side = np.tan(np.linspace(-np.pi / 4, np.pi / 4, n + 1))
    u, v = np.meshgrid(side, side, indexing="ij")
    sheet = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3)
    k = np.arange(n * (n + 1)).reshape(n, n + 1)[:, :-1].ravel()
    two = np.concatenate([np.c_[k, k + n + 1, k + n + 2], np.c_[k, k + n + 2, k + 1]])
    vertices, faces = [], []
    for axis in range(3):
        for sign in (1, -1):
            turned = np.roll(sheet * (1, sign, sign), axis, axis=1)  # a rotation: faces look outwards
            faces.append(two + len(vertices) * len(sheet))
            vertices.append(turned)
    d = np.concatenate(vertices)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    t, p = np.arccos(d[:, 1]), np.arctan2(-d[:, 2], d[:, 0])
    r = radius * (1 + 0.05 * np.sin(9 * p) * np.sin(t) * np.sin(11 * t))
    return (d * r[:, None]).astype(np.float32), np.concatenate(faces)


def ball_with_poles(n_triangles: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """The same of meridians and circles of latitude."""
    n = max(3, round((n_triangles / 4) ** 0.5))
    theta, phi = np.linspace(0, np.pi, n + 1)[1:-1], np.linspace(0, 2 * np.pi, 2 * n + 1)[:-1]
    t, p = np.meshgrid(theta, phi, indexing="ij")
    r = radius * (1 + 0.05 * np.sin(9 * p) * np.sin(t) * np.sin(11 * t))
    around = np.stack([r * np.sin(t) * np.cos(p), r * np.cos(t), -r * np.sin(t) * np.sin(p)], -1)
    poles = np.array([[0, radius, 0], [0, -radius, 0]])
    vertices = np.concatenate([poles[:1], around.reshape(-1, 3), poles[1:]])
    k = np.arange(2 * n)
    j = (k + 1) % (2 * n)
    a = 1 + 2 * n * np.arange(n - 2)[:, None]
    b = a + 2 * n
    last = len(vertices) - 1
    faces = [
        np.c_[np.zeros(2 * n, int), 1 + k, 1 + j],
        np.stack([a + k, b + k, b + j], -1).reshape(-1, 3),
        np.stack([a + k, b + j, a + j], -1).reshape(-1, 3),
        np.c_[last - 2 * n + k, np.full(2 * n, last), last - 2 * n + j],
    ]
    return vertices.astype(np.float32), np.concatenate(faces)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--triangles", type=int, default=1_000_000)
    parser.add_argument("--particles", type=int, default=302_751)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--frames", type=int, default=0)
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    positions, spacing = pool(options.particles)
    lo, hi = positions.min(axis=0), positions.max(axis=0)
    middle = (lo + hi) / 2
    scene = gb.Scene(gb.Particles(positions, support=2 * spacing), threshold=0.6, device=options.device)
    gpu = scene.device.name != "cpu"
    vertices, faces = ball(options.triangles, 0.25 * float(np.ptp(positions[:, 0])))
    mesh = gb.Mesh(vertices, faces, color=(0.8, 0.4, 0.2))
    above = np.eye(4)
    above[:3, 3] = middle[0], hi[1], middle[2]
    mesh.pose = above
    poles = gb.Mesh(*ball_with_poles(options.triangles, 0.25 * float(np.ptp(positions[:, 0]))))
    poles.pose = above
    if gpu:
        import cupy

        vertices, positions = cupy.asarray(vertices), cupy.asarray(positions)
    camera = gb.Camera.fit(scene.particles, size=(width, height))
    plain, shadows = gb.RenderSettings(), gb.RenderSettings(shadows=True)
    glass = gb.Material(reflection=0.0, transmission=1.0, index=1.5)
    glassy = gb.RenderSettings(shadows=True, sky=gb.Sky(), bounces=4)

    def moved(i: int) -> None:
        pose = above.copy()
        pose[0, 3] += 1e-3 * (i % 7)
        mesh.pose = pose

    def rebuilt(i: int) -> None:
        scene.update(positions=positions)
        mesh.update(vertices)

    rows = [
        ("particles alone, no shadows", [scene], plain, None),
        ("particles alone", [scene], shadows, None),
        ("mesh alone", [mesh], shadows, None),
        ("mesh + particles, no shadows", [scene, mesh], plain, None),
        ("mesh + particles", [scene, mesh], shadows, None),
        ("mesh + particles, mesh moves", [scene, mesh], shadows, moved),
        ("mesh + particles, both rebuilt", [scene, mesh], shadows, rebuilt),
        ("mesh with poles + particles", [scene, poles], shadows, None),
        ("glass mesh + particles", [scene, gb.Layer(mesh, glass)], glassy, None),
    ]
    print(f"{len(mesh):,} triangles, {len(scene):,} particles, {width}x{height}, {scene.device.name}")
    frames = options.frames or (100 if gpu else 2)
    for name, layers, settings, change in rows:
        for i in range(3 if gpu else 1):
            gb.render(layers, camera, (width, height), settings)
            if change:
                change(i)
        scene._scene.synchronize()
        mesh.build(scene.device).synchronize()
        start = time.perf_counter()
        for i in range(frames):
            if change:
                change(i)
            frame = gb.render(layers, camera, (width, height), settings)
        frame.trace_seconds  # noqa: B018  waits for the last frame
        seconds = (time.perf_counter() - start) / frames
        print(f"{name:34} {1e3 * seconds:9.3f} ms  {1 / seconds:8.1f} frames/s")


if __name__ == "__main__":
    main()
