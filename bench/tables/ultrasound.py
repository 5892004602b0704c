"""Thesis ch. 4: Tables 4.1 to 4.3 and Figures 4.6 and 4.7, of the source and of globule."""

from __future__ import annotations

import glob
import importlib.util
import os
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from globule._base.device import choose
from globule.ultrasound import phantoms
from globule.ultrasound.reconstruct import reconstruct
from globule.ultrasound.sweep import Sweep
from globule.volumes.files import read_volume
from globule.volumes.volume import Volume

from .cylinders import measure_cylinders
from .sweep_speed import placed, sweep_speed
from .table import Setting, Table

METHODS = ("pvn-om", "vvn-om", "pvn", "vvn")

# Seconds on a GTX 1080 by frames and side of the volume, in the order of METHODS (Table 4.1).
SOURCE_SECONDS = {
    (131, 128): (0.72, 1.07, 4.98, 2.71),
    (131, 256): (7.86, 8.71, 24.47, 16.22),
    (131, 512): (79.79, 86.28, 121.71, 239.55),
    (66, 512): (70.57, 70.84, 107.40, 185.89),
    (51, 512): (71.16, 67.64, 104.48, 150.23),
}
SOURCE_MIB = {  # Table 4.2, 131 frames: PVN-OM, VVN-OM
    128: (1390, 1538),
    256: (1614, 1762),
    512: (3406, 3554),
}
# Table 4.3, mm: mean and deviation by true value and method.
SOURCE_CYLINDERS = {
    (1.5, "vvn-om"): (1.49, 0.05),
    (1.5, "pvn-om"): (1.54, 0.03),
    (3.0, "vvn-om"): (2.95, 0.08),
    (3.0, "pvn-om"): (3.14, 0.02),
}
SOURCE_SEPARATION = (12.60, 0.10)
CYLINDER_METHODS = ("vvn-om", "pvn-om")
SHARES = tuple(range(0, 101, 10))  # per cent of the slices removed (Fig. 4.6)
LENGTH = 46.0  # mm along the path in Table 4.1, so that a sweep fills a cube
POSE_NOISE = (0.1, 0.1)  # mm and degrees, of a good optical tracker (Table 4.3)


def _sweep(n_frames: int) -> Sweep:
    """The source's three sweeps: breast (131 frames), cylinders of 1.5 mm (66) and 3 mm (51)."""
    if n_frames == 131:
        return phantoms.breast(length=LENGTH)
    return phantoms.cylinders(1.5 if n_frames == 66 else 3.0, n_frames, length=LENGTH)


def _best(run: Callable[[], Volume], quick: bool) -> tuple[float, float, Volume]:
    """Seconds, CPU seconds of all threads, and volume of the shortest of several runs."""
    best: tuple[float, float, Volume] | None = None
    spent, n = 0.0, 0
    while n < 3 or (spent < 0.1 and n < 20):
        start, cpu = time.perf_counter(), time.process_time()
        volume = run()
        seconds, cores = time.perf_counter() - start, time.process_time() - cpu
        if best is None or seconds < best[0]:
            best = seconds, cores, volume
        spent += seconds
        n += 1
        if spent > (1.0 if quick else 3.0):
            break
    assert best is not None
    return best


def _gain(seconds: Sequence[float | None], k: int) -> float | None:
    """Time of method k without octree over its time with octree; None for other methods."""
    if k >= 2:
        return None
    slow, fast = seconds[k + 2], seconds[k]
    return slow / fast if slow and fast else None


def _on_device(setting: Setting, sweep: Sweep, method: str, size: int, volume: Volume) -> float:
    """Seconds from frames to a volume, both in the memory of the device."""

    def spent(volume: Volume) -> float:
        return sum(volume.info[f"{step}_seconds"] for step in ("bin", "fill"))

    there = placed(sweep, setting.device)
    if there is sweep:
        return spent(volume)
    return min(
        spent(reconstruct(there, method, size=(size,) * 3, device=setting.device, extrapolate=True)) for _ in range(5)
    )


