"""Small files as the programs of many origins write them, each with what must be read from it.

A ball of `X` on a lattice is the fluid of most; grains are spheres that do not touch.
"""

import base64
import bz2
import gzip
import json
import lzma
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from format_helpers import naming, vtu
from scipy.io import savemat
from test_formats_simulators import INSIDE, bi4

STEP = 0.1
_GRID = np.stack(np.mgrid[-4:5, -4:5, -4:5], -1).reshape(-1, 3) * STEP
X = _GRID[np.linalg.norm(_GRID, axis=1) < 0.401] + (1.0, 2.0, 3.0)
N = len(X)
FLUID = N * STEP**3
CENTERS = np.stack(np.mgrid[:4, :3, :2], -1).reshape(-1, 3) * 0.5
RADII = 0.1 + 0.005 * np.arange(len(CENTERS))
SPHERES = float((4 / 3 * np.pi * RADII**3).sum())


class Kind(NamedTuple):
    """One kind of files. volume: of the surface; None: it has no certain one. names: attributes."""

    name: str
    file: str
    make: Callable[[Path], Any]
    n: int = N
    volume: float | None = FLUID
    frames: int = 1
    periodic: str | None = None
    unit: str = ""
    names: tuple[str, ...] = ()
    package: str = ""
    places: np.ndarray = X
    area: float | None = None  # of a mesh
    ghosts: bool = False
    warns: str = ""  # in the only warning


KINDS: list[Kind] = []


def kind(name: str, file: str, **expected: Any) -> Callable:
    """Add the function that writes `file`."""

    def add(make: Callable[[Path], Any]) -> Callable[[Path], Any]:
        KINDS.append(Kind(name, file, make, **expected))
        return make

    return add


def text(name: str, file: str, content: str, encoding: str = "utf-8", **expected: Any) -> None:
    """Add a file of this text."""
    kind(name, file, **expected)(lambda path: path.write_bytes(content.encode(encoding)))


def grains(**more: Any) -> dict[str, Any]:
    """What is expected of the spheres."""
    return {"n": len(CENTERS), "volume": SPHERES, "places": CENTERS} | more


def rows(x: np.ndarray, mark: str = " ", before: str = "", after: str = "") -> str:
    """A line for each place."""
    lines = (mark.join(f"{v:.6f}" for v in place) for place in x)
    return "".join(f"{before}{line}{after}\n" for line in lines)


def numbered(x: np.ndarray, mark: str = " ", after: str = "") -> str:
    """A line for each place, with its number first."""
    lines = rows(x, mark, "", after).splitlines()
    return "".join(f"{i}{mark}{line}\n" for i, line in enumerate(lines, 1))


def with_radii(mark: str = " ", factor: float = 1.0) -> str:
    """A line for each sphere, with its radius last."""
    table = np.column_stack([CENTERS, factor * RADII])
    return rows(table, mark)


# Tables

text("ParaView table", "a.csv", '"Points:0","Points:1","Points:2"\n' + rows(X, ","))
text("pandas with its index", "a.csv", ",x,y,z\n" + numbered(X, ","))
text("R write.csv", "a.csv", '"","x","y","z"\n' + numbered(X, ","))
text("DualSPHysics CSV", "a.csv",
     "Pos.x [m];Pos.y [m];Pos.z [m];Idp;Rhop [kg/m^3]\n" + rows(X, ";", after=";7;1000"),
     unit="m", names=("Rhop",))  # fmt: skip
text("Excel in German", "a.csv", "\ufeffx;y;z\r\n" + rows(X, ";").replace(".", ","))
text("Excel Unicode text", "a.txt", "\ufeffX\tY\tZ\r\n" + rows(X, "\t"), "utf-16")
text("EDEM radii", "a.csv", "Particle Radius (m),X (m),Y (m),Z (m)\n"
     + "".join(f"{r:.6f},{row}\n" for r, row in zip(RADII, rows(CENTERS, ",").splitlines(), strict=True)),
     **grains(names=("Particle Radius",)), unit="m")  # fmt: skip
text("OpenFOAM cloud", "a.csv", "Points:0,Points:1,Points:2,d,origProcId\n"
     + "".join(f"{row},0\n" for row in with_radii(",", 2.0).splitlines()), **grains(names=("d",)))  # fmt: skip
