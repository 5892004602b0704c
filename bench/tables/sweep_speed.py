"""Speed on a tracked sweep of 21 frames of 820x616, compared with PLUS (two EPYC cores)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from globule import _core
from globule._base.device import choose
from globule.ultrasound import phantoms
from globule.ultrasound.grid import bounds, make_grid
from globule.ultrasound.options import Options
from globule.ultrasound.plus.config import Filler, PlusConfig
from globule.ultrasound.plus.reconstruct import reconstruct_plus
from globule.ultrasound.reconstruct import crowded, located_frames, reconstruct, start
from globule.ultrasound.reconstructor import Reconstructor
from globule.ultrasound.sweep import Sweep

from .table import Setting, Table

FRAMES, SIZE, APART = 21, (820, 616), 1.5  # mm between frames, as in PLUS' SpinePhantomFreehand
LIVE_FRAMES, LIVE_LENGTH = 60, 66.0  # mm
# Seconds by what is done and voxels along the longest axis.
PLUS_SECONDS = {
    ("nearest binning", 256): 0.041, ("nearest binning", 512): 0.110,
    ("binning, holes to 9³", 256): 0.041 + 8.6, ("binning, holes to 9³", 512): 0.110 + 100.5,
    ("PLUS-exact, STICK", 256): 0.041 + 2.1, ("PLUS-exact, STICK", 512): 0.110 + 18.8,
}  # fmt: skip
_RUNS = 3


def sweep_speed(setting: Setting) -> Iterable[Table]:
    """Seconds of each step, and from a frame to the volume that has the frame."""
    sweep = phantoms.breast(n_frames=FRAMES, length=FRAMES * APART, size=SIZE, spacing=0.08)
    machine = choose(setting.device)
    rows: list[tuple[Any, ...]] = []
    for size in (256,) if setting.quick else (256, 512):
        for what, seconds, cores, volume in _steps(setting, sweep, size):
            known = PLUS_SECONDS.get((what, size))
            shape = "x".join(map(str, volume.values.shape[::-1]))
            ratio = known / seconds if known else None
            rows.append((what, shape, known, seconds, ratio, cores))
    setting.say("sweep: live")
    rows += [(what, "256", None, wall, None, cores) for what, wall, cores in _live(setting)]
    yield Table(
        "sweep", f"{FRAMES} frames of {SIZE[0]}x{SIZE[1]}, seconds",
        ("what", "voxels", "PLUS s", "ours s", "PLUS/ours", "core seconds"), rows,
        (f"PLUS: its spine phantom, two EPYC cores; ours: a phantom, {machine.description}",
         "core seconds: of all threads together, which other work on the machine does not lengthen",
         "nearest binning: the step alone, from frames where the device has them"),
    )  # fmt: skip


def _steps(setting: Setting, sweep: Sweep, size: int) -> Iterable[tuple[str, float, float, Any]]:
    options: dict[str, Any] = {"device": setting.device, "threads": setting.threads}
    low, high = sweep.bounds()
    spacing = float((high - low).max()) / size
    exact = PlusConfig((spacing,) * 3, fill_holes=True, fillers=[Filler("STICK", 9, 1)])
    setting.say(f"sweep: {size} voxels")
    wall, cores, volume = _best(lambda: reconstruct(sweep, "pvn-om", size=size, **options))
    alone = _binning_cores(setting, sweep, size)
    there = placed(sweep, setting.device)
    seconds = _best(lambda: reconstruct(there, "pvn-om", size=size, **options))[2].info["bin_seconds"]
    yield "nearest binning", seconds, alone, volume
    yield "binning, holes to 9³", wall, cores, volume
    yield "between frames", *_best(lambda: reconstruct(sweep, "frames", size=size, **options))
    yield "PLUS-exact, STICK", *_best(lambda: reconstruct_plus(sweep, exact, **options))


def placed(sweep: Sweep, device: str) -> Sweep:
    """The sweep with its frames in the memory of the device."""
    if choose(device).name == "cpu":
        return sweep
    import cupy

    return Sweep(cupy.asarray(sweep.frames), sweep.world_from_image)


def _binning_cores(setting: Setting, sweep: Sweep, size: int) -> float:
    """Core seconds of nearest binning alone."""
    chosen, frames = choose(setting.device), sweep.frames
    low, high = bounds(sweep.world_from_image, None, frames.shape[1:])
    grid = make_grid(low, high, None, size, None)
    poses = grid.poses(sweep.world_from_image)
    core = _core.SweepGrid(chosen.name, setting.threads)
    seconds = []
    for _ in range(_RUNS):
        start(core, grid, frames, Options(), crowded(poses, frames.shape[1:]))
        begun = time.process_time()
        core.add(located_frames(frames, poses, None), 1)
        seconds.append(time.process_time() - begun)
    return min(seconds)


def _best(run: Callable[[], Any]) -> tuple[float, float, Any]:
    """Shortest wall and core seconds of a few runs, and the volume with the shortest binning."""
    walls, cores, volumes = [], [], []
    for _ in range(_RUNS):
        begun, cpu = time.perf_counter(), time.process_time()
        volumes.append(run())
        walls.append(time.perf_counter() - begun)
        cores.append(time.process_time() - cpu)
    best = min(volumes, key=lambda volume: volume.info.get("bin_seconds", 0.0))
    return min(walls), min(cores), best


def _live(setting: Setting) -> Iterable[tuple[str, float, float]]:
    """Rows: seconds from a frame to the volume, with given bounds and in a growing volume."""
    sweep = phantoms.breast(n_frames=LIVE_FRAMES, length=LIVE_LENGTH, size=SIZE, spacing=0.08)
    low, high = sweep.bounds()
    for name, region in (("in a region", (low, high)), ("growing", None)):
        live = Reconstructor(
            float((high - low).max()) / 256, region=region, device=setting.device,
            threads=setting.threads,
        )  # fmt: skip
        walls, cores = [], []
        for frame, pose in zip(sweep.frames, sweep.world_from_image, strict=True):
            begun, cpu = time.perf_counter(), time.process_time()
            live.add(frame, pose)
            live.volume()
            walls.append(time.perf_counter() - begun)
            cores.append(time.process_time() - cpu)
        what = f"live {name}, frame to volume: "
        yield what + "median", float(np.median(walls)), float(np.median(cores))
        yield what + "longest", max(walls), max(cores)
