"""Lattices whose axes are not those of the world, and whose voxels are not cubes.

A reconstruction places cubes along the axes of its poses. Poses in another frame, turned and
stretched, give any lattice of right angles: the volume's matrix undoes the frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.checks import numeric, positive
from .sweep import Sweep

_MOST_RATIO = 30.0  # of the longest edge of a voxel to the shortest


def lattice_frame(sweep: Sweep, axes: Any, spacing: Any, region: Any) -> tuple[np.ndarray | None, float | None]:
    """The frame of a lattice, and the spacing in it.

    Args:
        sweep: with valid frames.
        axes: "world", "sweep", or (3, 3) with the directions of x, y and z of the voxels as
            columns, unit length, right angles, right-handed.
        spacing: mm, one number or three (x, y, z), or None.
        region: refused beside axes that are not the world's.

    Returns:
        world_from_lattice (4, 4), or None for the world's own axes and cubes; the smallest spacing,
        mm, or None.

    Raises TypeError, ValueError.
    """
    steps = None if spacing is None else _steps(spacing)
    turn = np.eye(3)
    if isinstance(axes, str):
        if axes not in ("world", "sweep"):
            raise ValueError(f"axes: expected world, sweep or a 3x3 matrix, got {axes!r}")
        if axes == "sweep":
            turn = sweep_axes(sweep)
    else:
        turn = _rotation(axes)
    own = np.array_equal(turn, np.eye(3))
    cubes = steps is None or steps.min() == steps.max()
    if own and cubes:
        return None, None if steps is None else float(steps[0])
    if region is not None:
        raise ValueError("region: expected axes world and cubic voxels beside a region")
    frame = np.eye(4)
    frame[:3, :3] = turn if steps is None else turn * (steps / steps.min())
    return frame, None if steps is None else float(steps.min())


def sweep_axes(sweep: Sweep) -> np.ndarray:
    """Right-angled axes along a sweep, (3, 3) columns: those of the smaller box around the frames'
    corners, of their principal axes and of the mean directions of rows, columns and normal. Each
    axis is named after, and points along, the world's axis that it is nearest to."""
    corners = sweep.corners()[sweep.valid].reshape(-1, 3)
    principal = np.linalg.svd(corners - corners.mean(0), full_matrices=False)[2].T
    steps = sweep.world_from_image[sweep.valid, :3, :2]
    units = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    u, v = units[0].T
    # Frames of a pass that comes back may be turned by 180 degrees: their axes count alike.
    signs = np.where(np.einsum("fik,ik->fk", units, units[0]) < 0, -1.0, 1.0)
    u, v = (units * signs[:, None]).mean(0).T
    if np.linalg.norm(np.cross(u, v)) < 1e-6:
        u, v = units[0].T
    images = np.linalg.qr(np.column_stack([u, v, np.cross(u, v)]))[0]
    boxes = [np.ptp(corners @ axes, axis=0) for axes in (images, principal)]
    # A sweep that has no thickness along an axis counts by its area.
    sizes = [np.prod(np.maximum(box, 1e-3 * box.max())) for box in boxes]
    return _named(principal if sizes[1] < 0.999 * sizes[0] else images)


def _named(axes: np.ndarray) -> np.ndarray:
    """The axes in the order, and with the signs, that lie nearest to x, y, z; right-handed."""
    orders = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
    order = max(orders, key=lambda order: sum(abs(axes[k, i]) for k, i in enumerate(order)))
    result = axes[:, order]
    result = result * np.where(np.diag(result) < 0, -1.0, 1.0)
    if np.linalg.det(result) < 0:
        worst = int(np.argmin(np.diag(result)))
        result[:, worst] *= -1
    return result


def _steps(spacing: Any) -> np.ndarray:
    if np.ndim(spacing) == 0:
        return np.full(3, positive("spacing", spacing))
    steps = numeric("spacing", spacing, "a number or three")
    if steps.shape != (3,) or not (np.isfinite(steps).all() and (steps > 0).all()):
        raise ValueError(f"spacing: expected a positive number or three, got {spacing!r}")
    if steps.max() > _MOST_RATIO * steps.min():
        raise ValueError(f"spacing: expected edges that differ at most {_MOST_RATIO:g} times, got {spacing!r}")
    return steps


def _rotation(axes: Any) -> np.ndarray:
    turn = numeric("axes", axes, "world, sweep or a 3x3 matrix")
    if turn.shape != (3, 3) or not np.allclose(turn.T @ turn, np.eye(3), atol=1e-6):
        raise ValueError("axes: expected a 3x3 matrix with unit columns at right angles")
    if np.linalg.det(turn) < 0:
        raise ValueError("axes: expected right-handed axes, got left-handed ones")
    return turn
