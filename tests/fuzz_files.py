"""Files of every kind that globule reads, small or real, and the doors through which it reads them.

`KINDS` names, for each kind: what writes its files into the current folder, how Python opens one of
them, and which command does.
"""

import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import globule as gb
import kinds
import numpy as np
import pytest
import tomli_w
from cli_helpers import cube
from format_helpers import sample, structured_points, vtk_write
from globule import formats
from globule.cli.shared import UserError
from globule.cli.state import read_state
from globule.formats.pictures.exr import write_exr
from globule.formats.ranges import has_ranges, ranges
from globule.sim.scene_read import as_dict, read_scene
from globule.ultrasound.marks import read_marks, read_tracked
from globule.ultrasound.plus.config import read_plus_config
from globule.viewer.state import State
from sweep_helpers import example_files, small_sweep
from test_environment import bright, hdr
from test_formats_hostile import FOREIGN
from test_sim_checkpoints import SCENE

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
LARGEST = 320_000  # bytes, of a real file


class Kind(NamedTuple):
    """make     writes files into the current folder; returns the names of those to damage
    read     opens one of them, and uses what came
    command  the words of `globule` that open it, or None
    weight   how many mutants of it, beside others
    """

    make: Callable[[], list[str]]
    read: Callable[[str], Any]
    command: Callable[[str], list[str]] | None
    weight: float = 1.0


def _particles() -> list[str]:
    names = [f"own{e}" for e in formats.EXTENSIONS]
    for name in names:
        formats.write(name, sample())
    for name, content in FOREIGN.items():
        Path(name).write_bytes(content())
    return [*names, *FOREIGN, *_real("particles")]


def _real(folder: str, pattern: str = "*") -> list[str]:
    """Copies of the real files of a folder that are small enough."""
    names = []
    for path in sorted((DATA / folder).glob(pattern)):
        if path.name != "README.md" and path.stat().st_size < LARGEST:
            shutil.copyfile(path, path.name)
            names.append(path.name)
    return names


def _meshes() -> list[str]:
    import trimesh

    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh.visual.vertex_colors = np.arange(32, dtype=np.uint8).reshape(8, 4) * 7
    names = ["box.obj", "box.stl", "box.glb", "box.ply"]
    for name in names:
        mesh.export(name)
    mesh.export("ascii.stl", file_type="stl_ascii")
    mesh.export("ascii.ply", encoding="ascii")
    return [*names, "ascii.stl", "ascii.ply"]


def _read_particles(path: str) -> None:
    particles = gb.read(path)
    assert particles.positions.dtype == np.float32
    assert particles.positions.shape[1:] == (3,)
    assert all(len(a) == len(particles) for a in particles.attributes.values())


def _with_ranges() -> list[str]:
    names = [f"own.{e}" for e in ("npy", "npz", "vtu", "vtp", "bgeo")]
    for name in names:
        formats.write(name, sample())
    return names


