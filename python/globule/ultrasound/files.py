"""Sweeps from files, and back: `read_sweep` and `write_sweep`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.checks import a_path, number, numeric
from ..formats.errors import bad, faults
from ..formats.kind import Kind, kind_of, kind_or_none, wrong_kind
from ..formats.packed import opens_packed
from ..formats.sweeps import igs, slicer_bundle, stack, stradwin
from ..formats.sweeps.poses import PoseTable, interpolate, read_poses
from ..formats.sweeps.transforms import WORLDS, Edges, Transform, chain, find_path
from ..formats.volumes.raw import Progress
from .calibration import Calibration
from .plausible import check_hand, check_order, check_pixels, check_seconds, check_travel
from .setup import Setup
from .sweep import Sweep, checked_frames
from .sweep_writing import POSES_BESIDE

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# Usual ones; the content counts.
EXTENSIONS = (*igs.EXTENSIONS, ".npz", ".npy", ".h5", ".mrb", ".sw", *stack.DICOM)
_STACKS = {"hdf5": stack.read_h5, "tiff": stack.read_tiff, "video": stack.read_video}
_UNLIKE = 0.05  # by which a calibration's mm per pixel may differ from the file's
_MOST_LONGER = 0.1  # by which poses on a clock of their own may last longer than the frames


def read_sweep(
    path: str | os.PathLike[str],
    calibration: Calibration | str | os.PathLike[str] | None = None,
    plus: str | os.PathLike[str] | None = None,
    poses: str | os.PathLike[str] | None = None,
    temporal_offset: float | None = None,
    clip: Sequence[float] | None = None,
    fan: Sequence[float] | None = None,
    mask: ArrayLike | str | os.PathLike[str] | None = None,
    frame_times: ArrayLike | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Read a tracked sweep.

    Args:
        path: PLUS/IGSIO .igs.mha or .igs.nrrd; a scene of 3D Slicer (.mrb); Stradwin (.sw); .npz
            with frames and world_from_image; a scan of TUS-REC (.h5, .npz with frames and tforms);
            or a stack of images (folder of image files, TIFF, video, .mha, .nrrd, .npy, .npz,
            DICOM) with `poses`.
        calibration: probe_from_image and region: a Calibration or its .toml.
        plus: PLUS configuration (.xml) with transforms and region.
        poses: table (.csv, .json, of TUM, ROS, OptiTrack or NDI, a tracker's buffer of PLUS) of
            world_from_probe, or of world_from_image (with its scale) where no calibration is given;
            interpolated to the times of the frames. A DICOM file with ultrasound regions gives the
            scale of poses of its reference pixel.
        temporal_offset: s, a frame at time t takes the pose at t + offset; default: the
            calibration's, or 0.
        clip: (column, row, width, height) in pixels; fan: see `Fan`; mask: (H, W) or an image's
            path. All given regions combine, and replace the regions of calibration and
            configuration.
        frame_times: (F,) s, or frames per second, for a stack that stores no times. With frames
            per second, a table with a clock of its own starts with the first frame, if both last
            equally long.
        progress: called as progress(done, total): bytes of .mha and .nrrd, pictures of a folder, 1
            of 1 at the end of other formats.

    A frame counts if its image and every transform on the way to the world have the status OK, and
    if poses surround its time. Raises FormatError or ValueError with one line that says what is
    wrong; FileNotFoundError and other OSErrors pass unchanged.
    """
    setup = Setup(calibration, plus, clip, fan, mask)
    if temporal_offset is None:
        temporal_offset = setup.temporal_offset
    number("temporal_offset", temporal_offset)
    recording, arrays = recording_of(path, progress)
    if not recording.frames.size:
        raise bad(path, "", "expected images, got poses alone; give the images, and this file as poses")
    if frame_times is not None:
        times = checked_frame_times(frame_times, len(recording.frames))
        recording = recording._replace(times=times)
    rated = frame_times is not None and np.ndim(frame_times) == 0
    if rated:
        stack.check_numbers(path)
    edges = dict(setup.edges)
    if poses is None and os.path.isdir(path) and (Path(path) / POSES_BESIDE).is_file():
        poses = Path(path) / POSES_BESIDE
    metadata: dict[str, Any] = {"fields": recording.fields}
    if poses is not None:
        table = read_poses(poses)
        check_seconds(poses, table.times, recording.times)
        if rated and table.times is not None:
            table = _on_frame_clock(poses, table, recording.times)
        table = _with_pixel_size(table, arrays, setup)
        _agree(path, arrays, setup)
        recording, name = _posed(poses, recording, table, temporal_offset, setup)
        edges |= {name: recording.edges[name]}
        temporal_offset = 0.0  # the table has been asked with it
    else:
        if "world_from_image" in arrays:
            recording.edges["Image", _text(arrays.get("world"), "Reference")] = _from_arrays(
                path, arrays, len(recording.frames)
            )
        if "tforms" in arrays:
            recording.edges["Probe", "Tracker"] = _from_arrays(path, arrays, len(recording.frames), "tforms")
        edges |= recording.edges
        metadata["frame_fields"] = recording.frame_fields
    if setup.calibration:  # it counts, whatever the file says of the image
        edges = {key: edge for key, edge in edges.items() if "Image" not in key}
        edges["Image", "Probe"] = setup.edges["Image", "Probe"]
    sweep = _assembled(path, recording, edges, setup, temporal_offset, metadata)
    sweep.space = _space(path, arrays)
    sweep.mask = setup.mask(sweep.frames.shape[1:], _mask_beside(path, arrays))
    return sweep