text("STAR-CCM+ table", "a.csv",
     '"Pressure (Pa)","X (m)","Y (m)","Z (m)"\n' + rows(X, ",", "1.0,"),
     unit="m", names=("Pressure",))  # fmt: skip
text("CFD-Post export", "a.csv",
     "[Name]\nfluid\n\n[Data]\nX [ m ], Y [ m ], Z [ m ], Pressure [ Pa ]\n"
     + rows(X, ", ", after=", 1.0"), unit="m", names=("Pressure",))  # fmt: skip
text("EDEM export", "a.csv",
     "EXTRACTED DATA:\nTIME: 0.1\nParticle ID, Position X (m), Position Y (m), Position Z (m)\n"
     + numbered(X, ", "), unit="m")  # fmt: skip
text("COMSOL export", "a.txt",
     "% Model:              run.mph\n% Dimension:          3\n"
     "% x                       y                        z\n" + rows(X, "       "))  # fmt: skip
text("numpy.savetxt", "a.txt", "# x y z\n" + rows(X))
text("gnuplot data", "a.dat", "# time 0.1\n# x y z\n" + rows(X) + "\n\n")
text("CloudCompare ASCII", "a.txt", "//X Y Z R G B\n" + rows(X, after=" 255 0 0"))
text("MeshLab XYZ with normals", "a.xyz", rows(X, after=" 0.0 0.0 1.0"))
text("scanner's PTS", "a.pts", f"{N}\n" + rows(X, after=" -1033 12 34 56"), names=("intensity",))
text("Yade", "a.txt", "#format x_y_z_r\n# periodic\n" + with_radii(), **grains(names=("radius",)))
text("table of grains", "a.csv", "x,y,z,radius\n" + with_radii(","), **grains(names=("radius",)))
kind("packed table", "a.csv.gz")(lambda path: path.write_bytes(gzip.compress(b"x,y,z\n" + rows(X, ",").encode())))
kind("bzip2 table", "a.xyz.bz2")(lambda path: path.write_bytes(bz2.compress(rows(X).encode())))
kind("xz table", "a.csv.xz")(lambda path: path.write_bytes(lzma.compress(b"x,y,z\n" + rows(X, ",").encode())))

# Atoms

_FRAMES = (X, X + (1.0, 0, 0))
_NAMED = "".join(f"{N}\nframe {k}\n" + rows(x, before="Ar ") for k, x in enumerate(_FRAMES))
text("VMD XYZ", "a.xyz", _NAMED, volume=None, frames=2, names=("atomic_number", "radius"))
text("LAMMPS XYZ", "a.xyz", f"{N}\nAtoms. Timestep: 0\n" + rows(X, before="1 "), names=("type",))
_DUMP = "".join(
    f"ITEM: TIMESTEP\n{10 * k}\nITEM: NUMBER OF ATOMS\n{N}\nITEM: BOX BOUNDS pp pp ff\n"
    "0.0 9.0\n0.0 9.0\n0.0 9.0\nITEM: ATOMS type x y z\n" + rows(x, before="1 ")
    for k, x in enumerate(_FRAMES)
)
text("LAMMPS dump", "a.lammpstrj", _DUMP, frames=2, periodic="xy", names=("type",))
text("LIGGGHTS dump", "a.dump",
     f"ITEM: UNITS\nsi\nITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n{len(CENTERS)}\n"
     "ITEM: BOX BOUNDS ff ff ff\n"
     "-1 9\n-1 9\n-1 9\nITEM: ATOMS x y z radius\n" + with_radii(),
     **grains(names=("radius",)), periodic="", unit="LAMMPS si")  # fmt: skip