def _read_ranges(path: str) -> None:
    if not has_ranges(path):
        raise formats.FormatError(f"{path}: expected ranges, got none")
    n, read, _ = ranges(path)
    for first, last in ((0, n // 2), (n // 2, n)):
        assert len(read(first, last)) == last - first


def _of_kinds(*packages: str) -> list[str]:
    """Files of programs of many origins, each in a folder of its own."""
    names = []
    for k, kind in enumerate(kinds.KINDS):
        if kind.package in packages:
            path = Path(f"{k}", kind.file)
            path.parent.mkdir()
            names += _if_installed(partial(kind.make, path), str(path))
    return names


def _simulators() -> list[str]:
    """Files of simulation programs, as the tests have them."""
    import test_pysph_npz

    test_pysph_npz.written(Path("pysph.npz"))
    return ["pysph.npz", *_of_kinds("", "gsd.hoomd"), *_if_installed(_packed_vtk, "LZ4.vtp", "LZMA.vtp")]


def _if_installed(make: Callable[[], Any], *names: str) -> list[str]:
    """The names, where the package that makes the files is there."""
    try:
        make()
    except (ImportError, pytest.skip.Exception):
        return []
    return [*names]


def _packed_vtk() -> None:
    import pyvista
    import vtk

    cloud = pyvista.PolyData(np.arange(60, dtype=np.float32).reshape(20, 3))
    cloud["mass"] = np.arange(20.0)
    for how in ("LZ4", "LZMA"):
        writer = vtk.vtkXMLPolyDataWriter()
        getattr(writer, f"SetCompressorTypeTo{how}")()
        vtk_write(writer, f"{how}.vtp", cloud)


def _hdf5() -> list[str]:
    import test_hdf5 as made

    made.gadget(Path("gadget.hdf5"))
    made.gadget(Path("packed.hdf5"), compression="gzip", chunks=True)
    made.h5part("run.h5part")
    made.vtkhdf("run.vtkhdf")
    made.pysph("drop.hdf5")
    return ["gadget.hdf5", "packed.hdf5", "run.h5part", "run.vtkhdf", "drop.hdf5", *_of_kinds("h5py")]


def _by_packages() -> list[str]:
    """Tables and scenes, by pyarrow and usd-core."""
    names = ["a.parquet", "a.feather", "a.usda", "a.usdc"]
    for name in names:
        formats.write(name, sample())
    return names


def _volumes() -> list[str]:
    rng = np.random.default_rng(2)
    values = rng.integers(0, 200, (5, 6, 7)).astype(np.int16)
    volume = gb.volumes.Volume(values, np.diag([0.5, 0.6, 0.7, 1.0]))
    names = [f"own{e}" for e in (".mha", ".nrrd", ".nii", ".nii.gz", ".vti", ".npz", ".sparse.npz")]
    for name in names:
        gb.volumes.write_volume(name, volume)
    values.astype("<i2").tofile("beside.raw")
    Path("beside.mhd").write_text(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nDimSize = 7 6 5\nElementType = MET_SHORT"
        "\nElementSpacing = 0.5 0.6 0.7\nElementDataFile = beside.raw\n",
        encoding="utf-8",
    )
    Path("beside.nhdr").write_text(
        "NRRD0004\ntype: short\ndimension: 3\nsizes: 7 6 5\nspacings: 0.5 0.6 0.7\nendian: little\n"
        "encoding: raw\ndata file: beside.raw\n",
        encoding="utf-8",
    )
    names += _if_installed(lambda: _vtk_volume(values), "zlib.vti")
    for name, binary in (("binary.vtk", True), ("ascii.vtk", False)):
        Path(name).write_bytes(structured_points(binary))
    return [*names, "binary.vtk", "ascii.vtk", "beside.mhd", "beside.nhdr", *_real("ultrasound", "RECON*.mha")]


def _vtk_volume(values: np.ndarray) -> None:
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk

    image = vtk.vtkImageData()
    image.SetDimensions(*values.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(values.ravel(), deep=True))
    vtk_write(vtk.vtkXMLImageDataWriter(), "zlib.vti", image)


def _dicom() -> list[str]:
    import SimpleITK as sitk

    image = sitk.GetImageFromArray(np.arange(2 * 8 * 9, dtype=np.uint8).reshape(2, 8, 9))
    sitk.WriteImage(image, "two.dcm")
    sitk.WriteImage(image[:, :, 0], "one.dcm")
    gb.volumes.write_volume("own.dcm", gb.volumes.Volume(np.ones((3, 8, 9), np.uint8), np.eye(4)))
    return ["two.dcm", "one.dcm", "own.dcm"]


def _read_volume(path: str) -> None:
    volume = gb.volumes.read_volume(path)
    assert volume.values.ndim == 3
    assert np.isfinite(volume.world_from_voxel).all()


def _voxels(path: str) -> None:
    """A volume as particles, by the function for them."""
    gb.volumes.sample_tomography(path)


def _sweeps() -> list[str]:
    import test_sweep_bundles as made

    names = ["own.igs.mha", "own.igs.nrrd", "own.npz"]
    for name in names:
        gb.ultrasound.write_sweep(name, small_sweep())
    np.save("stack.npy", small_sweep().frames)
    names += _if_installed(lambda: made.whole("own.mrb"), "own.mrb")
    return names + _if_installed(lambda: made.stradwin("own"), "own.sw")


def _parts_of_sweeps() -> list[str]:
    example_files()
    Path("poses.json").write_text(
        '{"poses": [' + ", ".join(
            f'{{"time": {t}, "position": [1, {t}, 2], "quaternion": [0, 0, 0, 1]}}'
            for t in range(8)
        ) + "]}", encoding="utf-8"
    )  # fmt: skip
    real = _real("ultrasound", "LNMEAN.xml")
    return ["poses.csv", "poses.json", "probe.toml", "config.xml", "frames/frame_0002.png",
            *real, "marks.csv"]  # fmt: skip


def _read_part(path: str) -> None:
    name = os.path.basename(path)
    if name.startswith("poses"):
        gb.ultrasound.read_sweep("frames", poses=path, calibration="probe.toml")
    elif name == "probe.toml":
        gb.ultrasound.read_sweep("sweep.igs.mha", calibration=path)
    elif name == "config.xml":
        read_plus_config(path)
        gb.ultrasound.read_sweep("sweep.igs.mha", plus=path)
    elif name.endswith(".xml"):
        read_plus_config(path)
    elif name == "marks.csv":
        read_marks(path, read_tracked("wires.igs.mha"))
    else:
        gb.ultrasound.read_sweep("frames", poses="poses.csv", calibration="probe.toml")


def _part_words(path: str) -> list[str]:
    name = os.path.basename(path)
    out = ["-o", "out.npz", "--voxels", "12", "--device", "cpu", "--threads", "1"]
    if name.startswith("poses"):
        return ["reconstruct", "frames", "--poses", path, "--calibration", "probe.toml", *out]
    if name == "probe.toml":
        return ["reconstruct", "sweep.igs.mha", "--calibration", path, *out]
    if name.endswith(".xml"):
        return ["reconstruct", "sweep.igs.mha", "--plus", path, "-o", "out.npz", "--device", "cpu"]
    if name == "marks.csv":
        return ["calibrate", "marks.csv", "--sweep", "wires.igs.mha", "-o", "out.toml"]
    return ["info", "frames"]


def _read_sweep(path: str) -> None:
    sweep = gb.ultrasound.read_sweep(path)
    assert sweep.frames.ndim == 3
    assert len(sweep.frames) == len(sweep.world_from_image)


def _pictures() -> list[str]:
    from PIL import Image

    rng = np.random.default_rng(4)
    color = rng.integers(0, 255, (12, 24, 3)).astype(np.uint8)
    Image.fromarray(color).save("a.png")
    Image.fromarray(color).save("a.jpg")
    for coding in ("flat", "runs", "old"):
        Path(f"{coding}.hdr").write_bytes(hdr(bright(24, 12), coding))
    return ["a.png", "a.jpg", "flat.hdr", "runs.hdr", "old.hdr"]


def _exr() -> list[str]:
    write_exr("a.exr", {"color": np.random.default_rng(4).random((12, 24, 3), np.float32)})
    return ["a.exr"]


def _read_picture(path: str) -> None:
    image = gb.Environment(path).image
    assert image.shape[2:] == (3,)
    assert np.isfinite(image).all()


COARSE = {"dam-break": 3.0, "droplet": 1.5, "beam": 1.5, "cut-block": 2.5}  # times the spacing


def _coarse(name: str) -> dict[str, Any]:
    """A shipped scene with few particles; brain-surgery is left out, as it needs an atlas."""
    spacing = COARSE[name] * read_scene(name).spacing
    return _plain(as_dict(read_scene(name, spacing)))


def _scenes() -> list[str]:
    names = [f"{name}.toml" for name in COARSE]
    for name in COARSE:
        Path(f"{name}.toml").write_text(tomli_w.dumps(_coarse(name)), encoding="utf-8")
    Path("all.toml").write_text(tomli_w.dumps(SCENE), encoding="utf-8")
    formats.write("cube.npz", cube())
    Path("files.toml").write_text(
        "spacing = 0.1\n[domain]\nlo = [-1, -1, -1]\nhi = [2, 2, 2]\n[[fluids]]\nname = 'water'\n"
        "[fluids.particles]\nfile = 'cube.npz'\n",
        encoding="utf-8",
    )
    return [*names, "all.toml", "files.toml"]


def _plain(value: Any) -> Any:
    """As TOML holds it: without None."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if v is not None}
    return [_plain(v) for v in value] if isinstance(value, (list, tuple)) else value


def _read_scene(path: str) -> None:
    sim = gb.Simulation(path, device="cpu", threads=1)
    _run(sim)


def _run(sim: gb.Simulation) -> None:
    """Two steps; that they may come to nothing is no fault of a file's reader."""
    try:
        sim.step()
        sim.step()
        sim.record.measure()
    except (ArithmeticError, ValueError):
        pass


def _checkpoints() -> list[str]:
    names = [f"{name}.npz" for name in ("dam-break", "cut-block")]
    for name in names:
        sim = gb.Simulation(_coarse(name[:-4]), device="cpu", threads=1)
        sim.run(0.002)
        sim.save(name)
    sim = gb.Simulation(SCENE, device="cpu", threads=1)
    sim.run(0.006)
    sim.save("all.npz")
    return [*names, "all.npz"]


def _read_checkpoint(path: str) -> None:
    _run(gb.Simulation.load(path, device="cpu", threads=1))


def _states() -> list[str]:
    formats.write("cube.npz", cube())
    state = State()
    state.set(surface__threshold=0.5, look__preset="water", cuts__plane=True, color__by="speed",
              cuts__normal=(0.0, 1.0, 0.0))  # fmt: skip
    camera = gb.Camera((1, 2, 3), (0, 0, 0), (0, 0, 1))
    state.bookmarks["front"] = camera
    state.save("state.toml", camera)
    keys = [{"time": t, "eye": [1.0, t, 3.0], "look_at": [0, 0, 0], "up": [0, 0, 1], "fov": 40}
            for t in range(3)]  # fmt: skip
    Path("path.toml").write_text(tomli_w.dumps({"key": keys}), encoding="utf-8")
    Path("path.json").write_text(str(keys).replace("'", '"'), encoding="utf-8")
    return ["state.toml", "path.toml", "path.json"]


def _read_state(path: str) -> None:
    if os.path.basename(path) == "state.toml":
        try:
            read_state(path)
        except UserError as error:
            raise ValueError(str(error)) from None
    else:
        gb.CameraPath.load(path)


def _state_words(path: str) -> list[str]:
    words = ["render", "cube.npz", "--size", "64x64", "--device", "cpu", "--threads", "1"]
    if os.path.basename(path) == "state.toml":
        return [*words, "-o", "out.png", "--state", path]
    return [*words, "-o", "out%03d.png", "--fps", "0.001", "--camera-path", path]


def _info(path: str) -> list[str]:
    return ["info", path]


KINDS = {
    "particles": Kind(_particles, _read_particles, _info, 5.0),
    "ranges": Kind(_with_ranges, _read_ranges, None, 1.0),
    "simulators": Kind(_simulators, _read_particles, _info, 4.0),
    "hdf5": Kind(_hdf5, _read_particles, None, 0.3),
    "tables": Kind(_by_packages, _read_particles, None, 0.5),
    "meshes": Kind(_meshes, _read_particles, _info, 1.5),
    "volumes": Kind(_volumes, _read_volume, _info, 4.0),
    "voxels": Kind(_volumes, _voxels, None, 0.5),
    "dicom": Kind(_dicom, _read_volume, _info, 0.3),
    "sweeps": Kind(_sweeps, _read_sweep, _info, 1.5),
    "parts of sweeps": Kind(_parts_of_sweeps, _read_part, _part_words, 1.5),
    "pictures": Kind(_pictures, _read_picture, None, 1.5),
    "exr": Kind(_exr, _read_picture, None, 0.2),
    "scenes": Kind(_scenes, _read_scene, None, 2.0),
    "checkpoints": Kind(_checkpoints, _read_checkpoint, None, 3.0),
    "states": Kind(_states, _read_state, _state_words, 1.5),
}
