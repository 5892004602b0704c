"""The panel of time: playback of sequences, simulations, live sweeps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ...ultrasound.options import METHODS
from ..forces import force_words, forces
from ..roles import STEER
from ..sweep_source import COMPOUNDING
from .panel import Panel, handle
from .widgets import bounded

TITLES = {"sequence": "Time", "simulation": "Simulation", "sweep": "Live sweep"}
IMAGES = "Undo: remove the newest images. Clear: remove all."


class Play(Panel):
    """Playback, steps and what else changes in time."""

    status: Any = None

    @property
    def title(self) -> str:  # type: ignore[override]  # read-only here
        """The heading for the kind of source."""
        return TITLES[self.viewer.source.kind]

    def __init__(self, page: Any):
        self.held: dict[str, np.ndarray] = {}  # poses (4, 4) of instruments that people move
        super().__init__(page)

    def wanted(self) -> bool:
        """Whether the source changes in time."""
        return self.viewer.source.kind in TITLES

    def build(self) -> None:
        """Make the widgets."""
        kind = self.viewer.source.kind
        {"sequence": self._sequence, "simulation": self._simulation, "sweep": self._sweep}[kind]()
        self.command("Play or pause", "space", lambda browser: self.toggle())

    def tick(self) -> None:
        """Update the status."""
        if self.status is None:
            return
        source = self.viewer.source
        words = source.status()
        if source.kind == "simulation" and (felt := force_words(forces(source.simulation))):
            words += "  \n" + felt
        if self.status.content != words:
            self.status.content = words

    def toggle(self) -> None:
        """Run, or pause."""
        source = self.viewer.source
        if source.kind == "sequence":
            self.state.set(time__playing=not self.state.time.playing)
        elif source.kind == "simulation":
            self.run(not source.running)
        elif source.running:
            source.stop()
        else:
            source.start()
        self.tick()
        self.viewer.engine.notify()

    # Sequences

    def _sequence(self) -> None:
        self.add("time", "rate")

    # Simulations

    def _simulation(self) -> None:
        gui, source = self.gui, self.viewer.source
        sim = source.simulation
        self.switches: list[tuple[Any, Callable[[], bool]]] = []
        self.status = gui.add_markdown(source.status())
        hint = "Simulated seconds per second, if the machine is fast enough"
        speed = gui.add_slider("Speed", 0.01, 2.0, 0.01, source.speed, hint=hint)
        speed.on_update(self.safe(lambda event: setattr(source, "speed", bounded(speed))))
        if source.has_tissue:
            self._cut_depth()
            self.command("Undo the last cut of tissue", "U", self._undo)
        for name, emitter in _named(sim, "emitters"):
            self._switch(f"Emitter {name}", emitter, partial(getattr, emitter, "on"))
        for name, instrument in _named(sim, "tools"):
            self._instrument(name, instrument)

    def _cut_depth(self) -> None:
        """The slider of the depth, in the unit of the label beside a stroke."""
        gui, source = self.gui, self.viewer.source
        gui.add_markdown("**Cut**: choose the tool *Cut* and draw on the surface.")
        factor, unit = source.shown_unit()
        longest = float(f"{factor * source.tissue_extent():.2g}")
        step = longest / 50
        source.cut_depth = source.cut_depth or 10 * step / factor
        first, label = factor * source.cut_depth, f"Cut depth, {unit}"
        hint = f"Depth below the surface, {unit}; the right end cuts all through"
        depth = gui.add_slider(label, step, longest, step, first, hint=hint)

        def changed(event: Any) -> None:
            asked = bounded(depth)
            source.cut_depth = asked / factor if asked < 0.99 * longest else None

        depth.on_update(self.safe(changed))

    def reset(self) -> None:
        """Go back to the beginning."""
        self.viewer.source.reset()
        for box, on in getattr(self, "switches", ()):
            box.value = on()
        self.tick()
        self.viewer.engine.notify()

    def _undo(self, browser: Any) -> None:
        done = self.viewer.source.undo()
        self.page.tools.hands[browser.client_id].say(done)
        self.viewer.engine.notify()

    def run(self, running: bool) -> None:
        """Run or pause the simulation."""
        self.viewer.source.play(running)

    def _switch(self, label: str, thing: Any, on: Callable[[], bool]) -> None:
        box = self.gui.add_checkbox(label, on(), hint="On or off; until then it follows the scene")
        self.switches.append((box, on))

        def changed(event: Any) -> None:
            with self.viewer.source.lock:
                thing.on = box.value
                self.viewer.source.by_hand = True

        box.on_update(self.safe(changed))

    def _instrument(self, name: str, instrument: Any) -> None:
        """A switch for the handle that moves an instrument."""
        source = self.viewer.source
        hint = "Show handles in the image that move and turn it"
        shown = self.gui.add_checkbox(f"Move {name} by hand", False, hint=hint)

        def changed(event: Any) -> None:
            if shown.value:
                with source.lock:
                    self.held[name] = np.array(instrument.pose)
            else:
                self.held.pop(name, None)
                source.follow_keys(name)

        shown.on_update(self.safe(changed))
        self._switch(f"{name} on", instrument, lambda: instrument.works(source.simulation.time))

    def handles(self, browser: Any) -> list[dict[str, Any]]:
        """Of the instruments that people move."""
        return [
            handle(f"instrument {name}", name, pose[:3, 3], pose[:3, :3].T, turns=True)
            for name, pose in list(self.held.items())
            if self.viewer.clients[browser.client_id].role == STEER
        ]

    def pulled(self, name: str, at: Any, axes: Any) -> None:
        """Move an instrument. Raises ValueError for axes that are no rotation."""
        if not np.allclose(axes @ axes.T, np.eye(3), atol=1e-3) or np.linalg.det(axes) < 0:
            raise ValueError(f"{name}: expected the axes of a rotation")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = axes.T, at
        name = name.removeprefix("instrument ")
        self.held[name] = pose
        self.viewer.source.move(name, pose)
        self.viewer.engine.notify()

    # Sweeps

    def _sweep(self) -> None:
        gui, source = self.gui, self.viewer.source
        self.status = gui.add_markdown(source.status())
        buttons = gui.add_button_group("Images", ("Undo", "Clear"), hint=IMAGES)
        buttons.on_click(self.safe(self._record))
        hint = "Edge of a voxel, mm; takes effect after Clear"
        ends = {"min": 0.01, "max": 100.0, "step": 0.1, "unit": "mm"}
        spacing = gui.add_number("Spacing", source.spacing, **ends, hint=hint)
        hint = "How the values in a voxel are combined; takes effect after Clear"
        first = source.compounding
        way = gui.add_dropdown("Compounding", COMPOUNDING, initial_value=first, hint=hint)
        spacing.on_update(self.safe(lambda event: setattr(source, "spacing", bounded(spacing))))
        way.on_update(self.safe(lambda event: setattr(source, "compounding", way.value)))
        self.method = gui.add_dropdown("Method", METHODS, hint="Reconstruction method")
        hint = "Stop receiving, and reconstruct the volume by this method"
        self.button("Reconstruct all images", lambda browser: self._finish(), hint)

    def _record(self, event: Any) -> None:
        source = self.viewer.source
        source.undo() if event.target.value == "Undo" else source.reset()
        self.tick()
        self.viewer.engine.notify()

    def _finish(self) -> None:
        self.viewer.source.finish(self.method.value)
        self.viewer.engine.notify()


def _named(simulation: Any, name: str) -> list[tuple[str, Any]]:
    """A simulation's emitters or instruments, by name."""
    found: Any = getattr(simulation, name, None)
    return list(found.items()) if hasattr(found, "items") else []
