"""Scenes: TOML, a dict or Python becomes a checked `SceneFile`, or an error of one line."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path as File
from typing import Any

import numpy as np

from .._base.checks import positive as positive_number
from .._base.structured import parse_toml, read_text
from ..formats import EXTENSIONS
from . import limits
from .instruments import Instrument, Key, Motion
from .sampling import ENDS, FACES
from .schema import (
    Problem,
    SceneError,
    Table,
    choice,
    color,
    density,
    direction,
    distinct,
    each,
    exactly_one,
    key,
    number,
    place,
    positive,
    read_table,
    shown,
    switch,
    text,
    vector,
    velocity,
    whole,
)
from .shapes import Box, Cylinder, Plane, Sphere
from .solids import (
    LONGEST,
    MODEL,
    MODELS,
    MOST_POISSON,
    MOST_SHARE,
    SHORTEST,
    check_model,
    prony_series,
)
from .sources import DistanceFile, MeshFile, ParticleFile, Tomography, check_files
from .toml_lines import key_lines

SHIPPED = ("dam-break", "droplet", "poiseuille", "beam", "cut-block", "brain-surgery")
FOLDER = File(__file__).parent / "scenes"
SOLID_SHAPES = ("box", "sphere", "cylinder", "mesh", "tomography", "particles")
BOUNDARY_SHAPES = ("box", "sphere", "cylinder", "plane", "mesh", "distance")
RIGID_SHAPES = ("box", "sphere", "cylinder", "mesh")
IMPLICIT_FROM = 1.0  # Pa s
MOST_FRICTION = 100.0
WALLS = "walls"  # the phase of the domain's walls


@dataclass(kw_only=True)
class Solver(Table):
    """Method, limits and accuracy of the solver's steps."""

    method: str = key(choice("dfsph", "wcsph"), "dfsph")
    max_error: float = key(number(1e-6, 0.1), 0.001)  # mean compression, a share
    divergence_error: float | None = key(number(1e-6, 0.1), None)  # default: max_error
    viscosity_error: float = key(number(1e-9, 0.1), 1e-4)  # residual of implicit viscosity
    min_iterations: int = key(whole(0, 1_000_000), 2)
    max_iterations: int = key(whole(1, 1_000_000), 100)
    cfl: float = key(number(1e-3, 2.0), 1.0)
    max_dt: float = key(positive, 0.005)  # s
    sound_speed: float | None = key(positive, None)  # of wcsph, m/s
    extra_viscosity: float = key(number(0.0, 1e9), 0.0)  # of wcsph, Pa s

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_iterations > self.max_iterations:
            expected = f"expected at most max_iterations, {self.max_iterations}"
            raise Problem(("min_iterations",), f"{expected}, got {self.min_iterations}")


@dataclass(kw_only=True)
class Domain(Table):
    """The simulated box. The simulation removes and counts particles that leave the domain."""

    lo: tuple = key(place)  # m
    hi: tuple = key(place)
    walls: bool = key(switch, False)  # whether its faces are boundaries
    open: list = key(distinct(choice(*FACES)), [])
    periodic: list = key(distinct(choice("x", "y", "z")), [])  # axes without end

    def __post_init__(self) -> None:
        super().__post_init__()
        Box(self.lo, self.hi)
        for i, face in enumerate(self.open):
            if face[1] in self.periodic:
                expected = f"expected faces of axes that end, got {face!r} with periodic"
                raise Problem(("open", i), f"{expected} {shown(self.periodic)}")

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The two corners of the domain, (3,) float64 m each."""
        return np.asarray(self.lo), np.asarray(self.hi)


@dataclass(kw_only=True)
class Shape(Table):
    """A shape in which tissue is fixed."""

    box: Box | None = key(Box, None)
    sphere: Sphere | None = key(Sphere, None)
    cylinder: Cylinder | None = key(Cylinder, None)

    def __post_init__(self) -> None:
        super().__post_init__()
        exactly_one(self, ("box", "sphere", "cylinder"))

    @property
    def shape(self) -> Any:
        """The given shape."""
        return self.box or self.sphere or self.cylinder


@dataclass(kw_only=True)
class Fluid(Table):
    """A liquid and its shape at the start."""

    name: str = key(text)
    box: Box | None = key(Box, None)
    sphere: Sphere | None = key(Sphere, None)
    cylinder: Cylinder | None = key(Cylinder, None)
    mesh: MeshFile | None = key(MeshFile, None)
    particles: ParticleFile | None = key(ParticleFile, None)
    density: float = key(density, 1000.0)  # kg/m³
    viscosity: float = key(number(0.0, 1e9), 0.001)  # Pa s
    implicit: bool | None = key(switch, None)  # viscosity; default: from 1 Pa s up
    surface_tension: float = key(number(0.0, 1e3), 0.0)  # N/m
    velocity: tuple = key(velocity, (0.0, 0.0, 0.0))  # m/s
    color: tuple = key(color, (0.05, 0.25, 0.5))
    reflection: float = key(number(0.0, 1.0), 0.0)  # shares of light
    refraction: float = key(number(0.0, 1.0), 0.0)
    shown: bool = key(switch, True)  # in pictures

    def __post_init__(self) -> None:
        super().__post_init__()
        at_most_one(self, ("box", "sphere", "cylinder", "mesh", "particles"))
        if self.implicit is None:
            self.implicit = self.viscosity >= IMPLICIT_FROM


@dataclass(kw_only=True)
class Relaxation(Table):
    """A part of a solid's shear modulus that relaxes."""

    share: float = key(number(above=0.0, most=MOST_SHARE))
    time: float = key(number(SHORTEST, LONGEST))  # s


