"""Forces of a simulation at a haptic device: a loop of 1 kHz beside the simulation's steps."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from typing import Any, Protocol

import numpy as np

from .._base.checks import number, shown
from .blade import check_rigid
from .coupling import Coupling, LocalModel, Servo, displaced, displacement
from .settings import StepReport
from .simulation import Simulation
from .tools import Tool

LEAST = 0.001  # spacings: displacements from which the local model learns
LAG = 0.02  # s: the tool follows the coupling that slowly; faster tools and tissue would shake
N_LATE = 60000  # periods whose lateness is kept


class Device(Protocol):
    """What `HapticLoop` needs of a device. The loop calls both methods once a period."""

    def read(self) -> Any:
        """The device's pose: (4, 4) world_from_device, m, or a position (3,) without rotation."""

    def write(self, force: np.ndarray, torque: np.ndarray) -> None:
        """The force (3,) N and torque (3,) N m that the device has to give, world axes."""


class HapticLoop:
    """A haptic device that moves a grasper of a simulation and gives the tissue's force.

    The loop runs at `coupling.rate` in a thread of its own, beside the steps of the simulation.
    Each step gives the loop a local linear model of the tissue's force; docs/design/haptics.md
    explains both. The tool moves as the device moves from where the loop finds both at its start.

        with HapticLoop(sim, "grip", device) as loop:
            loop.run(10.0)

    Args:
        sim: its other threads may read it meanwhile.
        tool: name of an instrument of kind "grasper".
        device: with the methods of `Device`. A position (3,) gives forces without torques.
        coupling: None: 300 N/m, and the grasper's radius as `arm`.

    Attributes:
        servo: its `tool` pose and `energy`.
        n_ticks: periods so far.
        n_missed: periods that were left out because the loop was late.

    Raises:
        ValueError: an instrument that there is not or that has no force; a device that gives
            another pose.
        TypeError: a device without `read` and `write`.
    """

    def __init__(
        self, sim: Simulation, tool: str, device: Device, coupling: Coupling | None = None
    ):
        if tool not in sim.tools:
            known = ", ".join(sim.tools) or "none in the scene"
            raise ValueError(f"tool: expected an instrument ({known}), got {shown(tool)}")
        self._tool: Tool = sim.tools[tool]
        if self._tool.kind != "grasper":
            raise ValueError(
                f"tool: expected a grasper, which has a force, got {tool!r}, a {self._tool.kind}"
            )
        for method in ("read", "write"):
            if not callable(getattr(device, method, None)):
                raise TypeError(f"device: expected a method {method}, got {shown(device)}")
        self._sim, self._device = sim, device
        self.coupling = coupling or Coupling(arm=self._tool._reach)
        pose = np.asarray(device.read(), float)
        self._turns = pose.shape != (3,)
        n = 6 if self._turns else 3
        self._device_start = _checked(pose)
        self._tool_start = self._tool.pose.copy()
        self._model = LocalModel(self.coupling, LEAST * sim.settings.spacing, n)
        self.servo = Servo(self.coupling, self._model.free(self._tool_start), n)
        self.n_ticks = self.n_missed = 0
        self._late: deque[float] = deque(maxlen=N_LATE)
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._error: BaseException | None = None

    def tick(self) -> None:
        """One period: read the device, compute, write the force. `run` calls this; a device whose
        driver has a loop of its own may call this there instead."""
        pose = _checked(self._device.read())
        start, tool = self._device_start, self._tool_start
        placed = tool.copy()
        placed[:3, 3] += pose[:3, 3] - start[:3, 3]
        if self._turns:
            placed[:3, :3] = pose[:3, :3] @ start[:3, :3].T @ tool[:3, :3]
        self._device.write(*self.servo.tick(placed))
        self.n_ticks += 1

    def step(self, dt: float | None = None) -> StepReport:
        """One step of the simulation with the tool where the coupling has it; then a new local
        model. Arguments and errors as of `Simulation.step`, and an error of the device."""
        return self._step(self.servo.tool, dt)

    def run(self, seconds: float, real_time: bool = True) -> None:
        """Simulate some seconds.

        Args:
            seconds: s.
            real_time: the simulation waits for the clock; the loop runs in its thread. False: no
                clock and no thread; each step has as many periods of the loop as it is long, and
                the same run gives the same bits.

        Raises:
            ValueError: seconds below 0.
            ArithmeticError: as of `Simulation.step`.
            Exception: what the device raised; the force was set to 0 before.
        """
        seconds = number("seconds", seconds, 0.0)
        sim, first = self._sim, self._sim.time
        if real_time:
            own = self._thread is None
            self.start()
            try:
                begun = time.perf_counter()
                while (rest := first + seconds - sim.time) > 1e-9:
                    ahead = sim.time - first - (time.perf_counter() - begun)
                    if ahead > 0 and self._stop.wait(ahead):
                        break
                    self.step(min(sim.dt, rest))
            finally:
                if own:
                    self.stop()
            self._raise()
            return
        if self._thread is not None:
            raise ValueError("real_time: expected True while the loop runs in its thread")
        n_before = self.n_ticks
        try:
            while (rest := first + seconds - sim.time) > 1e-9:
                dt, pose = min(sim.dt, rest), self.servo.tool  # as if both went on side by side
                n = round((sim.time + dt - first) * self.coupling.rate)
                while self.n_ticks - n_before < n:
                    self.tick()
                self._step(pose, dt)
        except BaseException:
            with contextlib.suppress(Exception):  # the error that came first is raised
                self._device.write(np.zeros(3), np.zeros(3))
            raise

    def start(self) -> None:
        """Begin the loop's thread; without effect while it runs."""
        if self._thread is None:
            self._stop.clear()
            self._thread = threading.Thread(target=self._loop, name="haptic loop", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the loop's thread and set the force to 0; without effect when it does not run."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None

    def __enter__(self) -> HapticLoop:
        self.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self.stop()

    @property
    def lateness(self) -> np.ndarray:
        """(M,) s: how late each of the last periods in the thread began, 60,000 at most."""
        return np.array(self._late)

    def _step(self, pose: np.ndarray, dt: float | None) -> StepReport:
        self._raise()
        dt = self._sim.dt if dt is None else dt
        begin = self._tool.pose
        share = dt / (dt + LAG)
        self._tool.move_to(displaced(begin, share * displacement(pose, begin, 1.0, 6), 1.0))
        report = self._sim.step(dt)
        # Readings are means of the step, about the tip at its beginning.
        middle = displaced(begin, displacement(self._tool.pose, begin, 1.0, 6) / 2, 1.0)
        if self._tool._holds:
            force = self._tool.force
            torque = self._tool.torque - np.cross(middle[:3, 3] - begin[:3, 3], force)
            self.servo.update(self._model.learn(middle, force, torque, dt))
        else:
            self.servo.update(self._model.free(middle))
        return report

    def _loop(self) -> None:
        period, due = 1 / self.coupling.rate, time.perf_counter()
        try:
            while not self._stop.is_set():
                self.tick()
                due += period
                left = due - time.perf_counter()
                if left < -period:
                    missed = int(-left / period)
                    self.n_missed += missed
                    due += missed * period
                if left > 0:
                    time.sleep(left)
                self._late.append(time.perf_counter() - due)
        except BaseException as error:
            self._error = error
            self._stop.set()
        finally:
            try:
                self._device.write(np.zeros(3), np.zeros(3))
            except Exception as error:
                self._error = self._error or error

    def _raise(self) -> None:
        if self._error is not None:
            error, self._error = self._error, None
            self.stop()
            raise error


def _checked(pose: Any) -> np.ndarray:
    """(4, 4); positions, without a rotation to check, come quickly."""
    if isinstance(pose, np.ndarray) and pose.shape == (3,) and math.isfinite(pose.sum()):
        whole = np.eye(4)
        whole[:3, 3] = pose
        return whole
    return check_rigid("device.read()", pose)
