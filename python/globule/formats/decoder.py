"""A program of its own that opens files with libraries of others: SimpleITK, OpenEXR, h5py,
pyarrow, usd-core, SciPy.

`workers.py` starts it. It knows nothing of globule. It loads the library that its word names, then
runs a task for each line of standard input, in a fork of its own with limits of memory and time: a
damaged file may end the fork, which ends this program, and nothing else. A line is a list in JSON:
the task, the path, bytes of memory for the header and for all, seconds.

A task prints a line of JSON with the size that the file claims, waits for a line with a request (an
empty one refuses the claim; the answer is {}), then prints a line of JSON with facts and the
arrays' types, and the arrays. What goes wrong is a line {"error": …}.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import os
import re
import sys
from typing import Any


class _RefusedError(BaseException):
    """What the file claims is refused: it is closed before that is answered, so that others may
    write it at once."""


_DONE = 77  # exit status of a task that has answered; a library may exit with others, 0 included


def serve(library: str) -> None:
    """Run the tasks of standard input, until it is closed or a task ends otherwise than it should:
    this process then ends as the task did."""
    _limit("RLIMIT_CORE", 0, 0)
    with contextlib.suppress(ImportError):  # the task tells it
        importlib.import_module(library)
    # Unbuffered: what follows the line is for the task.
    with open(0, "rb", buffering=0, closefd=False) as lines:
        while line := lines.readline():
            task = os.fork()
            if task == 0:
                status = 1
                try:
                    main(*json.loads(line))
                    status = _DONE
                finally:
                    os._exit(status)
            status = os.waitstatus_to_exitcode(os.waitpid(task, 0)[1])
            if status < 0:
                os.kill(os.getpid(), -status)
            if status != _DONE:
                os._exit(status)


def main(task: str, path: str, header: int, memory: int, seconds: int) -> None:
    """Run one task, with limits that last."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    _limit("RLIMIT_CPU", seconds, seconds + 5)
    if memory:  # less as long as only the header is read
        _limit("RLIMIT_DATA", min(header, memory), memory)

    def tell(facts: dict) -> None:
        out.write(json.dumps(facts).encode() + b"\n")
        out.flush()

    def ask(claim: int, **facts: object) -> Any:
        tell({"claim": claim, **facts})
        request = sys.stdin.readline()
        if not request.strip():  # the claim is refused; the next line is for the next task
            raise _RefusedError
        if memory:
            _limit("RLIMIT_DATA", memory, memory)
        return json.loads(request)

    try:
        known = (dicom, regions, series, exr, hdf5, sweep_h5, video, arrow, usd, matlab)
        tasks = {t.__name__: t for t in known}
        facts, arrays = tasks[task](path, ask)
        described = [[a.dtype.str, a.shape] for a in arrays]
        tell({**facts, "arrays": described})
        for array in arrays:
            out.write(memoryview(array).cast("B") if array.size else b"")
        out.flush()
    except _RefusedError:
        tell({})
    except MemoryError:
        tell({"error": "more memory than there is"})
    except Exception as error:
        # ITK's "Reason" is the system's last error, which may have nothing to do with it.
        lines = [line.strip() for line in str(error).splitlines()]
        lines = [line for line in lines if line and not line.startswith("Reason:")]
        said = re.sub(r"^ITK ERROR: \w+\(\w+\): ", "", lines[-1]) if lines else ""
        tell({"error": said or type(error).__name__})


def _limit(name: str, now: int, most: int) -> None:
    """Set a limit of this process, on systems that have it."""
    try:
        import resource

        resource.setrlimit(getattr(resource, name), (now, most))
    except (ImportError, AttributeError, OSError, ValueError):
        pass


def _sitk() -> Any:
    import SimpleITK as sitk

    sitk.ProcessObject.SetGlobalWarningDisplay(False)
    sitk.ProcessObject.SetGlobalDefaultNumberOfThreads(1)
    return sitk


