"""The part of `info` and `convert` for tracked sweeps and volumes."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..formats.errors import FormatError
from ..formats.kind import kind_or_none
from ..formats.sweeps import igs, stack
from ..formats.sweeps.transforms import WORLDS, find_path
from ..formats.volumes import READABLE as READABLE_VOLUMES
from ..formats.volumes import WRITABLE as WRITABLE_VOLUMES
from ..formats.volumes import check_name
from ..ultrasound.files import EXTENSIONS as READABLE_SWEEPS
from ..ultrasound.sweep_writing import WRITABLE as SWEEPS
from ..ultrasound.sweep_writing import write_sweep
from ..ultrasound.trust import check_poses
from ..volumes.files import write_volume
from ..volumes.slices import save_three_view
from .shared import UserError, check_output, count, mistakes, read_sweep_file, read_volume_file, readable

WRITABLE = (*SWEEPS, *WRITABLE_VOLUMES, ".png")


EXTENSIONS = tuple(dict.fromkeys((*SWEEPS, *READABLE_SWEEPS, *READABLE_VOLUMES)))


def kind_of(path: str) -> str | None:
    """ "sweep", "volume", or None for everything else. Raises UserError for a file that cannot be
    read."""
    with readable(path, "expected a file to read, got"):
        found = kind_or_none(path)
        return found.kind if found and found.kind in ("sweep", "volume") else None


def describe(path: str, kind: str) -> dict[str, Any]:
    """All facts about a sweep or volume, for JSON."""
    facts: dict[str, Any] = {"file": path, "kind": kind}
    if os.path.isfile(path):
        facts["bytes"] = os.path.getsize(path)
    return facts | (_sweep(path) if kind == "sweep" else _volume(path))


def lines(facts: dict[str, Any]) -> list[str]:
    """The facts in words."""
    if facts["kind"] == "volume":
        size = "x".join(map(str, facts["size"]))
        spacing = " x ".join(f"{s:.6g}" for s in facts["spacing"])
        counts = facts["counts"]
        known = "" if facts["origin_known"] else " (assumed: the format does not store them)"
        return [
            f"{facts['file']}: volume, {size} voxels {facts['dtype']}, {facts['space']}",
            f"  spacing    {spacing} mm",
            f"  bounds     {_place(facts['bounds']['lo'])}  to  {_place(facts['bounds']['hi'])} mm",
            f"  values     {facts['min']:g} to {facts['max']:g}",
            f"  voxels     {counts['measured']:,} measured, {counts['filled']:,} filled, "
            f"{counts['empty']:,} empty{known}",
        ]
    size = "x".join(map(str, facts["size"]))
    n_frames = count(facts["frames"], "frame")
    what = f"sweep, {n_frames} of {size} {facts['dtype']}" if size != "0x0" else f"poses of {n_frames} without images"
    found = [f"{facts['file']}: {what}"]
    if facts["transforms"]:
        found.append(f"  transforms {' '.join(facts['transforms'])}")
    if facts["seconds"] is not None:
        found.append(f"  duration   {facts['seconds']:.3f} s")
    if facts["spacing"] is None and "valid" in facts:
        return [*found, f"  poses      none is valid, in {facts['world']} ({facts['space']})"]
    if facts["spacing"] is None and size == "0x0":
        return found
    if facts["spacing"] is None:
        return [*found, "  poses      need a calibration: no transform leads from the image to the world"]
    spacing = " x ".join(f"{s:.6g}" for s in facts["spacing"])
    strange = [f"  outliers   {finding}" for finding in facts["findings"]]
    if len(strange) > 20:
        strange[20:] = [f"  outliers   … and {len(strange) - 20:,} more"]
    return [
        *found,
        f"  poses      {facts['valid']:,} valid, in {facts['world']} ({facts['space']})",
        *strange,
        f"  pixel      {spacing} mm",
        f"  bounds     {_place(facts['bounds']['lo'])}  to  {_place(facts['bounds']['hi'])} mm",
    ]


def convert(path: str, output: str, kind: str) -> str:
    """Write a sweep or volume in another format; return a line about the result."""
    check_output("OUT", output, SWEEPS if kind == "sweep" else (*WRITABLE_VOLUMES, ".png"))
    if output.lower().endswith(".dcm"):
        with mistakes():
            check_name(output, False)
    if kind == "sweep":
        found = kind_or_none(path)
        images = found is not None and found.format in ("metaimage", "nrrd")
        if images and output.lower().endswith((".mha", ".nrrd")):
            with mistakes():  # unchanged: a recording may have no calibration
                recording = igs.read(path)
                igs.write(output, recording)
            return f"{output}: {count(len(recording.frames), 'frame')}"
        sweep = read_sweep_file(path)
        with mistakes():
            write_sweep(output, sweep)
        return f"{output}: {count(len(sweep), 'frame')}"
    if output.lower().endswith((".igs.mha", ".igs.nrrd")):
        raise UserError(f"OUT: expected the extension of a volume format, got {output}")
    volume = read_volume_file(path)
    with mistakes():
        if output.lower().endswith(".png"):
            save_three_view(output, volume)
            return f"{output}: three planes through the middle, and the sources of the values"
        write_volume(output, volume, maps=output.lower().endswith((".npz", ".vti")))
    return f"{output}: {'x'.join(map(str, volume.values.shape[::-1]))} voxels"


def _sweep(path: str) -> dict[str, Any]:
    facts: dict[str, Any] = {"transforms": [], "seconds": None, "spacing": None}
    sweep = None
    found = kind_or_none(path)
    if found is not None and found.format in ("metaimage", "nrrd"):
        with readable(path):
            recording = igs.read(path)
        frames, times = recording.frames, recording.times
        facts["transforms"] = sorted(f"{a}To{b}" for a, b in recording.edges)
        if any(find_path(recording.edges, "Image", world) for world in WORLDS):
            sweep = read_sweep_file(path)
    elif found is not None and found.format == "dicom":
        with mistakes():
            frames, times, _ = stack.read_dicom(path)
    else:
        try:
            sweep = read_sweep_file(path)
        except UserError as error:
            if not isinstance(error.__cause__, FormatError) or not os.path.isdir(path):
                raise
            with mistakes():  # images without poses
                frames, times, _ = stack.read_folder(path)
    if sweep is not None:
        frames, times = sweep.frames, sweep.timestamps
        facts |= {
            "valid": sweep.n_valid, "world": sweep.world, "space": sweep.space,
            "masked": None if sweep.mask is None else int((~sweep.mask).sum()),
        }  # fmt: skip
        if sweep.n_valid:
            low, high = sweep.bounds()
            poses = check_poses(sweep)
            facts |= {
                "spacing": sweep.spacing, "bounds": {"lo": low, "hi": high},
                "outliers": np.flatnonzero(poses.outliers),
                "findings": list(map(str, poses.findings)),
            }  # fmt: skip
    if times is not None and len(times):
        facts["seconds"] = float(np.ptp(times))
    return facts | {
        "frames": len(frames), "size": frames.shape[:0:-1], "dtype": str(frames.dtype)
    }  # fmt: skip


def _volume(path: str) -> dict[str, Any]:
    volume = read_volume_file(path)
    lo, hi = volume.bounds()
    return {
        "size": np.array(volume.values.shape[::-1]),
        "spacing": volume.spacing,
        "world_from_voxel": volume.world_from_voxel,
        "bounds": {"lo": lo, "hi": hi},
        "space": volume.space,
        "dtype": str(volume.values.dtype),
        "min": float(volume.values.min()),
        "max": float(volume.values.max()),
        "origin_known": volume.info.get("origin") == "stored",
        "counts": {
            "voxels": volume.values.size, "measured": volume.n_measured,
            "filled": volume.n_filled, "empty": volume.n_empty,
        },
    }  # fmt: skip


def _place(values: Any) -> str:
    return " ".join(f"{v:.6g}" for v in values)
