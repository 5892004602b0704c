"""A simulation that runs while it is looked at, cut, pulled and poured into."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..render.camera import Camera
from ..render.frame import Layer, RenderSettings
from ..scene.particles import Particles
from ..scene.scene import Scene
from .overlay import STEEL, Mark
from .scenes import SceneMaker
from .source import Origin, Source, box_corners
from .state import State

LONGEST_PAUSE = 0.25  # s of the clock between two pictures of slow motion
PULL_TIME = 0.05  # s in which what is held comes to the pointer
FASTEST = 2.0  # extents per second, of what is held
MOST_UNDONE = 5  # strokes that can be taken back
UNDO_BYTES = 1 << 30  # of the states kept for that
GRASP = 7  # the number of the pointer's grasp; instruments count from 0


class SimulationSource(Source):
    """simulation: `globule.Simulation`, or anything that steps like it and has `particles`.

    speed: seconds of the simulation per second of the clock, where it is fast enough.
    """

    kind = "simulation"
    unit = "m"

    def __init__(self, name: str, simulation: Any, device: str = "auto", threads: int = 0):
        super().__init__(name)
        self.simulation = simulation
        self._device, self._threads = device, threads
        self.running, self.speed = False, 1.0
        self.cut_depth: float | None = None  # m; None: all through
        self._before: list[dict[str, Any]] = []  # each of the last strokes
        self._stepping = False
        self.report: Any = None
        self.n_cut = 0  # bonds, by the last stroke
        self.by_hand = False  # whether somebody has cut, pulled, moved or switched something
        self._own: Particles | None = None  # a copy, for colours of values
        self._own_version = -1
        self._wanted_steps = 0
        self._hold = np.zeros(3)  # where the held matter is, world
        self._held: np.ndarray | None = None  # its ids
        self._target: np.ndarray | None = None  # where the pointer is, world
        self._ground: float | None = None  # height, where the scene says it
        self.maker = SceneMaker(device, threads)
        self.has_tissue = self._has_bonds()
        self._look()
        self._note()

    def _has_bonds(self) -> bool:
        return bool(getattr(getattr(self.simulation, "tissue", None), "n_bonds", 0))

    def _look(self) -> None:
        """As the simulation's scene file has it."""
        settings = getattr(self.simulation, "settings", None)
        gravity = getattr(settings, "gravity", None)
        if gravity is not None and np.linalg.norm(gravity) > 0:
            self.up = tuple((-np.asarray(gravity, float) / np.linalg.norm(gravity)).tolist())
        view = getattr(getattr(self.simulation, "file", None), "view", None)
        if view is not None:
            self.up, self.preset, self._ground = tuple(view.up), view.look, view.ground
            if view.speeds is not None:
                low, high = view.speeds
                self.settings = {
                    "color__by": "velocity",
                    "color__automatic": False,
                    "color__low": low,
                    "color__high": high,
                }
            if view.eye is not None:
                self.camera = Camera(view.eye, view.look_at, view.up, view.fov)

    # What is seen

    def preset_settings(self, name: str, scene: Scene, up: Any) -> RenderSettings:
        settings = super().preset_settings(name, scene, up)
        if self._ground is None or settings.ground is None:
            return settings
        return replace(settings, ground=replace(settings.ground, height=self._ground))

    def particles(self) -> Particles:
        if self._own_version != self.version or self._own is None:
            self._own, self._own_version = self.simulation.particles, self.version
        return self._own

    def layers(self, state: State) -> list[Layer]:
        surface = state.surface
        scene = getattr(self.simulation, "scene", None)
        plain = surface.support is None and surface.root == "exact" and not state.color.by
        if scene is None or not plain or surface.kernel != scene.kernel:
            return [Layer(self.maker.scene(self.particles(), state))]
        if surface.threshold is not None:
            scene.threshold = surface.threshold
        self.maker.show(scene)
        return [Layer(scene)]

    def origin(self, state: State) -> Origin:
        name = self.files[0] if self.files else "scene.toml"
        code = [f"simulation = gb.Simulation({name!r})"]
        n, passed = getattr(self.simulation, "n_steps", 0), []
        if n:
            code += [f"for _ in range({n}):", "    simulation.step()"]
            passed = [f"the {self.simulation.time:.4g} s that have passed"]
        left = ["what was done by hand"] if self.by_hand else []
        return Origin(
            [name], [*code, "particles = simulation.particles"], left=passed + left, lives=True
        )

    def tissue_extent(self) -> float:
        """m, the longest side of the box around all tissue; 0 where there is none."""
        sim = self.simulation
        if not self.has_tissue:
            return 0.0
        tissue = [p.kind == "tissue" for p in sim.phases.values()]
        return float(np.ptp(sim.positions[np.asarray(tissue)[sim.arrays.phase]], axis=0).max())

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        domain = getattr(getattr(self.simulation, "settings", None), "domain", None)
        if domain is None:
            return super().bounds()
        return domain.bounds()

    def outline(self) -> np.ndarray:
        """Around what is shown and the instruments; where there is only fluid, which runs, all the
        domain up to the fluid's top, or up to the emitters that it comes from."""
        sim = self.simulation
        shown = getattr(sim, "shown_particles", None)
        if shown is None or not len(shown):
            return box_corners(*self.bounds())
        lo, hi = shown.bounds()
        tools = [tool.pose[:3, 3] for tool in getattr(sim, "tools", {}).values()]
        lo, hi = np.min([lo, *tools], axis=0), np.max([hi, *tools], axis=0)
        if not self.has_tissue:
            first, last = (np.array(corner) for corner in self.bounds())
            if not getattr(sim, "emitters", {}):
                axis = int(np.argmax(np.abs(self.up)))
                if self.up[axis] > 0:
                    last[axis] = hi[axis]
                else:
                    first[axis] = lo[axis]
            lo, hi = np.minimum(lo, first), np.maximum(hi, last)
        return box_corners(lo, hi)

    def marks(self) -> list[Mark]:
        """The edges of scalpels, and the tips of other instruments."""
        marks = []
        for name, tool in getattr(self.simulation, "tools", {}).items():
            knife = getattr(tool, "knife", None)
            points = knife.at(tool.pose) if knife is not None else tool.pose[None, :3, 3]
            marks.append(Mark(tuple(map(tuple, points.tolist())), name, STEEL))
        return marks

    def _note(self) -> None:
        """What `status` says; with `lock` held."""
        sim = self.simulation
        self._noted = float(getattr(sim, "time", 0.0)), int(getattr(sim, "n_steps", 0))

    def status(self) -> str:
        time, steps = self._noted
        if not self.running:
            name = "pausing after this step" if self._stepping else "paused"
        elif steps:
            name = "running"
        else:
            name = "running, first step …"
        return f"**{name}** · {time:.4f} s · {steps:,} steps"

    def facts(self) -> dict[str, Any]:
        with self.lock:
            return self._facts()

    def _facts(self) -> dict[str, Any]:
        sim, facts = self.simulation, {"running": "yes" if self.running else "no"}
        for label, name, form in (
            ("time", "time", "{:.4f} s"),
            ("steps", "n_steps", "{:,}"),
            ("time step", "dt", "{:.3g} s"),
        ):
            value = getattr(sim, name, None)
            if value is not None:
                facts[label] = form.format(value)
        if (tissue := getattr(sim, "tissue", None)) is not None:
            facts["pieces"] = f"{tissue.n_pieces:,}"
        for label, name in (
            ("iterations", "iterations"),
            ("compression", "compression"),
            ("bonds", "n_bonds"),
            ("cut", "n_cut"),
            ("escaped", "n_escaped"),
        ):
            value = getattr(self.report, name, None)
            if value is not None:
                facts[label] = f"{value:.3g}" if isinstance(value, float) else str(value)
        return facts

    # Time

    def advance(self, state: State) -> float | None:
        if not self.running and not self._wanted_steps:
            return None
        with self.lock:
            if not self.running and not self._wanted_steps:  # a reset had the lock
                return None
            before = float(getattr(self.simulation, "time", 0.0))
            self._stepping = True
            try:
                self._pull()
                self.report = self.simulation.step()
                self._note()
                self.version += 1
            finally:
                self._stepping = False
            self._wanted_steps = max(0, self._wanted_steps - 1)
        passed = float(getattr(self.simulation, "time", 0.0)) - before
        return min(passed / self.speed, LONGEST_PAUSE) if self.running else 0.0

    def stand_still(self) -> None:
        self.running, self._wanted_steps = False, 0

    def play(self, running: bool) -> None:
        self.running = running

    def step(self) -> None:
        """One step, and then stand still."""
        self.running, self._wanted_steps = False, 1

    def reset(self) -> None:
        with self.lock:
            self.stand_still()
            self.by_hand = False
            self.simulation.reset()
            self._before.clear()
            self._note()
            self.version += 1

    # Instruments

    def cut_along(self, points: list, camera: Camera) -> str:
        """Cut along a stroke on the surface, away from the eye to `cut_depth`, or all through; in
        words what that did."""
        lo, hi = self.bounds()
        through = float(np.linalg.norm(hi - lo))
        with self.lock:
            blade = ribbon(points, camera, self.cut_depth or through, 0.05 * through)
            before = self._state()
            self.n_cut = self.simulation.tissue.cut(blade)
            if not self.n_cut:
                return "The stroke met no tissue."
            self._keep(before)
            self.by_hand = True
            self.version += 1
            pieces = self.simulation.tissue.n_pieces
        return (
            f"**Cut {self.n_cut:,} bonds**, {pieces:,} {'piece' if pieces == 1 else 'pieces'}."
            + ("" if self.running else " Run to see it open.")
        )

    def _state(self) -> dict[str, Any]:
        """What `undo` goes back to."""
        sim = self.simulation
        if not hasattr(sim, "arrays"):
            return {}
        emitters = {
            name: (e.emitted, e._volume) for name, e in getattr(sim, "emitters", {}).items()
        }
        return {
            "arrays": sim.arrays.state(),
            "rows": len(sim.record.diagnostics),
            "emitters": emitters,
            "counts": (sim.record.n_removed, sim.record.n_cut),
        }

    def _keep(self, state: dict[str, Any]) -> None:
        self._before = [*self._before, state][-MOST_UNDONE:] if state else []
        sizes = [sum(a.nbytes for a in one["arrays"].values()) for one in self._before]
        while sum(sizes) > UNDO_BYTES:
            del sizes[0], self._before[0]

    def undo(self) -> str:
        """Back to just before the last stroke that cut something; in words what that did."""
        with self.lock:
            if not self._before:
                raise ValueError(
                    "undo: expected a cut made with the tool Cut, got none (the last 5 are kept)"
                )
            state, sim = self._before.pop(), self.simulation
            sim.arrays.set_state(state["arrays"])
            del sim.record.diagnostics[state["rows"] :]
            sim.record.n_removed, sim.record.n_cut = state["counts"]
            for tool in sim.tools.values():
                tool.start(sim.time)
            for name, (emitted, volume) in state["emitters"].items():
                sim.emitters[name]._emitted, sim.emitters[name]._volume = emitted, volume
            self._held = self._target = None
            self._note()
            self.version += 1
            return f"Undone: back at {sim.time:.4f} s, before the cut."

    def move(self, name: str, pose: np.ndarray) -> None:
        """Put an instrument somewhere: (4, 4) world_from_instrument, or its tip (3,); the next step
        goes there."""
        with self.lock:
            self.simulation.tools[name].move_to(pose)
            self.by_hand = True

    def follow_keys(self, name: str) -> None:
        """Let an instrument move as its scene says again."""
        with self.lock:
            self.simulation.tools[name].start(self.simulation.time)

    def suction(self) -> str | None:
        """The name of the instrument that takes fluid away, where the scene has one."""
        tools = getattr(self.simulation, "tools", {})
        return next((name for name, tool in tools.items() if tool.kind == "suction"), None)

    def suck(self, hand: Any, phase: str, here: tuple) -> None:
        """Hold the suction's tip at what is under the pointer; afterwards it follows its keys."""
        name = self.suction()
        if phase == "end":
            self.follow_keys(name)
            return
        found = hand.on_surface([here])
        if found:
            self.move(name, np.asarray(found[0]))

    def grasp(self, hand: Any, phase: str, start: tuple, here: tuple) -> None:
        """Take hold of what is under the pointer, and pull it along the picture's plane; the next
        step does it."""
        if phase == "end":
            self._target = None
            return
        camera = hand.client.camera
        if self._target is None:
            self._hold = np.asarray(hand.on_surface([start])[0], np.float64)
        origin, direction = camera.ray(hand.client.frame.size, here)
        forward = camera.frame((1, 1))[1]
        depth = float((self._hold - origin) @ forward)
        self._target = origin + depth / float(direction @ forward) * direction

    def _pull(self) -> None:
        """Before a step: move what is held towards the pointer, or let it go."""
        sim, target = self.simulation, self._target
        if target is None:
            if self._held is not None and self._has_bonds():
                sim.tools.release(GRASP)
            self._held = None
            return
        spacing = float(sim.settings.spacing)
        if self._held is None:
            self.by_hand = True
            near = np.linalg.norm(sim.positions - self._hold, axis=1) < 3 * spacing
            self._held = sim.ids[near]
            if self._has_bonds():
                sim.tools.grasp(self._hold, 3 * spacing, GRASP)
        if self._has_bonds():
            dt = sim.dt
            most = self._extent() * FASTEST
            velocity = (target - self._hold) / PULL_TIME
            velocity *= min(1.0, most / max(float(np.linalg.norm(velocity)), 1e-30))
            sim.tools.move_grasp(GRASP, velocity, (0.0, 0.0, 0.0), self._hold)
            self._hold = self._hold + velocity * dt
            return
        ids = np.intersect1d(self._held, sim.ids)
        if not len(ids):
            return
        at = np.searchsorted(sim.ids, ids)
        away = target - sim.positions[at].mean(axis=0)
        speed = sim.velocities[at].mean(axis=0)
        mass = np.median([p.density for p in sim.phases.values()]) * spacing**3
        force = mass * (away / PULL_TIME - speed) / PULL_TIME
        sim.steer.apply_force(np.broadcast_to(force, (len(ids), 3)).astype(np.float32), ids=ids)

    def _extent(self) -> float:
        lo, hi = self.bounds()
        return float(np.max(hi - lo))


def ribbon(points: list, camera: Camera, depth: float, above: float) -> np.ndarray:
    """A blade's way as triangles (M, 3, 3), world: a stroke drawn on the surface, swept along the
    rays of the eye from a little above it to some depth below."""
    line = np.asarray(points, np.float64)
    keep = np.append(True, np.linalg.norm(np.diff(line, axis=0), axis=1) > 0)
    line = line[keep]
    if len(line) < 2:
        raise ValueError("cut: expected a line, got a point")
    away = camera.towards(line)
    top, bottom = line - above * away, line + depth * away
    a, b, c, d = top[:-1], top[1:], bottom[:-1], bottom[1:]
    return np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.float32)