@dataclass(kw_only=True)
class Solid(Table):
    """Elastic tissue: a solid, or springs (`model = "bonds"`)."""

    name: str = key(text)
    box: Box | None = key(Box, None)
    sphere: Sphere | None = key(Sphere, None)
    cylinder: Cylinder | None = key(Cylinder, None)
    mesh: MeshFile | None = key(MeshFile, None)
    tomography: Tomography | None = key(Tomography, None)
    particles: ParticleFile | None = key(ParticleFile, None)
    density: float = key(density, 1040.0)
    young: float | None = key(number(1e-3, 1e13), None)  # Pa
    rigidity: float | None = key(number(above=0.0, most=0.999), None)
    model: str = key(choice(*MODELS), MODEL)
    poisson: float | None = key(number(0.0, MOST_POISSON), None)  # of a solid; None: POISSON
    relaxation: list | None = key(each(Relaxation), None)  # Prony series of a solid
    viscosity: float = key(number(0.0, 1e9), 0.0)  # Pa s
    implicit: bool | None = key(switch, None)
    surface_tension: float = key(number(0.0, 1e3), 0.0)  # N/m: fluids stick to it
    damping: float = key(number(0.0, 1e6), 0.0)  # of its motion, 1/s
    tear: float = key(number(0.0, 1e6), 0.0)  # strain at which a bond breaks; 0: never
    plastic: float = key(number(0.0, 1e6), 0.0)  # strain beyond which some stays; 0: never
    creep: float = key(number(above=0.0, most=1e6), 1.0)  # share of that strain that stays, 1/s
    friction: float = key(number(0.0, MOST_FRICTION), 0.0)  # coefficient of its contacts
    fixed: list = key(each(Shape), [])
    velocity: tuple = key(velocity, (0.0, 0.0, 0.0))
    color: tuple = key(color, (0.62, 0.38, 0.35))
    reflection: float = key(number(0.0, 1.0), 0.0)
    refraction: float = key(number(0.0, 1.0), 0.0)
    shown: bool = key(switch, True)

    def __post_init__(self) -> None:
        super().__post_init__()
        at_most_one(self, SOLID_SHAPES)
        if self.implicit is None:
            self.implicit = self.viscosity >= IMPLICIT_FROM
        if self.young is not None and self.rigidity is not None:
            raise ValueError("expected young or rigidity, got both")
        if self.model != "solid" and self.poisson is not None:
            raise ValueError('poisson: expected model = "solid" beside it, got "bonds"')
        check_model(self.model, self.pairs)
        prony_series(self.pairs)

    @property
    def pairs(self) -> list[tuple[float, float]]:
        """(share, time) of each part that relaxes."""
        return [(term.share, term.time) for term in self.relaxation or ()]