def dicom(path: str, ask: Any) -> tuple[dict, list]:
    """Values and place of one file."""
    sitk = _sitk()
    reader = sitk.ImageFileReader()
    reader.SetFileName(path)
    reader.SetImageIO("GDCMImageIO")
    reader.ReadImageInformation()
    ask(_claim(reader), sizes=list(reader.GetSize()))
    facts, arrays = _image(sitk, reader.Execute())
    kind = reader.GetMetaData("0008|0016") if reader.HasMetaDataKey("0008|0016") else ""
    if kind.strip(" \0") == "1.2.840.10008.5.1.4.1.1.6.2":
        facts |= _place_of_enhanced_us(path)
    return facts, arrays


def _place_of_enhanced_us(path: str) -> dict:
    """Where an Enhanced US Volume lies (PS3.3 C.8.24.3), which GDCM does not read."""
    import numpy as np
    import pydicom

    data = pydicom.dcmread(path, stop_before_pixels=True)
    shared = data.SharedFunctionalGroupsSequence[0]
    frames = data.PerFrameFunctionalGroupsSequence
    measures = shared.PixelMeasuresSequence[0]
    row, column = map(float, measures.PixelSpacing)
    x, y = np.reshape(shared.PlaneOrientationVolumeSequence[0].ImageOrientationVolume, (2, 3))
    places = np.array([f.PlanePositionVolumeSequence[0].ImagePositionVolume for f in frames], float)
    steps = np.diff(places, axis=0)
    if len(steps) and np.abs(steps - steps[0]).max() > 1e-3 * np.abs(steps[0]).max():
        raise ValueError("planes at even distances, got others: a volume for each time or data type")
    z = steps[0] if len(steps) else np.cross(x, y) * float(measures.SliceThickness)
    between = float(np.linalg.norm(z))
    if not between > 0:
        raise ValueError("planes at different places, got several at one")
    directions = np.stack([x, y, z / between], axis=1)
    return {"spacing": [column, row, between], "origin": places[0].tolist(), "direction": directions.ravel().tolist()}


_MOST_REGIONS = 64
_REGION = {
    "spatial": "RegionSpatialFormat", "unit_x": "PhysicalUnitsXDirection",
    "unit_y": "PhysicalUnitsYDirection", "delta_x": "PhysicalDeltaX",
    "delta_y": "PhysicalDeltaY", "x0": "RegionLocationMinX0", "y0": "RegionLocationMinY0",
    "x1": "RegionLocationMaxX1", "y1": "RegionLocationMaxY1", "reference_x": "ReferencePixelX0",
    "reference_y": "ReferencePixelY0",
}  # fmt: skip


def regions(path: str, ask: Any) -> tuple[dict, list]:
    """Numbers of the Sequence of Ultrasound Regions, without the pixels."""
    import pydicom

    ask(0)
    data = pydicom.dcmread(path, stop_before_pixels=True, specific_tags=["SequenceOfUltrasoundRegions"])
    found = []
    for item in list(data.get("SequenceOfUltrasoundRegions") or [])[:_MOST_REGIONS]:
        values = {name: item.get(keyword) for name, keyword in _REGION.items()}
        found.append({n: None if v is None else float(v) for n, v in values.items()})
    return {"regions": found}, []


def series(path: str, ask: Any) -> tuple[dict, list]:
    """Values and place of the series of a folder that has most slices."""
    sitk = _sitk()
    reader = sitk.ImageSeriesReader()
    found = [reader.GetGDCMSeriesFileNames(path, i) for i in reader.GetGDCMSeriesIDs(path)]
    if not found:
        raise ValueError("a DICOM series in this folder, got none")
    names = max(found, key=len)
    first = sitk.ImageFileReader()
    first.SetFileName(names[0])
    first.SetImageIO("GDCMImageIO")
    first.ReadImageInformation()
    held = sum(os.path.getsize(name) for name in names)
    ask(_claim(first) * len(names), sizes=[*first.GetSize()[:2], len(names)], held=held)
    reader.SetFileNames(names)
    return _image(sitk, reader.Execute())


def _claim(reader: Any) -> int:
    # A pixel has at most 8 bytes; colors at most 4 numbers.
    return 8 * max(1, reader.GetNumberOfComponents()) * math.prod(reader.GetSize())


