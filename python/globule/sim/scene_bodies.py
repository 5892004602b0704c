"""A scene's tables of fluids, tissue, boundaries and rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from .._base.settings import Choice, Color, Each, Number, Switch, Table, Vector, at, same, setting
from .instruments import Key, Motion, Steady
from .materials import LONGEST, MODEL, MODELS, MOST_POISSON, MOST_SHARE, SHORTEST, check_model, prony_series
from .sampling import ENDS, FACES
from .schema import DENSITY, FRICTION, NAME, PLACE, SHARE, TENSION, VELOCITY, VISCOSITY, exactly_one
from .shapes import Box, Cylinder, Plane, Sphere
from .sources import DistanceFile, MeshFile, ParticleFile, Tomography

SOLID_SHAPES = ("box", "sphere", "cylinder", "mesh", "tomography", "particles")
BOUNDARY_SHAPES = ("box", "sphere", "cylinder", "plane", "mesh", "distance")
RIGID_SHAPES = ("box", "sphere", "cylinder", "mesh")
IMPLICIT_FROM = 1.0  # Pa s
PART = "[shape](#shapes-and-files), at most one of them"


@dataclass(kw_only=True)
class Shape(Table):
    """A shape in which tissue is fixed."""

    box: Box | None = setting(Box, None, PART)
    sphere: Sphere | None = setting(Sphere, None, PART)
    cylinder: Cylinder | None = setting(Cylinder, None, PART)

    def __post_init__(self) -> None:
        super().__post_init__()
        exactly_one(self, ("box", "sphere", "cylinder"))

    @property
    def shape(self) -> Any:
        """The given shape."""
        return self.box or self.sphere or self.cylinder


@dataclass(kw_only=True)
class Body(Table):
    """What fluids, tissue, boundaries and rigid bodies have in common."""

    shapes: ClassVar[tuple[str, ...]]
    name: str = setting(NAME, help="a name of its own")
    box: Box | None = setting(Box, None, PART)
    sphere: Sphere | None = setting(Sphere, None, PART)
    cylinder: Cylinder | None = setting(Cylinder, None, PART)
    mesh: MeshFile | None = setting(MeshFile, None, PART)
    color: tuple = setting(Color(), (0.5, 0.5, 0.5), '"#rrggbb", sRGB, or [r, g, b], linear')
    reflection: float = setting(SHARE, 0.0, "share of the light that is reflected")
    refraction: float = setting(SHARE, 0.0, "share of the remaining light that is refracted")
    shown: bool = setting(Switch(), True, "whether images show the phase")

    def __post_init__(self) -> None:
        super().__post_init__()
        exactly_one(self, self.shapes, least=0)


@dataclass(kw_only=True)
class Flowing(Body):
    """What has a density and moves at the start."""

    density: float = setting(DENSITY, 1000.0, "density", "kg/m³")
    velocity: tuple = setting(VELOCITY, (0.0, 0.0, 0.0), "velocity at the start", "m/s")


@dataclass(kw_only=True)
class Viscous(Flowing):
    """What the viscosity solver moves."""

    particles: ParticleFile | None = setting(ParticleFile, None, PART)
    viscosity: float = setting(
        VISCOSITY,
        0.001,
        "dynamic viscosity; a fluid with surface tension "
        "has at least 0.0075 sqrt(density · surface_tension · spacing), without which its surface "
        "[boils](../design/simulation.md#drops)",
        "Pa s",
    )
    implicit: bool | None = setting(
        Switch(), None, "whether the viscosity solver is implicit, which allows long steps", usual="from 1 Pa s up"
    )
    surface_tension: float = setting(
        TENSION, 0.0, "surface tension; of tissue: fluids with one stick to the tissue", "N/m"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.implicit is None:
            self.implicit = self.viscosity >= IMPLICIT_FROM


@dataclass(kw_only=True)
class Fluid(Viscous):
    """A liquid and its shape at the start. Without a shape, emitters and vessels add the fluid."""

    shapes = ("box", "sphere", "cylinder", "mesh", "particles")
    color: tuple = same(Body, "color", default=(0.05, 0.25, 0.5), usual="water")


@dataclass(kw_only=True)
class Relaxation(Table):
    """A part of a solid's shear modulus that relaxes."""

    share: float = setting(Number(above=0.0, most=MOST_SHARE), help="share of the shear modulus")
    time: float = setting(Number(SHORTEST, LONGEST), help="time in which it relaxes", unit="s")


