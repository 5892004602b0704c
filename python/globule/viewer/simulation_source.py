"""A simulation that runs while a person watches, cuts and pulls."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .._base.arrays import box_corners, on_gpu
from ..data.attributes import attribute_names
from ..data.particles import Particles
from ..pieces.scene import Scene
from ..render.camera import Camera
from ..render.layers import Layer
from ..render.settings import RenderSettings
from ..scene.mesh import Mesh
from .forces import PULL, newtons
from .layers import hidden
from .overlay import STEEL, Mark
from .past import Past, Strokes, forget_rows, restore, taken
from .scenes import SceneMaker
from .simulation_facts import facts_of
from .source import Origin, Source
from .state import State
from .stroke import ribbon

LONGEST_PAUSE = 0.25  # s between two steps in slow motion
PULL_TIME = 0.05  # s in which held matter reaches the pointer
FASTEST = 2.0  # of held matter, extents of the domain per second
GRASP = 7  # the number of the pointer's grasp; instruments count from 0


class SimulationSource(Source):
    """A running simulation.

    Args:
        name: for titles.
        simulation: `globule.Simulation`, or an object with `step()` and `particles`.
        device, threads: as for `Scene`, for colored particles.

    Attributes:
        running: steps are taken.
        speed: upper limit of simulated seconds per second.
        cut_depth: m below the surface that a stroke cuts; None: all through.
        n_cut: bonds that the last stroke cut.
        by_hand: the person has cut, pulled, moved or switched something.
    """

    kind = "simulation"
    unit = "m"

    def __init__(self, name: str, simulation: Any, device: str = "auto", threads: int = 0):
        super().__init__(name)
        self.simulation = simulation
        self._device, self._threads = device, threads
        self.running, self.speed = False, 1.0
        self.cut_depth: float | None = None
        self._strokes = Strokes()
        self._past = Past()
        self._wanted_place: int | None = None  # step to go to
        self._behind = False  # it has gone back, and not on since
        self._stepping = False
        self.report: Any = None
        self.n_cut = 0
        self.by_hand = False
        self._own: Particles | None = None  # a copy, for colors of values
        self._fluid: tuple[Particles, Particles] | None = None  # all, and the shown ones
        self._own_version = -1
        self._wants_step = False
        self._hold = np.zeros(3)  # place of the held matter, world
        self._held: np.ndarray | None = None  # its ids
        self._target: np.ndarray | None = None  # place of the pointer, world
        self._pulled: float | None = None  # N, that the hand felt in the last step
        self._ground: float | None = None  # height, if the scene has one
        self.has_foam = bool(getattr(getattr(simulation, "foam", None), "on", False))
        if self.has_foam:
            device = simulation.scene.device.name  # all layers of an image are on one device
        self.maker = SceneMaker(device, threads)
        self.has_tissue = self._has_bonds()
        self._look()
        self._note()

    def _has_bonds(self) -> bool:
        return bool(getattr(getattr(self.simulation, "tissue", None), "n_bonds", 0))

    def _look(self) -> None:
        """Take direction, preset and camera from the simulation's scene file."""
        settings = getattr(self.simulation, "settings", None)
        gravity = getattr(settings, "gravity", None)
        if gravity is not None and np.linalg.norm(gravity) > 0:
            self.up = tuple((-np.asarray(gravity, float) / np.linalg.norm(gravity)).tolist())
        view = getattr(getattr(self.simulation, "file", None), "view", None)
        if view is not None:
            self.up, self.preset, self._ground = tuple(view.up), view.look, view.ground
            self.fov = view.fov
            if view.speeds is not None:
                ends = dict(zip(("color__low", "color__high"), view.speeds, strict=True))
                self.settings = {"color__by": "speed", "color__automatic": False, **ends}
            if view.eye is not None:
                self.camera = Camera(view.eye, view.look_at, view.up, view.fov)

    # Content

    def preset_settings(self, name: str, scene: Scene | Mesh, up: Any) -> RenderSettings:
        """The settings of a preset, with the ground of the scene file."""
        settings = super().preset_settings(name, scene, up)
        if self._ground is None or settings.ground is None:
            return settings
        return replace(settings, ground=replace(settings.ground, height=self._ground))

    def particles(self) -> Particles:
        """A copy of the particles of the current step."""
        if self._own_version != self.version or self._own is None:
            self._own, self._own_version = self.simulation.particles, self.version
        return self._own

    def color_names(self) -> list[str]:
        """As for every source, of the last copy: the page must not wait for a step in progress."""
        return attribute_names(self.particles() if self._own is None else self._own)

    def layers(self, state: State) -> list[Layer]:
        """The simulation's own scene if the settings allow, and foam. The caller holds `lock`."""
        if not self._shows_own(state):
            return [Layer(self.maker.scene(self._drawn(state), state)), *self._foam(state)]
        scene = self.simulation.scene
        self.maker.show(scene)
        return [Layer(scene), *self._foam(state)]

    def _foam(self, state: State) -> list[Layer]:
        """The layer of the foam, as images of `globule simulate` show it; none while there is none,
        where it is hidden, and with the thesis's tracing, which cannot trace it."""
        if not self.has_foam or 1 in hidden(state) or state.surface.root != "exact":
            return []
        foam = self.simulation.foam
        return [foam.layer()] if len(foam) else []

    def _shows_own(self, state: State) -> bool:
        """Whether the settings allow the simulation's own scene."""
        surface = state.surface
        scene = getattr(self.simulation, "scene", None)
        plain = (surface.support, surface.root, surface.threshold) == (None, "exact", None)
        plain = plain and not state.color.by and not (self.has_tissue and surface.shape == "balls")
        return scene is not None and plain and surface.kernel == scene.kernel and not self.is_smooth(state)

    def is_smooth(self, state: State) -> bool:
        """Whether one smooth surface is around a copy of all that is shown."""
        if state.surface.shape != "auto":
            return state.surface.shape == "smooth"
        return not self.has_tissue and self.maker.shape(self._shown(), state) == "smooth"

    def _drawn(self, state: State) -> Particles:
        return self._shown() if self.is_smooth(state) else self.particles()

    def _shown(self) -> Particles:
        """The particles that are not hidden: of a fluid in a tank, the fluid's."""
        everything = self.particles()
        if self._fluid is None or self._fluid[0] is not everything:
            weight = everything.weight
            some = np.ndim(weight) == 1 and not on_gpu(weight) and not np.all(weight)
            shown = everything[np.asarray(weight) > 0] if some else everything
            self._fluid = everything, shown
        return self._fluid[1]

    def origin(self, state: State) -> Origin:
        """The scene file, with as many steps as have been taken."""
        name = self.files[0] if self.files else "scene.toml"
        code = [f"simulation = gb.Simulation({name!r})"]
        particles = "shown_particles" if self.is_smooth(state) else "particles"
        n, passed = getattr(self.simulation, "n_steps", 0), []
        if n:
            code += [f"for _ in range({n}):", "    simulation.step()"]
            passed = [f"the simulated {self.simulation.time:.4g} s"]
        left = ["changes by hand"] if self.by_hand else []
        beside = ["simulation.foam.layer()"] if self._foam(state) else []
        common: dict[str, Any] = {"left": passed + left, "lives": True, "beside": beside}
        if self._shows_own(state):
            return Origin([name], code, scene="simulation.scene", **common)
        return Origin([name], [*code, f"particles = simulation.{particles}"], **common)

    def tissue_extent(self) -> float:
        """The longest side of the box around all tissue, m; 0 without tissue."""
        sim = self.simulation
        if not self.has_tissue:
            return 0.0
        tissue = [p.kind == "tissue" for p in sim.phases.values()]
        return float(np.ptp(sim.positions[np.asarray(tissue)[sim.arrays.phase]], axis=0).max())

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of the domain, m."""
        domain = getattr(getattr(self.simulation, "settings", None), "domain", None)
        if domain is None:
            return super().bounds()
        return domain.bounds()

    def outline(self) -> np.ndarray:
        """Points (M, 3), m, for a camera to show: particles and instruments.

        Without tissue: the whole floor of the domain, up to the top of the fluid or the emitters.
        """
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
        """The blades of scalpels and the tips of other instruments."""
        marks = []
        for name, tool in getattr(self.simulation, "tools", {}).items():
            knife = getattr(tool, "knife", None)
            points = knife.at(tool.pose) if knife is not None else tool.pose[None, :3, 3]
            marks.append(Mark(tuple(map(tuple, points.tolist())), name, STEEL))
        return marks

    def _note(self) -> None:
        """Remember time and steps for `status`. The caller holds `lock`."""
        sim = self.simulation
        self._noted = float(getattr(sim, "time", 0.0)), int(getattr(sim, "n_steps", 0))

    @property
    def place(self) -> tuple[int, int]:
        """The step of now, and the last step that `go_to` can reach; never waits for `lock`."""
        return self._noted[1], max(self._noted[1], self._past.last)

    def status(self) -> str:
        """Running or paused, time and steps."""
        time, steps = self._noted
        if not self.running:
            name = "pausing after this step" if self._stepping else "paused"
        elif steps:
            name = "running"
        else:
            name = "running, first step …"
        return f"**{name}** · {time:.4f} s · {steps:,} {'step' if steps == 1 else 'steps'}"

    def facts(self) -> dict[str, Any]:
        """Time, steps and the report of the last step."""
        with self.lock:
            return facts_of(self.simulation, self.report, self.running)

    # Time

    def advance(self, state: State) -> float | None:
        """Take one step if the simulation runs or `step` was called; or go where `go_to` says."""
        if self._wanted_place is not None:
            return self._go()
        if not self.running and not self._wants_step:
            return None
        with self.lock:
            if not self.running and not self._wants_step:  # after a reset
                return None
            before = float(getattr(self.simulation, "time", 0.0))
            self._stepping, self._wants_step = True, False  # a `step` from now on asks for one more
            try:
                self._past.note(self.simulation)
                self._go_on()
                self._pull()
                self.report = self.simulation.step()
                self._feel()
                self._note()
                self.version += 1
            finally:
                self._stepping = False
        passed = float(getattr(self.simulation, "time", 0.0)) - before
        return min(passed / self.speed, LONGEST_PAUSE) if self.running else 0.0

    def stand_still(self) -> None:
        """Pause after the current step."""
        self.running, self._wants_step = False, False

    def play(self, running: bool) -> None:
        """Run, or pause after the current step."""
        self.running = running

    def step(self) -> None:
        """Take one step and pause."""
        self.running, self._wants_step = False, True

    def go_to(self, steps: int) -> None:
        """Pause, and go to the kept state that is nearest to a step."""
        self.stand_still()
        self._wanted_place = steps

    def _go(self) -> float:
        """Do what `go_to` asked for last."""
        with self.lock:
            steps, self._wanted_place = self._wanted_place, None
            if steps is None or not self._past.last:  # after a reset
                return 0.0
            if self.simulation.n_steps > self._past.last:
                self._past.note(self.simulation, always=True)
            self._restore(self._past.near(steps))
            self._behind = True
        return 0.0

    def _go_on(self) -> None:
        """From a state gone back to: what came after it is no longer true. Holds `lock`."""
        if self._behind:
            forget_rows(self.simulation)
            self._strokes.forget_after(self.simulation.n_steps)
            self._behind = False

    def _restore(self, state: dict[str, Any]) -> None:
        """Go to a state that was taken. The caller holds `lock`."""
        restore(self.simulation, state)
        self._jumped()

    def _jumped(self) -> None:
        """Let go of what was held, since time has not just gone on. The caller holds `lock`."""
        self._held = self._target = self._pulled = None
        self._note()
        self.version += 1

    def reset(self) -> None:
        """Go back to the start and pause."""
        with self.lock:
            self.stand_still()
            self.by_hand = False
            self.simulation.reset()
            self._strokes.clear()
            self._past.clear()
            self._wanted_place, self._behind = None, False
            self._jumped()

    # Instruments

    def cut_words(self) -> str:
        """The depth that a stroke will cut, for its label while it is drawn."""
        if not self.has_tissue:
            return ""
        if self.cut_depth is None:
            return "all through"
        factor, unit = self.shown_unit()
        return f"{factor * self.cut_depth:.3g} {unit} deep"

    def shown_unit(self) -> tuple[float, str]:
        """The unit in which the page says lengths of cuts, and what a meter is in it."""
        return (1e3, "mm") if self._extent() < 1.0 else (1.0, "m")

    def cut_along(self, points: list, camera: Camera) -> str:
        """Cut tissue along a stroke, to `cut_depth`, away from the eye.

        Args:
            points: (x, y, z) each, m, on the surface.
            camera: through which the stroke was drawn.

        Returns:
            A sentence for the page.

        Raises:
            ValueError: the stroke is a single point.
        """
        lo, hi = self.bounds()
        through = float(np.linalg.norm(hi - lo))
        with self.lock:
            blade = ribbon(points, camera, self.cut_depth or through, 0.05 * through)
            before = taken(self.simulation)
            self.n_cut = self.simulation.tissue.cut(blade)
            if not self.n_cut:
                return "The stroke met no tissue."
            self._go_on()
            self._strokes.keep(before)
            self._past.note(self.simulation, always=True)
            self.by_hand = True
            self.version += 1
            pieces = self.simulation.tissue.n_pieces
        return f"**Cut {self.n_cut:,} bonds**, {pieces:,} {'piece' if pieces == 1 else 'pieces'}." + (
            "" if self.running else " Press Play to see it open."
        )

    def note_settings(self, n: int) -> None:
        """As for every source."""
        self._strokes.note_settings(n)

    def cut_is_newest(self, n: int) -> bool:
        """As for every source."""
        return self._strokes.is_newest(n)

    def undo(self) -> str:
        """Go back to the state before the last cut; returns a sentence for the page.

        Raises:
            ValueError: there is no cut to undo.
        """
        with self.lock:
            self._restore(self._strokes.pop())
            self._behind = True
            self._go_on()
            self._past.note(self.simulation, always=True)
            return f"Undone: the simulation is at {self.simulation.time:.4f} s, before the cut."

    def move(self, name: str, pose: np.ndarray) -> None:
        """Move an instrument in the next step.

        Args:
            name: of the instrument.
            pose: (4, 4) world_from_instrument, or its tip (3,), m.
        """
        with self.lock:
            self.simulation.tools[name].move_to(pose)
            self.by_hand = True

    def follow_keys(self, name: str) -> None:
        """Let an instrument move again as the scene file says."""
        with self.lock:
            self.simulation.tools[name].start(self.simulation.time)

    def suction(self) -> str | None:
        """The name of the scene's suction instrument, or None."""
        tools = getattr(self.simulation, "tools", {})
        return next((name for name, tool in tools.items() if tool.kind == "suction"), None)

    def suck(self, hand: Any, phase: str, here: tuple) -> None:
        """Hold the suction tip at the surface under the pointer while the mouse button is down."""
        name = self.suction()
        assert name is not None  # without one the page does not offer the tool
        if phase == "end":
            self.follow_keys(name)
            return
        found = hand.on_surface([here])
        if found:
            self.move(name, np.asarray(found[0]))

    def grasp(self, hand: Any, phase: str, start: tuple, here: tuple) -> None:
        """Hold the matter under the pointer and pull it parallel to the image plane.

        Args:
            hand: of the browser.
            phase: "start", "move" or "end" of the drag.
            start, here: first and current place, (0, 0) to (1, 1).
        """
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
        """Before a step: pull the held matter towards the pointer, or release it."""
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

    def _feel(self) -> None:
        """After a step: note what the hand feels of tissue. The caller holds `lock`."""
        if self.has_tissue:
            held, tools = self._held is not None, self.simulation.tools
            force = float(np.linalg.norm(tools.grasp_force(GRASP)[0])) if held else 0.0
            self.simulation.record.diagnostics[-1][PULL] = force
            self._pulled = force if held else None

    def pull_words(self) -> str:
        """The force on the hand in the last step, or "" without tissue; never waits for `lock`."""
        force, held = self._pulled, self._held
        if self._target is not None and held is not None and not len(held):
            return "nothing to hold here"
        return "" if force is None or self._target is None else newtons(force)

    def _extent(self) -> float:
        lo, hi = self.bounds()
        return float(np.max(hi - lo))
