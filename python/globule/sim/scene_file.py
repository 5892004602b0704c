"""The tables of a scene: every key with its kind, default, meaning and unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _core
from .._base.checks import shown
from .._base.settings import Choice, Direction, Each, Number, Problem, Switch, Table, Vector, Whole, setting
from ..formats import EXTENSIONS
from . import limits
from .instruments import Instrument
from .sampling import FACES
from .scene_bodies import PART, Boundary, Fluid, Rigid, Solid
from .schema import NAME, PLACE, POINTS, POSITIVE, VISCOSITY, Rising, exactly_one
from .shapes import Box, Sphere

LIST = "list of [tables](#fluids), below: `[[fluids]]` …"
WALLS = "walls"  # the phase of the domain's walls
ITERATIONS: int = _core.limits["iterations"]


@dataclass(kw_only=True)
class Solver(Table):
    """Method, limits and accuracy of the solver's steps."""

    method: str = setting(
        Choice("dfsph", "wcsph"),
        "dfsph",
        '"dfsph", or "wcsph": weakly compressible (Tait\'s equation), as a cross-check',
    )
    max_error: float = setting(
        Number(1e-6, 0.1),
        0.001,
        "mean compression that the density solve leaves; 0.1 % of the particles may have four times as much, a share",
    )
    divergence_error: float | None = setting(
        Number(1e-6, 0.1),
        None,
        "ten times the mean compression that velocities may add in a step (2e-4 at most; above 60 layers less), "
        "a share",
        usual="`max_error`",
    )
    viscosity_error: float = setting(Number(1e-9, 0.1), 1e-4, "relative residual of implicit viscosity")
    min_iterations: int = setting(Whole(0, 1_000_000), 2, "fewest iterations of both solves")
    max_iterations: int | None = setting(
        Whole(1, 1_000_000),
        None,
        "most iterations of both solves",
        usual=f"{ITERATIONS}, of velocities one for each layer of the fluids, if that is more",
    )
    cfl: float = setting(
        Number(1e-3, 2.0),
        1.0,
        "a step is at most 0.4 cfl spacing / fastest "
        "speed; the square root of pressure / density counts as a speed. On key frames, boundaries "
        "and graspers at work move at most 0.4 cfl spacing in a step",
    )
    max_dt: float = setting(POSITIVE, 0.005, "longest step", "s")
    sound_speed: float | None = setting(
        POSITIVE, None, "speed of sound, of wcsph", "m/s", usual="10 times the speed of a fall through the domain"
    )
    extra_viscosity: float = setting(
        VISCOSITY, 0.0, "viscosity between all fluids, of wcsph, which damps its waves", "Pa s"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        most = self.max_iterations or ITERATIONS
        if self.min_iterations > most:
            expected = f"expected at most max_iterations, {most}"
            raise Problem(("min_iterations",), f"{expected}, got {self.min_iterations}")


@dataclass(kw_only=True)
class Domain(Table):
    """The domain is the simulated box. Particles that leave the domain rest where they are, act on
    nothing, and count as escaped; images and frames still show them. A [sink](#sinks) removes
    fluid."""

    lo: tuple = setting(PLACE, help="corner where x, y and z are least", unit="m")
    hi: tuple = setting(PLACE, help="corner where x, y and z are largest", unit="m")
    walls: bool = setting(Switch(), False, "whether the faces of the domain are boundaries")
    open: list = setting(Each(Choice(*FACES), distinct=True), [], 'faces without a wall: "-x", "+x" … "+z"')
    periodic: list = setting(
        Each(Choice("x", "y", "z"), distinct=True),
        [],
        "axes along which the "
        'domain repeats: "x", "y", "z". Tissue does not come in again on the other side: it counts '
        "as escaped",
    )

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
class Emitter(Table):
    """A disc that emits fluid at a rate."""

    name: str = setting(NAME, help="a name of its own")
    fluid: str = setting(NAME, help="name of one of the fluids")
    center: tuple = setting(PLACE, help="center of the disc", unit="m")
    direction: tuple = setting(Direction(), help="direction of the flow")
    radius: float = setting(POSITIVE, help="radius of the disc", unit="m")
    rate: float = setting(POSITIVE, help="volume that the disc emits, exact", unit="m³/s")
    start: float = setting(Number(least=0.0), 0.0, "when the emitter begins to run", "s")
    end: float | None = setting(POSITIVE, None, "when the emitter stops", "s", usual="without end")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_end(self.start, self.end)


def check_end(start: float, end: float | None) -> None:
    """Refuse an emitter that ends before it starts."""
    if end is not None and end <= start:
        raise Problem(("end",), f"expected more than start, {start:g} s, got {end:g}")


@dataclass(kw_only=True)
class Sink(Table):
    """A region that removes the fluid that enters it."""

    name: str = setting(NAME, help="a name of its own")
    box: Box | None = setting(Box, None, PART)
    sphere: Sphere | None = setting(Sphere, None, PART)

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

    name: str = setting(NAME, help="a name of its own")
    solid: str = setting(NAME, help="name of the surrounding tissue")
    fluid: str = setting(NAME, help="name of the blood's fluid")
    path: list = setting(POINTS, help="points of the vessel's center line", unit="m")
    radius: float = setting(POSITIVE, help="radius of the tube", unit="m")
    pressure: float = setting(Number(above=0.0, most=1e9), 2000.0, "pressure above the outside", "Pa")
    pool: float = setting(POSITIVE, help="blood that the vessel can lose", unit="m³")


@dataclass(kw_only=True)
class Foam(Table):
    """The table, even an empty one, switches on spray, foam and bubbles. They never act on the
    simulation ([design](../design/simulation.md#spray-foam-and-bubbles)). Each pair of limits gives
    the values at which a potential is 0 and 1. Without gravity, `approach` and `speed` are
    required."""

    approach: tuple | None = setting(
        Rising(),
        None,
        "limits of trapped air: the weighted sum of the speeds with which neighbors come closer",
        "m/s",
        usual="2 and 8 times sqrt(gravity · spacing)",
    )
    curvature: tuple = setting(
        Rising(), (0.5, 2.0), "limits of the wave crest: the weighted sum of 1 - cosine between normals"
    )
    speed: tuple | None = setting(
        Rising(), None, "limits of the kinetic energy, as speeds", "m/s", usual="3 and 10 times sqrt(gravity · spacing)"
    )
    air_rate: float = setting(
        Number(0.0, 1e6), 500.0, "new particles of trapped air per fluid particle, at most", "1/s"
    )
    crest_rate: float = setting(
        Number(0.0, 1e6), 2000.0, "new particles of wave crests per fluid particle, at most", "1/s"
    )
    lifetime: float = setting(
        POSITIVE, 2.0, "mean lifetime of foam; each one's is from half to one and a half of it", "s"
    )
    max_particles: int = setting(Whole(1, 100_000_000), 200_000, "most particles; beyond, the oldest go")
    seed: int = setting(Whole(0, 2**31 - 1), 0, "seed of the random numbers")


@dataclass(kw_only=True)
class View(Table):
    """Camera and look of the scene's images."""

    eye: tuple | None = setting(
        PLACE, None, "camera position, beside `look_at`", "m", usual="the whole scene is in view"
    )
    look_at: tuple | None = setting(PLACE, None, "point in the middle of the image, beside `eye`", "m")
    up: tuple = setting(Direction(), (0.0, 0.0, 1.0), "direction that points up in the image")
    fov: float = setting(Number(above=0.0, most=170.0), 40.0, "vertical field of view", "degrees")
    look: str | None = setting(
        Choice("water", "blood", "glass", "tissue", "clay"),
        None,
        '"water", "blood", "glass", "tissue" or "clay"',
        usual="plain",
    )
    ground: float | None = setting(
        Number(-1e6, 1e6), None, "height of the look's ground along `up`", "m", usual="the lowest point of the scene"
    )
    speeds: tuple | None = setting(
        Rising(), None, "color by speed: the speeds at the ends of the color map", "m/s", usual="color by phase"
    )
    size: tuple = setting(Vector(2, 1, 16384, whole=True), (640, 480), "width and height of images", "pixels")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.eye is None) != (self.look_at is None):
            raise ValueError("expected eye and look_at together, got one of them")
        if self.eye is not None and self.eye == self.look_at:
            raise Problem(("look_at",), f"expected a point other than eye, got {self.eye}")


