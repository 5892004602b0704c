"""Meshes: a cube of edge 1."""

from pathlib import Path
from typing import Any

import numpy as np
from format_helpers import vtu

from kinds.base import kind, rows, text
from kinds.vtk import array, xml

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
# Corners, middles of edges, and of the faces across x and y.
_MIDDLES = [[0.5, 0, 0], [1, 0.5, 0], [0.5, 1, 0], [0, 0.5, 0], [0.5, 0, 1], [1, 0.5, 1], [0.5, 1, 1], [0, 0.5, 1],
            [0, 0, 0.5], [1, 0, 0.5], [1, 1, 0.5], [0, 1, 0.5], [0, 0.5, 0.5], [1, 0.5, 0.5], [0.5, 0, 0.5],
            [0.5, 1, 0.5]]  # fmt: skip
_BIQUADRATIC = np.concatenate([_CORNERS[_HEXAHEDRON], _MIDDLES])
kind("biquadratic hexahedron of VTK", "a.vtu", **cube(n=24, places=_BIQUADRATIC))(
    lambda path: vtu(path, _BIQUADRATIC, [np.arange(24)], [33])
)
text("XDMF of meshio", "a.xdmf",
     '<Xdmf Version="3.0"><Domain><Grid><Geometry GeometryType="XYZ"><DataItem DataType="Float" '
     f'Dimensions="8 3" Format="XML">{rows(_CORNERS)}</DataItem></Geometry><Topology TopologyType='
     '"Quadrilateral" NumberOfElements="6"><DataItem DataType="Int" Dimensions="6 4" Format="XML">'
     f'{_faces("", _QUADS)}</DataItem></Topology></Grid></Domain></Xdmf>', **cube())  # fmt: skip


@kind("glTF", "a.glb", **cube(package="trimesh"))
def _(path: Path) -> None:
    import trimesh

    trimesh.Trimesh(_CORNERS, _TRIANGLES, process=False).export(path)