def is_sweep(path: str | os.PathLike[str]) -> bool:
    """Whether a file or folder holds tracked frames or a stack of images, by its content."""
    found = kind_or_none(path)
    return found is not None and found.kind == "sweep"


@opens_packed
def recording_of(
    path: str | os.PathLike[str], progress: Progress = None
) -> tuple[igs.Recording, dict[str, np.ndarray]]:
    """Frames and what their file says; the other arrays of a NumPy archive."""
    arrays: dict[str, np.ndarray] = {}
    a_path(path)
    kind = Kind("sweep", "hdf5") if _is_hdf5(path) else kind_of(path, "sweep")
    if kind.format in ("metaimage", "nrrd"):
        recording = igs.read(path, progress)
    elif kind.format == "mrb":
        recording, arrays = slicer_bundle.read(path, progress)
    elif kind.format == "stradwin":
        recording = stradwin.read(path)
        if progress:
            progress(1, 1)
    else:
        if kind.format == "pictures":
            images = stack.read_folder(path, progress)
        elif kind == ("sweep", "npz") or kind.format == "npy":
            images = stack.read_numpy(path)
        elif kind == ("sweep", "dicom"):
            images = stack.read_dicom(path)
        elif kind.format in _STACKS:
            images = _STACKS[kind.format](path)
        else:
            raise wrong_kind(path, "a sweep or a stack of images", kind)
        if progress and kind.format != "pictures":
            progress(1, 1)
        ok = np.ones(len(images.frames), bool)
        fields: list[dict[str, str]] = [{} for _ in ok]
        recording = igs.Recording(images.frames, images.times, {}, ok, {}, fields)
        arrays = images.arrays
    if not recording.frames.size:
        return recording, arrays  # the buffer of a tracker
    with faults(path, refused=(TypeError, ValueError)):
        return recording._replace(frames=np.asarray(checked_frames(recording.frames))), arrays


def _is_hdf5(path: Any) -> bool:
    if not os.path.isfile(path):
        return False
    with open(path, "rb") as file:
        return file.read(8) == b"\x89HDF\r\n\x1a\n"


def checked_frame_times(value: Any, n: int) -> np.ndarray:
    """Times (F,) of n frames, s, float64. Raises ValueError."""
    times = numeric("frame_times", value)
    if times.ndim == 0 and np.isfinite(times) and times > 0:
        return np.arange(n) / float(times)
    if times.shape != (n,) or not np.isfinite(times).all():
        expected = f"frames per second or {n} finite times"
        raise ValueError(f"frame_times: expected {expected}, got shape {times.shape}")
    return times