@dataclass(kw_only=True)
class Output(Table):
    """Frames that a run writes."""

    fps: float = setting(Number(above=0.0, most=1e6), 30.0, "frames per second")
    format: str = setting(
        Choice(*(name[1:] for name in EXTENSIONS)), "vtp", "format of frames: any format that globule writes"
    )


@dataclass(kw_only=True)
class SceneFile(Table):
    """A scene with all its keys, in SI units; docs/reference/scene-keys.md describes each key."""

    spacing: float = setting(POSITIVE, help="distance between particles", unit="m")
    domain: Domain = setting(Domain, help="[table](#domain)")
    title: str = setting(NAME, "", "title of the scene")
    gravity: tuple = setting(Vector(least=-1e6, most=1e6), (0.0, 0.0, -9.81), "acceleration of gravity", "m/s²")
    fine_fluids: bool = setting(
        Switch(),
        False,
        "whether the particles of all fluids have half "
        "the spacing, beside [tissue and boundaries](../design/tissue.md#blood-finer-than-tissue) "
        "of the whole one",
    )
    seconds: float = setting(POSITIVE, 1.0, "length of the run", "s")
    solver: Solver = setting(Solver, Solver, "[table](#solver)")
    fluids: list = setting(Each(Fluid), [], LIST)
    solids: list = setting(Each(Solid), [], LIST)
    boundaries: list = setting(Each(Boundary), [], LIST)
    rigids: list = setting(Each(Rigid), [], LIST)
    instruments: list = setting(Each(Instrument), [], LIST)
    emitters: list = setting(Each(Emitter), [], LIST)
    sinks: list = setting(Each(Sink), [], LIST)
    vessels: list = setting(Each(Vessel), [], LIST)
    foam: Foam | None = setting(Foam, None, "[table](#foam); without it, fluids make none")
    view: View = setting(View, View, "[table](#view)")
    output: Output = setting(Output, Output, "[table](#output)")

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


LISTS = ("fluids", "solids", "boundaries", "rigids", "instruments", "emitters", "sinks", "vessels")


def white_matter(name: str) -> str:
    """The name of the phase of a solid's white matter."""
    return f"{name} white matter"
