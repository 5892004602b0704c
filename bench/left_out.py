"""Errors of frames left out, of globule's methods, of PLUS's and of the literature's, in one table.

    python -m bench.left_out [--record] [--voxel-size MM] [SWEEP[,PLUS.xml or CALIBRATION.toml] …]

Every K-th frame is left out at a time and predicted from the volume of the others, as in `cross_validate`
of globule.ultrasound.trust. Errors are root mean squares in gray levels, at 4,000 random pixels of each
of up to 24 frames, over those that all methods predict ("common") or that the method itself does ("own").
Intervals are of 95 %, from frames drawn with repetition (bootstrap, Efron 1979); "best" is the share of
these draws in which the method has the least error.

Sweeps: those of ../shared/data, simulated ones whose truth is known (tilted, curved, irregular, two
passes, a moved probe), and those given. The same voxels for all methods:

frames, bezier, vvn-om, pvn-om   of globule
plus       PLUS's linear compounding with its sticks for holes, from the twin that equals PLUS (--plus)
b-spline   Catmull-Rom splines through four frames along the path
gaussian   adaptive Gaussian: all frames near a voxel, weights as wide as the nearest frame is away
rbf        biharmonic radial basis functions with a linear part through 3x3 pixels of both neighboring
           frames (Rohling, Gee, Berman 1999)

The last three are none of globule's methods; they are made here, at the voxels around the frame.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import globule as gb
import numpy as np
from globule.ultrasound.calibration import turn_by
from globule.ultrasound.grid import VoxelGrid
from globule.ultrasound.marks import read_tracked
from globule.ultrasound.n_wires import calibrate_n_wires
from globule.ultrasound.neighbors import FramePath
from globule.ultrasound.phantoms import hand_path, scan_volume
from globule.ultrasound.plus.config import Filler, PlusConfig, read_plus_config
from globule.ultrasound.plus.reconstruct import reconstruct_plus
from globule.ultrasound.sweep import Sweep
from globule.ultrasound.wires import read_phantom
from globule.volumes.slices import sample
from globule.volumes.volume import FAR

from .tables.report import record

OWN = ("frames", "bezier", "vvn-om", "pvn-om")
LITERATURE = ("b-spline", "gaussian", "rbf")
METHODS = (*OWN, "plus", *LITERATURE)
FRAMES, PIXELS = 24, 4_000  # that are compared: frames of a sweep, and pixels of each, at most
DRAWS = 1000
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


# Methods of the literature, at points (P, 3) in voxels


class Enclosing(NamedTuple):
    """Points between the planes of frames a and a + 1: their numbers, the share of the way from one to
    the other, the place (column, row) on it, and the spread of `Between`, voxels."""

    a: int
    number: np.ndarray
    t: np.ndarray
    at: np.ndarray
    spread: np.ndarray


def enclosing(path: FramePath, points: np.ndarray) -> list[Enclosing]:
    """All joined pairs of frames between which points lie, and inside of the images."""
    found = []
    for a in np.flatnonzero(path.joined).tolist():
        d0, d1 = ((points - path.origin[f]) @ path.inverse[f][0] for f in (a, a + 1))
        number = np.flatnonzero((d0 < 0) != (d1 < 0))
        if not len(number):
            continue
        d0, d1 = d0[number], d1[number]
        t = d0 / (d0 - d1)
        first, second = (path.coordinates(f, points[number])[:, 1:] for f in (a, a + 1))
        at = first + t[:, None] * (second - first)
        known = path.sample(a, *at.T)[1]
        if known.any():
            found.append(Enclosing(a, number[known], t[known], at[known], np.abs(d1 * t)[known]))
    return found


def b_spline(path: FramePath, points: np.ndarray, pairs: list[Enclosing]) -> np.ndarray:
    """Splines through four frames; passes are averaged as `frames` does."""
    n, total, weights = len(path.frames), np.zeros(len(points)), np.zeros(len(points))
    for a, number, t, at, spread in pairs:
        four = [a - 1 if a > 0 and path.joined[a - 1] else a, a, a + 1]
        four.append(a + 2 if a + 2 < n and path.joined[a + 1] else a + 1)
        shares = 0.5 * np.stack([
            -t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2
        ])  # fmt: skip
        value = np.clip((shares * [path.sample(i, *at.T)[0] for i in four]).sum(axis=0), 0, None)
        weight = 1 / (spread + 1)
        total[number] += weight * value
        weights[number] += weight
    return total / np.where(weights > 0, weights, np.nan)


def gaussian(path: FramePath, points: np.ndarray, _: Any = None) -> np.ndarray:
    """All frames, by a Gaussian of the distance from their planes."""
    height, width = path.frames.shape[1:]
    distance = np.full((len(path.frames), len(points)), np.inf)
    places = []
    for f in range(len(path.frames)):
        d, u, v = path.coordinates(f, points).T
        inside = (np.abs(u - (width - 1) / 2) < width / 2) & (np.abs(v - (height - 1) / 2) < height / 2)
        distance[f, inside] = np.abs(d[inside])
        places.append((u, v))
    wide = np.maximum(distance.min(axis=0), 0.5)
    total, weights = np.zeros(len(points)), np.zeros(len(points))
    for f, (u, v) in enumerate(places):
        near = np.flatnonzero(distance[f] < 4 * wide)
        if len(near):
            value, known = path.sample(f, u[near], v[near])
            weight = np.where(known, np.exp(-0.5 * (distance[f, near] / wide[near]) ** 2), 0)
            total[near] += weight * value
            weights[near] += weight
    return total / np.where(weights > 0, weights, np.nan)


def rbf(path: FramePath, points: np.ndarray, pairs: list[Enclosing]) -> np.ndarray:
    """Splines through 3x3 pixels of each of the two frames that enclose a point most closely."""
    nearest, which = np.full(len(points), np.inf), np.full(len(points), -1)
    for a, number, _, _, spread in pairs:
        closer = number[spread < nearest[number]]
        which[closer] = a
        nearest[number] = np.minimum(nearest[number], spread)
    out = np.full(len(points), np.nan)
    for a in np.unique(which[which >= 0]).tolist():
        out[which == a] = _radial(path, (a, a + 1), points[which == a])
    return out


def _radial(path: FramePath, pair: tuple[int, int], points: np.ndarray) -> np.ndarray:
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


MADE: dict[str, Callable[[FramePath, np.ndarray, list[Enclosing]], np.ndarray]] = {
    "b-spline": b_spline,
    "gaussian": gaussian,
    "rbf": rbf,
}


def compared(sweep: Sweep, f: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels of frame f that are compared. At random: images have overlays and
    wires, which a lattice of pixels meets too often or not at all."""
    inside = np.ones(sweep.frames.shape[1:], bool) if sweep.mask is None else sweep.mask
    every = np.flatnonzero(inside)
    taken = np.random.default_rng(f).choice(every, min(PIXELS, len(every)), replace=False)
    return np.unravel_index(np.sort(taken), inside.shape)


