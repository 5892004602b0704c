"""Files of other programs."""

import struct
from pathlib import Path

import numpy as np
from test_formats_simulators import INSIDE, bi4

from kinds.base import CENTERS, FRAMES, RADII, N, X, grains, kind, rows, text, with_radii

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
         for k, x in enumerate(FRAMES)
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


def mercury(flat: bool) -> str:
    """Two times of grains that move along x."""
    size = "-1 -1 9 9" if flat else "-1 -1 -1 9 9 9"
    text = ""
    for k in range(2):
        text += f"{len(CENTERS)} {0.5 * k} {size}\n"
        for (x, y, z), r in zip(CENTERS, RADII, strict=True):
            x += k
            place, turned = (f"{x + 4 * z:g} {y:g} 1 0", " 0" * 2) if flat else (f"{x:g} {y:g} {z:g} 1 0 0", " 0" * 6)
            text += f"{place} {r:.6f}{turned} 1\n"
    return text


_NAMES = {"frames": 2, "periodic": "", "names": ("radius", "velocity", "species", "angular_velocity")}
text("MercuryDPM", "a.data", mercury(False), **grains(**_NAMES))
text("MercuryDPM in a plane", "a.data.0001", mercury(True), **grains(**_NAMES) | {
    "places": np.column_stack([CENTERS[:, 0] + 4 * CENTERS[:, 2], CENTERS[:, 1], 0 * CENTERS[:, 2]])})  # fmt: skip
