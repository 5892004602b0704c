"""Checks of a scene's keys together: bodies outside of the domain or too small for a particle,
lengths that single precision cannot tell apart, runs that would never end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from .._base.settings import Path, Problem
from .materials import MOST_SUBSTEPS, substep_rate
from .rigidity import young_of_rigidity
from .sampling import FACES

MOST_REACH = 2**17  # spacings from the origin: there a float32 tells 1/128 of one
OVERFULL = 0.1  # mean compression that tells at once that fluid has no room
NEAR = 2.0  # spacings beside the domain: a wall there still pushes what is in it
MOST_STEPS = 1_000_000  # a frame
# Of densities: beside a particle that is much lighter, the pressure solver's step is too long; in a
# box without free surface a ratio of 100 ends with 1e9 m/s.
MOST_RATIO = 50.0
_REMEDIES = {"max_dt": "raise it", "viscosity": "lower it or set implicit = true"}


def check(scene: Any) -> None:
    """Raise Problem at the key that is wrong."""
    frame = 1 / scene.output.fps
    if scene.seconds < frame * (1 - 1e-6):
        expected = f"expected at least a frame, {frame:g} s"
        raise Problem(("seconds",), f"{expected}, got {scene.seconds:g}")
    lo, hi = np.asarray(scene.domain.lo), np.asarray(scene.domain.hi)
    if (hi - lo).min() < 2 * scene.spacing:
        expected = f"expected less than half the domain, {(hi - lo).min() / 2:g} m"
        raise Problem(("spacing",), f"{expected}, got {scene.spacing:g}")
    far = float(np.abs([lo, hi]).max())
    if far > MOST_REACH * scene.spacing:
        expected = f"expected at least {far / MOST_REACH:.3g} in a domain up to {far:g} m"
        raise Problem(("spacing",), f"{expected} from the origin, got {scene.spacing:g}")
    for path, first, last, body in _extents(scene):
        _check_inside(path, first, last, scene.domain)
        if body:
            spacing = scene.fluid_spacing if path[0] == "fluids" else scene.spacing
            _check_width(path, first, last, spacing)
    for i, table in enumerate(scene.boundaries):
        name, shape = shape_of(table)
        if hasattr(shape, "bounds"):
            first, last = shape.bounds()
            if table.motion is None:
                reach = NEAR * scene.spacing
                _check_inside(("boundaries", i, name), first, last, scene.domain, reach)
            _check_width(("boundaries", i, name), first, last, scene.spacing)
    for i, vessel in enumerate(scene.vessels):
        _check_course(("vessels", i, "path"), vessel, scene.solids)
    for i, emitter in enumerate(scene.emitters):
        _check_way(("emitters", i, "direction"), emitter, scene)
    for path, step in _steps(scene):
        _check_step(path, step, frame)
    for i, solid in enumerate(scene.solids):
        if solid.model != (model := scene.solids[0].model):
            expected = f"expected {model!r} as of solids[0], since all tissue has one model"
            raise Problem(("solids", i, "model"), f"{expected}, got {solid.model!r}")
        key = "young" if solid.young is not None else "rigidity"
        if (given := getattr(solid, key)) is not None:
            young = float(given if key == "young" else young_of_rigidity(given))
            rate = substep_rate(young, solid.poisson, solid.density, scene.spacing, solid.model)
            check_substeps(("solids", i, key), rate, scene.solver.max_dt, frame)
    check_densities({
        (kind, i, "density"): table.density
        for kind in ("fluids", "solids")
        for i, table in enumerate(getattr(scene, kind))
    })  # fmt: skip


def check_densities(densities: dict[Path, float]) -> None:
    """Raise Problem at a density too far from another one; densities: of fluids and tissue."""
    for path, density in reversed(densities.items()):
        for other in densities.values():
            if max(density, other) > (1 + 1e-9) * MOST_RATIO * min(density, other):
                expected = f"expected {other / MOST_RATIO:g} to {other * MOST_RATIO:g} kg/m³"
                beside = f"beside a density of {other:g} kg/m³ (a ratio of at most {MOST_RATIO:g})"
                raise Problem(path, f"{expected} {beside}, got {density:g}")


def _check_step(path: Path, step: float, frame: float) -> None:
    least = frame / MOST_STEPS
    if step < least:
        expected = f"expected steps of at least {least:.3g} s, a millionth of a frame"
        remedy = _REMEDIES.get(path[-1], "lower it")
        raise Problem(path, f"{expected}, got a value that needs {step:.3g} s; {remedy}")


def check_substeps(path: Path, rate: float, longest: float, frame: float) -> None:
    """Raise Problem where a modulus needs so many substeps, `rate` a second, that a run would not
    end or that no checkpoint of it could be read. longest: step, s; frame: s between two images."""
    for what, seconds, most in (("step", longest, MOST_SUBSTEPS), ("frame", frame, MOST_STEPS)):
        if rate * seconds > most:
            expected = f"expected at most {most:,} substeps in a {what} of {seconds:.3g} s"
            got = f"got a modulus that needs {rate * seconds:.3g}"
            raise Problem(path, f"{expected}, {got}; lower it, or take a larger spacing")


def check_material(phase: Any, spacing: float, frame: float) -> None:
    """Raise Problem where a phase of a running simulation needs steps that are too short. frame: s
    between two images."""
    if phase.kind in ("fluid", "tissue"):
        for name, step in steps_of_material(phase, spacing):
            _check_step((f"phases[{phase.name!r}]", name), step, frame)


def check_emitter(name: str, emitter: Any, spacing: float, frame: float) -> None:
    """As `check_material`, for an emitter."""
    step = _step_of_emitter(emitter, spacing, 0.4 * spacing)
    _check_step((f"emitters[{name!r}]", "rate"), step, frame)


def _check_inside(path: Path, first: np.ndarray, last: np.ndarray, domain: Any, reach: float = 0.0) -> None:
    lo, hi = domain.bounds()
    if (last < lo - reach).any() or (first > hi + reach).any():
        expected = f"expected a place in the domain, {_corners(lo, hi)}"
        raise Problem(path, f"{expected}, got {_corners(first, last)}")


def _check_width(path: Path, lo: np.ndarray, hi: np.ndarray, spacing: float) -> None:
    width = (hi - lo).min()
    if width < 0.999 * spacing:
        expected = f"expected at least a spacing, {spacing:g} m, in every direction"
        raise Problem(path, f"{expected}, got {width:g}")


def _check_course(path: Path, vessel: Any, solids: list) -> None:
    """Whether a vessel meets its solid, where that is a shape and not a file."""
    solid = next(solid for solid in solids if solid.name == vessel.solid)
    _, shape = shape_of(solid)
    if not hasattr(shape, "bounds"):
        return
    least, share = math.inf, np.linspace(0, 1, 1001)[:, None]
    for a, b in zip(*map(np.asarray, (vessel.path[:-1], vessel.path[1:])), strict=True):
        away = shape.distance((1 - share) * a + share * b).min() - math.dist(a, b) / 2000
        least = min(least, float(away))
    if least > vessel.radius:
        expected = f"expected a course through {solid.name}, {_corners(*shape.bounds())}"
        raise Problem(path, f"{expected}, got one that passes {least:.2g} m beside it")


def _check_way(path: Path, emitter: Any, scene: Any) -> None:
    """Whether what an emitter lets in is not stopped by a wall at once."""
    if not scene.domain.walls:
        return
    for face in FACES:
        axis, sign = "xyz".index(face[1]), 1 if face[0] == "+" else -1
        wall = (scene.domain.hi if sign > 0 else scene.domain.lo)[axis]
        room, steep = sign * (wall - emitter.center[axis]), sign * emitter.direction[axis] > 0.5
        solid = face not in scene.domain.open and face[1] not in scene.domain.periodic
        if solid and steep and room < scene.spacing:
            expected = f"expected a way into the domain, got {_point(emitter.direction)}"
            raise Problem(path, f"{expected}, into its wall {face}, {max(room, 0):.3g} m away")


def _corners(lo: np.ndarray, hi: np.ndarray) -> str:
    return f"{_point(lo)} to {_point(hi)}"


def _point(at: Any) -> str:
    return "(" + ", ".join(f"{x:g}" for x in at) + ")"


def shape_of(table: Any) -> tuple[str, Any]:
    """The key and the shape of a body's table, which may be a file; "" and None without one."""
    for name in ("box", "sphere", "cylinder", "plane", "mesh", "distance"):
        if getattr(table, name, None) is not None:
            return name, getattr(table, name)
    return "", None


