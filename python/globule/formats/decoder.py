"""A program of its own that opens files with libraries of others: SimpleITK, OpenEXR, h5py.

`guarded.py` starts it, with limits of memory and time: a damaged file may end this program and
nothing else. It knows nothing of globule. Words: the task, the path, bytes of memory for the
header and for all, seconds.

It prints a line of JSON with the size that the file claims, waits for a line with a request, then
prints a line of JSON with facts and the arrays' types, and the arrays. What goes wrong is a line
{"error": …}.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from typing import Any


def main(task: str, path: str, header: int, memory: int, seconds: int) -> None:
    """Run one task."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    _limit("RLIMIT_CPU", seconds, seconds + 5)
    _limit("RLIMIT_CORE", 0, 0)
    if memory:  # less as long as only the header is read
        _limit("RLIMIT_DATA", min(header, memory), memory)

    def tell(facts: dict) -> None:
        out.write(json.dumps(facts).encode() + b"\n")
        out.flush()

    def ask(claim: int, **facts: object) -> Any:
        tell({"claim": claim, **facts})
        request = sys.stdin.readline()
        if not request:
            os._exit(0)
        if memory:
            _limit("RLIMIT_DATA", memory, memory)
        return json.loads(request)

    try:
        tasks = {t.__name__: t for t in (dicom, regions, series, exr, hdf5, sweep_h5, video)}
        facts, arrays = tasks[task](path, ask)
        described = [[a.dtype.str, a.shape] for a in arrays]
        tell({**facts, "arrays": described})
        for array in arrays:
            out.write(memoryview(array).cast("B") if array.size else b"")
        out.flush()
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
    return _image(sitk, reader.Execute())


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
    data = pydicom.dcmread(
        path, stop_before_pixels=True, specific_tags=["SequenceOfUltrasoundRegions"]
    )
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
            raise ValueError(
                f"frames (N, H, W) and tforms (N, 4, 4), got {frames.shape} and {tforms.shape}"
            )
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
        for name, first, n in request:
            dataset = file[name]
            values = dataset[first : first + n] if dataset.ndim else dataset[()]
            arrays.append(np.ascontiguousarray(values))
    return {}, arrays


def _walk(h5py: Any, group: Any, name: str, tree: dict, depth: int) -> None:
    for key in group:
        if len(tree) > _MOST_OBJECTS:
            raise ValueError(f"more than {_MOST_OBJECTS:,} groups and data sets")
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            continue
        item, place = group[key], f"{name}/{key}"
        if isinstance(item, h5py.Group) and depth < _MOST_NESTED:
            tree[place] = {"attributes": _attributes(item)}
            _walk(h5py, item, place, tree, depth + 1)
        elif isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf":
            if item.shape is None or item.is_virtual or item.external:
                continue
            offset = item.id.get_offset()
            tree[place] = {
                "attributes": _attributes(item),
                "shape": item.shape,
                "dtype": item.dtype.str,
                "offset": -1 if offset is None else offset,
            }
            of_frames = name.endswith("/Steps") or key == "NumberOfPoints"
            if item.size <= (_SMALL if of_frames else 0):
                tree[place]["values"] = item[()].tolist()


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
        elif getattr(value, "size", 65) <= 64 and value.dtype.kind in "biuf":
            found[name] = value.tolist()
        elif getattr(value, "size", 65) <= 64 and value.dtype.kind in "OS":
            texts = [t.decode("utf-8", "replace") if isinstance(t, bytes) else t for t in value]
            if all(isinstance(t, str) for t in texts):
                found[name] = [t[:200] for t in texts]
    return found


if __name__ == "__main__":
    del sys.path[0]  # this folder: its modules are not those of others with the same name
    main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
