"""All settings of the viewer, in groups of plain values; one TOML file holds them."""

from __future__ import annotations

import copy
import dataclasses
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import tomli_w

from .._base.checks import shown
from .._base.colormaps import NAMES as COLORMAPS
from .._base.files import atomic_write
from .._base.structured import parse_toml, read_text
from ..render.camera import Camera
from ..render.legend import POSITIONS
from ..render.presets import PRESETS
from ..scene.particles import FARTHEST
from ..scene.scene import KERNELS
from .fields import checked, choice, real, switch, triple, whole
from .history import History

FAR = float(FARTHEST)  # the largest coordinate of a scene
MOST_BOOKMARKS = 64
CORNERS = POSITIONS[:4]  # on the page, a legend outside would change the image's size
MOST_BYTES = 256 * 1024  # of a state file


@dataclass
class Surface:
    """The implicit surface of the particles."""

    kernel: str = choice("murakami", KERNELS, "Kernel", "Basis function of the particles")
    threshold: float | None = real(
        None,
        1e-3,
        1e3,
        "Threshold",
        "Iso-value of the field; a higher value makes a thinner surface",
    )
    support: float | None = real(
        None, 0.0, FAR, "Support", "Radius of a particle's influence, world units"
    )
    root: str = choice(
        "exact",
        ("exact", "march", "bezier"),
        "Root method",
        "How a ray finds the surface; march and bezier as in the thesis",
    )
    shape: str = choice(
        "auto",
        ("auto", "smooth", "balls"),
        "Kind of surface",
        "smooth: one surface around a fluid; auto: smooth where the particles are those of a fluid",
    )


@dataclass
class Look:
    """Material, lights and surroundings."""

    preset: str = choice(
        "plain", ("plain", *PRESETS), "Preset", "Material, lights and surroundings"
    )
    matter: str = choice("preset", ("preset", "own"), "Material", "own: use the four values below")
    reflection: float = real(
        0.0, 0.0, 1.0, "Reflection", "Specular reflectance at normal incidence, 0 to 1"
    )
    transmission: float = real(
        0.0, 0.0, 1.0, "Transmission", "Share of the unreflected light that is transmitted, 0 to 1"
    )
    index: float = real(1.33, 1.0, 4.0, "Refractive index", "No unit; water 1.33, glass 1.5")
    roughness: float = real(
        0.0, 0.0, 1.0, "Roughness", "Of reflected and transmitted light, 0 to 1"
    )
    lights: str = choice(
        "preset", ("preset", "own"), "Lights", "own: use the sun and headlight below"
    )
    azimuth: float = real(
        -34.0, -180.0, 180.0, "Sun azimuth", "Degrees from the front, positive to the right"
    )
    elevation: float = real(54.0, -90.0, 90.0, "Sun elevation", "Degrees above the horizon")
    angle: float = real(0.5, 0.0, 60.0, "Sun size", "Degrees; a larger sun makes softer shadows")
    headlight: bool = switch(True, "Headlight", "A light at the camera")
    exposure: float = real(
        1.0, 0.05, 20.0, "Exposure", "Factor on the brightness of the image, no unit"
    )
    sky: str = choice(
        "preset", ("preset", "none", "gradient"), "Sky", "Background, and light from all around"
    )
    ground: str = choice(
        "preset", ("preset", "none", "plain", "checker"), "Ground", "A plane under the scene"
    )
    background: tuple = triple(
        (0.93, 0.94, 0.96),
        0.0,
        1e3,
        "Background",
        "Where there is no sky: linear red, green and blue, 0 to 1",
    )
    shadows: bool = switch(False, "Shadows", "Lights cast shadows")
    ambient_rays: int = whole(
        0, 0, 64, "Ambient occlusion", "Rays per sample that look for occluders; 0: off"
    )
    bounces: int = whole(4, 0, 16, "Bounces", "Most reflections and refractions along a ray")


