"""Error of frames left out, of every method and sweep, in one table (Markdown).

    python -m bench.left_out [--voxel-size MM] [SWEEP[,PLUS.xml or CALIBRATION.toml] …]

Every K-th frame is left out at a time and predicted from the volume of the others (`cross_validate`
of globule.ultrasound.trust). Errors are root mean squares in gray levels over the pixels that the
method predicts. `common` counts only the pixels that every method predicts. Without a SWEEP, the
sweeps are simulated.

`gaussian`, `cubic` and `rbf` stand for methods of the literature that globule does not offer: a
Gaussian of the distance, as wide as the distance of the nearest frame asks for (adaptive Gaussian,
convolution by distance), a Catmull-Rom spline through four frames along the path (B-spline), and
biharmonic radial basis functions with a linear part through 3x3 pixels of both neighboring frames
(Rohling, Gee, Berman 1999). They are evaluated at the pixels themselves, without a volume, and so
is `linear`, the interpolation of `frames`. Errors are of every third row and column.
"""

from __future__ import annotations

import argparse
from typing import Any

import globule as gb
import numpy as np
from globule.ultrasound.grid import VoxelGrid
from globule.ultrasound.neighbors import FramePath
from globule.volumes.slices import reslice_frame

METHODS = ("frames", "bezier", "vvn-om", "pvn-om")
LITERATURE = ("linear", "cubic", "gaussian", "rbf")
STEP = 3  # between pixels that are compared


def literature(sweep: Any, rest: Any, f: int, spacing: float) -> dict[str, np.ndarray]:
    """Predictions of frame f, (H, W), NaN where a method has none."""
    index = np.flatnonzero(rest.valid)
    low = sweep.bounds()[0]
    grid = VoxelGrid(low, spacing, (1, 1, 1))
    poses = grid.poses(rest.world_from_image[index]) / 2.0**32
    path = FramePath(rest.frames[index], poses, rest.mask)
    height, width = sweep.frames.shape[1:]
    rows, columns = np.mgrid[:height:STEP, :width:STEP]
    pixels = np.stack([np.ones(rows.size), columns.ravel(), rows.ravel()], axis=1)
    points = pixels @ (grid.poses(sweep.world_from_image[f][None])[0] / 2.0**32).reshape(3, 3)
    n = len(index)
    after = int(np.searchsorted(index, f))
    found = {name: np.full(rows.size, np.nan) for name in LITERATURE}
    a, b = after - 1, after
    if not 0 < after < n or not path.joined[a]:
        return {name: values.reshape(rows.shape) for name, values in found.items()}
    first, second = path.coordinates(a, points), path.coordinates(b, points)
    d0, d1 = first[:, 0], second[:, 0]
    known = (d0 < 0) != (d1 < 0)
    t = d0 / np.where(known, d0 - d1, 1)
    at = first[:, 1:] + t[:, None] * (second[:, 1:] - first[:, 1:])
    four = [max(a - 1, 0), a, b, min(b + 1, n - 1)]
    sampled = [path.sample(i, at[:, 0], at[:, 1]) for i in four]
    values = np.stack([value for value, _ in sampled])
    known &= sampled[1][1]
    shares = 0.5 * np.stack([
        -t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2
    ])  # fmt: skip
    found["cubic"][known] = np.clip((shares * values).sum(axis=0), 0, None)[known]
    total, weights = np.zeros(rows.size), np.zeros(rows.size)
    width2 = np.maximum(np.minimum(np.abs(d0), np.abs(d1)), 0.5) ** 2
    for i in four:
        place = path.coordinates(i, points)
        value, inside = path.sample(i, place[:, 1], place[:, 2])
        weight = np.where(inside, np.exp(-0.5 * place[:, 0] ** 2 / width2), 0)
        total += weight * value
        weights += weight
    known &= weights > 1e-6
    found["gaussian"][known] = (total / np.maximum(weights, 1e-12))[known]
    between = (d0 < 0) != (d1 < 0)
    one = path.between(a, b, points)
    found["linear"][one.known] = one.value[one.known]
    found["rbf"][between] = radial(path, (a, b), points[between])
    return {name: values.reshape(rows.shape) for name, values in found.items()}


