"""The solver of a simulation with what it was told: settings, materials and particles."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from .. import _core
from .._base.device import Device
from .limits import check_densities, check_material
from .scene_file import SceneFile
from .settings import Phase, settings_in
from .steered import Kept

ARRAYS = {
    "place": (np.float32, 4),
    "velocity": (np.float32, 4),
    "id": (np.uint32, 1),
    "phase": (np.uint8, 1),
    "pressure": (np.float32, 1),
    "growth": (np.float32, 1),
    "divergence_impulse": (np.float32, 1),
}


class Solver:
    """What a simulation and its parts share.

    Attributes:
        lock: held by every call that must be whole.
        file: the scene.
        device: of the particles.
        settings: gravity, and the steps.
        phases: the materials by name, in the order of their numbers.
        traced: the core's scene, in the solver's memory.
        core: the core's solver.
        pushed: whether others than steps gave speeds that nobody took note of.
        changed: the same of settings and materials.
        n_removed: particles that sinks, suction, ablation or `remove` took away.
    """

    def __init__(self, file: SceneFile, device: Device, threads: int):
        self.lock = threading.RLock()
        self.file, self.device = file, device
        self.settings = settings_in(file)
        self.phases: dict[str, Phase] = Kept("phases", Phase)
        self._settings_sent = self.settings._pack()
        self.core = _core.Simulation(device.name, threads, self._settings_sent)
        self.traced = self.core.scene()
        self.pushed = self.changed = True
        self.n_removed = 0
        self._phases_sent: list[dict[str, Any]] = []

    def __len__(self) -> int:
        return self.core.size()

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.core.time()

    def number_of(self, phase: str | None) -> int:
        """The number of a phase; None: the first that is no boundary."""
        if phase is None:
            phase = next((n for n, p in self.phases.items() if p.kind != "boundary"), None)
            if phase is None:
                raise ValueError("phase: expected fluids, solids or rigids in the scene, got none")
        if not isinstance(phase, str) or phase not in self.phases:
            raise ValueError(f"phase: expected one of {', '.join(self.phases)}, got {phase!r}")
        return list(self.phases).index(phase)

    def spacing_of(self, phase: Phase) -> float:
        """Of a material's particles, m."""
        return self.settings.fluid_spacing if phase.kind == "fluid" else self.settings.spacing

    def send(self) -> None:
        """Hand settings and materials that changed to the core."""
        settings = self.settings._pack()
        if self._settings_sent != settings:
            self.core.configure(settings)
            self._settings_sent = settings
            self.changed = True
        frame = 1 / self.file.output.fps
        check_densities({
            (f"phases[{name!r}]", "density"): phase.density
            for name, phase in self.phases.items()
            if phase.kind in ("fluid", "tissue") and phase.density is not None
        })  # fmt: skip
        for i, phase in enumerate(self.phases.values()):
            packed = phase._pack()
            if i >= len(self._phases_sent):
                self._phases_sent.append({})
            if packed != self._phases_sent[i]:
                check_material(phase, self.spacing_of(phase), frame)
                self.core.set_phase(packed)
                self._phases_sent[i] = packed
                self.changed = True

    def read(self, name: str) -> np.ndarray:
        """An array of `ARRAYS` in the solver's order: (N,) or (N, 4)."""
        dtype, columns = ARRAYS[name]
        n = len(self)
        out = np.empty((n, columns) if columns > 1 else n, dtype)
        if n:
            self.core.read(name, out)
        return out

    def write(self, name: str, values: np.ndarray) -> None:
        """Replace an array of `ARRAYS`, in the solver's order."""
        self.pushed = True
        if len(self):
            self.core.write(name, np.ascontiguousarray(values, ARRAYS[name][0]))

    def order(self) -> np.ndarray:
        """(N,) from the solver's order to that of ids."""
        return np.argsort(self.read("id"))

    def ids(self) -> np.ndarray:
        """(N,) uint32, ascending."""
        return np.sort(self.read("id"))

    def positions(self) -> np.ndarray:
        """(N, 3) float32, m, in id order."""
        return np.ascontiguousarray(self.read("place")[self.order(), :3])

    def phase(self) -> np.ndarray:
        """(N,) uint8, the number of each particle's phase, in id order."""
        return self.read("phase")[self.order()]

    def remove(self, ids: np.ndarray) -> None:
        """Remove particles by their ids (M,) uint32; unknown ones have no effect."""
        if len(ids):
            n_before = len(self)
            self.core.remove(ids)
            self.n_removed += n_before - len(self)
