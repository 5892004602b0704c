"""HDF5, MATLAB's and XDMF."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinds.base import FRAMES, STEP, N, X, kind, rows, text


def hdf5(name: str, file: str = "a.hdf5", **expected: Any) -> Callable:
    """Add the function that fills an HDF5 file."""

    def add(fill: Callable[[Any], None]) -> Callable[[Any], None]:
        @kind(name, file, package="h5py", **expected)
        def _(path: Path) -> None:
            import h5py

            with h5py.File(path, "w") as file:
                fill(file)

        return fill

    return add


@hdf5("AREPO with a table of masses", periodic="", names=("mass",))
def _(file: Any) -> None:
    head = {"BoxSize": 9.0, "Time": 0.5, "MassTable": [0.0, 0.5, 0, 0, 0, 0]}
    file.create_group("Header").attrs.update(head)
    file["PartType1/Coordinates"] = X


@hdf5("SWIFT", periodic="xyz", names=("density",), volume=None)
def _(file: Any) -> None:
    file.create_group("Header").attrs.update({"BoxSize": [9.0] * 3, "Time": [0.5]})
    file.create_group("HydroScheme").attrs["Kernel gamma"] = 1.825742
    file["PartType0/Coordinates"], file["PartType0/Densities"] = X, np.ones(N)
    file["PartType0/SmoothingLengths"] = np.full(N, 0.12)


@hdf5("WarpX openPMD", "a.h5", unit="m", names=("weighting",))
def _(file: Any) -> None:
    file.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "particlesPath": "particles/"})
    group = file.create_group("data/100/particles/electrons")
    for axis, values in zip("xyz", X.T, strict=True):
        group[f"position/{axis}"] = values
        group[f"position/{axis}"].attrs["unitSI"] = 1.0
        offset = group.create_group(f"positionOffset/{axis}")
        offset.attrs.update({"value": 0.0, "shape": [N], "unitSI": 1.0})
    group["weighting"] = np.ones(N)


def _h5md(file: Any, boundary: list[bytes], edges: Any) -> Any:
    file.create_group("h5md").attrs["version"] = [1, 1]
    group = file.create_group("particles/all")
    group["position/value"] = np.stack(FRAMES)
    group["position/step"], group["position/time"] = [0, 10], [0.0, 0.1]
    group["position/value"].attrs["unit"] = "nm"
    box = group.create_group("box")
    box.attrs.update({"dimension": 3, "boundary": np.array(boundary)})
    if edges is not None:
        box["edges"] = edges
    return group


@hdf5("H5MD of ESPResSo", "a.h5", frames=2, periodic="xyz", unit="nm", names=("type", "mass"))
def _(file: Any) -> None:
    group = _h5md(file, [b"periodic"] * 3, None)
    group["box/edges/value"] = np.tile(9.0 * np.eye(3), (2, 1, 1))
    group["box/edges/step"] = [0, 10]
    group["species/value"] = np.zeros((2, N), int)
    group["mass"] = np.ones(N)  # the same in all frames


@hdf5("H5MD of LAMMPS", "a.h5md.h5", frames=2, periodic="xy", unit="nm")
def _(file: Any) -> None:
    _h5md(file, [b"periodic", b"periodic", b"none"], np.full(3, 9.0))


@hdf5("h5py by its names", "a.h5", names=("density",))
def _(file: Any) -> None:
    file["positions"], file["density"] = X, np.ones(N)


@kind("XDMF of flat arrays", "a.xmf", names=("v",), package="h5py")
def _(path: Path) -> None:
    """As MechSys and PersianSPH write it."""
    import h5py

    with h5py.File(path.with_name("a.h5"), "w") as file:
        file["x"], file["v"] = X.ravel(), X.ravel()
    item = f'<DataItem Dimensions="{N} 3" Format="HDF">\na.h5:/'
    body = f'<Geometry GeometryType="XYZ">{item}x\n</DataItem></Geometry><Attribute Name="v" AttributeType="Vector" '
    body = (
        f'<Xdmf Version="2.0"><Domain><Grid>{body}Center="Node">{item}v\n</DataItem></Attribute></Grid></Domain></Xdmf>'
    )
    path.write_text(body, encoding="utf-8")


@hdf5("SPH with a long smoothing length", "a.h5", names=("density",))
def _(file: Any) -> None:
    file["positions"], file["h"] = X, np.full(N, 1.5 * STEP)
    file["m"], file["rho"] = np.full(N, 1000 * STEP**3), 1000 + 20 * np.sin(np.arange(N))


@hdf5("h5py by groups of frames", "a.h5", frames=2)
def _(file: Any) -> None:
    for k, step in ((0, 9), (1, 10)):
        file[f"frame_{step}/positions"] = FRAMES[k]


@hdf5("h5py by frames", "a.h5", frames=2, names=("density", "mass"))
def _(file: Any) -> None:
    file["pos"], file["density"], file["mass"] = np.stack(FRAMES), np.ones((2, N)), np.ones(N)
    file["time"] = [0.0, 0.5]


@hdf5("h5py by columns", "a.h5")
def _(file: Any) -> None:
    file["x"], file["y"], file["z"] = X[:, :1], X[:, 1:2], X[:, 2:]


@hdf5("PyTables", "a.h5", names=("mass",))
def _(file: Any) -> None:
    table = np.zeros(N, [("mass", "f4"), ("x", "f8"), ("y", "f8"), ("z", "f8"), ("name", "S4")])
    table["x"], table["y"], table["z"] = X.T
    file["run/particles"] = table


def _matlab(path: Path, **matrices: np.ndarray) -> None:
    """A file as `save -v7.3` writes it: a header before HDF5, and axes in reverse."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, matrix in matrices.items():
            file[name] = matrix.T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")