_YAML = "".join(
    f"---\ncreator: LAMMPS\ntimestep: {10 * k}\nunits: lj\ntime: {k}\nnatoms: {N}\nboundary: [ p, p, p, p, f, f, ]\n"
    "thermo:\n  - keywords: [ Step, Temp, ]\n  - data: [ 0, 3, ]\nbox:\n  - [ 0, 9 ]\n  - [ 0, 9 ]\n  - [ 0, 9 ]\n"
    "keywords: [ type, x, y, z,  ]\ndata:\n" + rows(x, " , ", "  - [ 1 , ", " , ]") + "...\n"
    for k, x in enumerate(_FRAMES)
)
text("LAMMPS dump yaml", "a.yaml", _YAML, frames=2, periodic="xy", unit="LAMMPS lj", names=("type",))
_HEAD = f"LAMMPS data file\n\n{N} atoms\n1 atom types\n\n0 9 xlo xhi\n0 9 ylo yhi\n0 9 zlo zhi\n\n"
_ATOMS = "".join(f"{i} 1 {row}\n" for i, row in enumerate(rows(X).splitlines(), 1))
text("LAMMPS data", "a.lmp", f"{_HEAD}Masses\n\n1 1.0\n\nAtoms # atomic\n\n{_ATOMS}",
     periodic="xyz", names=("type", "id"))  # fmt: skip
text("ASE extended XYZ", "a.extxyz",
     f'{N}\nLattice="9 0 0 0 9 0 0 0 9" Properties=species:S:1:pos:R:3 pbc="T T F"\n'
     + rows(X, before="Ar "), volume=None, periodic="xy", unit="Å", names=("radius",))  # fmt: skip
text("OVITO extended XYZ", "a.extxyz",
     f'{N}\nLattice="9 0 0 0 9 0 0 0 9" Origin="0 0 0" Properties=id:I:1:pos:R:3 Time=0.5\n'
     + numbered(X), periodic="xyz", unit="Å", names=("id",))  # fmt: skip
_PDB = "".join(
    f"ATOM  {i:5d}  O   HOH A{1:4d}    {x:8.3f}{y:8.3f}{z:8.3f}  1.00  0.00           O\n"
    for i, (x, y, z) in enumerate(X, 1)
)
text("PDB", "a.pdb", "CRYST1    9.000    9.000    9.000  90.00  90.00  90.00 P 1           1\n"
     f"{_PDB}END\n", volume=None, periodic="xyz", unit="Å", names=("radius",),
     package="MDAnalysis")  # fmt: skip
_GRO = "".join(f"{1:5d}SOL     OW{i:5d}{x:8.3f}{y:8.3f}{z:8.3f}\n" for i, (x, y, z) in enumerate(X / 10, 1))
text("GROMACS GRO", "a.gro", f"water\n{N}\n{_GRO}   0.90000   0.90000   0.90000\n", volume=None,
     periodic="xyz", unit="Å", names=("radius",), package="MDAnalysis")  # fmt: skip


def gsd(path: Path, frames: list[dict[str, Any]]) -> None:
    """A file of HOOMD, each frame with these fields of the particles."""
    import gsd.hoomd

    with gsd.hoomd.open(path, "w") as file:
        for fields in frames:
            frame = gsd.hoomd.Frame()
            frame.configuration.box = [18, 18, 18, 0, 0, 0]
            vars(frame.particles).update(N=len(fields["position"]), **fields)
            file.append(frame)


kind("HOOMD GSD", "a.gsd", frames=2, periodic="xyz", names=("type",), package="gsd.hoomd")(
    lambda path: gsd(path, [{"position": x, "types": ["A", "B"], "typeid": np.arange(N) % 2} for x in _FRAMES])
)
kind("HOOMD grains", "a.gsd", periodic="xyz", package="gsd.hoomd", **grains(names=("diameter", "radius")))(
    lambda path: gsd(path, [{"position": CENTERS, "diameter": 2 * RADII}])
)


# VTK


def legacy(dataset: str, rest: bytes) -> bytes:
    head = f"# vtk DataFile Version 3.0\nparticles\nBINARY\nDATASET {dataset}\nPOINTS {N} float\n"
    return head.encode() + X.astype(">f4").tobytes() + b"\n" + rest


@kind("DualSPHysics PartVTK", "a.vtk", names=("Idp", "Rhop"))
def _(path: Path) -> None:
    cells = np.column_stack([np.ones(N), np.arange(N)]).astype(">i4").tobytes()
    ids = f"\nPOINT_DATA {N}\nSCALARS Idp unsigned_int\nLOOKUP_TABLE default\n".encode()
    ids += np.arange(N, dtype=">u4").tobytes()
    rhop = b"\nSCALARS Rhop float\nLOOKUP_TABLE default\n" + np.full(N, 1000, ">f4").tobytes()
    path.write_bytes(legacy("POLYDATA", f"VERTICES {N} {2 * N}\n".encode() + cells + ids + rhop))


