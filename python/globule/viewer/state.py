"""Everything that a person sets in the viewer, in groups of plain values, as one TOML file."""

from __future__ import annotations

import copy
import dataclasses
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .._base.colormaps import NAMES as COLORMAPS
from .._base.files import atomic_write
from ..render.camera import Camera
from ..render.presets import PRESETS
from ..scene.scene import KERNELS
from .fields import checked, choice, real, switch, triple, whole

FAR = 1e18  # the largest coordinate of a scene
MOST_BOOKMARKS = 64
MOST_BYTES = 256 * 1024  # of a state file


@dataclass
class Surface:
    kernel: str = choice("murakami", KERNELS, "Kernel", "Shape of each particle's influence")
    threshold: float | None = real(
        None,
        1e-3,
        1e3,
        "Threshold",
        "The surface is where the field has this value: higher is thinner",
    )
    support: float | None = real(None, 0.0, FAR, "Support", "Radius of each particle's influence")
    root: str = choice(
        "exact",
        ("exact", "march", "bezier"),
        "Root method",
        "How the surface is found along a ray; march and bezier as in the thesis",
    )


@dataclass
class Look:
    preset: str = choice("plain", ("plain", *PRESETS), "Preset", "Matter, light and surroundings")
    matter: str = choice("preset", ("preset", "own"), "Matter", "own: the four values below")
    reflection: float = real(0.0, 0.0, 1.0, "Reflection", "Mirror's weight straight on")
    transmission: float = real(0.0, 0.0, 1.0, "Transmission", "Share of the rest that goes through")
    index: float = real(1.33, 1.0, 4.0, "Index", "Of refraction: water 1.33, glass 1.5")
    roughness: float = real(0.0, 0.0, 1.0, "Roughness", "Of mirrored and transmitted light")
    lights: str = choice("preset", ("preset", "own"), "Lights", "own: the sun and lamp below")
    azimuth: float = real(-34.0, -180.0, 180.0, "Sun azimuth", "Degrees, from the front")
    elevation: float = real(54.0, -90.0, 90.0, "Sun elevation", "Degrees above the horizon")
    angle: float = real(0.5, 0.0, 60.0, "Sun size", "Degrees; larger makes softer shadows")
    headlight: bool = switch(True, "Headlight", "A lamp at the eye")
    exposure: float = real(1.0, 0.05, 20.0, "Exposure", "Factor of the picture's light")
    sky: str = choice("preset", ("preset", "none", "gradient"), "Sky", "Seen behind and mirrored")
    ground: str = choice(
        "preset", ("preset", "none", "plain", "checker"), "Ground", "A plane under the scene"
    )
    background: tuple = triple((0.93, 0.94, 0.96), 0.0, 1e3, "Background", "Where there is no sky")
    shadows: bool = switch(False, "Shadows", "Lights throw shadows")
    ambient_rays: int = whole(0, 0, 64, "Ambient occlusion", "Rays that look how open a place is")
    depth: int = whole(4, 0, 16, "Reflection depth", "How often light is followed")


@dataclass
class Coloring:
    by: str = choice("", (), "Colour by", "A field or attribute; none: the particles' own colours")
    colormap: str = choice("viridis", COLORMAPS, "Colour map")
    automatic: bool = switch(True, "Automatic range", "Lowest and highest value")
    low: float = real(0.0, -1e30, 1e30, "From", "Value of the map's first colour")
    high: float = real(1.0, -1e30, 1e30, "To", "Value of the map's last colour")
    legend: bool = switch(True, "Legend", "Draw the colour map into the picture")


