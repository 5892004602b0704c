"""NumPy, points of scanners and of editors."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import savemat

from kinds.base import CENTERS, FRAMES, RADII, N, X, grains, kind, rows, text, with_radii
from kinds.hdf5 import hdf5

kind("numpy.save", "a.npy")(lambda path: np.save(path, X))
kind("numpy.savez by name", "a.npz", names=("speed",))(lambda path: np.savez(path, positions=X, speed=np.ones(N)))
kind("frames of numpy.save", "a.npy", frames=2)(lambda path: np.save(path, np.stack(FRAMES)))
kind("frames of numpy.savez", "a.npz", frames=2, names=("speed",))(
    lambda path: np.savez(path, positions=np.stack(FRAMES), speed=np.ones((2, N)), time=[0.0, 0.1])
)
kind("MATLAB 5", "a.mat", **grains(names=("radius",)))(
    lambda path: savemat(path, {"positions": CENTERS, "radius": RADII, "h": 0.1, "run": "a", "all": {"a": 1}})
)
kind("numpy.save with ids", "a.npy", names=("id",), warns="taken as id, x, y, z")(
    lambda path: np.save(path, np.column_stack([np.arange(N), X]))
)
kind("numpy.savez of columns", "a.npz", names=("speed",))(
    lambda path: np.savez(path, pos_x=X[:, 0], pos_y=X[:, 1], pos_z=X[:, 2], speed=np.ones(N))
)
kind("numpy.savez of coords", "a.npz")(lambda path: np.savez(path, coords=X))
kind("numpy.savez without a name", "a.npz")(lambda path: np.savez(path, X))


def records(x: np.ndarray) -> np.ndarray:
    """A structured array, as pandas' to_records and yt have it."""
    found = np.zeros(len(x), [("x", "f4"), ("y", "f4"), ("z", ">f8"), ("id", "i8"), ("name", "S3")])
    found["x"], found["y"], found["z"] = x.T
    return found


kind("pandas records", "a.npy", names=("id",))(lambda path: np.save(path, records(X)))
kind("records in an archive", "a.npz", names=("id",))(lambda path: np.savez(path, data=records(X)))
kind("records of vectors", "a.npy", names=("mass",))(
    lambda path: np.save(path, np.array([(x, 1.0) for x in X], [("pos", "f8", 3), ("mass", "f4")]))
)

text("PLY of CloudCompare", "a.ply",
     f"ply\nformat ascii 1.0\ncomment Created by CloudCompare\nelement vertex {N}\n"
     "property float x\nproperty float y\nproperty float z\nproperty float scalar_p\nend_header\n"
     + rows(X, after=" 1.0"), names=("scalar_p",))  # fmt: skip


@kind("PLY of Open3D", "a.ply")
def _(path: Path) -> None:
    head = f"ply\nformat binary_little_endian 1.0\ncomment Created by Open3D\nelement vertex {N}\n"
    head += "property double x\nproperty double y\nproperty double z\nend_header\n"
    path.write_bytes(head.encode() + X.astype("<f8").tobytes())


_PCD = f"""# .PCD v.7 - Point Cloud Data file format
VERSION .7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH {N}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {N}
"""
text("PCD, ASCII", "a.pcd", f"{_PCD}DATA ascii\n{rows(X)}")
kind("PCD, binary", "a.pcd")(lambda path: path.write_bytes(f"{_PCD}DATA binary\n".encode() + X.astype("<f4").tobytes()))


@kind("LAS", "a.las", package="laspy", names=("intensity",))
def _(path: Path) -> None:
    import laspy

    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-6), np.zeros(3)
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = X.T
    scan.write(path)


@kind("Parquet with units", "a.parquet", package="pyarrow", names=("speed",), unit="m")
def _(path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table(dict(zip("xyz", X.T, strict=True)) | {"speed": np.ones(N)})
    units = [field.with_metadata({"unit": "m"}) for field in table.schema]
    parquet.write_table(table.cast(pa.schema(units)), path)


@kind("Arrow of polars", "a.arrow", package="pyarrow")
def _(path: Path) -> None:
    import pyarrow as pa
    from pyarrow import feather

    feather.write_feather(pa.table(dict(zip("xyz", X.T, strict=True))), path)


@kind("USD points of Houdini", "a.usda", package="pxr", unit="0.01 m")
def _(path: Path) -> None:
    points = ", ".join(f"({x:.6f}, {y:.6f}, {z:.6f})" for x, y, z in X)
    head = '#usda 1.0\n(\n    metersPerUnit = 0.01\n    upAxis = "Y"\n)\n'
    path.write_text(f'{head}def Points "p"\n{{\n    point3f[] points = [{points}]\n}}\n')


@kind("Partio bgeo", "a.bgeo")
def _(path: Path) -> None:
    import globule as gb

    gb.write(path, gb.Particles(X))


# More that give radii

text("tab-separated grains", "a.tsv", "x [m]\ty [m]\tz [m]\tRadius [m]\n" + with_radii("\t"),
     **grains(names=("Radius",)), unit="m")  # fmt: skip
text("LAMMPS data of spheres", "a.lmp",
     f"LAMMPS data file\n\n{len(CENTERS)} atoms\n1 atom types\n\n-1 9 xlo xhi\n-1 9 ylo yhi\n"
     "-1 9 zlo zhi\n\nAtoms # sphere\n\n"
     + "".join(
         f"{i} 1 {2 * r:.6f} 2500.0 {x:.6f} {y:.6f} {z:.6f}\n"
         for i, ((x, y, z), r) in enumerate(zip(CENTERS, RADII, strict=True), 1)
     ) + "\nVelocities\n\n1 0 0 0\n", **grains(names=("diameter",)), periodic="xyz")  # fmt: skip


@kind("PCD of grains", "a.pcd", **grains(names=("radius",)))
def _(path: Path) -> None:
    head = _PCD.replace("x y z\n", "x y z radius\n").replace("4 4 4", "4 4 4 4")
    head = head.replace("F F F", "F F F F").replace("1 1 1\n", "1 1 1 1\n", 1)
    head = head.replace(str(N), str(len(CENTERS)))
    path.write_text(f"{head}DATA ascii\n{with_radii()}", encoding="utf-8")


@hdf5("grains in HDF5", "a.h5", **grains(names=("radius",)))
def _(file: Any) -> None:
    file["positions"], file["radius"] = CENTERS, RADII


text("XDMF with its numbers", "a.xmf",
     '<Xdmf><Domain><Grid><Geometry GeometryType="XYZ"><DataItem Format="XML" Dimensions="'
     f'{len(CENTERS)} 3">{rows(CENTERS)}</DataItem></Geometry><Attribute Name="radius" '
     f'Center="Node"><DataItem Format="XML" Dimensions="{len(CENTERS)}">'
     f"{' '.join(map(str, RADII))}</DataItem></Attribute></Grid></Domain></Xdmf>",
     **grains(names=("radius",)))  # fmt: skip