@dataclass
class Coloring:
    """Colors by the values of a field or attribute."""

    by: str = choice("", (), "Color by", "A field or attribute of the particles")
    colormap: str = choice(
        "viridis", COLORMAPS, "Color map", "Colors from the lowest to the highest value"
    )
    automatic: bool = switch(True, "Automatic range", "From the lowest to the highest value")
    low: float = real(
        0.0, -1e30, 1e30, "From", "Value of the first color, in the unit of the values"
    )
    high: float = real(1.0, -1e30, 1e30, "To", "Value of the last color, in the unit of the values")
    legend: bool = switch(True, "Legend", "Draw the color map into the image")
    legend_at: str = choice("lower-right", CORNERS, "Place", "Corner of the legend")
    legend_title: str = choice("", (), "Legend title", "Empty: the name of the values")
    legend_unit: str = choice("", (), "Legend unit", "Of the values")


@dataclass
class Notes:
    """Annotations of the image."""

    title: str = choice("", (), "Title", "At the top of the image")
    scale_bar: bool = switch(
        False, "Scale bar", "A bar of a round length, true at the center of rotation"
    )
    axes: bool = switch(False, "Axes", "The directions of x, y and z")
    box: bool = switch(False, "Box", "Bounding box of the particles, with coordinates")
    unit: str = choice("", (), "Unit of lengths", "For scale bar and box")


@dataclass
class Cuts:
    """Clips: a plane, a box and a sphere. Coordinates are in world units."""

    plane: bool = switch(False, "Plane", "Remove one side of a plane")
    normal: tuple = triple(
        (1.0, 0.0, 0.0), -1.0, 1.0, "Normal", "Direction to the side that is removed, no unit"
    )
    point: tuple = triple((0.0, 0.0, 0.0), -FAR, FAR, "Point", "A point on the plane, world units")
    box: bool = switch(False, "Box", "Remove the inside of a box")
    lo: tuple = triple((-1.0, -1.0, -1.0), -FAR, FAR, "Low corner", "Of the box, world units")
    hi: tuple = triple((1.0, 1.0, 1.0), -FAR, FAR, "High corner", "Of the box, world units")
    keep_box: bool = switch(False, "Keep the inside", "Remove the outside of the box instead")
    sphere: bool = switch(False, "Sphere", "Remove the inside of a sphere")
    center: tuple = triple((0.0, 0.0, 0.0), -FAR, FAR, "Center", "Of the sphere, world units")
    radius: float = real(1.0, 1e-30, FAR, "Radius", "Of the sphere, world units")
    keep_sphere: bool = switch(False, "Keep the inside", "Remove the outside of the sphere instead")


@dataclass
class Quality:
    """Samples, size and JPEG quality of the images on the page."""

    samples: int = whole(16, 1, 256, "Samples when still", "Rays per pixel while nothing moves")
    rate: float = real(
        20.0, 1.0, 120.0, "Target frame rate", "Images per second while something moves"
    )
    sharpness: int = whole(
        92, 30, 100, "JPEG quality when still", "Of images while nothing moves, 30 to 100"
    )
    width: int = whole(1920, 160, 7680, "Largest width", "Of an image, in pixels")


@dataclass
class Slices:
    """The visible parts of a volume: slices, the iso-surface, images of its sweep."""

    shown: bool = switch(True, "Show slices", "Three orthogonal planes through the volume")
    x: float = real(0.5, 0.0, 1.0, "x slice", "Position along the volume's first axis, 0 to 1")
    y: float = real(0.5, 0.0, 1.0, "y slice", "Position along the volume's second axis, 0 to 1")
    z: float = real(0.5, 0.0, 1.0, "z slice", "Position along the volume's third axis, 0 to 1")
    overlay: bool = switch(
        False, "Measured / filled", "Tint filled voxels orange and empty voxels blue"
    )
    surface: bool = switch(True, "Show surface", "The iso-surface of the volume")
    open: bool = switch(True, "Cut open", "Remove the corner of the surface in front of the slices")
    level: float | None = real(
        None, 1e-6, 1e9, "Iso-value", "Of the surface, in the units of the volume"
    )
    frame: bool = switch(False, "Show sweep image", "One image of the sweep at its place")
    number: int = whole(0, 0, 1_000_000, "Sweep image", "Index in the sweep, from 0")


