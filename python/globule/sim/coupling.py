"""A virtual coupling between a haptic device and a tool in tissue, at the device's rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .._base.checks import number, positive

STIFFEST = 10.0  # times the coupling's stiffness: what a local model may hold
SMOOTH = 0.02  # s: time constant of readings and of their poses; tissue rings meanwhile
SPAN = 0.01  # s: between two corrections of the stiffness
GAIN = 0.3  # share of a correction: noise of several readings averages
MARGIN = 1.25  # the loop's stiffness over the learned one: errors of the model then take energy


@dataclass(frozen=True)
class Coupling:
    """The spring and damper between a device and its tool (Colgate, Stanley & Brown 1995).

    Attributes:
        stiffness: k, N/m; rotations have the stiffness k arm², N m/rad.
        damping: b, N s/m; rotations have b arm².
        arm: m, about the size of the tool.
        rate: of the loop, Hz.

    Raises:
        ValueError: a number that is not above 0; a damping below 0.
    """

    stiffness: float = 300.0
    damping: float = 0.0
    arm: float = 0.01
    rate: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("stiffness", "arm", "rate"):
            positive(name, getattr(self, name))
        number("damping", self.damping, 0.0)

    @property
    def needed_damping(self) -> float:
        """The least damping of the device itself, N s/m, with which the sampled loop is passive
        whatever the hand does: k T / 2 + b (Colgate & Schenkel 1997, with a velocity of two
        samples)."""
        return self.stiffness / (2 * self.rate) + self.damping


class Near(NamedTuple):
    """The force near a pose, to first order: wrench - matrix u, u the displacement from the pose.

    Displacements are [position; arm rotation vector] m, wrenches [force; torque / arm] N: 6 numbers
    in world axes, or the first 3.
    """

    pose: np.ndarray  # (4, 4) world_from_tool
    wrench: np.ndarray  # (n,) N, on the tool
    matrix: np.ndarray  # (n, n) N/m, symmetric and positive semidefinite


class LocalModel:
    """A tool's force near its pose, learned from the readings of a simulation.

    Readings correct the stiffness along the tool's last displacement: `GAIN` of the symmetric
    rank-two update of Powell (1970), the least change of the matrix that explains them.
    Displacements below `least` change it less. Eigenvalues stay from 0 to `STIFFEST` k: passive
    matter.

    Args:
        coupling: its stiffness is the first stiffness of held tissue.
        least: m.
        n: 3 for forces, 6 for forces and torques.
    """

    def __init__(self, coupling: Coupling, least: float, n: int = 6):
        self._coupling, self._least, self._n = coupling, least, n
        self.free(np.eye(4))

    def free(self, pose: np.ndarray) -> Near:
        """The model of a tool that holds nothing."""
        self.matrix = self._coupling.stiffness * np.eye(self._n)
        self._readings = 0
        self._time = 0.0
        return Near(pose, np.zeros(self._n), np.zeros((self._n, self._n)))

    def learn(self, pose: np.ndarray, force: np.ndarray, torque: np.ndarray, dt: float) -> Near:
        """The model after a reading.

        Args:
            pose: (4, 4) world_from_tool.
            force: (3,) N on the tool, the mean of a step.
            torque: (3,) N m about the tool's tip.
            dt: of the step, s.
        """
        c, n = self._coupling, self._n
        wrench = np.concatenate([force, torque / c.arm])[:n]
        if self._readings == 0:
            self._last = self._smooth = pose, wrench
        self._readings += 1
        # The same filter for both: what is linear stays so.
        share, (at, mean) = dt / (dt + SMOOTH), self._smooth
        at = displaced(at, share * displacement(pose, at, c.arm, n), c.arm)
        self._smooth = at, mean + share * (wrench - mean)
        self._time += dt
        if self._time >= SPAN:
            self._correct(*self._smooth)
            self._time = 0.0
        return Near(*self._smooth, MARGIN * self.matrix)

    def _correct(self, pose: np.ndarray, wrench: np.ndarray) -> None:
        u = displacement(pose, self._last[0], self._coupling.arm, self._n)
        off = self._last[1] - wrench - self.matrix @ u
        self._last = pose, wrench
        size = u @ u + self._least**2
        change = np.outer(off, u) / size
        change += change.T - (off @ u) / size**2 * np.outer(u, u)
        values, axes = np.linalg.eigh(self.matrix + GAIN * change)
        self.matrix = (axes * np.clip(values, 0.0, STIFFEST * self._coupling.stiffness)) @ axes.T


class Servo:
    """The loop at the device's rate: the tool's pose, and the force on the device.

    The tool has no mass: the coupling pulls the tool to where the coupling's force and the force of
    the local model agree (Adams & Hannaford 1999; Otaduy & Lin 2006), by an implicit Euler step.

    Args:
        coupling: between device and tool.
        near: the first local model.
        n: 3 for forces, 6 for forces and torques.

    Attributes:
        tool: (4, 4) world_from_tool, where the tool should be.
        energy: J, what the hand has given and not got back, exact for forces that are constant
            between two calls (Stramigioli et al. 2005).
    """

    def __init__(self, coupling: Coupling, near: Near, n: int = 6):
        self._coupling, self._n = coupling, n
        self.tool, self.energy = near.pose, 0.0
        self._device = near.pose
        self._wrench = np.zeros(n)
        self.update(near)

    def update(self, near: Near) -> None:
        """Replace the local model; another thread may call this between two `tick`s."""
        c = self._coupling
        held = (c.stiffness + c.damping * c.rate) * np.eye(self._n)
        self._model = near, np.linalg.inv(held + near.matrix)

    def tick(self, device: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One period of the loop.

        Args:
            device: (4, 4) world_from_device, where the tool is when no force acts.

        Returns:
            force (3,) N and torque (3,) N m on the device.
        """
        c, n, (near, inverse) = self._coupling, self._n, self._model
        moved = displacement(device, self._device, c.arm, n)
        self.energy -= float(self._wrench @ moved)
        pull = near.wrench + c.stiffness * displacement(device, near.pose, c.arm, n)
        if c.damping:
            moved += displacement(self.tool, near.pose, c.arm, n)
            pull += c.damping * c.rate * moved
        u = inverse @ pull
        self._wrench = near.wrench - near.matrix @ u
        self._device, self.tool = device, displaced(near.pose, u, c.arm)
        torque = self._wrench[3:] * c.arm if n == 6 else np.zeros(3)
        return self._wrench[:3].copy(), torque