def _image(sitk: Any, image: Any) -> tuple[dict, list]:
    if image.GetDimension() == 4 and image.GetSize()[3] == 1:
        image = image[:, :, :, 0]
    kind = image.GetPixelIDTypeAsString()
    facts = {
        "dimension": image.GetDimension(),
        "components": image.GetNumberOfComponentsPerPixel(),
        "kind": kind,
        "direction": image.GetDirection(),
        "spacing": image.GetSpacing(),
        "origin": image.GetOrigin(),
        "tags": {
            tag: image.GetMetaData(tag).encode("utf-8", "replace").decode()
            for tag in ("0018|1065", "0018|1063")
            if image.HasMetaDataKey(tag)
        },
    }
    return facts, [] if "complex" in kind else [sitk.GetArrayFromImage(image)]


def sweep_h5(path: str, ask: Any) -> tuple[dict, list]:
    """Frames and transforms of a scan of TUS-REC: `frames` (N, H, W), `tforms` (N, 4, 4)."""
    import h5py
    import numpy as np

    with h5py.File(path, "r") as file:
        names = sorted(file)
        if "frames" not in names or "tforms" not in names:
            raise ValueError(f"datasets frames and tforms, got {', '.join(names)[:80] or 'none'}")
        frames, tforms = file["frames"], file["tforms"]
        for one in (frames, tforms):
            if not isinstance(one, h5py.Dataset) or one.dtype.kind not in "uif":
                raise ValueError(f"numbers in {one.name}, got another type")
            if one.is_virtual or one.external:
                raise ValueError(f"{one.name} in this file, got a link to another file")
        n = len(frames)
        if frames.ndim != 3 or tforms.shape != (n, 4, 4):
            raise ValueError(f"frames (N, H, W) and tforms (N, 4, 4), got {frames.shape} and {tforms.shape}")
        ask(frames.size * frames.dtype.itemsize + tforms.size * 8, sizes=list(frames.shape))
        native = np.ascontiguousarray(frames[()], frames.dtype.newbyteorder("="))
        return {}, [native, np.ascontiguousarray(tforms[()], np.float64)]


def video(path: str, ask: Any) -> tuple[dict, list]:
    """The gray values of all frames of the first video, and their times, s."""
    import av
    import numpy as np

    av.logging.set_level(av.logging.PANIC)
    with av.open(path) as file:
        if not file.streams.video:
            raise ValueError("a video, got none")
        stream = file.streams.video[0]
        height, width = stream.codec_context.height, stream.codec_context.width
        # Containers may not know how many frames follow: each takes at least a byte of the file.
        rate = float(stream.average_rate or 0)
        length = float(stream.duration * stream.time_base) if stream.duration else 0.0
        n = stream.frames or int(length * rate + 2) or os.path.getsize(path)
        # A video packs frames far better than the limit for files allows.
        ask(n * height * width, sizes=[width, height, n], held=n * height * width)
        frames: list[Any] = []
        times: list[float] = []
        for frame in file.decode(stream):
            if len(frames) >= n + 2:
                raise ValueError(f"{n} frames, as the header says, got more")
            frames.append(np.ascontiguousarray(frame.to_ndarray(format="gray")))
            times.append(float("nan") if frame.time is None else frame.time)
        if not frames:
            raise ValueError("frames, got none")
        return {}, [np.stack(frames), np.array(times)]


def exr(path: str, ask: Any) -> tuple[dict, list]:
    """R G B, or Y, of the first part."""
    import numpy as np
    import OpenEXR

    with OpenEXR.File(path, header_only=True) as file:
        lo, hi = file.header()["dataWindow"]
        n_channels = len(file.header().get("channels", ())) or 4
    width, height = (int(n) for n in np.asarray(hi, np.int64) - lo + 1)
    ask(4 * max(4, n_channels) * width * height, sizes=[width, height])
    with OpenEXR.File(path, separate_channels=True) as file:
        planes = {name: channel.pixels for name, channel in file.channels().items()}
    names = ("R", "G", "B") if "R" in planes else ("Y",)
    picked = [np.ascontiguousarray(planes[n], np.float32) for n in names if n in planes]
    return {"channels": list(planes)}, picked


_MOST_OBJECTS, _MOST_NESTED = 50_000, 8
_PLACES = "positions?|pos|points|coord(?:inate)?s|xyz"  # names of positions
_SMALL = 100_000  # numbers: data sets of a table of frames are told with their values


