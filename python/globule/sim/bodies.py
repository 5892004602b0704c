"""The bodies of a scene as particles, from which the solver starts."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..data.particles import Particles
from ..fluids.spacing import measure_spacing
from .limits import NEAR, shape_of
from .overlap import check_overlap
from .rigidity import young_of_rigidity
from .room import check_room
from .sampling import FACES, fill, surface
from .scene_bodies import Boundary
from .scene_file import WALLS, SceneFile, white_matter
from .schema import SceneError
from .settings import Phase, phase_of
from .shapes import Box


@dataclass(kw_only=True)
class Body:
    """Particles of one phase, or tissue of two.

    Attributes:
        name: of the phase.
        kind: "fluid", "tissue", "boundary" or "rigid".
        table: the scene's table with the material.
        positions: (N, 3) float64, m.
        velocities: (N, 3) float64, m/s.
        young: (N,) Pa, of tissue, else None.
        fixed: (N,) bool, of tissue: what stays where it is, else None.
        n_white: how many of the last ones are white matter, a phase of its own.
    """

    name: str
    kind: str
    table: Any
    positions: np.ndarray
    velocities: np.ndarray
    young: np.ndarray | None = None
    fixed: np.ndarray | None = None
    n_white: int = 0

    def phases(self) -> list[tuple[Phase, slice]]:
        """Each phase and which particles are of it."""
        first = phase_of(self.kind, self.table)
        if not self.n_white:
            return [(first, slice(None))]
        white = replace(first, name=white_matter(self.name), color=self.table.tomography.white)
        return [(first, slice(None, -self.n_white)), (white, slice(-self.n_white, None))]


BRAIN = 0.35  # default rigidity of tissue


def bodies(scene: SceneFile) -> list[Body]:
    """All bodies of a scene: fluids, solids, rigids, boundaries, then the domain's walls.

    Raises:
        SceneError: names the body whose file or shape gives no particles, or that does not fit in
            memory or beside another one.
    """
    makers = {
        "fluids": _fluid, "solids": _solid, "rigids": _rigid, "boundaries": _boundary
    }  # fmt: skip
    tables = [
        (table, f"{kind}[{i}] ({table.name})", maker)
        for kind, maker in makers.items()
        for i, table in enumerate(getattr(scene, kind))
    ]
    shapes = {}
    for table, name, _ in tables:
        with _named(name):
            shapes[id(table)] = _shape(table)
    check_room(scene, shapes)
    named: list[tuple[str, Body]] = []
    for table, name, maker in tables:
        with _named(name):
            given = shapes[id(table)] is not None or _source(table) is not None
            made = maker(scene, table, shapes[id(table)]) if given else [_empty(table, maker)]
        named += [(name, body) for body in made]
    check_overlap(scene, named)
    found = [body for _, body in named]
    closed = any(axis not in scene.domain.periodic for axis in "xyz")
    if scene.domain.walls and closed and len(scene.domain.open) < len(FACES):
        walls = Boundary(
            name=WALLS,
            box=Box(scene.domain.lo, scene.domain.hi),
            hollow=True,
            open=[*scene.domain.open, *(s + axis for axis in scene.domain.periodic for s in "-+")],
        )
        found += _boundary(scene, walls, walls.box)
    return found


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Errors of this block get the body's name in front."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise SceneError(f"{name}: {error}") from error


def _fluid(scene: SceneFile, table: Any, shape: Any) -> list[Body]:
    if table.particles:
        positions, velocities, rigidity = table.particles.load()
        if rigidity is not None and (rigidity > 0).any():
            raise ValueError(f"{table.particles.file}: expected rigidity 0 in a fluid, got others")
        return [_body(scene, table, "fluid", positions, velocities)]
    return [_body(scene, table, "fluid", fill(shape, scene.fluid_spacing))]


def _source(table: Any) -> Any:
    """The file of particles or voxels that a table has instead of a shape."""
    return getattr(table, "particles", None) or getattr(table, "tomography", None)


def _empty(table: Any, maker: Any) -> Body:
    """A phase whose particles emitters, vessels or `Simulation.add` bring."""
    kind = {_fluid: "fluid", _solid: "tissue", _rigid: "rigid", _boundary: "boundary"}[maker]
    nowhere = np.empty((0, 3))
    return Body(name=table.name, kind=kind, table=table, positions=nowhere, velocities=nowhere)


def _solid(scene: SceneFile, table: Any, shape: Any) -> list[Body]:
    young = table.young or float(young_of_rigidity(table.rigidity or BRAIN))
    velocities = rigidity = None
    n_white = 0
    if table.particles:
        positions, velocities, rigidity = table.particles.load()
    elif table.tomography:
        positions, white = table.tomography.load(scene.spacing)
        positions, n_white = positions[np.argsort(white, kind="stable")], int(white.sum())
    else:
        positions = fill(shape, scene.spacing)
    body = _body(scene, table, "tissue", positions, velocities)
    fixed = np.zeros(len(positions), bool)
    for i, region in enumerate(table.fixed):
        away = region.shape.distance(positions)
        held = away <= 1e-6 * scene.spacing
        if not held.any():
            problem = f"fixed[{i}]: expected a shape with particles of the solid in it, got none"
            if away.min() > scene.spacing / 2:
                raise ValueError(problem)
            at = f"at a spacing of {scene.spacing:g} m: nothing is fixed there"  # a coarse look
            warnings.warn(f"{table.name}: {problem} {at}", stacklevel=2)
        fixed |= held
    body.young, body.fixed, body.n_white = np.full(len(positions), young), fixed, n_white
    if rigidity is None:
        return [body]
    return _by_rigidity(scene, body, rigidity)


def _by_rigidity(scene: SceneFile, body: Body, rigidity: np.ndarray) -> list[Body]:
    """Tissue of its own stiffness, fixed tissue and fluid, by each particle's rigidity."""
    liquid = rigidity == 0
    body.young = young_of_rigidity(rigidity)
    body.fixed |= rigidity == 1
    solid = ~liquid
    parts = [Body(
        name=body.name, kind="tissue", table=body.table, positions=body.positions[solid],
        velocities=body.velocities[solid], young=body.young[solid], fixed=body.fixed[solid],
    )]  # fmt: skip
    if liquid.any():
        if not scene.fluids:
            n = int(liquid.sum())
            raise ValueError(f"expected a fluid for the {n} particles of rigidity 0, got none")
        parts.append(Body(
            name=scene.fluids[0].name, kind="fluid", table=scene.fluids[0],
            positions=body.positions[liquid], velocities=body.velocities[liquid],
        ))  # fmt: skip
    return parts


