"""Atoms, molecules and grains in boxes."""

from pathlib import Path
from typing import Any

import numpy as np

from kinds.base import CENTERS, FRAMES, RADII, N, X, grains, kind, numbered, rows, text, with_radii

_NAMED = "".join(f"{N}\nframe {k}\n" + rows(x, before="Ar ") for k, x in enumerate(FRAMES))
text("VMD XYZ", "a.xyz", _NAMED, volume=None, frames=2, names=("atomic_number", "radius"))
text("LAMMPS XYZ", "a.xyz", f"{N}\nAtoms. Timestep: 0\n" + rows(X, before="1 "), names=("type",))
_DUMP = "".join(
    f"ITEM: TIMESTEP\n{10 * k}\nITEM: NUMBER OF ATOMS\n{N}\nITEM: BOX BOUNDS pp pp ff\n"
    "0.0 9.0\n0.0 9.0\n0.0 9.0\nITEM: ATOMS type x y z\n" + rows(x, before="1 ")
    for k, x in enumerate(FRAMES)
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
    for k, x in enumerate(FRAMES)
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


kind("HOOMD GSD", "a.gsd", frames=2, periodic="xyz", names=("type",), package="gsd.hoomd", warns="no diameters")(
    lambda path: gsd(path, [{"position": x, "types": ["A", "B"], "typeid": np.arange(N) % 2} for x in FRAMES])
)
kind("HOOMD grains", "a.gsd", periodic="xyz", package="gsd.hoomd", **grains(names=("diameter", "radius")))(
    lambda path: gsd(path, [{"position": CENTERS, "diameter": 2 * RADII}])
)