@dataclass(kw_only=True)
class Boundary(Table):
    """A wall: one layer of particles, at rest or moving along key frames."""

    name: str = key(text)
    box: Box | None = key(Box, None)
    sphere: Sphere | None = key(Sphere, None)
    cylinder: Cylinder | None = key(Cylinder, None)
    plane: Plane | None = key(Plane, None)
    mesh: MeshFile | None = key(MeshFile, None)
    distance: DistanceFile | None = key(DistanceFile, None)
    hollow: bool = key(switch, False)  # whether things move inside it
    open: list = key(distinct(choice(*FACES, *ENDS)), [])
    keys: list = key(each(Key), [])
    adhesion: float = key(number(0.0, 1e3), 0.0)  # N/m: fluids with a surface tension stick to it
    friction: float = key(number(0.0, MOST_FRICTION), 0.0)  # coefficient, of tissue
    shown: bool = key(switch, False)
    color: tuple = key(color, (0.5, 0.5, 0.5))
    reflection: float = key(number(0.0, 1.0), 0.0)
    refraction: float = key(number(0.0, 1.0), 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        at_most_one(self, BOUNDARY_SHAPES)
        try:
            self.motion = Motion(self.keys) if self.keys else None
        except Problem as problem:
            raise Problem(("keys", *problem.path), problem.message) from None


@dataclass(kw_only=True)
class Rigid(Table):
    """A body that keeps its shape. Gravity and contacts move the body."""

    name: str = key(text)
    box: Box | None = key(Box, None)
    sphere: Sphere | None = key(Sphere, None)
    cylinder: Cylinder | None = key(Cylinder, None)
    mesh: MeshFile | None = key(MeshFile, None)
    density: float = key(density, 1000.0)
    velocity: tuple = key(velocity, (0.0, 0.0, 0.0))
    spin: tuple = key(vector(least=-1e6, most=1e6), (0.0, 0.0, 0.0))  # rad/s
    adhesion: float = key(number(0.0, 1e3), 0.0)  # N/m
    friction: float = key(number(0.0, MOST_FRICTION), 0.0)  # coefficient, of tissue
    color: tuple = key(color, (0.6, 0.5, 0.3))
    reflection: float = key(number(0.0, 1.0), 0.0)
    refraction: float = key(number(0.0, 1.0), 0.0)
    shown: bool = key(switch, True)

    def __post_init__(self) -> None:
        super().__post_init__()
        at_most_one(self, RIGID_SHAPES)


@dataclass(kw_only=True)
class Emitter(Table):
    """A disc that emits fluid at a rate."""

    name: str = key(text)
    fluid: str = key(text)
    center: tuple = key(place)
    direction: tuple = key(direction)
    radius: float = key(positive)
    rate: float = key(positive)  # m³/s
    start: float = key(number(least=0.0), 0.0)  # seconds
    end: float | None = key(positive, None)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_end(self.start, self.end)


def check_end(start: float, end: float | None) -> None:
    """Refuse an emitter that ends before it starts."""
    if end is not None and end <= start:
        raise Problem(("end",), f"expected more than start, {start:g} s, got {end:g}")


@dataclass(kw_only=True)
class Sink(Table):
    """A region that removes fluid."""

    name: str = key(text)
    box: Box | None = key(Box, None)
    sphere: Sphere | None = key(Sphere, None)

    def __post_init__(self) -> None:
        super().__post_init__()
        exactly_one(self, ("box", "sphere"))

    @property
    def region(self) -> tuple:
        """Corners (lo, hi) of the box, or center and radius of the ball, m."""
        if self.box:
            return self.box.lo, self.box.hi
        assert self.sphere is not None  # exactly one of both
        return self.sphere.center, self.sphere.radius


@dataclass(kw_only=True)
class Vessel(Table):
    """A tube inside tissue that bleeds where a blade cuts the tube."""

    name: str = key(text)
    solid: str = key(text)
    fluid: str = key(text)
    path: list = key(each(place, least=2))
    radius: float = key(positive)
    pressure: float = key(number(above=0.0, most=1e9), 2000.0)  # Pa above the outside
    pool: float = key(positive)  # m³ of blood in all


def _rising(value: Any) -> tuple[float, ...]:
    lo, hi = vector(2, least=0)(value)
    if lo >= hi:
        raise ValueError(f"expected the lower one first, got {shown(value)}")
    return lo, hi


def _pixels(value: Any) -> tuple[float, ...]:
    size = vector(2, least=1, most=16384)(value)
    for i, n in enumerate(size):
        if not n.is_integer():
            raise Problem((i,), f"expected a whole number from 1 to 16384, got {n:g}")
    return size


@dataclass(kw_only=True)
class Foam(Table):
    """Spray, foam and bubbles that fluids carry. Limits: where a potential is 0, and 1."""

    approach: tuple | None = key(_rising, None)  # m/s, of neighbors; default: by gravity
    curvature: tuple = key(_rising, (0.5, 2.0))
    speed: tuple | None = key(_rising, None)  # m/s; default: by gravity
    air_rate: float = key(number(0.0, 1e6), 500.0)  # 1/s, per fluid particle
    crest_rate: float = key(number(0.0, 1e6), 2000.0)  # 1/s
    lifetime: float = key(positive, 2.0)  # s, of foam: the mean
    max_particles: int = key(whole(1, 100_000_000), 200_000)  # beyond, the oldest go
    seed: int = key(whole(0, 2**31 - 1), 0)  # of the random numbers


@dataclass(kw_only=True)
class View(Table):
    """Camera and look of the scene's images."""

    eye: tuple | None = key(place, None)
    look_at: tuple | None = key(place, None)
    up: tuple = key(direction, (0.0, 0.0, 1.0))
    fov: float = key(number(above=0.0, most=170.0), 40.0)
    look: str | None = key(choice("water", "blood", "glass", "tissue", "clay"), None)
    ground: float | None = key(number(-1e6, 1e6), None)  # of a look, height along `up`
    speeds: tuple | None = key(vector(2, least=0), None)  # m/s at the ends of a color map
    size: tuple = key(_pixels, (640.0, 480.0))

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.eye is None) != (self.look_at is None):
            raise ValueError("expected eye and look_at together, got one of them")
        if self.eye is not None and self.eye == self.look_at:
            raise Problem(("look_at",), f"expected a point other than eye, got {self.eye}")
        if self.speeds is not None and self.speeds[0] >= self.speeds[1]:
            raise Problem(("speeds",), f"expected the lower one first, got {self.speeds}")