@dataclass
class Cuts:
    plane: bool = switch(False, "Plane", "Take away one side of a plane")
    normal: tuple = triple((1.0, 0.0, 0.0), -1.0, 1.0, "Normal", "Points at what is taken away")
    point: tuple = triple((0.0, 0.0, 0.0), -FAR, FAR, "Point", "On the plane")
    box: bool = switch(False, "Box", "Take away a box")
    lo: tuple = triple((-1.0, -1.0, -1.0), -FAR, FAR, "Low corner")
    hi: tuple = triple((1.0, 1.0, 1.0), -FAR, FAR, "High corner")
    keep_box: bool = switch(False, "Keep the inside", "Crop: take away what is outside instead")
    sphere: bool = switch(False, "Sphere", "Take away a ball")
    center: tuple = triple((0.0, 0.0, 0.0), -FAR, FAR, "Centre")
    radius: float = real(1.0, 1e-30, FAR, "Radius")
    keep_sphere: bool = switch(False, "Keep the inside", "Take away what is outside instead")


@dataclass
class Quality:
    samples: int = whole(16, 1, 256, "Samples when still", "Rays per pixel once nothing moves")
    rate: float = real(20.0, 1.0, 120.0, "Pictures per second", "Aimed at while something moves")
    sharpness: int = whole(92, 30, 100, "JPEG quality when still")
    width: int = whole(1920, 160, 7680, "Largest width", "Pixels")


@dataclass
class Slices:
    shown: bool = switch(True, "Show slices", "Three planes through the volume")
    x: float = real(0.5, 0.0, 1.0, "x slice", "Share of the way along the volume's first axis")
    y: float = real(0.5, 0.0, 1.0, "y slice")
    z: float = real(0.5, 0.0, 1.0, "z slice")
    overlay: bool = switch(False, "Measured / filled", "Tint what was filled orange, empty blue")
    surface: bool = switch(True, "Show surface", "The volume's iso-surface")
    open: bool = switch(True, "Cut open", "Take the corner before the slices out of the surface")
    level: float | None = real(None, 1e-6, 1e9, "Surface level", "Values of at least this")
    frame: bool = switch(False, "Show sweep frame", "A frame of the sweep where it was taken")
    number: int = whole(0, 0, 1_000_000, "Frame", "Which one")


@dataclass
class Time:
    frame: int = whole(0, 0, 10_000_000, "Frame")
    playing: bool = switch(False, "Play")
    loop: bool = switch(True, "Loop")
    rate: float = real(24.0, 0.1, 1000.0, "Frames per second")


GROUPS = {
    "surface": Surface,
    "look": Look,
    "color": Coloring,
    "cuts": Cuts,
    "quality": Quality,
    "slices": Slices,
    "time": Time,
}


