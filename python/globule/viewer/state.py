"""All settings of the viewer, in groups of plain values; one TOML file holds them."""

from __future__ import annotations

import copy
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import tomli_w

from .._base.checks import shown
from .._base.colormaps import NAMES as COLORMAPS
from .._base.files import atomic_write
from .._base.settings import (
    SHARE,
    Choice,
    Number,
    Setting,
    Switch,
    Text,
    Vector,
    Whole,
    same,
    schema_of,
    setting,
    settings_of,
)
from .._base.structured import parse_toml, read_text
from ..data.particles import FARTHEST
from ..render.annotate import Annotation
from ..render.camera import Camera
from ..render.legend import POSITIONS
from ..render.materials import Material
from ..render.presets import GROUNDS, PRESETS
from ..render.settings import RenderSettings
from ..scene.scene import KERNELS
from ..scene.thesis import ROOTS
from .history import History

FAR = float(FARTHEST)  # the largest coordinate of a scene
MOST_BOOKMARKS = 64
CORNERS = POSITIONS[:4]  # on the page, a legend outside would change the image's size
MOST_BYTES = 256 * 1024  # of a state file


PLACE = Vector(3, -FAR, FAR)
ORIGIN = (0.0, 0.0, 0.0)
TEXT = Text(empty=True, longest=200)
OWN = ("preset", "own")
# Settings that need no new trace
OVER = ("measure.", "notes.", "time.", "quality.rate", "quality.sharpness", "color.legend")


class Group:
    """A group of settings. Assigning to one of a `State` is what `State.set` does."""

    __slots__ = ("_owner",)  # the state and the group's name in it; a copy belongs to no state

    def __setattr__(self, name: str, value: Any) -> None:
        known = settings_of(type(self))
        if name not in known:
            raise AttributeError(f"{name[:60]}: expected one of {', '.join(known)}")
        owner = getattr(self, "_owner", None)
        if owner is None:
            object.__setattr__(self, name, value)
        else:
            owner[0].set(**{f"{owner[1]}__{name}": value})

    def __copy__(self) -> Any:
        return type(self)(**vars(self))


@dataclass
class Surface(Group):
    """The implicit surface of the particles."""

    kernel: str = setting(Choice(*KERNELS), "murakami", "kernel of the particles")
    threshold: float | None = setting(
        Number(1e-6, 1e6),
        None,
        "iso-value of the particles' summed field; a higher value makes a thinner surface",
        "no unit",
        usual="by kernel",
    )
    support: float | None = setting(
        Number(1e-18, FAR),
        None,
        "support radius of every particle's kernel",
        "world units",
        usual="the file's, else two spacings",
    )
    root: str = setting(
        Choice("exact", *ROOTS),
        "exact",
        "search for the surface along a ray: "
        "exact, or as in the source thesis on the dense octree, march (points with thresholds) or "
        "bezier (clipping)",
        label="Root method",
    )
    shape: str = setting(
        Choice("auto", "smooth", "balls"),
        "auto",
        "smooth: one surface around a fluid; auto: smooth where the particles are those of a fluid",
        label="Kind of surface",
    )


@dataclass
class Look(Group):
    """Material, lights and surroundings."""

    preset: str = setting(Choice("plain", *PRESETS), "plain", "material, lights and surroundings")
    matter: str = setting(Choice(*OWN), "preset", "own: use the values below", label="Material")
    reflection: float = same(Material, "reflection", default=0.0)
    transmission: float = same(Material, "transmission", default=0.0)
    index: float = same(Material, "index", default=1.33)
    roughness: float = same(Material, "roughness")
    lights: str = setting(Choice(*OWN), "preset", "own: use the sun and headlight below")
    azimuth: float = setting(
        Number(-180.0, 180.0), -34.0, "angle from the front, positive to the right", "degrees", label="Sun azimuth"
    )
    elevation: float = setting(Number(-90.0, 90.0), 54.0, "angle above the horizon", "degrees", label="Sun elevation")
    angle: float = setting(
        Number(0.0, 60.0), 0.5, "angular diameter; a larger sun makes softer shadows", "degrees", label="Sun size"
    )
    headlight: bool = setting(Switch(), True, "a light at the camera")
    exposure: float = same(RenderSettings, "exposure")
    sky: str = setting(Choice("preset", "none", "gradient"), "preset", "background, and light from all around")
    ground: str = setting(Choice("preset", "none", *GROUNDS), "preset", "a plane under the scene")
    background: tuple = same(RenderSettings, "background")
    shadows: bool = same(RenderSettings, "shadows")
    ambient_rays: int = same(RenderSettings, "ambient_rays")
    bounces: int = same(RenderSettings, "bounces")


