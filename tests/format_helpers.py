"""Particles with every field, and whether a format kept them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from globule import formats
from globule.data.particles import Particles

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "particles"
FULL = [e for e in formats.EXTENSIONS if e not in (".txt", ".dat", ".npy")]
N = 40


def sample(n: int = N) -> Particles:
    rng = np.random.default_rng(7)

    def numbers(*shape: int) -> np.ndarray:
        return rng.random(shape, dtype=np.float32)

    return Particles(
        rng.normal(size=(n, 3)),
        support=numbers(n) + np.float32(0.1),
        color=numbers(n, 3),
        attributes={
            "velocity": numbers(n, 3),
            "density": 1000 * numbers(n),
            "id": np.arange(n)[::-1].copy(),
            "flags": np.arange(2 * n, dtype=np.uint8).reshape(n, 2),
            "thing": numbers(n, 1),
        },
    )


def assert_same(got: Particles, expected: Particles) -> None:
    assert np.array_equal(got.positions, expected.positions, equal_nan=True)
    for name in ("support", "weight", "color", "reflection", "refraction", "rigidity"):
        a, b = getattr(got, name), getattr(expected, name)
        assert (a is None) == (b is None), name
        if b is not None:
            assert np.array_equal(np.broadcast_to(a, np.shape(b)), b), name
    assert got.attributes.keys() == expected.attributes.keys()
    for name, array in expected.attributes.items():
        read = got.attributes[name]
        assert read.dtype.kind == array.dtype.kind or array.dtype.kind in "iub", name
        if read.shape != array.shape:  # some formats do not tell (N, 1) from (N,)
            assert (array.shape, read.shape) == ((len(got), 1), (len(got),)), name
        assert np.array_equal(read.astype(array.dtype).reshape(array.shape), array), name
        assert read.flags.owndata or read.base.flags.owndata


def read_or_refused(read: Callable[[Path], Any], path: Path) -> Any:
    """What `read` makes of a broken file; None where one line that names the file refuses it."""
    try:
        return read(path)
    except formats.FormatError as error:
        said = str(error)
    assert "\n" not in said
    assert path.name in said
    return None


def by_vtk(path: Path | str) -> Any:
    """The data set that VTK reads from a file."""
    pytest.importorskip("vtk")
    from vtkmodules import vtkIOLegacy, vtkIOXML

    reader = {
        ".vtk": vtkIOLegacy.vtkPolyDataReader,
        ".vtp": vtkIOXML.vtkXMLPolyDataReader,
        ".vtu": vtkIOXML.vtkXMLUnstructuredGridReader,
        ".vti": vtkIOXML.vtkXMLImageDataReader,
    }[Path(path).suffix]()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def naming(what: str, path: Path, *files: str) -> Path:
    """A file of VTK that names others, such as a Collection."""
    parts = "".join(f'<DataSet index="{i}" timestep="{i}" file="{file}"/>' for i, file in enumerate(files))
    if what[0] == "P":
        parts = "".join(f'<Piece Source="{file}"/>' for file in files)
    path.write_text(f'<VTKFile type="{what}" version="0.1"><{what}>{parts}</{what}></VTKFile>', encoding="utf-8")
    return path


def vtk_write(writer: Any, path: Path | str, data: Any) -> None:
    """Write a data set by a writer of VTK."""
    writer.SetFileName(str(path))
    writer.SetInputData(data)
    assert writer.Write()


def structured_points(binary: bool = True) -> bytes:
    """A legacy VTK file of 4 x 3 x 2 values 0 to 23."""
    values = np.arange(24, dtype=">i2")
    body = values.tobytes() if binary else " ".join(map(str, values)).encode()
    head = (f"# vtk DataFile Version 3.0\nthe sea\n{'BINARY' if binary else 'ASCII'}\n"
            "DATASET STRUCTURED_POINTS\nDIMENSIONS 4 3 2\nSPACING 0.5 1 2\nORIGIN 10 -20 30.25\n"
            f"POINT_DATA 24\nSCALARS eta short 1\nLOOKUP_TABLE default\n")  # fmt: skip
    more = b"\nVECTORS u short\n" + (bytes(144) if binary else b"0 " * 72)
    return head.encode() + body + more + b"\n"


def write_dump(path: str, *frames: np.ndarray, faces: str = "pp pp ff") -> None:
    """LAMMPS' dump of these positions in a box of 1 x 1 x 2."""
    with open(path, "w", encoding="utf-8") as file:
        for k, x in enumerate(frames):
            file.write(f"ITEM: TIMESTEP\n{k}\nITEM: NUMBER OF ATOMS\n{len(x)}\nITEM: BOX BOUNDS {faces}\n")
            file.write("0 1\n0 1\n0 2\nITEM: ATOMS id type x y z\n")
            file.writelines(f"{i + 1} 1 {a:.9g} {b:.9g} {c:.9g}\n" for i, (a, b, c) in enumerate(x))


def write_extxyz(path: str, *frames: np.ndarray) -> None:
    """Extended XYZ of the same."""
    with open(path, "w", encoding="utf-8") as file:
        for k, x in enumerate(frames):
            file.write(f'{len(x)}\nLattice="1 0 0 0 1 0 0 0 2" pbc="T T F" Time={0.5 * k} ')
            file.write("Properties=species:S:1:pos:R:3\n")
            file.writelines(f"H {a:.9g} {b:.9g} {c:.9g}\n" for a, b, c in x)


def words(values) -> str:
    return " ".join(str(v) for v in np.ravel(values))


def data_array(name: str, kind: str, values, components: int = 1) -> str:
    head = f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
    return f"{head}{words(values)}</DataArray>"


def vtu(path, points, cells, types, point_data="", cell_data="", more=""):
    corners = [i for cell in cells for i in cell]
    ends = np.cumsum([len(cell) for cell in cells])
    path.write_text(
        '<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">'
        f"<Points>{data_array('P', 'Float64', points, 3)}</Points>"
        f"<Cells>{data_array('connectivity', 'Int64', corners)}"
        f"{data_array('offsets', 'Int64', ends)}{data_array('types', 'UInt8', types)}{more}</Cells>"
        f"<PointData>{point_data}</PointData><CellData>{cell_data}</CellData>"
        "</Piece></UnstructuredGrid></VTKFile>"
    )
    return path


def vtk(path, points, cells, types, more=""):
    rows = "\n".join(f"{len(cell)} {words(cell)}" for cell in cells)
    n = sum(1 + len(cell) for cell in cells)
    path.write_text(
        "# vtk DataFile Version 3.0\ncells\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        f"POINTS {len(points)} double\n{words(points)}\nCELLS {len(cells)} {n}\n{rows}\n"
        f"CELL_TYPES {len(cells)}\n{words(types)}\n{more}"
    )
    return path