def n_places(radius: float, spacing: float) -> float:
    """About how many particles leave an emitter's disc side by side."""
    return max(1.0, math.pi * (max(radius - spacing / 2, 0.0) / spacing) ** 2)


def _extents(scene: Any) -> Iterator[tuple[Path, np.ndarray, np.ndarray, bool]]:
    """Key, corners and whether it is filled with particles, of all that has to be in the domain."""
    for kind in ("fluids", "solids", "rigids", "sinks"):
        for i, table in enumerate(getattr(scene, kind)):
            name, shape = shape_of(table)
            if hasattr(shape, "bounds"):
                yield (kind, i, name), *shape.bounds(), kind != "sinks"
    for i, table in enumerate(scene.emitters):
        reach = table.radius * np.sqrt(np.maximum(0, 1 - np.square(table.direction)))
        yield ("emitters", i, "center"), table.center - reach, table.center + reach, False


def _steps(scene: Any) -> Iterator[tuple[Path, float]]:
    """The longest step that each key allows by itself, as the solver has it: nothing moves farther
    than a share of the spacing."""
    d, solver = scene.spacing, scene.solver
    far = 0.4 * solver.cfl * d
    diagonal = math.dist(scene.domain.lo, scene.domain.hi)
    yield ("solver", "max_dt"), solver.max_dt
    if solver.method == "wcsph" and solver.sound_speed:
        yield ("solver", "sound_speed"), far / solver.sound_speed
    fall = math.sqrt(2 * math.hypot(*scene.gravity) * diagonal)
    if fall:
        yield ("gravity",), far / (11 * fall if solver.method == "wcsph" else fall)
    small = scene.fluid_spacing / d
    for i, fluid in enumerate(scene.fluids):
        for name, step in steps_of_material(fluid, small * d):
            yield ("fluids", i, name), step
    for kind in ("fluids", "solids", "rigids"):
        for i, table in enumerate(getattr(scene, kind)):
            if any(table.velocity):
                share = small if kind == "fluids" else 1.0
                yield (kind, i, "velocity"), share * far / math.hypot(*table.velocity)
    for i, rigid in enumerate(scene.rigids):
        if any(rigid.spin):
            _, shape = shape_of(rigid)
            across = math.dist(*shape.bounds()) if hasattr(shape, "bounds") else diagonal
            yield ("rigids", i, "spin"), far / (math.hypot(*rigid.spin) * across / 2)
    for i, emitter in enumerate(scene.emitters):
        yield ("emitters", i, "rate"), _step_of_emitter(emitter, small * d, small * far)


def steps_of_material(material: Any, d: float) -> Iterator[tuple[str, float]]:
    """Key and longest step, s, of each property that shortens steps; d: the spacing, m."""
    if material.viscosity and not material.implicit:
        yield "viscosity", 0.125 * d * d * material.density / material.viscosity
    if material.surface_tension:
        mass = material.density * d**3
        step = 0.4 * math.sqrt(mass / (2 * math.pi * material.surface_tension))
        yield "surface_tension", step


def _step_of_emitter(emitter: Any, d: float, far: float) -> float:
    """The step in which what leaves goes as far as a step may take it."""
    speed = emitter.rate / (n_places(emitter.radius, d) * d * d)
    return far / speed if speed > 0 else math.inf