@dataclass
class Coloring(Group):
    """Colors by the values of a field or attribute."""

    by: str = setting(TEXT, "", "field or attribute of the particles that gives the color", label="Color by")
    colormap: str = setting(
        Choice("auto", *COLORMAPS), "auto", "colors from the lowest to the highest value", label="Color map"
    )
    automatic: bool = setting(Switch(), True, "from the lowest to the highest value", label="Automatic range")
    low: float = setting(
        Number(-1e30, 1e30), 0.0, "value of the first color", "in the unit of the values", label="From"
    )
    high: float = setting(Number(-1e30, 1e30), 1.0, "value of the last color", "in the unit of the values", label="To")
    legend: bool = setting(Switch(), True, "draw the color map into the image")
    legend_at: str = setting(Choice(*CORNERS), "lower-right", "corner of the legend", label="Place")
    legend_title: str = same(Annotation, "legend_title")
    legend_unit: str = same(Annotation, "legend_unit")


@dataclass
class Notes(Group):
    """Annotations of the image."""

    title: str = same(Annotation, "title")
    scale_bar: bool = same(Annotation, "scale_bar")
    axes: bool = same(Annotation, "axes")
    box: bool = same(Annotation, "box", kind=Switch())
    unit: str = same(Annotation, "unit")


@dataclass
class Cuts(Group):
    """Clips: a plane, a box and a sphere. Coordinates are in world units."""

    plane: bool = setting(Switch(), False, "remove one side of a plane")
    normal: tuple = setting(Vector(3, -1.0, 1.0), (1.0, 0.0, 0.0), "direction to the side that is removed", "no unit")
    point: tuple = setting(PLACE, ORIGIN, "a point on the plane", "world units")
    box: bool = setting(Switch(), False, "remove the inside of a box")
    lo: tuple = setting(PLACE, (-1.0,) * 3, "low corner of the box", "world units")
    hi: tuple = setting(PLACE, (1.0,) * 3, "high corner of the box", "world units")
    keep_box: bool = setting(Switch(), False, "remove the outside of the box", label="Keep the box")
    sphere: bool = setting(Switch(), False, "remove the inside of a sphere")
    center: tuple = setting(PLACE, ORIGIN, "center of the sphere", "world units")
    radius: float = setting(Number(1e-30, FAR), 1.0, "radius of the sphere", "world units")
    keep_sphere: bool = setting(Switch(), False, "remove the outside of the sphere", label="Keep the sphere")


@dataclass
class Quality(Group):
    """Samples, size and JPEG quality of the images on the page."""

    samples: int = same(RenderSettings, "samples", default=16)
    rate: float = setting(
        Number(1.0, 120.0),
        20.0,
        "images per second while something moves",
        label="Target frame rate",
        slider=(1.0, 60.0),
        step=1.0,
    )
    sharpness: int = setting(
        Whole(30, 100), 92, "JPEG quality of images while nothing moves", label="JPEG quality when still", step=1
    )
    width: int = setting(Whole(160, 7680), 3840, "largest width of an image", "pixels", label="Largest width")


@dataclass
class Slices(Group):
    """The visible parts of a volume: slices, the iso-surface, images of its sweep."""

    shown: bool = setting(Switch(), True, "three orthogonal planes through the volume", label="Show slices")
    x: float = setting(SHARE, 0.5, "position along the volume's first axis", label="x slice")
    y: float = setting(SHARE, 0.5, "position along the volume's second axis", label="y slice")
    z: float = setting(SHARE, 0.5, "position along the volume's third axis", label="z slice")
    flat: bool = setting(Switch(), False, "the three slices seen from straight above, too", label="Flat slices")
    overlay: bool = setting(
        Switch(), False, "tint filled voxels orange and empty voxels blue", label="Measured / filled"
    )
    surface: bool = setting(Switch(), True, "the iso-surface of the volume", label="Show surface")
    open: bool = setting(Switch(), True, "remove the corner of the surface in front of the slices", label="Cut open")
    level: float | None = setting(
        Number(1e-6, 1e9), None, "of the surface", "in the units of the volume", label="Iso-value"
    )
    window: float | None = setting(
        Number(above=0, most=1e9),
        None,
        "values from black to white",
        "in the units of the volume",
        usual="nearly all values",
    )
    center: float | None = setting(
        Number(-1e9, 1e9),
        None,
        "the value in the middle of the window",
        "in the units of the volume",
        usual="of nearly all values",
        label="Level",
    )
    frame: bool = setting(Switch(), False, "one image of the sweep at its place", label="Show sweep image")
    number: int = setting(Whole(0, 1_000_000), 0, "index in the sweep", label="Sweep image")