def hdf5(path: str, ask: Any) -> tuple[dict, list]:
    """The tree of an HDF5 file, then rows [first, first + n) of the data sets asked for.

    Links to other files are not followed.
    """
    import h5py
    import numpy as np

    with h5py.File(path, "r") as file:
        tree: dict[str, dict] = {"": {"attributes": _attributes(file)}}
        _walk(h5py, file, "", tree, 0)
        request = ask(0, tree=tree)
        arrays = []
        for name, first, n, frame in request:
            table, _, column = name.rpartition("/")
            dataset = file[name] if name in file else file[table].fields(column)
            rows = slice(first, first + n) if frame is None else (frame, slice(first, first + n))
            if name not in file:  # a column of a table
                values = dataset[rows]
            elif "MATLAB_empty" in dataset.attrs:
                values = np.empty(_of_nothing(name), "f8")
            elif _of_matlab(dataset):
                values = np.squeeze(dataset[()]).T[rows]
            else:
                values = dataset[rows] if dataset.ndim else dataset[()]
            arrays.append(np.ascontiguousarray(values, "f8" if values.itemsize > 8 else None))
    return {}, arrays


def _walk(h5py: Any, group: Any, name: str, tree: dict, depth: int) -> None:
    for key in group:
        if len(tree) > _MOST_OBJECTS:
            raise ValueError(f"more than {_MOST_OBJECTS:,} groups and data sets")
        if isinstance(key, bytes):  # no text: nothing that anybody asks for
            continue
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue
        item, place = group[key], f"{name}/{key}"
        if isinstance(item, h5py.Group) and depth < _MOST_NESTED:
            tree[place] = {"attributes": _attributes(item)}
            _walk(h5py, item, place, tree, depth + 1)
        elif isinstance(item, h5py.Dataset) and _is_numbers(item):
            if item.shape is None or item.is_virtual or item.external:
                continue
            matlab = _of_matlab(item)
            offset = None if matlab else item.id.get_offset()
            shape = tuple(n for n in item.shape[::-1] if n != 1) if matlab else item.shape
            if "MATLAB_empty" in item.attrs:  # holds its shape in the place of numbers
                offset, shape = None, _of_nothing(key)
            long = item.dtype.itemsize > 8  # long double
            tree[place] = {
                "attributes": _attributes(item),
                "shape": shape,
                "dtype": "<f8" if long else item.dtype.str,
                "offset": -1 if offset is None or long else offset,
            }
            of_h5md = name.endswith(("/box", "/edges")) or place.endswith("/position/time")
            of_parts = key in ("NumberOfPoints", "NumberOfCells", "NumberOfConnectivityIds")
            of_frames = name.endswith("/Steps") or of_parts or of_h5md or key.lower() in ("t", "time", "times")
            if item.size <= (_SMALL if of_frames else 0):
                tree[place]["values"] = item[()].tolist()
        elif isinstance(item, h5py.Dataset) and _is_table(item):
            tree[place] = {"attributes": _attributes(item)}
            for column in item.dtype.names:
                kind = item.dtype[column]
                if kind.base.kind in "biuf" and "/" not in column:
                    shape, long = (*item.shape, *kind.shape), kind.base.itemsize > 8
                    dtype = "<f8" if long else kind.base.str
                    tree[f"{place}/{column}"] = {"attributes": {}, "shape": shape, "dtype": dtype, "offset": -1}


def _of_nothing(name: str) -> tuple[int, ...]:
    """The shape of MATLAB's []."""
    return (0, 3) if re.fullmatch(_PLACES, name.lower().rpartition("/")[2]) else (0,)


def _of_matlab(dataset: Any) -> bool:
    """Whether MATLAB, Julia or R wrote a matrix, whose axes come in reverse; vectors have one axis here."""
    if dataset.ndim != 2 or "MATLAB_class" in dataset.attrs:
        return dataset.ndim == 2
    name = dataset.name.lower().rpartition("/")[2]
    return bool(re.fullmatch(_PLACES, name)) and dataset.shape[0] in (2, 3) and dataset.shape[1] > 3


