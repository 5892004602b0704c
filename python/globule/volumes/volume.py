"""A volume of voxels in millimeters, with a record of where each value came from."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from .._base.arrays import DeviceArray, box_corners
from ..formats import volumes as formats
from ..formats.volumes.geometry import VolumeData, in_space

EMPTY, MEASURED, FILLED, EXTRAPOLATED = 0, 1, 2, 3
MAPS = ("count", "variance", "source", "uncertainty")  # besides `radius`, which says measured, filled or empty
FAR = 255  # in the map of kernel radii: no data within reach
BEYOND = 128  # added to the radius of an extrapolated voxel


class Volume:
    """Voxels of one size along each axis, and their origin.

    Args:
        values: (Z, Y, X) uint8, uint16 or float32; 0 where empty. Values and radius may lie on a
            GPU; a read copies them to the host.
        world_from_voxel: (4, 4) float64, mm: voxel index (x, y, z, 1) to the voxel's center.
        radius: (Z, Y, X) uint8: 0 measured; k = 1 to 126 filled, at most k voxels from the
            nearest measured voxel; 128 + k the same, extrapolated; 255 empty.
        space: meaning of the world's axes, "LPS" or "RAS".
        info: numbers of the reconstruction: times in seconds, bytes, counts.
        maps: a function that makes a map by name ("count", "variance", "source", "uncertainty") at
            the first read.
    """

    def __init__(
        self,
        values: np.ndarray | DeviceArray,
        world_from_voxel: np.ndarray,
        radius: np.ndarray | DeviceArray | None = None,
        space: str = "LPS",
        info: dict[str, Any] | None = None,
        maps: Callable[[str], np.ndarray] | None = None,
    ):
        self._values, self._radius = values, radius
        if radius is None:
            self._radius = np.zeros(values.shape, np.uint8)
        self.device_values = values if isinstance(values, DeviceArray) else None
        self.device_radius = radius if isinstance(radius, DeviceArray) else None
        self.world_from_voxel = np.asarray(world_from_voxel, np.float64)
        self.space = space
        self.info = dict(info or {})
        self._make_map = maps
        self._maps: dict[str, np.ndarray] = {}

    @property
    def values(self) -> np.ndarray:
        """(Z, Y, X); 0 where empty. `device_values` is the array on a GPU, or None."""
        self._values = np.asarray(self._values)
        return self._values

    @values.setter
    def values(self, values: np.ndarray) -> None:
        self._values, self.device_values = values, None

    @property
    def radius(self) -> np.ndarray:
        """(Z, Y, X) uint8: 0 measured; k = 1 to 126 filled, at most k voxels along each axis from a
        measured voxel or, with method frames, from the nearer frame; 128 + k the same,
        extrapolated: not between data; 255 empty."""
        self._radius = np.asarray(self._radius)
        return self._radius

    @radius.setter
    def radius(self, radius: np.ndarray) -> None:
        self._radius, self.device_radius = radius, None

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels (Z, Y, X)."""
        z, y, x = self._values.shape
        return z, y, x

    @property
    def spacing(self) -> np.ndarray:
        """(3,) mm along x, y and z."""
        return np.linalg.norm(self.world_from_voxel[:3, :3], axis=0)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of the voxel centers, mm, world."""
        corners = box_corners((0, 0, 0), np.array(self.values.shape[::-1]) - 1)
        places = corners @ self.world_from_voxel[:3, :3].T + self.world_from_voxel[:3, 3]
        return places.min(axis=0), places.max(axis=0)

    @property
    def measured(self) -> np.ndarray:
        """(Z, Y, X) bool: voxels that hold at least one pixel."""
        return self.radius == 0

    @property
    def empty(self) -> np.ndarray:
        """(Z, Y, X) bool: voxels too far from any data; their value 0 has no meaning."""
        return self.radius == FAR

    @property
    def filled(self) -> np.ndarray:
        """(Z, Y, X) uint8, the origin of each value: EMPTY 0, MEASURED 1, FILLED 2, interpolated
        between data, or EXTRAPOLATED 3, from data on one side."""
        return origin_of(self.radius)

    @property
    def hole_distance(self) -> np.ndarray:
        """(Z, Y, X) float32, mm: the largest of the distances along x, y and z to the nearest
        measured voxel; 0 for measured voxels, infinite if no measured voxel is within reach."""
        reach = (self.radius % BEYOND).astype(np.float32) * np.float32(self.spacing.max())
        reach[self.radius == FAR] = np.inf
        return reach

    @property
    def n_measured(self) -> int:
        """Voxels that hold at least one pixel."""
        return int(np.count_nonzero(self.radius == 0))

    @property
    def n_empty(self) -> int:
        """Voxels too far from any data."""
        return int(np.count_nonzero(self.radius == FAR))

    @property
    def n_filled(self) -> int:
        """Voxels interpolated between measured ones nearby."""
        return self.values.size - self.n_measured - self.n_empty - self.n_extrapolated

    @property
    def n_extrapolated(self) -> int:
        """Voxels filled although no data lie on the other side."""
        return int(np.count_nonzero((self.radius > BEYOND) & (self.radius != FAR)))

    @property
    def count(self) -> np.ndarray:
        """(Z, Y, X) uint32: number of pixels in each voxel."""
        return self._map("count")

    @property
    def variance(self) -> np.ndarray:
        """(Z, Y, X) float32: variance of the pixels' values in each voxel; 0 for one pixel or
        none."""
        return self._map("variance")

    @property
    def source(self) -> np.ndarray:
        """(Z, Y, X) int32: the latest frame with a pixel in the voxel; -1 for no frame."""
        return self._map("source")

    @property
    def uncertainty(self) -> np.ndarray:
        """(Z, Y, X) float32: expected root mean square difference of each voxel's value from a
        pixel seen there, gray levels; infinite for empty voxels. For volumes of method "frames";
        from frames left out, the distance of the frames on both sides, and their difference."""
        return self._map("uncertainty")

    def _map(self, name: str) -> np.ndarray:
        if name not in self._maps:
            if self._make_map is None:
                raise ValueError(f"{name}: this volume was not made from a sweep here, it has no such map")
            self._maps[name] = self._make_map(name)
        return self._maps[name]

    def in_space(self, space: str) -> Volume:
        """The same volume with the world's axes in `space`, "LPS" or "RAS". Both volumes share the
        arrays.

        Voxels keep their order, only `world_from_voxel` changes. Raises ValueError for another
        space.
        """
        place = VolumeData(self.values, self.world_from_voxel, self.space)
        matrix = in_space(place, space).world_from_voxel
        if space == self.space:
            return self
        return Volume(self.values, matrix, self.radius, space, self.info, self._map)

    def save(
        self, path: str | os.PathLike[str], maps: bool = False, progress: Callable[[int, int], None] | None = None
    ) -> None:
        """Write the volume in the format of the path's extension, whole or not at all.

        .npz, .sparse.npz and .vti also hold the origin of the values (`radius`), and with `maps`
        count, variance and source. For other formats, `maps` writes each map to a file of its own:
        NAME.count.nrrd; DICOM (.dcm) has no maps. `save` calls `progress(done, total)` with bytes
        for .mha and .nrrd, and with 1, 1 at the end for other formats.
        """
        formats.check_name(path, maps)  # before maps are made
        data = VolumeData(self.values, self.world_from_voxel, self.space)
        known = self._known_maps() if maps else None
        formats.write(path, data, self.radius, known, progress)

    def _known_maps(self) -> dict[str, np.ndarray]:
        found = {}
        for name in MAPS:
            try:
                found[name] = self._map(name)
            except (KeyError, ValueError):  # a volume of another method, file or program has none
                continue
        return found

    def __repr__(self) -> str:
        z, y, x = self.shape
        spacing = " x ".join(f"{s:.4g}" for s in self.spacing)
        extrapolated = f"{self.n_extrapolated} extrapolated, " if self.n_extrapolated else ""
        origins = f"{self.n_measured} measured, {self.n_filled} filled, {extrapolated}"
        return f"Volume({x} x {y} x {z} {self.values.dtype}, {spacing} mm, {self.space}, {origins}{self.n_empty} empty)"


def origin_of(radius: np.ndarray) -> np.ndarray:
    """EMPTY, MEASURED, FILLED or EXTRAPOLATED of radii as `Volume.radius` has them, uint8."""
    out = np.where(radius < BEYOND, np.uint8(FILLED), np.uint8(EXTRAPOLATED))
    out[radius == 0] = MEASURED
    out[radius == FAR] = EMPTY
    return out
