"""Tracked frames to files."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..formats.errors import FormatError
from ..formats.sweeps import igs, stack
from ..formats.sweeps.poses import PoseTable, write_csv
from ..formats.sweeps.transforms import Edges, Transform, chain, format_matrix, parse_matrix, split_name
from ..formats.volumes.raw import Progress
from .sweep import Sweep

if TYPE_CHECKING:
    pass
WRITABLE = (".igs.mha", ".mha", ".igs.nrrd", ".nrrd", ".npz")
POSES_BESIDE = "poses.csv"  # of a folder of pictures


def write_sweep(path: str | os.PathLike[str], sweep: Sweep, progress: Callable[[int, int], None] | None = None) -> None:
    """Write a sweep: .igs.mha, .igs.nrrd, .npz, or a new folder of PNG files with poses.csv.

    The writer stores the fields of the original file unchanged, and adds the calibration. Changed
    poses replace the original poses. The .igs formats cannot hold the mask.

    Args:
        path: with one of these extensions, or without an extension for a folder.
        sweep: (F, H, W) frames and their poses; LPS for .mha and .nrrd.
        progress: called as progress(done, total): bytes of .mha and .nrrd, pictures of a folder, 1
            of 1 at the end of .npz.

    Raises FormatError for an unknown extension, TypeError for anything but a Sweep, ValueError for
    data that the format cannot hold; OSErrors pass unchanged.
    """
    if not isinstance(sweep, Sweep):
        raise TypeError(f"sweep: expected Sweep, got {type(sweep).__name__}")
    name = os.fspath(path).lower()
    if name.endswith(".npz"):
        _write_npz(path, sweep)
        if progress:
            progress(1, 1)
    elif name.endswith(WRITABLE):
        igs.write(path, _as_recording(sweep), progress)
    elif "." not in os.path.basename(name.rstrip("/")):
        _write_folder(path, sweep, progress)
    else:
        raise FormatError(f"{path}: expected a folder or {' '.join(WRITABLE)}")


def _as_recording(sweep: Sweep) -> igs.Recording:
    """The sweep as PLUS has it: the file's own fields, and poses where those do not give them."""
    if sweep.space != "LPS":
        raise ValueError(f"space: expected LPS for .mha and .nrrd, got {sweep.space}")
    kept = sweep.metadata.get("frame_fields") or [{} for _ in sweep.frames]
    kept = [dict(fields) for fields in kept]
    way = sweep.metadata.get("way", [])
    constant = sweep.metadata.get("constant", {})
    if any(kept):
        for (source, target), matrix in constant.items():
            for fields in kept:
                fields.setdefault(f"{source}To{target}Transform", format_matrix(matrix))
                fields.setdefault(f"{source}To{target}TransformStatus", "OK")
    if not all(_gives_pose(sweep, i, fields, way) for i, fields in enumerate(kept)):
        kept = [_with_direct_pose(sweep, i, fields, way) for i, fields in enumerate(kept)]
    for i, fields in enumerate(kept):
        if sweep.timestamps is not None:
            text = fields.get("Timestamp")
            if text is None or float(text) != sweep.timestamps[i]:
                fields["Timestamp"] = repr(float(sweep.timestamps[i]))
        if sweep.valid[i]:
            fields["ImageStatus"] = "OK"
        elif fields.get("ImageStatus", "OK") == "OK" and _statuses_ok(fields, way):
            fields["ImageStatus"] = "INVALID"
    fields = sweep.metadata.get("fields", {})
    return igs.Recording(sweep.frames, sweep.timestamps, {}, sweep.valid, fields, kept)


def _steps(way: list[tuple[str, str]]) -> list[str]:
    """The names under which a file may hold the transforms of a way."""
    return [f"{a}To{b}Transform" for a, b in (*way, *((b, a) for a, b in way))]


def _statuses_ok(fields: dict[str, str], way: list[tuple[str, str]]) -> bool:
    return all(fields.get(f"{name}Status", "OK") == "OK" for name in _steps(way))


def _gives_pose(sweep: Sweep, i: int, fields: dict[str, str], way: list[tuple[str, str]]) -> bool:
    """Whether frame i is not valid, or its fields give exactly its pose."""
    if not way:
        return False
    if not sweep.valid[i]:
        return True
    edges: Edges = {}
    for name in _steps(way):
        if name in fields:
            matrix = parse_matrix(fields[name])
            key = split_name(name.removesuffix("Transform"))
            if key is not None:
                edges[key] = Transform(matrix, np.array(True))
    if not all(step in edges or step[::-1] in edges for step in way):
        return False
    placed = chain(edges, way, 1)
    exact = np.array_equal(placed.matrices[0], sweep.world_from_image[i])
    return exact and _statuses_ok(fields, way)


def _with_direct_pose(sweep: Sweep, i: int, fields: dict[str, str], way: list[tuple[str, str]]) -> dict[str, str]:
    """The fields with the pose as one transform: PLUS allows one way between two frames."""
    replaced = [name + end for name in _steps(way) for end in ("", "Status")]
    fields = {name: text for name, text in fields.items() if name not in replaced}
    name = f"ImageTo{sweep.world}Transform"
    known = np.isfinite(sweep.world_from_image[i]).all()
    fields[name] = format_matrix(sweep.world_from_image[i] if known else np.eye(4))
    fields[name + "Status"] = "OK" if sweep.valid[i] else "INVALID"
    return fields


def _write_npz(path: str | os.PathLike[str], sweep: Sweep) -> None:
    from ..formats.numpy_format import write_arrays

    arrays = {
        "frames": sweep.frames, "world_from_image": sweep.world_from_image, "valid": sweep.valid,
        "world": np.array(sweep.world), "space": np.array(sweep.space),
    }  # fmt: skip
    if sweep.timestamps is not None:
        arrays["timestamps"] = sweep.timestamps
    if sweep.mask is not None:
        arrays["mask"] = sweep.mask
    write_arrays(path, arrays)


def _write_folder(path: str | os.PathLike[str], sweep: Sweep, progress: Progress) -> None:
    from PIL import Image

    if sweep.frames.dtype == np.float32:
        raise ValueError("frames: expected uint8 or uint16 for PNG, got float32")
    folder = Path(path)
    if folder.exists():
        raise ValueError(f"{path}: expected the name of a new folder, got one that exists")
    temporary = folder.with_name(f".{folder.name}.{os.urandom(6).hex()}.tmp")
    try:
        temporary.mkdir()
        for i, frame in enumerate(sweep.frames):
            Image.fromarray(frame).save(temporary / f"frame_{i:04d}.png")
            if progress:
                progress(i + 1, len(sweep))
        if sweep.mask is not None:
            Image.fromarray(sweep.mask.astype(np.uint8) * 255).save(temporary / stack.MASK)
        table = PoseTable(sweep.timestamps, sweep.world_from_image, sweep.valid)
        write_csv(temporary / POSES_BESIDE, table)
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)  # it may not have been made
        raise
