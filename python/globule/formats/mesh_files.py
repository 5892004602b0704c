"""Triangle meshes to files: .ply and .stl binary, .obj, .vtp."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from .._base.files import atomic_write
from .vtk_data import write_polygons

_PLY = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int"}


def write_mesh(
    path: str | os.PathLike[str],
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    values: Mapping[str, np.ndarray],
) -> None:
    """Write a mesh in the format of the name's ending, one of EXTENSIONS.

    Args:
        path: of the file.
        vertices: (V, 3) float32 or float64.
        faces: (F, 3) int32.
        normals: (V, 3) float32 unit vectors.
        values: name -> (V,) or (V, k); .obj and .stl leave them out.
    """
    ending = os.path.splitext(os.fspath(path))[1].lower()
    _WRITERS[ending](path, vertices, faces, normals, values)


def _write_ply(path: Any, vertices: Any, faces: Any, normals: Any, values: Any) -> None:
    columns: dict[str, np.ndarray] = {}
    for names, array in ((("x", "y", "z"), vertices), (("nx", "ny", "nz"), normals)):
        columns.update(zip(names, array.T, strict=True))
    for name, array in values.items():
        word = "_".join(name.split()) or "value"  # a header's words end at blanks
        parts = {word: array} if array.ndim == 1 else {
            f"{word}:{i}": part for i, part in enumerate(array.T)
        }  # fmt: skip
        columns |= {key if key not in columns else f"{key}_": v for key, v in parts.items()}
    columns = {n: c.astype(np.uint8) if c.dtype == bool else c for n, c in columns.items()}
    rows = np.empty(len(vertices), [(n, c.dtype.newbyteorder("<")) for n, c in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    triangles = np.empty(len(faces), [("n", "u1"), ("corners", "<i4", 3)])
    triangles["n"], triangles["corners"] = 3, faces
    properties = "".join(f"property {_PLY[c.dtype.str[1:]]} {name}\n" for name, c in columns.items())
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with atomic_write(path) as file:
        file.write(head.encode())
        file.write(rows.tobytes())
        file.write(triangles.tobytes())


def _write_stl(path: Any, vertices: Any, faces: Any, normals: Any, values: Any) -> None:
    corners = vertices[faces].astype("<f4")
    rows = np.zeros(len(faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")])
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    rows["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
    rows["corners"] = corners
    with atomic_write(path) as file:
        file.write(b"surface mesh".ljust(80) + len(faces).to_bytes(4, "little"))
        file.write(rows.tobytes())


def _write_obj(path: Any, vertices: Any, faces: Any, normals: Any, values: Any) -> None:
    with atomic_write(path, "w") as file:
        for word, rows in (("v", vertices), ("vn", normals)):
            file.writelines(f"{word} {x!r} {y!r} {z!r}\n" for x, y, z in rows.tolist())
        for a, b, c in (faces + 1).tolist():
            file.write(f"f {a}//{a} {b}//{b} {c}//{c}\n")


def _write_vtp(path: Any, vertices: Any, faces: Any, normals: Any, values: Any) -> None:
    write_polygons(path, vertices, {"normals": normals, **values}, polys=faces)


_WRITERS: dict[str, Callable[..., None]] = {
    ".ply": _write_ply, ".stl": _write_stl, ".obj": _write_obj, ".vtp": _write_vtp,
}  # fmt: skip
EXTENSIONS = tuple(_WRITERS)