@kind("MATLAB 7.3, a matrix", "a.mat", package="h5py", names=("speed",))
def _(path: Path) -> None:
    _matlab(path, positions=X, speed=np.ones((N, 1)))


@kind("MATLAB 7.3, vectors", "a.mat", package="h5py", names=("mass",))
def _(path: Path) -> None:
    _matlab(path, x=X[:, :1], y=X[:, 1:2], z=X[:, 2:].T, mass=np.ones((1, N)))


@kind("XDMF with its HDF5", "a.xdmf", frames=2, names=("p",), package="h5py")
def _(path: Path) -> None:
    import h5py

    with h5py.File(path.with_name("a.h5"), "w") as file:
        for k, x in enumerate(FRAMES):
            file[f"x{k}"], file[f"p{k}"] = x, np.ones(N)
    grids = "".join(
        f'<Grid><Time Value="{k}"/><Geometry GeometryType="XYZ"><DataItem Dimensions="{N} 3" '
        f'NumberType="Float" Precision="8" Format="HDF">a.h5:/x{k}</DataItem></Geometry><Attribute '
        f'Name="p" Center="Node"><DataItem Dimensions="{N}" Format="HDF" Precision="8">a.h5:/p{k}'
        "</DataItem></Attribute></Grid>"
        for k in (0, 1)
    )
    collection = f'<Grid GridType="Collection" CollectionType="Temporal">{grids}</Grid>'
    head = '<?xml version="1.0"?>\n<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>\n'
    body = f'{head}<Xdmf Version="3.0"><Domain>{collection}</Domain></Xdmf>'
    path.write_text(body, encoding="utf-8")


def _half(k: int) -> str:
    return (
        f'<Grid><Geometry GeometryType="XYZ"><DataItem Format="XML" Dimensions="{len(X[k::2])} 3">'
        f"{rows(X[k::2])}</DataItem></Geometry></Grid>"
    )


text("XDMF of several domains", "a.xmf",
     '<Xdmf><Domain><Grid GridType="Collection" CollectionType="Temporal"><Grid GridType="Collection" '
     f'CollectionType="Spatial"><Time Value="0.5"/>{_half(0)}{_half(1)}</Grid></Grid></Domain></Xdmf>')  # fmt: skip