@dataclass
class Layers:
    """The layers of the image."""

    hidden: str = choice("", (), "Hidden layers", "Numbers of layers, from 1, such as 2 3")


@dataclass
class Compare:
    """Two data sets in one image."""

    at: float = real(0.5, 0.0, 1.0, "Divider", "Share of the image, from the left, of the first")


@dataclass
class Measure:
    """A measured distance."""

    shown: bool = switch(False, "Measurement", "A line with its length")
    start: tuple = triple((0.0, 0.0, 0.0), -FAR, FAR, "From", "First end, world units")
    end: tuple = triple((0.0, 0.0, 0.0), -FAR, FAR, "To", "Second end, world units")


@dataclass
class Time:
    """Playback of a sequence."""

    frame: int = whole(0, 0, 10_000_000, "Frame", "Index in the sequence, from 0")
    playing: bool = switch(False, "Play", "Key: space bar")
    loop: bool = switch(True, "Loop", "Start again after the last frame")
    rate: float = real(24.0, 0.1, 1000.0, "Frames per second", "Of the playback, frames per second")


Names = set[str]  # of settings, as "surface.kernel"; in class State, `set` is a method

GROUPS = {
    "surface": Surface,
    "look": Look,
    "color": Coloring,
    "notes": Notes,
    "cuts": Cuts,
    "quality": Quality,
    "slices": Slices,
    "layers": Layers,
    "compare": Compare,
    "measure": Measure,
    "time": Time,
}