def _posed(
    path: Any, recording: igs.Recording, table: PoseTable, offset: float, setup: Setup
) -> tuple[igs.Recording, tuple[str, str]]:
    """The recording with the table's poses at its frames, and between which frames they lead."""
    n = len(recording.frames)
    if not table.ok.any():
        raise bad(path, "", f"expected a pose with status OK, got none in {len(table.ok)}")
    times = recording.times
    if times is None and len(table.ok) == n:
        times = table.times  # one row a frame; None if the table has no times either
    # Also where stamps come twice.
    row_by_row = not offset and times is not None and table.times is not None and np.array_equal(times, table.times)
    without_clock = len(table.ok) == n > 1 and _is_still(table.times)
    if table.times is None or times is None or without_clock or row_by_row:
        if len(table.ok) != n:
            problem = f"expected {n} poses, one a frame, or times in the table and of the frames"
            hint = "; for more images, give a folder of them, or one file with all frames" if n == 1 else ""
            raise bad(path, "", f"{problem}, got {len(table.ok)}{hint}")
        if offset:
            raise bad(path, "", "expected times in the table, for a temporal offset")
        matrices, ok = table.matrices, table.ok
    else:
        for what, stamps in (("frames", times), ("poses", table.times)):
            if _is_still(stamps):
                advice = "give the frames' rate, or a table without times and with one row a frame"
                raise bad(path, "", f"expected time stamps that advance, got {stamps[0]:g} s for all {what}; {advice}")
        with faults(path):
            matrices, ok = interpolate(table, times + offset)
    scales = np.linalg.norm(table.matrices[table.ok][:, :3, :2], axis=1)
    if not setup.calibrated and np.allclose(scales, 1, atol=1e-3):
        problem = "expected a calibration (mm per pixel) beside poses without scale, got none"
        raise bad(path, "", problem)
    if setup.calibrated and not np.allclose(scales, 1, atol=0.1):
        problem = "expected poses without scale beside a calibration (clip, fan, mask may be)"
        raise bad(path, "", f"{problem}, got {np.median(scales):.4g} mm per pixel")
    name = ("Probe" if setup.calibrated else setup.image, "Reference")
    edges = {name: Transform(matrices, ok)}
    return recording._replace(times=times, edges=edges), name


def _is_still(times: np.ndarray | None) -> bool:
    """Whether there are several stamps, all alike."""
    return times is not None and len(times) > 1 and not np.ptp(times)


def _assembled(
    path: Any, recording: igs.Recording, edges: Edges, setup: Setup, offset: float,
    metadata: dict[str, Any],
) -> Sweep:  # fmt: skip
    n = len(recording.frames)
    image = setup.image
    wanted = (setup.world,) if setup.world else WORLDS
    found = {world: find_path(edges, image, world) for world in wanted}
    world, way = next(((world, found[world]) for world in wanted if found[world]), (None, None))
    if world is None or way is None:
        names = " ".join(sorted(f"{a}To{b}" for a, b in edges)) or "no transform"
        problem = f"expected a way from {image} to {' or '.join(wanted)}, got {names}"
        hint = "give a calibration, PLUS configuration or poses"
        hint = hint if edges else "a volume has none, and a recording then needs a table of poses"
        if set(edges) == {(image, "Probe")}:
            hint = "the file holds no poses of a probe; give --poses, or leave out the calibration"
        raise bad(path, "poses", f"{problem}; {hint}")
    if offset:
        edges = _shifted(path, recording, edges, way, offset)
    placed = chain(edges, way, n)
    valid = placed.ok & recording.ok
    if not valid.any():
        got = f"none in {n}" + (f" with a temporal offset of {offset:+g} s" if offset else "")
        raise bad(path, "poses", f"expected a frame with image and pose OK, got {got}")
    matrices = np.where(placed.ok[:, None, None], placed.matrices, np.nan)
    # What writing needs: the way, and the transforms on it that no frame holds.
    metadata |= {
        "way": way,
        "constant": {
            key: edges[key].matrices
            for key in (*way, *((b, a) for a, b in way))
            if key in edges and edges[key].matrices.ndim == 2
        },
    }
    if (image, "Probe") in way:  # a calibration and, apart from it, poses
        rest = chain(edges, way[way.index((image, "Probe")) + 1 :], n)
        check_travel(path, rest.matrices[valid])
    with faults(path):
        sweep = Sweep(recording.frames, matrices, recording.times, valid, world=world,
                      metadata=metadata)  # fmt: skip
        check_pixels(matrices[valid], sweep.frames.shape[1:])
        check_hand(path, matrices[valid])
        if recording.times is not None:
            check_order(path, recording.times[valid])
        return sweep