def _is_numbers(dataset: Any) -> bool:
    try:
        return dataset.dtype.kind in "biuf"
    except (TypeError, ValueError):  # of a type that h5py does not know
        return False


def _is_table(dataset: Any) -> bool:
    """Whether a data set has a row of named numbers for each particle."""
    try:
        whole = bool(dataset.dtype.names) and len(dataset.shape) == 1
        return whole and not (dataset.is_virtual or dataset.external)
    except (TypeError, ValueError):
        return False


def _attributes(item: Any) -> dict:
    """The attributes that are texts or a few numbers."""
    found: dict[str, Any] = {}
    for name in item.attrs:
        try:
            value = item.attrs[name]
        except (OSError, TypeError, ValueError):  # of a type that h5py does not know
            continue
        if getattr(value, "shape", ()) == (1,):
            value = value[0]
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str):
            found[name] = value[:200]
            continue
        size = getattr(value, "size", None)  # none: a reference, or an empty attribute
        if size is None or size > 64 or not hasattr(value, "dtype"):
            continue
        if value.dtype.kind == "f":
            found[name] = value.astype("f8").tolist()  # JSON knows no long double
        elif value.dtype.kind in "biu":
            found[name] = value.tolist()
        elif value.dtype.kind in "OS":
            texts = [t.decode("utf-8", "replace") if isinstance(t, bytes) else t
                     for t in value.flat]  # fmt: skip
            if all(isinstance(t, str) for t in texts):
                found[name] = [t[:200] for t in texts]
    return found


def matlab(path: str, ask: Any) -> tuple[dict, list]:
    """The real matrices of MATLAB 4 to 7; those of one row or column are (N,), single numbers ()."""
    import numpy as np
    from scipy.io import loadmat, whosmat

    real = {"double", "single", "logical", *(f"{u}int{bits}" for u in ("", "u") for bits in (8, 16, 32, 64))}
    sizes = {name: math.prod(shape) for name, shape, kind in whosmat(path, appendmat=False) if kind in real}
    ask(8 * sum(sizes.values()))
    structs = [name for name, _, kind in whosmat(path, appendmat=False) if kind == "struct"]
    names, arrays = [], []
    for name, a in loadmat(path, appendmat=False, variable_names=[*sizes]).items():
        if name in sizes and a.dtype.kind in "biuf":
            names.append(name)
            flat = a.size == 1 or (a.ndim == 2 and 1 in a.shape and a.shape != (1, 3))
            shape = a.squeeze().shape if flat else a.shape
            if a.shape == (0, 0):  # [], which has no axes
                shape = _of_nothing(name)
            arrays.append(np.ascontiguousarray(a, a.dtype.newbyteorder("=")).reshape(shape))
    return {"names": names, "structs": structs}, arrays


