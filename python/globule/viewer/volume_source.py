"""A volume: its iso-surface, three slices, and images of its sweep at their place."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .._base.arrays import box_corners
from ..data.particles import Particles
from ..render.camera import Camera, view_axes
from ..render.clips import ClipBox
from ..render.layers import Layer
from ..ultrasound.sweep import Sweep
from ..volumes.iso_surface import default_level, extract_iso_surface
from ..volumes.slices import reslice, tinted
from ..volumes.volume import EMPTY, Volume
from .overlay import Flat, Plate
from .scenes import SceneMaker
from .source import Origin, Probed, Source
from .state import Slices, State

NOTHING = np.zeros((0, 3), np.float32)
MOST_PIXELS = 1024  # of a slice's side
MOST_LOOKED_AT = 1 << 20  # values for what is black


class VolumeSource(Source):
    """A volume, and the sweep that it was reconstructed from, if there is one.

    Args:
        name: for titles.
        volume: to show.
        sweep: whose images can be shown at their place.
        device, threads: as for `Scene`.

    Attributes:
        level: iso-value of the surface where the settings have none (Otsu).
        least_level, most_level: ends of its slider.
        gray: values that are black and white where the settings have no window and level.
    """

    kind = "volume"
    up = (0.0, 0.0, 1.0)
    unit = "mm"
    has_volume = True  # False: nothing has come yet

    def __init__(self, name: str, volume: Volume, sweep: Sweep | None = None, device: str = "auto", threads: int = 0):
        super().__init__(name)
        self.sweep = sweep
        self.n_sweep_frames = 0 if sweep is None else len(sweep)
        self.maker = SceneMaker(device, threads)
        self.maker.fluids = False
        self._made: tuple | None = None
        self._plates: tuple | None = None
        self._slices: dict[int, tuple] = {}
        self._window = 0.0, 1.0  # black and white now
        self._take(volume)

    def _take(self, volume: Volume) -> None:
        """Show another volume from now on. The caller holds `lock`."""
        self.volume = volume
        known = volume.values[~volume.empty & (volume.values > 0)]
        self.level = default_level(volume) if known.size else 1.0
        highest = 255 if volume.values.dtype == np.uint8 else volume.values.max(initial=0)
        self.most_level = float(max(highest, 1))
        self.least_level = self.most_level / 100
        few = volume.values.ravel()[:: 1 + volume.values.size // MOST_LOOKED_AT]
        black = float(np.percentile(few, 0.1)) if few.min(initial=0) < 0 else 0.0
        white = float(np.percentile(known, 99.9)) if known.size else 1.0
        self.gray = black, white if white > black else black + 1.0
        self._made, self._slices = None, {}
        self.version += 1

    def origin(self, state: State) -> Origin:
        """The file of the volume, with the iso-value."""
        file = self.files[0] if self.files else "volume.npz"
        return self.surface_of(file, [], [f"volume = gb.volumes.read_volume({file!r})"], state)

    def surface_of(self, file: str, before: list[str], code: list[str], state: State) -> Origin:
        """The origin of an iso-surface.

        Args:
            file: of the volume, for the command.
            before: a command that makes the file.
            code: Python lines that make `volume`.
            state: settings.
        """
        shown = state.slices
        level = float(shown.level or self.level)
        code = [
            *code,
            f"surface = gb.volumes.extract_iso_surface(volume, {level!r}, {state.surface.kernel!r})",
            "particles = surface.particles",
        ]
        left = ["slices"] * shown.shown + ["the sweep's image"] * shown.frame
        left += ["the hidden surface"] * (not shown.surface)
        return Origin([file, "--level", f"{level:.9g}"], code, before, left, unsaid=("threshold", "support"))

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of the volume's voxel centers, mm."""
        return self.volume.bounds()

    def outline(self) -> np.ndarray:
        """The corners (8, 3) of the volume, mm."""
        return box_corners(*self.bounds())

    def particles(self) -> Particles:
        """The particles of the iso-surface."""
        if self._made is None:
            return self._surface(self.level, "murakami")[0]
        return self._made[1]

    def color_names(self) -> list[str]:
        """Coordinates and voxel value."""
        return ["x", "y", "z", "value"]

    def _surface(self, level: float, kernel: str) -> tuple[Particles, float | None]:
        """Particles and threshold of the iso-surface at a level."""
        asked = level, kernel
        if self._made is None or self._made[0] != asked:
            try:
                surface = extract_iso_surface(self.volume, level, kernel)
                self._made = asked, surface.particles, surface.threshold
            except ValueError:  # no voxel reaches the level
                nothing = Particles(NOTHING, support=1.0, attributes={"value": NOTHING[:, 0]})
                self._made = asked, nothing, None
        return self._made[1:]

    def layers(self, state: State) -> list[Layer]:
        """The iso-surface, if shown. The caller holds `lock`."""
        shown = state.slices
        if not shown.surface:
            nothing = Particles(NOTHING, support=1.0, attributes={"value": NOTHING[:, 0]})
            if self._made is None or self._made[0] != "none":
                self._made = "none", nothing, None
            return [Layer(self.maker.scene(self._made[1], state))]
        particles, threshold = self._surface(shown.level or self.level, state.surface.kernel)
        corner = self._corner(shown) if shown.shown and shown.open and self.has_volume else []
        return [Layer(self.maker.scene(particles, state, threshold), None, corner)]

    def window(self, shown: Slices) -> tuple[float, float]:
        """The values that are black and white."""
        low, high = self.gray
        width = shown.window or high - low
        middle = (low + high) / 2 if shown.center is None else shown.center
        return middle - width / 2, middle + width / 2

    def lengths(self) -> np.ndarray:
        """From the first to the last voxel along each axis (3,), mm."""
        edges = np.linalg.norm(self.volume.world_from_voxel[:3, :3], axis=0)
        return (np.array(self.volume.values.shape[::-1]) - 1) * edges

    def _at(self, shown: Slices) -> np.ndarray:
        """The voxel (3,) in which the slices cross."""
        sizes = np.array(self.volume.values.shape[::-1])
        return np.round(np.array([shown.x, shown.y, shown.z]) * (sizes - 1))

    def places(self, state: State) -> str:
        """The positions of the slices, for the panel."""
        edges = np.linalg.norm(self.volume.world_from_voxel[:3, :3], axis=0)
        at = self._at(state.slices) * edges
        most = (np.array(self.volume.values.shape[::-1]) - 1) * edges
        return "  \n".join(
            f"{axis} slice at **{here:.1f}** of {whole:.1f} mm"
            for axis, here, whole in zip("xyz", at, most, strict=True)
        )

    def _corner(self, shown: Slices) -> list[ClipBox]:
        """The box in front of all three slices, as the first camera sees them.

        Empty for volumes that are not parallel to the world's axes, since a box is.
        """
        axes = np.abs(self.volume.world_from_voxel[:3, :3])
        if (np.sort(axes, axis=0)[1] > 1e-3 * axes.max(axis=0)).any():
            return []
        at = (self.volume.world_from_voxel @ [*self._at(shown), 1.0])[:3]
        right, above, front = view_axes(self.up)
        seen = right + above + front > 0
        # Half a voxel behind the slices, so that they cover the cut through the surface.
        behind = 0.5 * axes.max(axis=1)
        lo, hi = self.bounds()
        room = hi - lo + 1
        lo = np.where(seen, at - behind, lo - room)
        hi = np.where(seen, hi + room, at + behind)
        return [ClipBox(tuple(lo.tolist()), tuple(hi.tolist()))]

    def probe(self, state: State, camera: Camera, size: tuple[int, int], screen: Any, nearest: float) -> Probed | None:
        """The voxel of a slice at a place of the image. The caller holds `lock`."""
        eye, direction = camera.ray(size, screen)
        found = None
        for plate in self.plates(state):
            plate_from_world = np.linalg.inv(plate.world_from_plate)
            start = plate_from_world[:3, :3] @ eye + plate_from_world[:3, 3]
            way = plate_from_world[:3, :3] @ direction
            t = -start[2] / way[2] if way[2] else -1.0
            column, row = (int(v) for v in np.floor((start + t * way)[:2] + 0.5))
            rows, columns = plate.texture.shape[:2]
            if not (0 < t < nearest and 0 <= column < columns and 0 <= row < rows):
                continue
            if plate.mask is None or plate.mask[row, column]:
                nearest, found = t, eye + t * direction
        if found is None:
            return None
        voxel = np.round((np.linalg.inv(self.volume.world_from_voxel) @ [*found, 1.0])[:3])
        words = {"position": ", ".join(f"{v:.5g}" for v in found) + " mm"}
        if ((voxel >= 0) & (voxel < self.volume.values.shape[::-1])).all():
            x, y, z = (int(v) for v in voxel)
            words |= {"value": f"{self.volume.values[z, y, x]:.5g}", "voxel": f"{x}, {y}, {z}"}
        return Probed(tuple(found.tolist()), words)

    def plates(self, state: State) -> list[Plate]:
        """The slices and the sweep image that are shown. The caller holds `lock`."""
        shown = state.slices
        key = self.version, dataclasses.replace(shown)
        if self._plates is None or self._plates[0] != key:
            self._window = self.window(shown)
            places = (shown.x, shown.y, shown.z) if shown.shown and self.has_volume else ()
            plates = [self.slice(i, at, shown.overlay) for i, at in enumerate(places)]
            if shown.frame and self.sweep is not None:
                plates += self._frame(self.sweep, min(shown.number, len(self.sweep) - 1))
            self._plates = key, plates
        return self._plates[1]

    def flats(self, state: State) -> list[Flat]:
        """The three slices from straight above, with lines where the other two are. The caller holds
        `lock`."""
        shown = state.slices
        if not (shown.flat and self.has_volume):
            return []
        places, lengths = (shown.x, shown.y, shown.z), self.lengths()
        found = []
        self._window = self.window(shown)
        for axis, place in enumerate(places):
            across, down = (a for a in (0, 1, 2) if a != axis)
            texture = self.slice(axis, place, shown.overlay).texture
            title = f"{'xyz'[axis]} {place * lengths[axis]:.1f} mm"
            ratio = float(lengths[across] / lengths[down]) if lengths[down] else 1.0
            found.append(Flat(texture, ratio, (places[across], places[down]), title))
        return found

    def slice(self, axis: int, share: float, overlay: bool) -> Plate:
        """A slice across a voxel axis.

        Args:
            axis: 0 (x), 1 (y) or 2 (z).
            share: position along the axis, 0 to 1.
            overlay: tint filled and empty voxels.
        """
        asked = (share, overlay, self._window)
        if axis in self._slices and self._slices[axis][0] == asked:
            return self._slices[axis][1]
        sizes = np.array(self.volume.values.shape[::-1])
        across, down = [a for a in (0, 1, 2) if a != axis]
        step = max(1.0, max(sizes[across], sizes[down]) / MOST_PIXELS)
        voxel_from_plate = np.zeros((4, 4))
        voxel_from_plate[across, 0] = voxel_from_plate[down, 1] = step
        voxel_from_plate[axis, 2] = 1.0
        voxel_from_plate[axis, 3] = round(share * (sizes[axis] - 1))
        voxel_from_plate[3, 3] = 1.0
        world_from_plate = self.volume.world_from_voxel @ voxel_from_plate
        size = (int(np.ceil(sizes[across] / step)), int(np.ceil(sizes[down] / step)))
        cut = reslice(self.volume, world_from_plate, size, linear=False)
        known = None if overlay else cut.origin != EMPTY
        texture = self._gray(cut.values, cut.origin if overlay else None)
        plate = Plate(texture, world_from_plate, known)
        self._slices[axis] = asked, plate
        return plate

    def _gray(self, values: np.ndarray, origin: np.ndarray | None = None) -> np.ndarray:
        """`tinted` image of values (H, W) of the volume or the sweep."""
        low, high = self._window
        return tinted(np.clip(255.0 * (values - low) / (high - low), 0, 255), origin)

    def _frame(self, sweep: Sweep, i: int) -> list[Plate]:
        if not sweep.valid[i]:
            return []
        return [Plate(self._gray(sweep.frames[i]), sweep.world_from_image[i])]

    def facts(self) -> dict[str, Any]:
        """Numbers of voxels."""
        volume = self.volume
        return {
            "voxels": " x ".join(str(n) for n in volume.values.shape[::-1]),
            "measured": f"{volume.n_measured:,}",
            "filled": f"{volume.n_filled:,}",
        }
