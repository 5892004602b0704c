"""The crown of a drop that falls into a shallow pool, against published laws.

The drop is that of the shipped scene `droplet`, in a wider pool. Lengths are in the drop's
diameters D, times tau in D / V since the drop touches the pool, with its speed V.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from globule.sim.scene_read import as_dict, read_scene
from globule.sim.simulation import Simulation

from .physics_fluid import Row, near

DIAMETER, SPEED, DEPTH, GAP = 0.007, 2.8, 0.0045, 0.001  # m, m/s: the scene's
HALF = 0.028  # of the pool's width, m: the foot is 7 mm from the walls at the last of the TIMES
ABOVE = 0.001  # m over the undisturbed surface, where the foot is
TIMES = np.arange(1.2, 8.05, 0.1)  # tau, when the crown's foot is compared
COSSALI_POWER = 0.43  # Cossali et al. 2004: the crown's diameter over tau


class Crown(NamedTuple):
    """A crown over time: arrays (N,), lengths over D."""

    time: np.ndarray  # tau
    radius: np.ndarray  # of the foot, outside, ABOVE the undisturbed surface
    height: np.ndarray  # of the rim above the undisturbed surface


def droplet(
    spacing: float, device: str = "cpu", threads: int = 0, half: float = HALF,
    speed: float = SPEED, depth: float = DEPTH,
) -> Simulation:  # fmt: skip
    """The scene `droplet` with a pool of another width and depth, m, and another speed, m/s."""
    scene: dict[str, Any] = as_dict(read_scene("droplet", spacing))
    pool, drop = scene["fluids"]
    half = round(half / spacing) * spacing
    lo, hi = (-half, -half, 0), (half, half, depth + 5 * DIAMETER)
    scene["domain"].update(lo=lo, hi=hi)
    pool["box"] = {"lo": lo, "hi": (half, half, depth)}
    drop["sphere"]["center"] = (0, 0, depth + GAP + DIAMETER / 2)
    drop["velocity"] = (0, 0, -speed)
    return Simulation(scene, device, threads)


def joined(x: np.ndarray, reach: float) -> np.ndarray:
    """Mask (M,) of the largest set of points that steps of at most `reach` join, without drops."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(x).query_pairs(reach, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), (len(x), len(x)))
    _, label = connected_components(links, directed=False)
    return np.asarray(label == np.bincount(label).argmax())


def shape_of(x: np.ndarray, d: float, depth: float = DEPTH, sectors: int = 24) -> tuple[float, ...]:
    """Radius of the crown's foot and height of its rim, m, of fluid at x, (M, 3) m.

    In each sector about the axis: the outermost particle within half a spacing of ABOVE over the
    undisturbed surface, and the highest particle, each with half a spacing. The median of sectors
    leaves out jets; drops that have left the fluid do not count.
    """
    x = x[joined(x, 1.5 * d)]
    r, turn = np.hypot(x[:, 0], x[:, 1]), np.arctan2(x[:, 1], x[:, 0]) / (2 * np.pi)
    sector = np.floor(turn * sectors).astype(int) % sectors
    foot, rim = np.zeros(sectors), np.zeros(sectors)
    level = np.abs(x[:, 2] - depth - ABOVE) < d / 2
    np.maximum.at(foot, sector[level], r[level])
    np.maximum.at(rim, sector, x[:, 2])
    return float(np.median(foot)) + d / 2, float(np.median(rim)) + d / 2 - depth


def watch(sim: Simulation, times: np.ndarray, speed: float = SPEED, depth: float = DEPTH) -> Crown:
    """Run on and look at the crown at each of the times tau."""
    phases, seen = list(sim.phases), []
    fluids = phases.index("pool"), phases.index("drop")
    for tau in times:
        sim.run_to((GAP + tau * DIAMETER) / speed)
        fluid = sim.positions[np.isin(sim.arrays.phase, fluids)]  # a drop may have left the domain
        seen.append((tau, *shape_of(fluid, sim.settings.spacing, depth)))
    time, radius, height = np.array(seen).T
    return Crown(time, radius / DIAMETER, height / DIAMETER)


def yarin_weiss(depth: float = DEPTH) -> float:
    """C in radius / D = C sqrt(tau - tau0), for a pool `depth` deep, m.

    Yarin & Weiss 1995 (J. Fluid Mech. 283): the edge of a film that spreads into a film at rest.
    """
    return float((2 * DIAMETER / (3 * depth)) ** 0.25)


def spread(crown: Crown) -> tuple[float, float, float]:
    """Of the foot: C and tau0 of radius / D = C sqrt(tau - tau0), and the power of tau alone."""
    slope, at_0 = np.polyfit(crown.time, crown.radius**2, 1)
    power = np.polyfit(np.log(crown.time), np.log(crown.radius), 1)[0]
    return float(np.sqrt(slope)), float(-at_0 / slope), float(power)


def splash(device: str = "cpu", threads: int = 0, layers: int = 9) -> list[Row]:
    """The crown of a drop on a pool of some layers of particles; We 762, h / D 0.64."""
    d = DEPTH / layers
    c, _, power = spread(watch(droplet(d, device, threads), TIMES))
    name = f"crown, spacing {1000 * d:g} mm:"
    return [
        near(f"{name} C in radius / D = C sqrt(tau - tau0)", yarin_weiss(), c, 0.15),
        near(f"{name} power of tau in the radius", COSSALI_POWER, power, 0.15),
    ]


def run(device: str, threads: int = 0, quick: bool = False) -> list[Row]:
    """A coarse crown, and without `quick` that of the shipped scene's spacing."""
    return [row for n in ((5,) if quick else (5, 9)) for row in splash(device, threads, n)]