@kind("SPlisHSPlasH VTK", "a.vtk", names=("id",))
def _(path: Path) -> None:
    cells = f"CELLS 0 0\nCELL_TYPES 0\nPOINT_DATA {N}\nSCALARS id unsigned_int 1\nLOOKUP_TABLE id_table\n"
    path.write_bytes(legacy("UNSTRUCTURED_GRID", cells.encode() + np.arange(N, dtype=">u4").tobytes()))


text("LPP of LIGGGHTS", "a.vtk",
     f"# vtk DataFile Version 2.0\nGenerated by lpp.py\nASCII\nDATASET POLYDATA\nPOINTS "
     f"{len(CENTERS)} float\n{rows(CENTERS)}VERTICES {len(CENTERS)} {2 * len(CENTERS)}\n"
     + "".join(f"1 {i}\n" for i in range(len(CENTERS)))
     + f"POINT_DATA {len(CENTERS)}\nSCALARS radius float 1\nLOOKUP_TABLE default\n"
     + "".join(f"{r:.6f}\n" for r in RADII), **grains(names=("radius",)))  # fmt: skip


def xml(what: str, body: str) -> str:
    order = 'byte_order="LittleEndian" header_type="UInt32"'
    return f'<?xml version="1.0"?>\n<VTKFile type="{what}" version="0.1" {order}>{body}</VTKFile>\n'


def array(name: str, values: np.ndarray) -> str:
    kind = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind] + str(8 * values.itemsize)
    k = values.shape[1] if values.ndim > 1 else 1
    data = base64.b64encode(struct.pack("<I", values.nbytes) + values.tobytes()).decode()
    return f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{k}" format="binary">{data}</DataArray>'


def polydata(x: np.ndarray, data: str = "") -> str:
    n = len(x)
    verts = array("connectivity", np.arange(n)) + array("offsets", np.arange(1, n + 1))
    points = f"<Points>{array('Points', x.astype('f4'))}</Points><Verts>{verts}</Verts>"
    piece = f'<Piece NumberOfPoints="{n}" NumberOfVerts="{n}">{points}{data}</Piece>'
    return xml("PolyData", f"<PolyData>{piece}</PolyData>")


def grid(path: Path, x: np.ndarray, data: str = "") -> Path:
    return vtu(path, x, [[i] for i in range(len(x))], [1] * len(x), data)


text("SPHinXsys PolyData", "a.vtp", polydata(X))
kind("Yade VTKRecorder", "a.vtu", **grains(names=("radii",)))(lambda path: grid(path, CENTERS, array("radii", RADII)))
kind("UnstructuredGrid of vertices", "a.vtu")(lambda path: grid(path, X))
_GHOSTS = np.array([0] * N + [1] * 5, "u1")
_GHOSTLY, _MARKED = np.r_[X, X[:5]], array("vtkGhostType", _GHOSTS)
kind("ghost points of UnstructuredGrid", "a.vtu", ghosts=True)(lambda path: grid(path, _GHOSTLY, _MARKED))
text("ghost points of PolyData", "a.vtp", polydata(_GHOSTLY, f"<PointData>{_MARKED}</PointData>"), ghosts=True)
text("ghost points of legacy VTK", "a.vtk",
     f"# vtk DataFile Version 3.0\nghosts\nASCII\nDATASET POLYDATA\nPOINTS {N + 5} float\n"
     f"{rows(_GHOSTLY)}POINT_DATA {N + 5}\nSCALARS vtkGhostType unsigned_char 1\n"
     f"LOOKUP_TABLE default\n{' '.join(map(str, _GHOSTS))}\n", ghosts=True)  # fmt: skip


def parts(path: Path, ending: str) -> list[str]:
    """The two halves of the fluid, beside a file."""
    names = [f"part_{k}.{ending}" for k in (0, 1)]
    for k, name in enumerate(names):
        if ending == "vtp":
            path.with_name(name).write_text(polydata(X[k::2]), encoding="utf-8")
        else:
            grid(path.with_name(name), X[k::2])
    return names