def _voxels(volume: Any, sweep: Sweep, f: int) -> np.ndarray:
    """The places (P, 3) of these pixels in voxels of a volume."""
    rows, columns = compared(sweep, f)
    pixels = np.stack([columns, rows, np.zeros(len(rows)), np.ones(len(rows))])
    return (np.linalg.inv(volume.world_from_voxel) @ sweep.world_from_image[f] @ pixels)[:3].T


def in_voxels(sweep: Sweep, rest: Sweep, f: int, volume: Any) -> dict[str, np.ndarray]:
    """Predictions of frame f at some pixels, NaN where there are none: values at the voxels of
    a volume around these, and between voxels as in a slice of the volume."""
    spacing = float(volume.spacing[0])
    grid = VoxelGrid(volume.world_from_voxel[:3, 3] - spacing / 2, spacing, volume.values.shape[::-1])
    index = np.flatnonzero(rest.valid)
    path = FramePath(rest.frames[index], grid.poses(rest.world_from_image[index]) / 2.0**32, rest.mask)
    at = _voxels(volume, sweep, f)
    shape = volume.values.shape
    low = np.floor(at).astype(int)
    corners = (low[:, None] + np.array(list(np.ndindex(2, 2, 2)))).reshape(-1, 3)
    corners = corners[((corners >= 0) & (corners < shape[::-1])).all(axis=1)]
    flat = np.unique(np.ravel_multi_index(corners.T[::-1], shape))
    points = np.column_stack(np.unravel_index(flat, shape)[::-1]) + 0.5
    pairs = enclosing(path, points)
    enclosed = np.zeros(len(points), bool)
    for pair in pairs:
        enclosed[pair.number] = True
    found = {}
    for name, method in MADE.items():
        values = method(path, points, pairs)
        known = enclosed & np.isfinite(values)
        all_values, radius = np.zeros(shape, np.float32), np.full(shape, FAR, np.uint8)
        all_values.ravel()[flat[known]], radius.ravel()[flat[known]] = values[known], 0
        seen, origin = sample(all_values, radius, at, True)
        found[name] = np.where(origin > 0, seen, np.nan)
    return found