def _shifted(path: Any, recording: igs.Recording, edges: Edges, way: list[tuple[str, str]], offset: float) -> Edges:
    """The tracker's transforms on the way, each at offset later than its frame."""
    if recording.times is None:
        raise bad(path, "Timestamp", "expected a time in every frame, for a temporal offset")
    if _is_still(recording.times):
        got = f"{recording.times[0]:g} s for all frames"
        raise bad(path, "Timestamp", f"expected times that advance, for a temporal offset, got {got}")
    order = np.argsort(recording.times, kind="stable")
    shifted = dict(edges)
    for key in (*way, *((b, a) for a, b in way)):
        if key in edges and edges[key].matrices.ndim == 3:
            edge = edges[key]
            table = PoseTable(recording.times[order], edge.matrices[order], edge.ok[order])
            shifted[key] = Transform(*interpolate(table, recording.times + offset))
    return shifted


def _on_frame_clock(path: Any, table: PoseTable, times: np.ndarray | None) -> PoseTable:
    """The table with its first pose at the first frame, if its clock is another than that of
    frames, of which only the rate is known."""
    if table.times is None or times is None or len(times) < 2 or _is_still(table.times):
        return table
    low, high = float(table.times.min()), float(table.times.max())
    if low <= times[-1] and high >= times[0]:
        return table
    longer = abs((high - low) - (times[-1] - times[0]))
    if longer > _MOST_LONGER * (times[-1] - times[0]):
        problem = f"expected poses over {times[-1] - times[0]:.3f} s, as long as the frames at the"
        raise bad(path, "", f"{problem} given rate, got {high - low:.3f} s on a clock of its own")
    return table._replace(times=table.times - low)


def _with_pixel_size(table: PoseTable, arrays: dict[str, np.ndarray], setup: Setup) -> PoseTable:
    """The table with the file's mm per pixel, where neither it nor a calibration has them: its
    poses then are those of the reference pixel and the image's axes."""
    if setup.calibrated or "mm_per_pixel" not in arrays or not table.ok.any():
        return table
    scales = np.linalg.norm(table.matrices[table.ok][:, :3, :2], axis=1)
    if not np.allclose(scales, 1, atol=1e-3):
        return table
    step = np.diag([*arrays["mm_per_pixel"], 1.0, 1.0])
    step[:2, 3] = -arrays["mm_per_pixel"] * arrays["reference_pixel"]
    return table._replace(matrices=table.matrices @ step)


def _agree(path: Any, arrays: dict[str, np.ndarray], setup: Setup) -> None:
    """Refuse a calibration whose mm per pixel are not those that the file states."""
    if "mm_per_pixel" not in arrays or setup.calibration is None:
        return
    own = np.linalg.norm(setup.calibration.probe_from_image[:3, :2], axis=0)
    stated = arrays["mm_per_pixel"]
    if (np.abs(own - stated) > _UNLIKE * stated).any():
        expected = " x ".join(f"{v:.4g}" for v in stated)
        got = " x ".join(f"{v:.4g}" for v in own)
        problem = f"expected a calibration with the file's {expected} mm per pixel, got {got}"
        raise bad(path, "", f"{problem}: it belongs to another depth setting")


def _from_arrays(path: Any, arrays: dict[str, np.ndarray], n: int, name: str = "world_from_image") -> Transform:
    matrices = arrays[name]
    if matrices.shape != (n, 4, 4) or matrices.dtype.kind not in "iuf":
        got = f"{matrices.dtype} {matrices.shape}"
        raise bad(path, name, f"expected numbers ({n}, 4, 4), got {got}")
    ok = arrays.get("valid", np.ones(n, bool))
    if ok.shape != (n,) or ok.dtype != bool:
        raise bad(path, "valid", f"expected ({n},) bool, got {ok.dtype} {ok.shape}")
    return Transform(matrices.astype(np.float64), ok & np.isfinite(matrices).all(axis=(1, 2)))


def _text(array: np.ndarray | None, default: str) -> str:
    return str(array) if array is not None and array.shape == () else default


def _space(path: Any, arrays: dict[str, np.ndarray]) -> str:
    space = _text(arrays.get("space"), "LPS")
    if space not in ("LPS", "RAS"):
        raise bad(path, "space", f"expected LPS or RAS, got {space[:20]!r}")
    return space


def _mask_beside(path: Any, arrays: dict[str, np.ndarray]) -> Any:
    if os.path.isdir(path) and (Path(path) / stack.MASK).is_file():
        return Path(path) / stack.MASK
    return arrays.get("mask")