@dataclass(kw_only=True)
class Output(Table):
    """Frames that a run writes."""

    fps: float = key(number(above=0.0, most=1e6), 30.0)
    format: str = key(choice(*(name[1:] for name in EXTENSIONS)), "vtp")


@dataclass(kw_only=True)
class SceneFile(Table):
    """A scene with all its keys, in SI units; docs/reference/scene-keys.md describes each key."""

    spacing: float = key(positive)  # of the particles
    domain: Domain = key(Domain)
    title: str = key(text, "")
    gravity: tuple = key(vector(least=-1e6, most=1e6), (0.0, 0.0, -9.81))
    fine_fluids: bool = key(switch, False)  # whether fluids have half the spacing
    seconds: float = key(positive, 1.0)  # how long it runs
    solver: Solver = key(Solver, Solver)
    fluids: list = key(each(Fluid), [])
    solids: list = key(each(Solid), [])
    boundaries: list = key(each(Boundary), [])
    rigids: list = key(each(Rigid), [])
    instruments: list = key(each(Instrument), [])
    emitters: list = key(each(Emitter), [])
    sinks: list = key(each(Sink), [])
    vessels: list = key(each(Vessel), [])
    foam: Foam | None = key(Foam, None)
    view: View = key(View, View)
    output: Output = key(Output, Output)

    def __post_init__(self) -> None:
        super().__post_init__()
        names = self._made_names()
        for kind in LISTS:
            for i, item in enumerate(getattr(self, kind)):
                if item.name in names:
                    problem = f"expected a name of its own, got {item.name!r}{names[item.name]}"
                    raise Problem((kind, i, "name"), problem)
                names[item.name] = " again"
        for kind, attribute, among in (
            ("emitters", "fluid", "fluids"),
            ("vessels", "fluid", "fluids"),
            ("vessels", "solid", "solids"),
        ):
            known = [item.name for item in getattr(self, among)]
            for i, item in enumerate(getattr(self, kind)):
                if getattr(item, attribute) not in known:
                    listed = ", ".join(known) or "a fluid of the scene"
                    got = getattr(item, attribute)
                    raise Problem((kind, i, attribute), f"expected one of {listed}, got {got!r}")
        if self.foam and not any(self.gravity):
            for name in ("approach", "speed"):
                if getattr(self.foam, name) is None:
                    expected = "expected [m/s, m/s] where there is no gravity, got none"
                    raise Problem(("foam", name), expected)
        limits.check(self)

    def _made_names(self) -> dict[str, str]:
        """Names of the phases that globule adds to those of the tables, and whose they are."""
        made = {WALLS: ", the name of the domain's walls"} if self.domain.walls else {}
        for solid in self.solids:
            if solid.tomography and solid.tomography.white:
                made[white_matter(solid.name)] = f", the name of a part of {solid.name!r}"
        return made

    @property
    def fluid_spacing(self) -> float:
        """Of the particles of fluids, m."""
        return self.spacing / 2 if self.fine_fluids else self.spacing


LISTS = (
    "fluids", "solids", "boundaries", "rigids", "instruments", "emitters", "sinks", "vessels"
)  # fmt: skip


def at_most_one(table: Any, names: tuple[str, ...]) -> None:
    """Refuse a table with more than one of these keys."""
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) > 1:
        raise ValueError(f"expected one of {', '.join(names)}, got {' and '.join(given)}")