# Errors


def plus_volume(rest: Sweep, spacing: float, xml: str | None) -> Any:
    """PLUS's linear compounding into voxels of this size; region of the configuration, if there is one."""
    height, width = rest.frames.shape[1:]
    config = read_plus_config(xml) if xml else PlusConfig((spacing,) * 3, clip_size=(width, height))
    config.spacing, config.interpolation, config.compounding = (spacing,) * 3, "LINEAR", "MEAN"
    config.fill_holes, config.fillers, config.optimization = True, [Filler("STICK", 9, 1)], "FULL"
    return reconstruct_plus(rest, config, device="cpu", threads=1)


def errors(sweep: Sweep, k: int, spacing: float, xml: str | None = None) -> dict[str, np.ndarray]:
    """Of each method (F, 4), a row for each frame left out: sum of squares and number of pixels, common
    ones and its own; and "pixels" (F,)."""
    indices = np.flatnonzero(sweep.valid)
    tested = indices[1 + np.unique(np.linspace(0, len(indices) - 3, FRAMES).astype(int))]
    sums: dict[str, list[Any]] = {name: [] for name in (*METHODS, "pixels")}
    for fold in range(k):
        left_out = [i for rank, i in enumerate(indices[1:-1]) if rank % k == fold]
        valid = sweep.valid & ~np.isin(np.arange(len(sweep)), left_out)
        rest = Sweep(sweep.frames, sweep.world_from_image, valid=valid, mask=sweep.mask)
        volumes = {
            name: gb.ultrasound.reconstruct(rest, name, spacing=spacing, device="cpu", threads=1) for name in OWN
        }
        volumes["plus"] = plus_volume(rest, spacing, xml)
        for f in np.intersect1d(left_out, tested).tolist():
            seen = sweep.frames[f][compared(sweep, f)].astype(float)
            found = in_voxels(sweep, rest, f, volumes["frames"])
            for name, volume in volumes.items():
                values, origin = sample(volume.values, volume.radius, _voxels(volume, sweep, f), True)
                found[name] = np.where(origin > 0, values, np.nan)
            common = np.all([np.isfinite(v) for v in found.values()], axis=0)
            sums["pixels"].append(len(seen))
            for name, values in found.items():
                own, square = np.isfinite(values), (values - seen) ** 2
                sums[name].append((square[common].sum(), common.sum(), square[own].sum(), own.sum()))
    return {name: np.array(values) for name, values in sums.items()}


