"""Values at places, for files and other programs."""

from __future__ import annotations

import os
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.checks import a_path, optional
from .._base.files import atomic_write
from ..data.particles import HERE
from ..formats.vtk_data import write_image, write_polygons

if TYPE_CHECKING:
    from xarray import Dataset

EXTENSIONS = (".csv", ".npz", ".vti", ".vtp")


@dataclass(frozen=True, eq=False)
class Samples:
    """Values at places: the result of `sample`, `map_heights` and `project`.

    `samples["speed"]` is `samples.values["speed"]`.

    points  (*shape, 3) float32, world
    values  name -> (*shape,) or (*shape, k) array
    dims    names of the places' dimensions: ("z", "y", "x") of a grid, ("v", "u") of a plane,
            ("s",) of a line, ("point",) of points
    coords  dimension -> (n,) float64 coordinates, world units; for points their numbers
    steps   (d, 3) float64, world: from one place to the next along each dimension; (0, 3) for
            points
    origin  (x, y, z) float64, world, from which points, coords and heights are given
    """

    points: np.ndarray
    values: dict[str, np.ndarray]
    dims: tuple[str, ...]
    coords: dict[str, np.ndarray]
    steps: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    origin: tuple[float, float, float] = HERE

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]

    def __repr__(self) -> str:
        shape = " x ".join(f"{name} {n}" for name, n in zip(self.dims, self.shape, strict=True))
        return f"Samples({shape}: {', '.join(self.values)})"

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of places along each dimension."""
        return self.points.shape[:-1]

    def world_points(self) -> np.ndarray:
        """(*shape, 3) places, world: float64 where there is an origin, else float32."""
        return self.points if self.origin == HERE else self.points + np.asarray(self.origin)

    def columns(self) -> dict[str, np.ndarray]:
        """The places as a table: x, y, z and all values, (M,) each; `NAME:0` … for components."""
        flat = self.world_points().reshape(-1, 3)
        table = {axis: flat[:, i] for i, axis in enumerate("xyz")}
        for name, array in self.values.items():
            if array.ndim == len(self.dims):
                table[name] = array.reshape(-1)
            else:
                parts = array.reshape(-1, array.shape[-1]).T
                table.update({f"{name}:{i}": part for i, part in enumerate(parts)})
        return table

    def to_xarray(self) -> Dataset:
        """The values as an xarray.Dataset with x, y and z as coordinates of each place.

        Raises MissingPackageError without xarray.
        """
        xarray = optional("xarray", "measure")
        components = {name: f"{name}_component" for name, array in self.values.items() if array.ndim > len(self.dims)}
        data: dict[str, Any] = {
            name: ((*self.dims, components[name]) if name in components else self.dims, array)
            for name, array in self.values.items()
        }
        places: dict[str, Any] = {name: (name, along) for name, along in self.coords.items()}
        for i, axis in enumerate("xyz"):
            if axis not in self.dims:
                places[axis] = (self.dims, self.points[..., i])
        return xarray.Dataset(data, places, {"origin": self.origin})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the samples; the file appears whole or not at all.

        The places become world coordinates, float64 where there is an origin; values stay.

        Args:
            path: the extension gives the format. .csv: one row a place. .npz: `points`, and each
                of the values by its name. .vti: a grid or a plane as image data. .vtp: points,
                a line as a polyline, or a plane as quadrilaterals.

        Raises ValueError for another extension, or places that the format cannot hold.
        """
        name = a_path(path)
        extension = os.path.splitext(name)[1].lower()
        if extension not in EXTENSIONS:
            raise ValueError(f"path: expected a name ending in {' '.join(EXTENSIONS)}, got {name}")
        if extension == ".csv":
            write_table(name, self.columns())
        elif extension == ".npz":
            if "points" in self.values:
                raise ValueError("values: expected no value named points in a .npz, got one")
            with atomic_write(name) as file:
                np.savez_compressed(file, points=self.world_points(), **self.values)  # type: ignore[arg-type]
        elif extension == ".vti":
            self._save_image(name)
        else:
            self._save_polygons(name)

    def _flat(self) -> dict[str, np.ndarray]:
        d = len(self.dims)
        return {n: a.reshape(-1, *a.shape[d:]) for n, a in self.values.items()}

    def _save_image(self, path: str) -> None:
        if len(self.steps) < 2:
            raise ValueError(f"path: expected a grid or a plane for .vti, got {self!r}; use .vtp")
        steps, shape = list(self.steps[::-1]), list(self.shape[::-1])
        if len(steps) == 2:  # a plane is one layer thick
            across = np.cross(*steps)
            steps.append(across / np.linalg.norm(across) * np.linalg.norm(steps[0]))
            shape.append(1)
        origin = self.points.reshape(-1, 3)[0] + np.asarray(self.origin)
        write_image(path, origin, np.stack(steps), (shape[0], shape[1], shape[2]), self._flat())

    def _save_polygons(self, path: str) -> None:
        points, number = self.world_points().reshape(-1, 3), np.arange(self.points.size // 3)
        if self.dims == ("v", "u") and min(self.shape) > 1:
            n = number.reshape(self.shape)
            corners = [n[:-1, :-1], n[:-1, 1:], n[1:, 1:], n[1:, :-1]]
            quads = np.stack([corner.reshape(-1) for corner in corners], axis=1)
            write_polygons(path, points, self._flat(), polys=quads)
        elif self.dims == ("s",):
            write_polygons(path, points, self._flat(), lines=number[None])
        else:
            write_polygons(path, points, self._flat(), verts=number[:, None])


def write_table(path: str | os.PathLike[str] | None, columns: dict[str, Any]) -> None:
    """Write columns of equal length as comma-separated values with a row of names; None prints
    them."""
    import csv

    cells = [_words(np.asarray(column)) for column in columns.values()]
    with nullcontext(sys.stdout) if path is None else atomic_write(path, "w") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*cells, strict=True))


def _words(column: np.ndarray) -> list[str]:
    """Numbers as the shortest text that stands for them; NaN and infinities as nan and inf."""
    if column.dtype == bool:
        column = column.astype(np.uint8)
    if column.dtype.kind != "f":
        return [str(value) for value in column.tolist()]
    return [np.format_float_positional(v, trim="-") if 1e-4 <= abs(v) < 1e7 else f"{v!s}"
            for v in column]  # fmt: skip