kind("pieces of PolyData", "a.pvtp")(lambda path: naming("PPolyData", path, *parts(path, "vtp")))
kind("pieces of UnstructuredGrid", "a.pvtu")(lambda path: naming("PUnstructuredGrid", path, *parts(path, "vtu")))
kind("blocks of ParaView", "a.vtm")(lambda path: naming("vtkMultiBlockDataSet", path, *parts(path, "vtp")))


def _two_frames(path: Path) -> list[str]:
    path.with_name("sub").mkdir(exist_ok=True)
    names = ["sub/part0.vtp", "sub/part1.vtp"]
    for name, x in zip(names, _FRAMES, strict=True):
        (path.parent / name).write_text(polydata(x), encoding="utf-8")
    return names


kind("ParaView collection", "a.pvd", frames=2)(lambda path: naming("Collection", path, *_two_frames(path)))


@kind("ParaView file series", "a.vtp.series", frames=2)
def _(path: Path) -> None:
    files = [{"name": f, "time": k} for k, f in enumerate(_two_frames(path))]
    path.write_text(json.dumps({"file-series-version": "1.0", "files": files}), encoding="utf-8")


# HDF5


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
    group["position/value"] = np.stack(_FRAMES)
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
        for k, x in enumerate(_FRAMES):
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

# NumPy, points of scanners and of editors

kind("numpy.save", "a.npy")(lambda path: np.save(path, X))
kind("numpy.savez by name", "a.npz", names=("speed",))(lambda path: np.savez(path, positions=X, speed=np.ones(N)))
kind("frames of numpy.save", "a.npy", frames=2)(lambda path: np.save(path, np.stack(_FRAMES)))
kind("frames of numpy.savez", "a.npz", frames=2, names=("speed",))(
    lambda path: np.savez(path, positions=np.stack(_FRAMES), speed=np.ones((2, N)), time=[0.0, 0.1])
)
kind("MATLAB 5", "a.mat", **grains(names=("radius",)))(
    lambda path: savemat(path, {"positions": CENTERS, "radius": RADII, "h": 0.1, "run": "a", "all": {"a": 1}})
)
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


# Meshes: a cube of edge 1

_CORNERS = np.stack(np.mgrid[:2, :2, :2], -1).reshape(-1, 3).astype(float)
_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4],
                   [1, 5, 7, 3]])  # fmt: skip