class State:
    """The groups as attributes: `state.surface.threshold`. Change them with `set`, so that pages
    and pictures follow; any thread may."""

    surface: Surface
    look: Look
    color: Coloring
    cuts: Cuts
    quality: Quality
    slices: Slices
    time: Time

    def __init__(self) -> None:
        for name, make in GROUPS.items():
            setattr(self, name, make())
        self.bookmarks: dict[str, Camera] = {}
        self.version = 0
        self._lock = threading.RLock()
        self._listeners: list[Callable[[set[str]], None]] = []

    def listen(self, called: Callable[[set[str]], None]) -> None:
        """Have `called` with the names of what changed, as "surface.kernel"."""
        self._listeners.append(called)

    def set(self, **changes: Any) -> None:
        """Change settings: `state.set(surface__threshold=0.5, cuts__plane=True)`; all or none.

        Raises ValueError: name, expected and got.
        """
        with self._lock:
            good = {}
            for key, value in changes.items():
                group, _, name = key.partition("__")
                good[key] = checked(field_of(group, name), value)
            changed = set()
            for key, value in good.items():
                group, _, name = key.partition("__")
                if getattr(getattr(self, group), name) != value:
                    setattr(getattr(self, group), name, value)
                    changed.add(f"{group}.{name}")
            if not changed:
                return
            self.version += 1
        self.tell(changed)

    def tell(self, changed: set[str]) -> None:
        for called in self._listeners:
            called(changed)

    def snapshot(self) -> State:
        """A copy that stays as it is."""
        with self._lock:
            other = State()
            for name in GROUPS:
                setattr(other, name, copy.copy(getattr(self, name)))
            other.bookmarks = dict(self.bookmarks)
            other.version = self.version
            return other

    # As a file

    def to_toml(self, camera: Camera | None = None) -> str:
        """All that differs from the defaults, the camera and the bookmarks."""
        state = self.snapshot()
        parts = []
        for name, make in GROUPS.items():
            group, plain = getattr(state, name), make()
            lines = [
                f"{f.name} = {_toml(getattr(group, f.name))}"
                for f in dataclasses.fields(make)
                if getattr(group, f.name) != getattr(plain, f.name)
            ]
            if lines:
                parts.append("\n".join([f"[{name}]", *lines]))
        cameras = ([] if camera is None else [("[camera]", camera)]) + [
            (f"[bookmarks.{_toml(name)}]", view) for name, view in state.bookmarks.items()
        ]
        for title, view in cameras:
            angle = "fov" if view.height is None else "height"
            fields = ("eye", "look_at", "up", angle)
            lines = [f"{name} = {_toml(getattr(view, name))}" for name in fields]
            parts.append("\n".join([title, *lines]))
        return "\n\n".join(parts) + "\n"

    def load_toml(
        self, text: str, taken: Callable[[str, Any], Any] = lambda key, value: value
    ) -> Camera | None:
        """Become what the text says, and the defaults elsewhere; the camera that it names.

        taken: gives what is to become of a setting, of its name as `set` has it and its value.

        Raises ValueError: line or key, expected and got; then nothing is changed.
        """
        try:
            import tomllib
        except ImportError:  # Python 3.10
            import tomli as tomllib
        if len(text.encode()) > MOST_BYTES:
            raise ValueError(f"state: expected at most {MOST_BYTES} bytes, got {len(text)}")
        facts = tomllib.loads(text)
        new: dict[str, Any] = {}
        for name, make in GROUPS.items():
            given = facts.pop(name, {})
            if not isinstance(given, dict):
                raise ValueError(f"{name}: expected a table, got {given!r}")
            for key, value in given.items():
                try:
                    full = f"{name}__{key}"
                    new[full] = taken(full, checked(field_of(name, key), value))
                except ValueError as error:
                    raise ValueError(f"{name}.{error}") from None
            for f in dataclasses.fields(make):
                new.setdefault(f"{name}__{f.name}", f.default)
        camera = _camera("camera", facts.pop("camera", None))
        bookmarks = facts.pop("bookmarks", {})
        if not isinstance(bookmarks, dict) or len(bookmarks) > MOST_BOOKMARKS:
            raise ValueError(f"bookmarks: expected at most {MOST_BOOKMARKS} tables")
        views = {name: _camera(f"bookmarks.{name}", view) for name, view in bookmarks.items()}
        if facts:
            known = ", ".join([*GROUPS, "camera", "bookmarks"])
            raise ValueError(f"{next(iter(facts))}: expected one of {known}")
        self.bookmarks = views
        self.set(**new)
        self.tell({"bookmarks"})
        return camera

    def save(self, path: str | os.PathLike, camera: Camera | None = None) -> None:
        with atomic_write(path, "w") as file:
            file.write(self.to_toml(camera))


def field_of(group: str, name: str) -> dataclasses.Field:
    """Raises ValueError for a name that there is not."""
    if group not in GROUPS:
        raise ValueError(f"{group}: expected one of {', '.join(GROUPS)}")
    for field in dataclasses.fields(GROUPS[group]):
        if field.name == name:
            return field
    known = ", ".join(f.name for f in dataclasses.fields(GROUPS[group]))
    raise ValueError(f"{name}: expected one of {known}")


def _camera(name: str, facts: Any) -> Camera | None:
    if facts is None:
        return None
    known = {"eye", "look_at", "up", "fov", "height"}
    if not isinstance(facts, dict) or not {"eye", "look_at"} <= set(facts) <= known:
        raise ValueError(f"{name}: expected eye, look_at, up and fov or height, got {facts!r}")
    try:
        return Camera(**facts)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}.{error}") from None


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_toml(float(v)) for v in value)}]"
    if isinstance(value, str):
        escaped = "".join(f"\\u{ord(c):04x}" if ord(c) < 32 or c in '"\\\x7f' else c for c in value)
        return f'"{escaped}"'
    return repr(value)