def summary(found: dict[str, np.ndarray]) -> dict[str, float]:
    """NAME_rms with _low and _high, NAME_own, NAME_share of pixels, NAME_best share of draws; all
    common or own as above; frames, and the share of pixels that is common."""
    rng = np.random.default_rng(0)
    n = len(found["pixels"])
    drawn = rng.integers(0, n, (DRAWS, n))
    facts = {"frames": n, "common": found["frames"][:, 1].sum() / found["pixels"].sum()}
    draws = {}
    for name in METHODS:
        square, common, own_square, own = found[name].sum(axis=0)
        draws[name] = np.sqrt(found[name][drawn, 0].sum(axis=1) / np.maximum(found[name][drawn, 1].sum(axis=1), 1))
        low, high = np.percentile(draws[name], (2.5, 97.5))
        facts |= {f"{name}_rms": np.sqrt(square / max(common, 1)), f"{name}_low": low, f"{name}_high": high}
        facts |= {f"{name}_own": np.sqrt(own_square / max(own, 1)), f"{name}_share": own / found["pixels"].sum()}
    best = np.argmin([draws[name] for name in METHODS], axis=0)
    return facts | {f"{name}_best": float((best == i).mean()) for i, name in enumerate(METHODS)}


# Sweeps


def simulated(speckle: float = 0.25) -> dict[str, Sweep]:
    """Sweeps of 60 frames over one volume: balls in tissue, with speckle that is fixed in space."""
    from scipy.ndimage import gaussian_filter

    rng, step, n = np.random.default_rng(5), 0.2, 240
    grid = np.stack(np.meshgrid(*[(np.arange(n) - n / 2) * step] * 3, indexing="ij"))  # z, y, x
    echo = np.full((n, n, n), 0.55, np.float32)
    for _ in range(70):
        center, radius, value = rng.uniform(-20, 20, 3), rng.uniform(1.5, 5), rng.uniform(0.1, 1.0)
        echo[((grid - center[:, None, None, None]) ** 2).sum(axis=0) < radius**2] = value
    texture = np.hypot(*(gaussian_filter(rng.normal(size=echo.shape), 1.2) for _ in range(2)))
    shown = 140 * gaussian_filter(echo, 0.7) * (1 + speckle * (texture / texture.mean() - 1))
    place = np.diag([step, step, step, 1.0])
    place[:3, 3] = -n / 2 * step
    paths = {"tilted": _tilted(), "curved": _curved(), "irregular": _irregular(),
             "two passes": np.concatenate([_pass(-4, 0), _pass(4, 3)[::-1]]),
             "moved probe": np.concatenate([_pass(0, 0), _moved(_pass(0, 0))])}  # fmt: skip
    return {
        f"simulated, {name}": Sweep(np.clip(scan_volume(shown, place, poses, SIZE), 0, 255).astype(np.uint8), poses)
        for name, poses in paths.items()
    }


SIZE, PIXEL = (110, 110), 0.25  # of simulated images


def _place(turn: Any, middle: Any) -> np.ndarray:
    """An image turned about its middle, which lies there."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn_by(np.radians(np.asarray(turn, float))) * PIXEL
    matrix[:3, 3] = np.asarray(middle, float) - matrix[:3, :3] @ [SIZE[0] / 2, SIZE[1] / 2, 0]
    return matrix


def _pass(x: float, angle: float, n: int = 30) -> np.ndarray:
    poses = hand_path(n, 26.0, int(x) + 9, PIXEL, SIZE)
    moved = _place((0, angle, 0), (x, 0, 0)) @ np.linalg.inv(_place((0, 0, 0), (0, SIZE[1] * PIXEL / 2, 0)))
    return moved @ poses


def _moved(poses: np.ndarray) -> np.ndarray:
    """The same pass from another side: turned by 70 degrees about the images' columns, and shifted."""
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = turn_by(np.radians([8.0, 70, 0])), (1.3, 0.7, -0.9)
    return turn @ poses


def _tilted() -> np.ndarray:
    return np.array([_place((35, 8 * np.sin(s), 0), (0, 0, 26 * s / 6 - 13)) for s in np.linspace(0, 6, 60)])