def radial(path: FramePath, pair: tuple[int, int], points: np.ndarray) -> np.ndarray:
    """Biharmonic splines through 3x3 pixels of each of two frames around points (P, 3)."""
    values, places, known = [], [], np.ones(len(points), bool)
    for f in pair:
        _, u, v = path.coordinates(f, points).T
        (nx, ny), origin = path.averaged, path.poses[f, :3]
        for dv in (-1, 0, 1):
            for du in (-1, 0, 1):
                column, row = (
                    np.rint((c - (n - 1) / 2) / n) * n + (n - 1) / 2 + d * n for c, n, d in ((u, nx, du), (v, ny, dv))
                )
                value, inside = path.sample(f, column, row)
                x, y = path.poses[f, 3:6], path.poses[f, 6:9]
                values.append(value)
                places.append(origin + column[:, None] * x + row[:, None] * y - points)
                known &= inside
    data, x = np.stack(values, axis=1), np.stack(places, axis=1)
    m = data.shape[1]
    out = np.full(len(points), np.nan)
    for part in np.array_split(np.flatnonzero(known), max(1, known.sum() // 4096)):
        near = x[part]
        matrix = np.zeros((len(part), m + 4, m + 4))
        matrix[:, :m, :m] = np.linalg.norm(near[:, :, None] - near[:, None], axis=3)
        matrix[:, :m, m] = matrix[:, m, :m] = 1
        matrix[:, :m, m + 1 :] = near
        matrix[:, m + 1 :, :m] = near.transpose(0, 2, 1)
        right = np.concatenate([data[part], np.zeros((len(part), 4))], axis=1)[..., None]
        weights = np.linalg.solve(matrix, right)[..., 0]
        out[part] = (weights[:, :m] * np.linalg.norm(near, axis=2)).sum(axis=1) + weights[:, m]
    return np.clip(out, 0, None)


def errors(sweep: Any, k: int, **options: Any) -> dict[str, tuple[float, float, float]]:
    """Of each method: rms over its own pixels, rms over the common pixels, share of pixels."""
    indices = np.flatnonzero(sweep.valid)
    names = (*METHODS, *LITERATURE)
    sums = {name: np.zeros(4) for name in names}
    n = 0
    for fold in range(k):
        left_out = [i for rank, i in enumerate(indices[1:-1]) if rank % k == fold]
        valid = sweep.valid & ~np.isin(np.arange(len(sweep)), left_out)
        rest = gb.ultrasound.Sweep(sweep.frames, sweep.world_from_image, valid=valid, mask=sweep.mask)
        volumes = {method: gb.ultrasound.reconstruct(rest, method, **options) for method in METHODS}
        spacing = float(volumes["frames"].spacing[0])
        for f in left_out:
            seen = sweep.frames[f][::STEP, ::STEP].astype(float)
            inside = np.ones(seen.shape, bool)
            if sweep.mask is not None:
                inside = sweep.mask[::STEP, ::STEP]
            found = literature(sweep, rest, f, spacing)
            for method, volume in volumes.items():
                cut = reslice_frame(volume, sweep, f)
                values = np.where(cut.origin > 0, cut.values, np.nan)
                found[method] = values[::STEP, ::STEP]
            common = inside & np.all([np.isfinite(v) for v in found.values()], axis=0)
            n += int(inside.sum())
            for name, values in found.items():
                own = inside & np.isfinite(values)
                square = (values - seen) ** 2
                sums[name] += square[own].sum(), own.sum(), square[common].sum(), common.sum()
    return {name: (np.sqrt(a / max(b, 1)), np.sqrt(c / max(d, 1)), b / n) for name, (a, b, c, d) in sums.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sweeps", nargs="*", metavar="SWEEP[,PLUS.xml or CALIBRATION.toml]")
    parser.add_argument("--voxel-size", type=float, default=None)
    parser.add_argument("-k", type=int, default=5)
    parser.add_argument("--every", type=int, default=1, help="take every N-th frame of the sweep")
    options = parser.parse_args()
    sweeps = {}
    for word in options.sweeps:
        name, _, place = word.partition(",")
        reading = {"calibration" if place.endswith(".toml") else "plus": place or None}
        sweeps[name.rsplit("/", 1)[-1]] = gb.ultrasound.read_sweep(name, **reading)
    if not sweeps:
        for speckle in (0.0, 0.3):
            sweeps[f"breast phantom, speckle {speckle:g}"] = gb.ultrasound.phantoms.breast(
                66, length=33.0, size=(200, 200), spacing=0.23, speckle=speckle
            )
    place = {"size": 256} if options.voxel_size is None else {"spacing": options.voxel_size}
    print(f"| sweep | method | rms | rms, common pixels | pixels predicted |\n|{'---|' * 5}")
    for name, sweep in sweeps.items():
        found = errors(sweep[:: options.every], options.k, device="cpu", **place)
        for method, (own, common, share) in sorted(found.items(), key=lambda item: item[1][1]):
            print(f"| {name} | {method} | {own:.2f} | {common:.2f} | {100 * share:.1f} % |", flush=True)


if __name__ == "__main__":
    main()