def _rigid(scene: SceneFile, table: Any, shape: Any) -> list[Body]:
    body = _body(scene, table, "rigid", fill(shape, scene.spacing))
    arms = body.positions - body.positions.mean(axis=0)
    body.velocities += np.cross(np.asarray(table.spin), arms)
    return [body]


def _boundary(scene: SceneFile, table: Boundary, shape: Any) -> list[Body]:
    domain = np.asarray(scene.domain.lo), np.asarray(scene.domain.hi)
    positions = surface(shape, scene.spacing, table.hollow, table.open, domain)
    return [_body(scene, table, "boundary", positions)]


def _body(scene: SceneFile, table: Any, kind: str, positions: np.ndarray, velocities: Any = None) -> Body:
    if not len(positions):
        raise ValueError(f"expected particles, got none at a spacing of {scene.spacing:g} m")
    lo, hi = scene.domain.lo, scene.domain.hi
    reach = NEAR * scene.spacing if kind == "boundary" else 0.0
    moves = getattr(table, "motion", None) is not None  # and may come in
    near = (positions >= np.subtract(lo, reach)) & (positions <= np.add(hi, reach))
    away = np.logical_not(near.all(axis=1))
    if not moves and (away.all() or (away.any() and kind != "boundary")):
        middle = ", ".join(f"{x:g}" for x in positions[away].mean(axis=0))
        got = "all" if away.all() else f"{away.sum():,} of {len(away):,}"
        expected = "expected particles in the domain"
        raise ValueError(f"{expected}, got {got} outside of it, at ({middle})")
    if velocities is None:
        velocities = getattr(table, "velocity", (0.0, 0.0, 0.0))
    velocities = np.array(np.broadcast_to(velocities, positions.shape), np.float64)
    return Body(name=table.name, kind=kind, table=table, positions=positions, velocities=velocities)


def _shape(table: Any) -> Any:
    """The one shape of a body, loaded where it is a file's."""
    _, shape = shape_of(table)
    return shape.load() if hasattr(shape, "load") else shape


def scene_of_particles(particles: Particles) -> dict[str, Any]:
    """A scene of a fluid in its own box with walls, and as much room again above it: fluid that
    fills its box cannot flow. The particles themselves are not in it."""
    d = float(np.median(measure_spacing(particles.positions, k=3)))
    lo, hi = (corner.astype(float) for corner in particles.bounds())
    hi[2] += hi[2] - lo[2] + d
    domain = {"lo": lo - d / 2, "hi": hi + d / 2, "walls": True}
    return {"spacing": d, "domain": domain, "fluids": [{"name": "fluid"}]}