def check_places(scene: SceneFile) -> None:
    """Refuse a scene file whose particles come from nowhere; in Python, `add` may bring them.

    Raises:
        Problem: a scene without bodies, or a body without a shape.
    """
    if not (scene.fluids or scene.solids or scene.rigids):
        raise Problem((), "expected fluids, solids or rigids, got none")
    for kind, shapes in (
        ("solids", SOLID_SHAPES), ("boundaries", BOUNDARY_SHAPES), ("rigids", RIGID_SHAPES),
    ):  # fmt: skip
        for i, table in enumerate(getattr(scene, kind)):
            try:
                exactly_one(table, shapes)
            except ValueError as error:
                raise Problem((kind, i), str(error)) from None


def white_matter(name: str) -> str:
    """The name of the phase of a solid's white matter."""
    return f"{name} white matter"


def shipped(name: str) -> File:
    """The file of a scene that comes with the package."""
    return FOLDER / f"{name}.toml"


def read_scene(scene: Any, spacing: float | None = None, **keys: Any) -> SceneFile:
    """A scene with all its values checked.

    Args:
        scene: the name of a shipped scene, the path of a TOML file, a dict with the keys of a scene
            file, or a `SceneFile`.
        spacing: m, instead of the scene's own.
        keys: other keys of a scene, instead of the scene's own, as in a dict or as tables.

    Raises:
        SceneError: a wrong key or value; the message names file and line if the scene is a file.
        OSError: a file that cannot be read.
    """
    if spacing is not None:
        try:
            keys["spacing"] = positive_number("spacing", spacing)
        except (TypeError, ValueError):
            got = shown(spacing)
            raise SceneError(f"spacing: expected a number above 0, got {got}") from None
    name, folder = "", ""
    lines: dict[tuple, int] = {}
    if not isinstance(scene, (dict, SceneFile)):
        path = shipped(scene) if scene in SHIPPED else File(scene)
        name, folder = os.fspath(path), os.path.dirname(path)
        try:
            scene, lines = _parsed(path)
        except OSError as error:
            expected = f"expected a .toml file or one of {', '.join(SHIPPED)}"
            got = f"{os.fspath(path)}: {error.strerror}"
            raise type(error)(f"SCENE: {expected}, got {got}") from None
    try:
        if isinstance(scene, SceneFile):
            scene = {f.name: getattr(scene, f.name) for f in fields(scene)}
        found = read_table(SceneFile, {**scene, **keys})
        if name:
            check_places(found)
        for kind in LISTS:
            for i, item in enumerate(getattr(found, kind)):
                for source in ("mesh", "tomography", "particles", "distance"):
                    try:
                        check_files(getattr(item, source, None), folder)
                    except Problem as problem:
                        place = (kind, i, source, *problem.path)
                        raise Problem(place, problem.message) from None
        return found
    except Problem as problem:
        lines = {place: line for place, line in lines.items() if place[0] not in keys}
        raise SceneError(f"{_located(name, lines, problem.path)}{problem}") from None


@contextmanager
def errors_of(scene: Any) -> Iterator[None]:
    """What is wrong with a scene of a file is said with the file's name."""
    try:
        yield
    except ValueError as error:
        if not isinstance(scene, (str, os.PathLike)) or scene in SHIPPED:
            raise
        name = os.fspath(scene)
        if str(error).startswith(name):
            raise
        raise SceneError(f"{name}: {error}") from error


def as_dict(table: Any) -> Any:
    """A checked table as a dict in TOML's words, which `read_scene` reads again."""
    if isinstance(table, (list, tuple)):
        return [as_dict(item) for item in table]
    if not is_dataclass(table):
        return table
    found = {}
    for field in fields(table):
        value = getattr(table, field.name)
        if field.metadata and value not in (None, ""):
            found[field.name] = as_dict(value)
    return found


def _parsed(path: File) -> tuple[dict[str, Any], dict]:
    try:
        words = read_text(path)
        return parse_toml(words), key_lines(words.replace("\r\n", "\n"))
    except ValueError as error:
        line = re.search(r"at line (\d+)", str(error))
        where = f"{path}:{line[1]}" if line else path
        raise SceneError(f"{where}: expected TOML, got: {error}") from None


def _located(name: str, lines: dict, path: tuple) -> str:
    """The file and the line of a key, or of the nearest table around it."""
    while path and path not in lines:
        path = path[:-1]
    return f"{name}:{lines[path]}: " if path else f"{name}: " if name else ""
