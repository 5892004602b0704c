"""The readers of particle files: one line each.

A reader is a module with `read(path, **options)` that returns Particles or Contents. Other packages
add readers by an entry point of the group `globule.readers` that names a `Format`.
"""

from __future__ import annotations

import functools
import importlib
import warnings
from importlib import metadata
from typing import Any, NamedTuple

GROUP = "globule.readers"  # of entry points


class Format(NamedTuple):
    r"""A format of particle files.

    name      in lower case, unique: "gsd"
    module    its reader's module: ".gsd" within globule.formats, or "package.module"
    endings   of file names, in lower case: (".gsd",)
    content   regular expression, in bytes, that the beginning of such a file matches; b"": none,
              so that the ending alone decides
    function  of the module: function(path, **options) -> Particles or Contents
    writes    whether `write(path, particles)` of the module writes it
    package   that writing needs beside globule, or ""
    kind      "particles", or "mesh" for vertices with faces
    options   names of the reader's options
    about     what `globule info` calls the format
    up        "y" or "z": the axis that its programs have upwards
    """

    name: str
    module: str
    endings: tuple[str, ...] = ()
    content: bytes = b""
    function: str = "read"
    writes: bool = False
    kind: str = "particles"
    options: tuple[str, ...] = ()
    about: str = ""
    package: str = ""
    up: str = "y"


def _vtk(kind: bytes) -> bytes:
    """What a VTK XML file of some type begins with."""
    return rb"\s*<[\s\S]{0,4000}?VTKFile\b[^>]*?\btype *= *[\"']" + kind + rb"[\"']"


def _rows(*counts: int) -> bytes:
    """Lines of so many numbers, the first a whole one."""
    number = rb"[-+.\deE]+"
    lines = (rb"[ \t]*" + rb"[ \t]+".join([number] * n) + rb"[ \t]*\r?\n" for n in counts)
    return rb"\s*(?=\d+[ \t])" + b"".join(lines)