@dataclass(kw_only=True)
class Solid(Viscous):
    """Elastic tissue. Bonds connect particles closer than 1.5 spacings, and a blade cuts the bonds.
    By default, bonds are the neighborhoods of a solid; with `model = "bonds"`, bonds are
    springs."""

    shapes = SOLID_SHAPES
    tomography: Tomography | None = setting(Tomography, None, PART)
    density: float = same(Flowing, "density", default=1040.0)
    young: float | None = setting(
        Number(1e-3, 1e13),
        None,
        "Young's modulus; the time that a run "
        "takes grows with its root. At most 100,000 substeps in a step of `max_dt` and 1,000,000 "
        "in a frame",
        "Pa",
        usual="from `rigidity`",
    )
    rigidity: float | None = setting(
        Number(above=0.0, most=0.999), None, "0 to 1: 100 Pa · 10^(4 · rigidity)", usual="0.35, brain"
    )
    model: str = setting(
        Choice(*MODELS),
        MODEL,
        '`"solid"`: total-Lagrangian SPH with exact '
        'moduli ([solids](../design/solids.md)); `"bonds"`: springs along the bonds, ν = 1/4 in '
        "themselves and [about 0.44 in a simulation](../design/tissue.md#in-the-step), 14 % too "
        "soft at 5 particles across, faster in small bodies; the same of all solids",
    )
    poisson: float | None = setting(
        Number(0.0, MOST_POISSON), None, 'Poisson\'s ratio of `model = "solid"`', usual="0.45"
    )
    relaxation: list | None = setting(
        Each(Relaxation),
        None,
        'Prony series of `model = "solid"`: '
        "up to two { **share**, **time** }: this share of the shear modulus, at most 0.99, relaxes "
        "in this time, s; all shares together below 1. `young` is the modulus of sudden "
        "motion",
    )
    viscosity: float = same(Viscous, "viscosity", default=0.0)
    damping: float = setting(Number(0.0, 1e6), 0.0, "damping of the tissue's motion", "1/s")
    tear: float = setting(Number(0.0, 1e6), 0.0, "strain at which a bond breaks; 0: never")
    plastic: float = setting(
        Number(0.0, 1e6),
        0.0,
        "strain beyond which a part of the strain is "
        'permanent; 0: never. For a bond, its own strain; for `model = "solid"`, the elastic '
        "strain of a pulled bar, and the equivalent shear of other deformations "
        "([solids](../design/solids.md#strain-that-stays))",
    )
    creep: float = setting(Number(above=0.0, most=1e6), 1.0, "rate at which the excess strain becomes permanent", "1/s")
    friction: float = setting(
        FRICTION,
        0.0,
        "coefficient of the tissue's contacts: with walls, "
        "rigid bodies, pushers, other tissue, and of cut faces. A contact has the larger "
        "coefficient of its two sides ([friction](../design/tissue.md#friction))",
    )
    fixed: list = setting(Each(Shape), [], "{ box, sphere or cylinder }: fixed parts of the tissue")
    color: tuple = same(Body, "color", default=(0.62, 0.38, 0.35), usual="flesh")

    def __post_init__(self) -> None:
        super().__post_init__()
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
class Boundary(Body):
    """A wall: one layer of particles, at rest or moving along key frames."""

    shapes = BOUNDARY_SHAPES
    plane: Plane | None = setting(Plane, None, PART)
    distance: DistanceFile | None = setting(DistanceFile, None, PART)
    hollow: bool = setting(Switch(), False, "whether particles move inside the boundary")
    open: list = setting(
        Each(Choice(*FACES, *ENDS), distinct=True),
        [],
        'missing faces: of a box "-x" … "+z", of a cylinder "start", "end"',
    )
    keys: list = setting(Each(Key), [], "[key frames](#key-frames) that move the boundary", usual="none: at rest")
    velocity: tuple = setting(
        Vector(least=-1e6, most=1e6), (0.0, 0.0, 0.0), "instead of `keys`: it moves all the time", "m/s"
    )
    spin: tuple = setting(
        Vector(least=-1e6, most=1e6),
        (0.0, 0.0, 0.0),
        "instead of `keys`: it turns all the time, to the right about this axis",
        "rad/s",
    )
    about: tuple = setting(PLACE, (0.0, 0.0, 0.0), "point that it turns about with `spin`; moves with `velocity`", "m")
    adhesion: float = setting(
        TENSION, 0.0, "fluids with a surface tension stick to the body as to a fluid of that tension", "N/m"
    )
    friction: float = setting(FRICTION, 0.0, "coefficient of its contacts with tissue, as of solids")
    shown: bool = setting(
        Switch(),
        False,
        "whether images show the boundary; beside fluids a "
        "shell [less than seven spacings thick](../design/surface.md#what-is-not-reached) may have "
        "holes",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.motion: Motion | Steady | None = None
        if any(self.about) and not any(self.spin):
            raise ValueError("about: expected a spin about this point, got none")
        if any(self.velocity) or any(self.spin):
            if self.keys:
                raise ValueError("expected keys, or velocity and spin, got both")
            self.motion = Steady(self.velocity, self.spin, self.about)
        elif self.keys:
            with at("keys"):
                self.motion = Motion(self.keys)


@dataclass(kw_only=True)
class Rigid(Flowing):
    """A rigid body keeps its shape. Gravity and contacts move the body, and the body pushes back.
    Momentum is kept where bodies meet each other, fluids or tissue. A fluid acts by pressure,
    viscosity, surface tension and the body's `adhesion`, at any ratio of densities; with a rigid
    body in the scene, all viscosity is implicit. Bodies that stand on others or on walls sink by up
    to half a spacing, and slide without friction until their particles fit between those below
    ([design](../design/simulation.md#rigid-bodies))."""

    shapes = RIGID_SHAPES
    spin: tuple = setting(Vector(least=-1e6, most=1e6), (0.0, 0.0, 0.0), "angular velocity at the start", "rad/s")
    adhesion: float = same(Boundary, "adhesion")
    friction: float = same(Boundary, "friction")
    color: tuple = same(Body, "color", default=(0.6, 0.5, 0.3), usual="wood")