def _curved() -> np.ndarray:
    return np.array([_place((a, 0, 0), (0, 5 * np.cos(np.radians(a)), 17 * np.sin(np.radians(a))))
                     for a in np.linspace(-35, 35, 60)])  # fmt: skip


def _irregular() -> np.ndarray:
    """A hand that stops, hurries and trembles."""
    rng = np.random.default_rng(3)
    ways = np.cumsum(rng.gamma(0.7, 1.0, 60))
    along = 26 * (ways - ways[0]) / (ways[-1] - ways[0]) - 13
    return np.array([_place(rng.normal(0, 0.8, 3), (*rng.normal(0, 0.15, 2), z)) for z in along])


def shared_sweeps() -> dict[str, tuple[Sweep, float, str | None]]:
    """Sweep, edge of the voxels, mm, and PLUS configuration with the region."""
    found: dict[str, tuple[Sweep, float, str | None]] = {}
    ultrasound, wires = DATA / "ultrasound", DATA / "calibration"
    if (ultrasound / "SpinePhantomFreehand.igs.mha").is_file():
        xml = str(ultrasound / "NNMEAN.xml")
        sweep = gb.ultrasound.read_sweep(ultrasound / "SpinePhantomFreehand.igs.mha", plus=xml)
        found["PLUS's spine phantom"] = sweep, 0.5, xml
    names = {name: wires / f"fCal_Test_{name.title()}_3NWires.igs.mha" for name in ("calibration", "validation")}
    for name, path in names.items():
        if path.is_file():
            tracked, phantom = read_tracked(path), read_phantom(wires / "spatial_calibration_1.2.xml")
            ok = tracked.ok
            made = calibrate_n_wires(
                tracked.frames, tracked.times, tracked.poses[ok], tracked.pose_times[ok], phantom, fit_offset=True
            )
            sweep = gb.ultrasound.read_sweep(path, calibration=made.calibration)
            found[f"PLUS's N-wire phantom, {name} sweep"] = sweep[sweep.valid][:45], 0.5, None
    return found


def main() -> None:
    """Measure, print a table, and write it to docs/measured.csv if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sweeps", nargs="*", metavar="SWEEP[,PLUS.xml or CALIBRATION.toml]")
    parser.add_argument("--voxel-size", type=float, default=0.5)
    parser.add_argument("-k", type=int, default=5)
    parser.add_argument("--only-given", action="store_true", help="none but the given sweeps")
    parser.add_argument("--record", action="store_true", help="write to docs/measured.csv, too")
    options = parser.parse_args()
    sweeps: dict[str, tuple[Sweep, float, str | None]] = {}
    if not options.only_given:
        sweeps = {name: (sweep, options.voxel_size, None) for name, sweep in simulated().items()} | shared_sweeps()
    for word in options.sweeps:
        name, _, place = word.partition(",")
        xml = place if place.endswith(".xml") else None
        sweep = gb.ultrasound.read_sweep(name, calibration=None if xml else place or None, plus=xml)
        sweeps[Path(name).name.split(".")[0]] = sweep, options.voxel_size, xml
    print("| sweep | method | rms, common pixels | 95 % | best | rms, own pixels | predicted |\n|" + "---|" * 7)
    for name, (sweep, spacing, xml) in sweeps.items():
        facts = summary(errors(sweep, options.k, spacing, xml))
        for method in sorted(METHODS, key=lambda m: facts[f"{m}_rms"]):
            rms, low, high, best, own, share = (
                facts[f"{method}_{what}"] for what in ("rms", "low", "high", "best", "own", "share")
            )
            print(f"| {name} | {method} | {rms:.2f} | {low:.2f} to {high:.2f} | {100 * best:.0f} % | {own:.2f} | "
                  f"{100 * share:.1f} % |", flush=True)  # fmt: skip
        print(f"common: {100 * facts['common']:.1f} %, {facts['frames']} frames", file=sys.stderr, flush=True)
        if options.record:
            record("left_out", "any", {f"{name}, {len(sweep)} images": facts})


if __name__ == "__main__":
    main()