# fmt: off
FORMATS = (
    Format("text", ".text", (".txt", ".dat"), writes=True, about="nine-column text"),
    Format("vtk", ".vtk_legacy", (".vtk",), b"# vtk DataFile", writes=True, about="legacy VTK"),
    Format("vtp", ".vtk_xml", (".vtp",), writes=True, about="VTK XML PolyData"),
    Format("vtu", ".vtk_xml", (".vtu",), writes=True, about="VTK XML UnstructuredGrid"),
    Format("vts", ".vtk_xml_grids", (".vts",), _vtk(b"StructuredGrid"), about="VTK XML StructuredGrid"),
    Format("vtr", ".vtk_xml_grids", (".vtr",), _vtk(b"RectilinearGrid"), about="VTK XML RectilinearGrid"),
    Format("bgeo", ".bgeo", (".bgeo", ".bgeo.gz"), b"BgeoV", writes=True,
           about="Houdini classic geometry"),
    Format("ply", ".ply", (".ply",), writes=True, options=("spacing",), about="Stanford PLY"),
    Format("xyz", ".table", (".xyz",), function="read_xyz", writes=True, options=("frame",),
           about="table, blank-separated"),
    Format("csv", ".table", (".csv",), function="read_csv", writes=True,
           options=("columns", "frame"), about="table"),
    Format("tsv", ".table", (".tsv",), function="read_csv", options=("columns", "frame"),
           about="table, tab-separated"),
    Format("pts", ".table", (".pts",), function="read_xyz", about="points of a scanner",
           up="z"),
    Format("tecplot", ".tecplot", (".tec", ".plt"),
           rb"\s*(?:#[^\n]*\n\s*)*(?:(?i:TITLE)\s*=[^\n]*\n\s*)?(?i:VARIABLES)\s*=",
           options=("frame",), about="Tecplot ASCII"),
    Format("npz", ".numpy_format", (".npz",), function="read_npz", writes=True,
           options=("columns", "species", "frame"), about="NumPy archive"),
    Format("npy", ".numpy_format", (".npy",), function="read_npy", writes=True,
           options=("frame",), about="NumPy array"),
    Format("mat", ".numpy_format", (".mat",), rb"MATLAB 5\.0 MAT-file", function="read_mat", options=("columns",),
           about="MATLAB 5 matrices"),
    Format("obj", ".mesh", (".obj",), kind="mesh", options=("spacing",), about="Wavefront mesh"),
    Format("stl", ".mesh", (".stl",), kind="mesh", options=("spacing",), about="STL mesh"),
    Format("glb", ".mesh", (".glb",), kind="mesh", options=("spacing",),
           about="glTF mesh, binary"),
    Format("gsd", ".gsd_frames", (".gsd",), rb"(?:\xdf\x65){4}", options=("frame",),
           about="GSD, HOOMD-blue", up="z"),
    Format("lammps-dump", ".lammps", (".dump", ".lammpstrj"),
           rb"ITEM: (?:TIMESTEP|UNITS|TIME)\b|---\s*creator: LAMMPS\b",
           function="read_dump", options=("frame",), about="LAMMPS dump", up="z"),
    Format("lammps-data", ".lammps", (".lmp", ".lammps"),
           rb"[^\n]*\n(?:[^\n]{0,200}\n){0,4}[ \t]*\d+[ \t]+atoms\b", function="read_data",
           options=("atom_style",), about="LAMMPS data", up="z"),
    Format("extxyz", ".extxyz", (".extxyz",),
           rb"\s*\d+[ \t]*\r?\n[^\n]*\b(?:Properties|Lattice)\s*=", options=("frame",),
           about="extended XYZ", up="z"),
    Format("bi4", ".bi4", (".bi4",), rb"#FileJBD ", about="DualSPHysics", up="z"),
    Format("pvd", ".vtk_collections", (".pvd",), _vtk(b"Collection"), function="read_pvd",
           options=("frame",), about="ParaView collection"),
    Format("vtm", ".vtk_collections", (".vtm",), _vtk(b"vtkMultiBlockDataSet"),
           function="read_blocks", about="VTK XML multi-block"),
    Format("pvtp", ".vtk_collections", (".pvtp",), _vtk(b"PPolyData"), function="read_pieces",
           about="VTK XML PolyData in pieces"),
    Format("pvtu", ".vtk_collections", (".pvtu",), _vtk(b"PUnstructuredGrid"),
           function="read_pieces", about="VTK XML UnstructuredGrid in pieces"),
    Format("pvts", ".vtk_collections", (".pvts",), _vtk(b"PStructuredGrid"),
           function="read_pieces", about="VTK XML StructuredGrid in pieces"),
    Format("pvtr", ".vtk_collections", (".pvtr",), _vtk(b"PRectilinearGrid"),
           function="read_pieces", about="VTK XML RectilinearGrid in pieces"),
    Format("vtpd", ".vtk_collections", (".vtpd",), _vtk(b"vtkPartitionedDataSet"),
           function="read_blocks", about="VTK XML partitions"),
    Format("vtpc", ".vtk_collections", (".vtpc",), _vtk(b"vtkPartitionedDataSetCollection"),
           function="read_blocks", about="VTK XML collection of partitions"),
    Format("series", ".vtk_collections", (".series",), rb"\s*\{\s*[\"']file-series-version",
           function="read_series", options=("frame",), about="VTK file series"),
    Format("xdmf", ".xdmf", (".xdmf", ".xmf"), rb"\s*<[\s\S]{0,2000}?Xdmf\b", options=("frame",),
           about="XDMF"),
    Format("hdf5", ".hdf5", (".h5", ".hdf5", ".hdf", ".h5part", ".vtkhdf"),
           rb"\x89HDF\r\n|MATLAB 7\.3 MAT-file",
           options=("frame", "species", "columns"), about="HDF5"),
    Format("arrow", ".arrow", (".parquet", ".arrow", ".feather"), rb"PAR1|ARROW1\0\0", writes=True,
           options=("columns",), about="Parquet or Arrow table", package="pyarrow"),
    Format("mercury", ".mercury", (), _rows(8, 14) + b"|" + _rows(6, 8),
           options=("frame",), about="MercuryDPM", up="z"),
    Format("pcd", ".pcd", (".pcd",), rb"(?:#[^\n]*\n\s*)*VERSION\s+\.?\d",
           about="Point Cloud Library", up="z"),
    Format("las", ".through", (".las", ".laz"), b"LASF", function="read_las", about="laser scan",
           up="z"),
    Format("pdb", ".through", (".pdb", ".ent", ".gro"), function="read_molecule",
           options=("frame",), about="molecule, PDB or GRO", up="z"),
    Format("snapshot", ".through", (".tipsy", ".gadget", ".gadget2"),
           rb"\x00\x01\x00\x00[\s\S]{256}\x00\x01\x00\x00|\x08\x00\x00\x00HEAD",
           function="read_snapshot", about="snapshot of Gadget or Tipsy"),
    Format("usd", ".usd", (".usd", ".usda", ".usdc"), rb"#usda |PXR-USDC", writes=True,
           options=("frame", "species"), about="Universal Scene Description", package="usd-core"),
)
# fmt: on


@functools.cache
def formats() -> tuple[Format, ...]:
    """The formats of globule, and behind them those of other packages that are installed.

    An entry point that cannot be loaded, or takes a name that is there, is passed over with a
    warning.
    """
    found = list(FORMATS)
    for point in metadata.entry_points(group=GROUP):
        try:
            new = point.load()
            if not isinstance(new, Format):
                raise TypeError(f"expected a globule.formats.Format, got {type(new).__name__}")
            if new.name in {f.name for f in found}:
                raise ValueError(f"expected a name of its own, got {new.name!r}")
        except Exception as error:
            warnings.warn(f"reader {point.name} ({point.value}): {error}", stacklevel=2)
            continue
        found.append(new)
    return tuple(found)


def format_named(name: str) -> Format:
    """The format of a name. Raises KeyError."""
    return {f.name: f for f in formats()}[name]


def function_of(form: Format, name: str = "") -> Any:
    """A function of a format's module: its reader, or the one called `name`."""
    package = __name__.rpartition(".")[0]
    return getattr(importlib.import_module(form.module, package), name or form.function)