def arrow(path: str, ask: Any) -> tuple[dict, list]:
    """The columns of a Parquet or Arrow table that were asked for, (N,) or (N, k)."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    pa.set_cpu_count(1)
    pa.set_io_thread_count(1)
    with open(path, "rb") as file:
        parquet = file.read(4) == b"PAR1"
    if parquet:
        source = pq.ParquetFile(path, memory_map=False)
        schema, n = source.schema_arrow, source.metadata.num_rows
    else:
        source = pa.ipc.open_file(pa.OSFile(path))
        schema = source.schema
        n = sum(source.get_batch(i).num_rows for i in range(source.num_record_batches))
    widths: dict[str, int] = {}
    units = {}
    for field in schema:
        kind, k = field.type, 1
        if pa.types.is_fixed_size_list(kind):
            kind, k = kind.value_type, kind.list_size
        elif pa.types.is_list(kind):
            kind, k = kind.value_type, 3
        if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
            widths[field.name] = 8 * k * n
            unit = (field.metadata or {}).get(b"unit")
            if unit:
                units[field.name] = unit.decode("utf-8", "replace")[:200]
    if len(set(schema.names)) < len(schema.names):
        raise ValueError("columns of different names, got one twice")
    words = [field.name for field in schema if pa.types.is_string(field.type) or pa.types.is_large_string(field.type)
             or pa.types.is_dictionary(field.type)]  # fmt: skip
    names = ask(0, columns=widths, units=units, words=words)
    table = source.read(columns=names, use_threads=False) if parquet else source.read_all().select(names)
    arrays, kept, ragged = [], [], []
    for name in names:
        column = table.column(name).combine_chunks()
        if isinstance(column, pa.ChunkedArray):
            column = pa.concat_arrays(column.chunks)
        k = 1
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)
                or pa.types.is_boolean(column.type)):  # fmt: skip
            values = column.flatten()
            k = len(values) // max(len(column), 1)
            lengths = column.value_lengths() if pa.types.is_list(column.type) else None
            if column.null_count or (lengths is not None and len(lengths.unique()) > 1):
                ragged.append(name)  # no values of particles
                continue
            column = values
        array = column.to_numpy(zero_copy_only=False)
        if array.dtype.kind not in "biuf":
            array = array.astype(np.float64)  # missing ones become NaN
        array = array.astype(np.uint8) if array.dtype.kind == "b" else array
        array = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("="), copy=False))
        arrays.append(array.reshape(-1, k) if k > 1 else array)
        kept.append(name)
    return {"names": kept, "ragged": ragged}, arrays


def usd(path: str, ask: Any) -> tuple[dict, list]:
    """Points of prims of a layer at a time, in world space, with their other arrays."""
    os.environ["PXR_WORK_THREAD_LIMIT"] = "1"
    import numpy as np
    from pxr import Sdf, Usd, UsdGeom

    try:
        layer = Sdf.Layer.OpenAsAnonymous(path)
    except Exception as error:
        place = re.search(r":(\d+):(\d+): ", str(error))
        where = f" at line {place[1]}, column {place[2]}" if place else ""
        raise ValueError(f"text that usd-core cannot read{where}") from None
    if layer is None:
        raise ValueError("a layer that usd-core cannot open")
    _without_links(Sdf, layer)
    stage = Usd.Stage.Open(layer)
    places: dict[str, Any] = {}
    times: set[float] = set()
    moves: set[float] = set()  # of points that stay, by their prims and those above
    for prim in stage.Traverse():
        if len(places) > _MOST_OBJECTS:
            raise ValueError(f"more than {_MOST_OBJECTS:,} prims")
        for kind, name in ((UsdGeom.Points, "points"), (UsdGeom.PointInstancer, "positions")):
            if prim.IsA(kind):
                places[str(prim.GetPath())] = prim.GetAttribute(name)
                times.update(prim.GetAttribute(name).GetTimeSamples())
                for above in map(stage.GetPrimAtPath, prim.GetPath().GetPrefixes()):
                    moves.update(UsdGeom.Xformable(above).GetTimeSamples() if above.IsA(UsdGeom.Xformable) else ())
    rate = stage.GetTimeCodesPerSecond() or 24.0
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    up = str(UsdGeom.GetStageUpAxis(stage))
    claim = {"prims": list(places), "times": sorted(times or moves), "rate": rate, "unit": unit, "up": up}
    paths, time, visible = ask(0, **claim)
    when = Usd.TimeCode.EarliestTime() if time is None else Usd.TimeCode(time)
    names, arrays = [], []
    purposes = {place: str(UsdGeom.Imageable(places[place].GetPrim()).ComputePurpose()) for place in paths}
    left_out = {"guide", "proxy"} if "render" in purposes.values() else {"guide"}
    for place in paths:
        prim = places[place].GetPrim()
        if visible and purposes[place] in left_out:
            continue
        if visible and UsdGeom.Imageable(prim).ComputeVisibility(when) == "invisible":
            continue
        found = _usd_arrays(UsdGeom, prim, places[place], when)
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(when))
        if not np.array_equal(matrix, np.eye(4)):
            turn = matrix[:3, :3]
            found["points"] = found["points"].astype(np.float64) @ turn + matrix[3, :3]
            if found.get("velocities", np.empty(0)).shape == found["points"].shape:
                found["velocities"] = found["velocities"] @ turn
            scale = abs(np.linalg.det(turn)) ** (1 / 3)
            for name in ("widths", "support"):
                if name in found:
                    found[name] = found[name] * scale
        names.append(list(found))
        arrays += [np.ascontiguousarray(a) for a in found.values()]
    return {"names": names}, arrays


def _usd_arrays(UsdGeom: Any, prim: Any, points: Any, when: Any) -> dict[str, Any]:
    import numpy as np

    value = points.Get(when)
    x = np.array(value if value is not None else [], np.float32).reshape(-1, 3)
    found: dict[str, Any] = {"points": x}
    for name in ("widths", "velocities", "ids"):
        attribute = prim.GetAttribute(name)
        value = attribute.Get(when) if attribute else None
        if value is not None:
            found[name] = np.array(value)
    for variable in UsdGeom.PrimvarsAPI(prim).GetPrimvars():
        value = variable.ComputeFlattened(when) if variable.IsIndexed() else variable.Get(when)
        name, k = variable.GetPrimvarName(), variable.GetElementSize()
        try:
            array = np.array(value)
        except (TypeError, ValueError):
            continue
        if name in found or array.dtype.kind not in "biuf" or array.ndim not in (1, 2):
            continue
        if len(array) == k * len(x) and k > 1:
            array = array.reshape(len(x), k * int(np.prod(array.shape[1:])))
        if name == "displayColor" and array.shape == (1, 3):
            array = np.repeat(array, len(x), axis=0)
        found[name] = array
    widths = _usd_spheres(UsdGeom, prim, when, len(x))
    if widths is not None:
        found.setdefault("widths", widths)
    shown = _usd_shown(UsdGeom, prim, when, len(x))
    if shown is not None:
        found = {k: a[shown] if len(a) == len(x) else a for k, a in found.items()}
        x = found["points"]
    if found.get("widths", np.empty(0)).shape == (1,):
        found["widths"] = np.repeat(found["widths"], len(x))
    return found


def _usd_spheres(UsdGeom: Any, prim: Any, when: Any, n: int) -> Any:
    """(n,) widths of instances of spheres, scaled alike in all directions; None for others."""
    import numpy as np

    if not prim.IsA(UsdGeom.PointInstancer):
        return None
    own = UsdGeom.PointInstancer(prim)
    spheres = [prim.GetStage().GetPrimAtPath(place) for place in own.GetPrototypesRel().GetTargets()]
    kinds, scales = own.GetProtoIndicesAttr().Get(when), own.GetScalesAttr().Get(when)
    if not spheres or kinds is None or not all(sphere and sphere.IsA(UsdGeom.Sphere) for sphere in spheres):
        return None
    kinds = np.array(kinds, np.int64)
    scales = np.ones((n, 3), np.float32) if scales is None else np.array(scales, np.float32).reshape(-1, 3)
    if len(kinds) != n or len(scales) != n or not n or not 0 <= kinds.min() <= kinds.max() < len(spheres):
        return None
    if not np.allclose(scales, scales[:, :1], rtol=1e-3, atol=0):
        return None
    radii = []
    for sphere in spheres:
        radius = UsdGeom.Sphere(sphere).GetRadiusAttr().Get(when)
        volume = UsdGeom.Xformable(sphere).GetLocalTransformation(when).GetDeterminant3()
        radii.append((1.0 if radius is None else radius) * abs(volume) ** (1 / 3))
    return (2 * np.array(radii)[kinds] * scales[:, 0]).astype(np.float32)


def _usd_shown(UsdGeom: Any, prim: Any, when: Any, n: int) -> Any:
    """(n,) bool, which instances are visible; None: all."""
    import numpy as np

    if not prim.IsA(UsdGeom.PointInstancer):
        return None
    mask = UsdGeom.PointInstancer(prim).ComputeMaskAtTime(when)
    return np.array(mask, bool) if len(mask) == n else None


def _without_links(Sdf: Any, layer: Any) -> None:
    """Take out of a layer what names other files."""
    layer.subLayerPaths.clear()
    specs: list[Any] = []
    layer.Traverse("/", specs.append)
    for place in specs:
        spec = layer.GetObjectAtPath(place)
        for key in ("references", "payload", "clips"):
            if spec is not None and spec.HasInfo(key):
                spec.ClearInfo(key)


if __name__ == "__main__":
    del sys.path[0]  # this folder: its modules are not those of others with the same name
    serve(sys.argv[1])