def times_and_memory(setting: Setting) -> Iterable[Table]:
    """Tables 4.1 and 4.2: times and memory of every method, sweep and size."""
    machine = choose(setting.device).description
    sizes = (128,) if setting.quick else (128, 256, 512)
    times, memory = [], []
    for n_frames in (131, 66, 51):
        sweep = _sweep(n_frames)
        for size in sizes:
            seconds, threads, inside, shares = [], [], [], []
            for k, method in enumerate(METHODS):
                setting.say(f"4.1: {n_frames} frames, {size}³, {method}")
                spent, cores, volume = _best(
                    partial(
                        reconstruct,
                        sweep,
                        method,
                        size=(size,) * 3,
                        device=setting.device,
                        threads=setting.threads,
                        extrapolate=True,
                    ),
                    setting.quick,
                )
                seconds.append(spent)
                threads.append(cores)
                inside.append(_on_device(setting, sweep, method, size, volume))
                n = volume.values.size
                shares.append((volume.n_measured / n, volume.n_empty / n))
                if k < 2:
                    known = SOURCE_MIB[size][k] if n_frames == 131 else None
                    mib = volume.info["bytes"] / 2**20
                    memory.append((n_frames, size, method, known, mib,
                                   known / mib if known else None))  # fmt: skip
            source = SOURCE_SECONDS.get((n_frames, size), (None,) * 4)
            for k, method in enumerate(METHODS):
                theirs = source[k]
                ratio = theirs / seconds[k] if theirs else None
                gains = [_gain(s, k) for s in (source, seconds)]
                times.append((n_frames, size, method, source[k], seconds[k], ratio, inside[k],
                              threads[k], *gains, *shares[k]))  # fmt: skip
    host = "ours: from frames in host memory to a volume in host memory"
    yield Table(
        "4.1", "seconds by frames of 387x400, volume and method",
        ("frames", "size", "method", "source s", "ours s", "source/ours",
         "on device s", "core s", "octree, source", "octree, ours", "measured", "empty"),
        times, (f"source: GTX 1080; ours: {machine}", host,
                "on device: from frames to a volume that are both in the device's own memory",
                "core s: of all threads together, which other work does not lengthen",
                "octree: how many times faster than without it"),
    )  # fmt: skip
    yield Table(
        "4.2", "working memory, MiB",
        ("frames", "size", "method", "source MiB", "ours MiB", "source/ours"), memory,
        (f"source: all of the GPU's memory; ours: working memory on {machine}",),
    )  # fmt: skip


def cylinders(setting: Setting) -> Iterable[Table]:
    """Table 4.3: diameters and separations of the cylinder phantoms, mm."""
    rows = []
    spacing = 0.3 if setting.quick else 0.2
    separation = 12.6
    for diameter in (1.5, 3.0):
        sweep = phantoms.cylinders(diameter, separation=separation, pose_noise=POSE_NOISE)
        places = [(k * separation, 24.0) for k in (-1, 0, 1)]
        for method in CYLINDER_METHODS:
            setting.say(f"4.3: cylinders of {diameter} mm, {method}")
            volume = reconstruct(
                sweep, method, spacing=spacing, device=setting.device, threads=setting.threads,
                extrapolate=True,
            )  # fmt: skip
            found = measure_cylinders(volume, places, diameter)
            for what, true, values, source in (
                ("diameter", diameter, found.diameters, SOURCE_CYLINDERS[diameter, method]),
                ("separation", separation, found.separations, SOURCE_SEPARATION),
            ):
                mean, deviation = float(values.mean()), float(values.std(ddof=1))
                rows.append((what, true, method, *source, mean, deviation,
                             abs(source[0] - true), abs(mean - true), values.size))  # fmt: skip
    noise = f"{POSE_NOISE[0]} mm and {POSE_NOISE[1]} degrees"
    yield Table(
        "4.3", "cylinder phantom, mm",
        ("what", "true", "method", "source", "±", "ours", "± ", "source error", "our error", "n"),
        rows, ("source: CIRS 044, a real phantom; ours: simulated",
               f"ours: pose noise {noise}, voxels of {spacing} mm, slabs of 1 mm"),
    )  # fmt: skip


class Removal(NamedTuple):
    """Errors by share of removed slices: mean and deviation of MSE/MSE_0 over the repeats."""

    shares: tuple[int, ...]
    means: dict[str, list[float]]
    deviations: dict[str, list[float]]
    empty: dict[str, list[float]]


def removed_slices(
    reference: np.ndarray, methods: Sequence[str], repeats: int, seed: int = 0, **options: Any
) -> Removal:
    """Remove random slices, reconstruct the volume from the rest, and compare (Figs 4.6, 4.7).

    reference: (Z, Y, X) uint8; its slices along z are the frames, 1 mm apart. MSE_0 is the error
    without any slice, so every curve ends at 1. All methods lose the same slices.
    """
    n, height, width = reference.shape
    poses = np.tile(np.eye(4), (n, 1, 1))
    poses[:, 2, 3] = np.arange(n)
    box = ((-0.5, -0.5, -0.5), (width - 0.5, height - 0.5, n - 0.5))
    truth: np.ndarray = reference.astype(np.float64)
    nothing = float((truth**2).mean())
    errors = {m: np.ones((len(SHARES), repeats)) for m in methods}
    empty = {m: np.ones((len(SHARES), repeats)) for m in methods}
    rng = np.random.default_rng(seed)
    for repeat in range(repeats):
        order = rng.permutation(n)
        for i, share in enumerate(SHARES):
            kept = np.ones(n, bool)
            kept[order[: round(n * share / 100)]] = False
            if not kept.any():
                continue  # nothing remains: an error of 1, all of it empty
            for method in methods:
                volume = reconstruct(
                    Sweep(reference, poses, valid=kept), method, spacing=1.0, region=box,
                    extrapolate=True, **options,
                )  # fmt: skip
                error = float(((volume.values - truth) ** 2).mean())
                errors[method][i, repeat] = error / nothing
                empty[method][i, repeat] = volume.n_empty / volume.values.size
    return Removal(
        SHARES,
        {m: e.mean(axis=1).tolist() for m, e in errors.items()},
        {m: e.std(axis=1).tolist() for m, e in errors.items()},
        {m: e.mean(axis=1).tolist() for m, e in empty.items()},
    )