class State:
    """The groups of settings as attributes: `state.surface.threshold`.

    Change settings with `set`, so that pages and images follow. Any thread may call `set`.

    Attributes:
        surface, look, color, notes, cuts, quality, slices, layers, compare, measure, time: the
            groups.
        bookmarks: cameras by the name that a person gave them.
        version: counts the changes.
        history: undoes and redoes changes.
    """

    surface: Surface
    look: Look
    color: Coloring
    notes: Notes
    cuts: Cuts
    quality: Quality
    slices: Slices
    layers: Layers
    compare: Compare
    measure: Measure
    time: Time

    def __init__(self) -> None:
        for name, make in GROUPS.items():
            setattr(self, name, make())
        self.bookmarks: dict[str, Camera] = {}
        self.version = 0
        self._lock = threading.RLock()
        self._listeners: list[Callable[[Names], None]] = []
        self.history = History(self)

    def listen(self, called: Callable[[Names], None]) -> None:
        """Call a function after each change with the names of the settings ("surface.kernel")."""
        self._listeners.append(called)

    def set(self, **changes: Any) -> None:
        """Change settings: `state.set(surface__threshold=0.5, cuts__plane=True)`; all or none.

        Raises:
            ValueError: no such setting, or a value that it cannot have; nothing is changed.
        """
        with self._lock:
            good = {}
            for key, value in changes.items():
                group, _, name = key.partition("__")
                good[key] = checked(field_of(group, name), value)
            before = {}
            for key, value in good.items():
                group, _, name = key.partition("__")
                old = getattr(getattr(self, group), name)
                if old != value:
                    setattr(getattr(self, group), name, value)
                    before[key] = old
            if not before:
                return
            self.version += 1
            self.history.note(before)
            changed = {key.replace("__", ".", 1) for key in before}
        self.tell(changed)

    def tell(self, changed: Names) -> None:
        """Call all listeners with the names of settings that changed."""
        for called in self._listeners:
            called(changed)

    def snapshot(self) -> State:
        """A copy that later changes do not reach."""
        with self._lock:
            other = State()
            for name in GROUPS:
                setattr(other, name, copy.copy(getattr(self, name)))
            other.bookmarks = dict(self.bookmarks)
            other.version = self.version
            return other

    # As a file

    def to_toml(self, camera: Camera | None = None) -> str:
        """The settings that differ from their defaults, a camera and the bookmarks, as TOML."""
        state, facts = self.snapshot(), {}
        for name, make in GROUPS.items():
            group, plain = vars(getattr(state, name)), vars(make())
            changed = {k: _plain(group[k]) for k in plain if group[k] != plain[k]}
            if changed:
                facts[name] = changed
        if camera is not None:
            facts["camera"] = _facts(camera)
        if state.bookmarks:
            facts["bookmarks"] = {name: _facts(view) for name, view in state.bookmarks.items()}
        return tomli_w.dumps(facts)

    def load_toml(
        self, text: str, taken: Callable[[str, Any], Any] = lambda key, value: value
    ) -> Camera | None:
        """Take the settings of a TOML text, and the defaults for all that it does not name.

        Args:
            text: as `to_toml` writes it.
            taken: maps a setting's name (as `set` has it) and value to the value to take.

        Returns:
            The camera of the text, or None.

        Raises:
            ValueError: the message names the line or key; nothing is changed.
        """
        if len(text.encode()) > MOST_BYTES:
            raise ValueError(f"state: expected at most {MOST_BYTES} bytes, got {len(text)}")
        return self._take(parse_toml(text), taken)

    def load(self, path: str | os.PathLike[str]) -> Camera | None:
        """`load_toml` of a file.

        Raises:
            ValueError: the message begins with the path; nothing is changed.
            OSError: a file that cannot be read.
        """
        try:
            return self.load_toml(read_text(path, MOST_BYTES))
        except ValueError as error:
            raise ValueError(f"{os.fspath(path)}: {error}") from None

    def _take(self, facts: dict[str, Any], taken: Callable[[str, Any], Any]) -> Camera | None:
        new: dict[str, Any] = {}
        for name, make in GROUPS.items():
            given = facts.pop(name, {})
            if not isinstance(given, dict):
                raise ValueError(f"{name}: expected a table, got {shown(given)}")
            for key, value in given.items():
                try:
                    full = f"{name}__{key}"
                    new[full] = taken(full, checked(field_of(name, key), value))
                except ValueError as error:
                    raise ValueError(f"{name}.{error}") from None
            for f in dataclasses.fields(make):
                new.setdefault(f"{name}__{f.name}", f.default)
        camera = _camera("camera", facts.pop("camera")) if "camera" in facts else None
        bookmarks = facts.pop("bookmarks", {})
        if not isinstance(bookmarks, dict) or len(bookmarks) > MOST_BOOKMARKS:
            raise ValueError(f"bookmarks: expected at most {MOST_BOOKMARKS} tables")
        views = {name: _camera(f"bookmarks.{name}", view) for name, view in bookmarks.items()}
        if facts:
            known = ", ".join([*GROUPS, "camera", "bookmarks"])
            raise ValueError(f"{next(iter(facts))[:60]}: expected one of {known}")
        self.bookmarks = views
        self.set(**new)
        self.tell({"bookmarks"})
        return camera

    def save(self, path: str | os.PathLike[str], camera: Camera | None = None) -> None:
        """Write the settings and a camera to a TOML file."""
        with atomic_write(path, "w") as file:
            file.write(self.to_toml(camera))


def field_of(group: str, name: str) -> dataclasses.Field:
    """The field of a setting. Raises ValueError for an unknown group or name."""
    if group not in GROUPS:
        raise ValueError(f"{group}: expected one of {', '.join(GROUPS)}")
    for field in dataclasses.fields(GROUPS[group]):
        if field.name == name:
            return field
    known = ", ".join(f.name for f in dataclasses.fields(GROUPS[group]))
    raise ValueError(f"{name[:60]}: expected one of {known}")


def _camera(name: str, facts: Any) -> Camera:
    known = {"eye", "look_at", "up", "fov", "height"}
    if not isinstance(facts, dict) or not {"eye", "look_at"} <= set(facts) <= known:
        raise ValueError(f"{name}: expected eye, look_at, up and fov or height, got {shown(facts)}")
    try:
        return Camera(**facts)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}.{error}") from None


def _plain(value: Any) -> Any:
    """A setting as TOML holds it."""
    return [float(v) for v in value] if isinstance(value, (tuple, list)) else value


def _facts(camera: Camera) -> dict[str, Any]:
    """A camera as TOML holds it; `_camera` reads it back."""
    angle = "fov" if camera.height is None else "height"
    return {name: _plain(getattr(camera, name)) for name in ("eye", "look_at", "up", angle)}