@dataclass
class Layers(Group):
    """The layers of the image."""

    hidden: str = setting(TEXT, "", "numbers of layers, from 1, such as 2 3", label="Hidden layers")


@dataclass
class Compare(Group):
    """Two data sets in one image."""

    at: float = setting(SHARE, 0.5, "share of the image, from the left, of the first", label="Divider")


@dataclass
class Measure(Group):
    """A measured distance."""

    shown: bool = setting(Switch(), False, "a line with its length", label="Measurement")
    start: tuple = setting(PLACE, ORIGIN, "first end", "world units", label="From")
    end: tuple = setting(PLACE, ORIGIN, "second end", "world units", label="To")


@dataclass
class Time(Group):
    """Playback of a sequence."""

    frame: int = setting(Whole(0, 10_000_000), 0, "index in the sequence")
    playing: bool = setting(Switch(), False, "key: space bar", label="Play")
    loop: bool = setting(Switch(), True, "start again after the last frame")
    rate: float = setting(
        Number(0.1, 1000.0),
        24.0,
        "frame rate of the playback",
        "frames per second",
        label="Frames per second",
        slider=(1.0, 60.0),
        step=1.0,
    )


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

    Assign to one, or change several with `set`; pages and images follow. Any thread may do so.

    Attributes:
        surface, look, color, notes, cuts, quality, slices, layers, compare, measure, time: the
            groups.
        bookmarks: cameras by the name that a person gave them.
        version: counts the changes.
        traced: counts those that need a new trace; all others are drawn over the last one.
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
            object.__setattr__(getattr(self, name), "_owner", (self, name))
        self.bookmarks: dict[str, Camera] = {}
        self.version = self.traced = 0
        self._lock = threading.RLock()
        self._listeners: list[Callable[[Names], None]] = []
        self.history = History(self.get, self.set, self._lock)

    def listen(self, called: Callable[[Names], None]) -> None:
        """Call a function after each change with the names of the settings ("surface.kernel")."""
        self._listeners.append(called)

    def get(self, key: str) -> Any:
        """The value of a setting by its name in `set`, GROUP__NAME."""
        group, _, name = key.partition("__")
        return getattr(getattr(self, group), name)

    def set(self, **changes: Any) -> None:
        """Change settings: `state.set(surface__threshold=0.5, cuts__plane=True)`; all or none.

        Raises:
            ValueError: no such setting, or a value that it cannot have; nothing is changed.
        """
        with self._lock:
            good = {}
            for key, value in changes.items():
                group, _, name = key.partition("__")
                good[key] = field_of(group, name).check(value)
            before = {}
            for key, value in good.items():
                group, _, name = key.partition("__")
                old = getattr(getattr(self, group), name)
                if old != value:
                    object.__setattr__(getattr(self, group), name, value)
                    before[key] = old
            if not before:
                return
            self.version += 1
            changed = {key.replace("__", ".", 1) for key in before}
            self.traced += not all(key.startswith(OVER) for key in changed)
            self.history.note(before)
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
            other.version, other.traced = self.version, self.traced
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

    def load_toml(self, text: str, taken: Callable[[str, Any], Any] = lambda key, value: value) -> Camera | None:
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
                    new[full] = taken(full, field_of(name, key).check(value))
                except ValueError as error:
                    raise ValueError(f"{name}.{error}") from None
            for key, one in settings_of(make).items():
                new.setdefault(f"{name}__{key}", one.default)
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


def field_of(group: str, name: str) -> Setting:
    """A setting. Raises ValueError for an unknown group or name."""
    if group not in GROUPS:
        raise ValueError(f"{group}: expected one of {', '.join(GROUPS)}")
    known = settings_of(GROUPS[group])
    if name not in known:
        raise ValueError(f"{name[:60]}: expected one of {', '.join(known)}")
    return known[name]


def state_schema() -> dict[str, Any]:
    """The JSON Schema of a state file."""
    three, number = PLACE.schema(), {"type": "number"}
    parts = {"eye": three, "look_at": three, "up": three, "fov": number, "height": number}
    camera = {"type": "object", "properties": parts, "required": ["eye", "look_at"]}
    views = {"camera": camera, "bookmarks": {"type": "object", "additionalProperties": camera}}
    groups = {name: schema_of(make) for name, make in GROUPS.items()}
    return {"type": "object", "properties": groups | views, "additionalProperties": False}


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