def reference_volume(quick: bool) -> tuple[np.ndarray, str]:
    """A volume (Z, Y, X) uint8 and its name: nilearn's brain, or a phantom without nilearn."""
    found = importlib.util.find_spec("nilearn")
    if found is not None and found.origin:
        pattern = os.path.join(os.path.dirname(found.origin), "datasets/data/mni*_t1_*.nii.gz")
        for path in sorted(glob.glob(pattern)):
            values = read_volume(path).values.astype(np.float32)
            step = 2 if quick else 1
            gray = np.rint(255 / values.max() * values[::step, ::step, ::step]).astype(np.uint8)
            return gray, "MNI152 brain (nilearn), slices along z"
    sweep = phantoms.breast(n_frames=60, length=24.0, size=(160, 160), spacing=0.3)
    volume = reconstruct(sweep, "pvn-om", spacing=0.6, device="cpu", extrapolate=True)
    return volume.values, "breast phantom (nilearn is not installed), slices along z"


def methods_compared(setting: Setting) -> Iterable[Table]:
    """Figure 4.6: error by removed slices of pvn-om and vvn-om."""
    return _removal(setting, "4.6", ("pvn-om", "vvn-om"), 5)


def octree_compared(setting: Setting) -> Iterable[Table]:
    """Figure 4.7: error by removed slices of pvn and pvn-om."""
    return _removal(setting, "4.7", ("pvn", "pvn-om"), 2)


def _removal(setting: Setting, figure: str, methods: tuple[str, str], repeats: int) -> Iterable[Table]:
    repeats = min(repeats, 2) if setting.quick else repeats
    reference, name = reference_volume(setting.quick)
    setting.say(f"{figure}: {name}, {repeats} x {len(SHARES)} shares")
    curves = removed_slices(reference, methods, repeats, device=setting.device, threads=setting.threads)
    _plot(setting, figure, curves, methods, name)
    columns = ["removed %"]
    for method in methods:
        columns += [method, f"{method} ±", f"{method} empty"]
    rows = [
        (share, *(v for m in methods
                  for v in (curves.means[m][i], curves.deviations[m][i], curves.empty[m][i])))
        for i, share in enumerate(curves.shares)
    ]  # fmt: skip
    size = "x".join(map(str, reference.shape[::-1]))
    notes = [f"{name}, {size}; MSE_0: all slices removed; {repeats} repeats; kernels up to 9³"]
    if figure == "4.7":
        first, second = (curves.means[m] for m in methods)
        difference = np.abs(np.subtract(first, second)).mean()
        notes.append(f"mean difference {difference:.5f}; source: 0.00089")
    yield Table(figure, "MSE/MSE_0 against removed slices", tuple(columns), rows, tuple(notes))


def _plot(setting: Setting, figure: str, curves: Removal, methods: Sequence[str], name: str) -> None:
    """Write FOLDER/FIGURE.png, if matplotlib is installed."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        setting.say(f"{figure}.png needs matplotlib: pip install globule[figures]")
        return
    drawing = Figure(figsize=(9, 4), dpi=120, layout="constrained")
    FigureCanvasAgg(drawing)
    drawing.suptitle(name, fontsize=9)
    plain, logarithmic = drawing.subplots(1, 2)
    for axes in (plain, logarithmic):
        for method, style in zip(methods, ("o-", "s--"), strict=True):
            axes.errorbar(curves.shares, curves.means[method], curves.deviations[method],
                          fmt=style, capsize=3, markersize=4, label=method.upper())  # fmt: skip
        axes.set(xlabel="slices removed, %", ylabel="MSE / MSE$_0$", xlim=(-1, 101))
        axes.grid(alpha=0.3)
    plain.set_ylim(0, 1.02)
    plain.legend()
    logarithmic.set_yscale("log")  # an error of 0 does not show
    drawing.savefig(os.path.join(setting.folder, f"{figure}.png"))


TABLES: dict[str, Callable[[Setting], Iterable[Table]]] = {
    "4.1": times_and_memory,
    "4.2": times_and_memory,
    "4.3": cylinders,
    "4.6": methods_compared,
    "4.7": octree_compared,
    "sweep": sweep_speed,
}
