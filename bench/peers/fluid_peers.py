"""One function a program: DFSPH from a case's particles up to a time, for fluids.py.

Each takes a case (fluid, velocity, walls, spacing, ...), what the run shall be (error, threads,
seconds), and a folder for its own files. Each returns the final positions and velocities in the
case's order, steps, iterations, processor time and wall time of the steps alone.
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
from fluid_judge import GRAVITY, REST_DENSITY, wall_factor

sys.path.insert(0, str(Path(__file__).parents[2]))

MOST_ITERATIONS = 100  # SPlisHSPlasH's default
PACKAGES = {"globule": ["globule"], "SPlisHSPlasH": ["pysplishsplash"], "SPlisHSPlasH tight": ["pysplishsplash"]}
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def simulation(recipe: dict, error: float, threads: int):
    """globule's simulation of a case."""
    from bench import simulate

    if recipe["splash"]:
        return simulate.splash(recipe["splash"], error, "cpu", threads)
    return simulate.column(recipe["n"], error, "cpu", threads)


def length(rest: float, dt: float) -> float:
    """A step that leads to the end without a tiny last one; s."""
    return rest if rest <= 1.0001 * dt else rest / 2 if rest < 2 * dt else dt


def fluid_rows(sim) -> np.ndarray:
    """(N,) whether a particle of globule's simulation is fluid."""
    kinds = np.array([phase.kind for phase in sim.phases.values()])
    return kinds[np.asarray(sim.particles.attributes["phase"]).astype(int)] == "fluid"


def globule(case, run: dict, folder: Path) -> dict:
    sim = simulation(json.loads(str(case["recipe"])), run["error"], run["threads"])
    rows = fluid_rows(sim)
    if not np.array_equal(np.asarray(sim.positions)[rows], case["fluid"]):
        raise ValueError("expected the case's particles, got others")
    reports = []
    wall, cpu = time.perf_counter(), time.process_time()
    while (rest := run["seconds"] - sim.time) > 1e-6 * run["seconds"]:
        reports.append(sim.step(length(rest, sim.dt)))
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {
        "positions": np.asarray(sim.positions)[rows],
        "velocities": np.asarray(sim.velocities)[rows],
        "steps": len(reports),
        "time": sim.time,
        "iterations": np.mean([r.iterations for r in reports]),
        "divergence_iterations": np.mean([r.divergence_iterations for r in reports]),
        "halved": sum(r.n_halved for r in reports),
        "cpu": cpu,
        "wall": wall,
    }


def splishsplash(case, run: dict, folder: Path, tight: bool = False) -> dict:
    """The same particles, velocities and walls, with Akinci's walls and steps as in its scenes.

    The volumes of the walls are globule's: with its own, 1 / sum W, the lattice that touches the
    walls is too dense and bursts. The velocities' tolerance is its default, 0.1 % of the density in
    a step, or globule's if tight.
    """
    import pysplishsplash as sph

    base = _splishsplash_begun(sph, case, run, folder)
    sim, clock = sph.Simulation.getCurrent(), sph.TimeManager.getCurrent()
    solver, model = sim.getTimeStep(), sim.getFluidModel(0)
    field = {k: np.asarray(model.getFieldBuffer(k)) for k in ("id", "position", "velocity")}
    if not np.array_equal(field["position"], case["fluid"][field["id"]]):
        raise ValueError("expected the case's particles, got others")
    field["velocity"][:] = case["velocity"][field["id"]]
    walls = sim.getBoundaryModel(0)
    if walls.numberOfParticles() != len(case["walls"]):
        raise ValueError(f"expected {len(case['walls'])} particles of walls, got {walls.numberOfParticles()}")
    for i in range(walls.numberOfParticles()):
        walls.setVolume(i, walls.getVolume(i) * wall_factor())
    # A scene's tolerance does not reach the solver, which keeps its own defaults.
    velocities = min(run["error"] / 10, 2e-4) if tight else 1e-3
    for key, share in ((solver.MAX_ERROR, run["error"]), (solver.MAX_ERROR_V, velocities)):
        solver.setValueFloat(key, 100 * share)
        if abs(solver.getValueFloat(key) / (100 * share) - 1) > 1e-5:
            raise ValueError("the solver did not take its tolerance")

    kinds, counts = (solver.SOLVER_ITERATIONS, solver.SOLVER_ITERATIONS_V), []
    wall, cpu = time.perf_counter(), time.process_time()
    while (rest := run["seconds"] - clock.getTime()) > 1e-6 * run["seconds"]:
        dt = clock.getTimeStepSize()
        if rest < 2 * dt:  # the step after this one is chosen in this one
            clock.setTimeStepSize(length(rest, dt))
            sim.setValueFloat(sim.CFL_MAX_TIMESTEPSIZE, length(rest, dt))
        base.timeStepNoGUI()
        counts.append([solver.getValueUInt(kind) for kind in kinds])
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu

    order = np.argsort(np.asarray(model.getFieldBuffer("id")))
    iterations, divergence_iterations = np.mean(counts, axis=0)
    return {
        "positions": np.asarray(model.getFieldBuffer("position"))[order],
        "velocities": np.asarray(model.getFieldBuffer("velocity"))[order],
        "steps": len(counts),
        "time": clock.getTime(),
        "iterations": iterations,
        "divergence_iterations": divergence_iterations,
        "unsolved": int((np.array(counts) >= MOST_ITERATIONS).any(1).sum()),
        "cpu": cpu,
        "wall": wall,
    }


def _splishsplash_begun(sph, case, run: dict, folder: Path):
    """SPlisHSPlasH at time 0, ready for its first step."""
    (folder / "triangle.obj").write_text(TRIANGLE)  # a body needs a mesh; its samples are a file
    still = {"translation": [0, 0, 0], "scale": [1, 1, 1], "rotationAxis": [1, 0, 0]}
    still["rotationAngle"] = 0
    water = {"id": "Fluid", "density0": REST_DENSITY, "viscosityMethod": 0}
    scene = {
        "Configuration": {
            "particleRadius": float(case["spacing"]) / 2,
            "simulationMethod": 4,  # DFSPH
            "boundaryHandlingMethod": 0,  # Akinci 2012
            "gravitation": [0, -GRAVITY, 0],
            "cflMethod": 1,
            "cflFactor": 1,
            "cflMaxTimeStepSize": 0.005,
        },
        "Materials": [{**water, "maxEmitterParticles": 0}],
        "FluidModels": [{"id": "Fluid", "particleFile": "fluid.bgeo", **still}],
        "RigidBodies": [{"geometryFile": "triangle.obj", "particleFile": "walls.bgeo", "isWall": True, **still}],
    }
    (folder / "scene.json").write_text(json.dumps(scene))
    base = sph.Exec.SimulatorBase()
    base.init(
        sceneFile=str(folder / "scene.json"),
        useGui=False,
        initialPause=False,
        useCache=False,
        outputDir=str(folder / "out"),
        stopAt=run["seconds"],
    )
    base.initSimulation()
    # A run reads the walls before its first step; one that starts after its end makes no step.
    clock = sph.TimeManager.getCurrent()
    clock.setTime(2 * run["seconds"] + 1)
    base.runSimulation()
    clock.setTime(0.0)
    return base


PEERS = {"globule": globule, "SPlisHSPlasH": splishsplash, "SPlisHSPlasH tight": partial(splishsplash, tight=True)}