_TRIANGLES = _QUADS[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
_HEXAHEDRON = np.array([0, 4, 6, 2, 1, 5, 7, 3])


def cube(**more: Any) -> dict[str, Any]:
    """What is expected of the cube."""
    return {"n": 8, "volume": None, "places": _CORNERS, "area": 6.0} | more


def _faces(before: str, faces: np.ndarray, first: int = 0) -> str:
    return "".join(f"{before}{' '.join(str(i + first) for i in face)}\n" for face in faces)


text("OBJ of Blender", "a.obj",
     f"# Blender\no Cube\n{rows(_CORNERS, before='v ')}s off\n{_faces('f ', _QUADS, 1)}",
     **cube(package="trimesh"))  # fmt: skip
text("PLY of MeshLab", "a.ply",
     "ply\nformat ascii 1.0\ncomment VCGLIB generated\nelement vertex 8\nproperty float x\n"
     "property float y\nproperty float z\nelement face 6\n"
     "property list uchar int vertex_indices\nend_header\n"
     f"{rows(_CORNERS)}{_faces('4 ', _QUADS)}", **cube())  # fmt: skip
text("STL of OpenSCAD", "a.stl",
     "solid OpenSCAD_Model\n"
     + "".join(
         "facet normal 0 0 0\nouter loop\n" + rows(_CORNERS[t], before="vertex ")
         + "endloop\nendfacet\n"
         for t in _TRIANGLES
     ) + "endsolid OpenSCAD_Model\n", **cube(package="trimesh"))  # fmt: skip
text("legacy polygons", "a.vtk",
     f"# vtk DataFile Version 3.0\nmesh\nASCII\nDATASET POLYDATA\nPOINTS 8 float\n{rows(_CORNERS)}"
     f"POLYGONS 6 30\n{_faces('4 ', _QUADS)}", **cube())  # fmt: skip
text("polygons of ParaView", "a.vtp",
     xml("PolyData", '<PolyData><Piece NumberOfPoints="8" NumberOfPolys="6"><Points>'
         f'{array("Points", _CORNERS)}</Points><Polys>{array("connectivity", _QUADS.ravel())}'
         f'{array("offsets", 4 * np.arange(1, 7))}</Polys></Piece></PolyData>'),
     **cube())  # fmt: skip
kind("hexahedron of meshio", "a.vtu", **cube())(lambda path: vtu(path, _CORNERS, [_HEXAHEDRON], [12]))
text("XDMF of meshio", "a.xdmf",
     '<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XYZ"><DataItem DataType="Float" '
     f'Dimensions="8 3" Format="XML">{rows(_CORNERS)}</DataItem></Geometry><Topology TopologyType='
     '"Quadrilateral" NumberOfElements="6"><DataItem DataType="Int" Dimensions="6 4" Format="XML">'
     f'{_faces("", _QUADS)}</DataItem></Topology></Grid></Domain></Xdmf>', **cube())  # fmt: skip


@kind("glTF", "a.glb", **cube(package="trimesh"))
def _(path: Path) -> None:
    import trimesh

    trimesh.Trimesh(_CORNERS, _TRIANGLES, process=False).export(path)


# The rest

text("nine columns", "a.txt", f"{N}\n" + rows(X, after=" 0.5 0.5 0.5 0 0 1"))


@kind("DualSPHysics bi4", "a.bi4", n=30, volume=None, periodic="", unit="m", names=("density",),
      places=INSIDE)  # fmt: skip
def _(path: Path) -> None:
    path.write_bytes(bi4())


_TEC = 'TITLE = "fluid"\nVARIABLES = "X" "Y" "Z" "P"\n'
text("Tecplot of SPHysics", "a.dat", _TEC + f'ZONE T="fluid", I={N}, F=POINT\n'
     + rows(X, after=" 1.0"), names=("P",))  # fmt: skip
text("Tecplot of SPHinXsys", "a.plt",
     " VARIABLES = \"x\",\"y\",\"z\",\"ID\"\n" + "".join(
         f'ZONE T="water", SOLUTIONTIME={k}.5, DATAPACKING=POINT\n' + rows(x, after=" 7")
         for k, x in enumerate(_FRAMES)
     ), names=("ID",), frames=2)  # fmt: skip
text("Tecplot of grains", "a.tec",
     "variables = x, y, z, radius\nzone\n" + with_radii(), **grains(names=("radius",)))  # fmt: skip
_BLOCKS = "\n".join(" ".join(f"{v:.6f}" for v in axis) for axis in X.T).replace(" ", "\n", 40)
text("Tecplot in blocks", "a.plt",
     f'{_TEC}ZONE T="fluid", I={N}, DATAPACKING=BLOCK\n{_BLOCKS}\n{N}*1.5\n', names=("P",))  # fmt: skip
text("Tecplot elements in blocks", "a.dat",
     'VARIABLES = "X", "Y", "Z", "P"\n'
     f"ZONE NODES={N}, ELEMENTS=2, DATAPACKING=BLOCK, ZONETYPE=FETETRAHEDRON, VARLOCATION=([4]=CELLCENTERED)\n"
     f"{_BLOCKS}\n0.5 0.5\n1 2 3 4\n2 3 4 5\n", warns="values of cells are left out: P")  # fmt: skip


def tipsy(path: Path, order: str) -> None:
    """A snapshot with gas and two other particles."""
    gas = np.zeros((N, 12), order + "f4")
    gas[:, 0], gas[:, 1:4], gas[:, 7] = 1e-3, X, 1
    head = struct.pack(order + "dIIIIII", 0.5, N + 2, 3, N, 2, 0, 0)
    path.write_bytes(head + gas.tobytes() + np.ones((2, 9), order + "f4").tobytes())


kind("Tipsy", "a.tipsy", package="pynbody", names=("mass", "density"))(lambda path: tipsy(path, ">"))
kind("Tipsy of one machine", "a.tipsy", package="pynbody", names=("mass",))(lambda path: tipsy(path, "<"))