def displacement(pose: np.ndarray, start: np.ndarray, arm: float, n: int) -> np.ndarray:
    """(n,) from one pose (4, 4) to another: [position; arm rotation vector] m, world axes."""
    moved = pose[:3, 3] - start[:3, 3]
    if n == 3:
        return moved
    return np.concatenate([moved, arm * rotation_vector(pose[:3, :3] @ start[:3, :3].T)])


def displaced(start: np.ndarray, u: np.ndarray, arm: float) -> np.ndarray:
    """The pose (4, 4) that `displacement` is u, (3,) or (6,), from the start."""
    pose = start.copy()
    pose[:3, 3] += u[:3]
    if len(u) == 6:
        pose[:3, :3] = rotation(u[3:] / arm) @ start[:3, :3]
    return pose


def rotation_vector(turn: np.ndarray) -> np.ndarray:
    """(3,) axis times angle, rad, of a rotation (3, 3) by less than half a turn."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    sine = float(np.sqrt(axis @ axis))
    if sine < 1e-9:
        return axis
    return axis * (np.arctan2(sine, (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1) / 2) / sine)


def rotation(vector: np.ndarray) -> np.ndarray:
    """(3, 3) of a rotation vector (3,), rad (Rodrigues)."""
    angle = float(np.sqrt(vector @ vector))
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    first = np.sinc(angle / np.pi)
    second = np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.eye(3) + first * cross + second * cross @ cross
