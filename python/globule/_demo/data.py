"""Data sets for a first image, without a download.

`dam_break` is a frame of a simulation that comes with the package. `splash` is made by formulas for
any number of particles: a drop has fallen into a round pool. Ripples run outwards, a crown of water
breaks into jets and droplets, and a column rises in the middle with a drop above.

Each piece of the splash has rings or layers along its own surface, of one spacing. That keeps the
summed metaballs smooth, unlike a cubic lattice cut to shape. y is up, the unit of length is the
pool's radius. The same arguments give the same bytes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..sim.sampling import even_directions

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..data.particles import Particles

DEPTH = 0.13  # of the water at rest; its surface is y = 0
CROWN_RADIUS = 0.44
CROWN_HEIGHT = 0.33
N_JETS = 17
JITTER = 0.05  # of the spacing
TAU = 2 * np.pi

#: Colors from the pool's floor to the highest drop: height, r, g, b (linear).
RAMP = np.array(
    [
        [-0.13, 0.010, 0.050, 0.150],
        [-0.03, 0.015, 0.110, 0.290],
        [0.04, 0.030, 0.220, 0.480],
        [0.20, 0.060, 0.380, 0.720],
        [0.40, 0.240, 0.640, 0.900],
        [0.62, 0.560, 0.860, 0.980],
        [0.90, 0.780, 0.940, 1.000],
    ]
)


#: Colors from standing to fast water (linear).
SPEEDS = np.array([[0.006, 0.06, 0.22], [0.02, 0.17, 0.46], [0.14, 0.46, 0.78], [0.8, 0.92, 0.97]])


def dam_break() -> tuple[np.ndarray, np.ndarray, float]:
    """The scene dam-break after 1.3 s: the wave at the wall falls back.

    Returns positions (29160, 3) float32, m, y up; colors by speed (29160, 3) float32, linear; and
    the spacing of the particles, m. docs/make_demo_data.py makes the file.
    """
    with np.load(Path(__file__).with_name("dam_break.npz")) as file:
        spacing = float(file["spacing"])
        positions = np.cumsum(file["steps"], axis=0, dtype=np.int64) * (spacing / 64)
        fast = np.sqrt(file["speed"] / 255)
    color = np.stack([np.interp(fast, np.linspace(0, 1, 4), SPEEDS[:, c]) for c in range(3)], 1)
    return positions.astype(np.float32), color.astype(np.float32), spacing


def dam_break_particles() -> tuple[Particles, float]:
    """The particles of `dam_break` as `globule demo` writes them, with the attribute speed, m/s;
    and their spacing, m."""
    from ..data.particles import Particles

    positions, color, spacing = dam_break()
    with np.load(Path(__file__).with_name("dam_break.npz")) as file:
        speed = (file["speed"] / 255 * file["top_speed"]).astype(np.float32)
    found = Particles(positions, color=color, support=2 * spacing, attributes={"speed": speed})
    return found, spacing


def splash(n_target: int = 60_000) -> tuple[np.ndarray, np.ndarray, float]:
    """A splash of about `n_target` particles, best of some thousands or more.

    Returns positions (N, 3) float32, colors (N, 3) float32 in [0, 1], linear, and the spacing of
    the particles. Render with support = 2 * spacing, kernel murakami and a threshold of 0.6.

    Raises ValueError for n_target < 1.
    """
    if n_target < 1:
        raise ValueError(f"n_target: expected at least 1, got {n_target}")
    spacing = 0.0198 * (60_000 / n_target) ** (1 / 3)
    rng = np.random.default_rng(2024)
    jets = _Jets(rng)
    pieces = [_pool(spacing), _column(spacing), _wall(spacing, jets), _rim(spacing, jets), *_spray(spacing, jets, rng)]
    positions = np.concatenate(pieces)
    positions += rng.uniform(-JITTER * spacing, JITTER * spacing, positions.shape)
    color = np.stack([np.interp(positions[:, 1], RAMP[:, 0], RAMP[:, c]) for c in (1, 2, 3)], axis=1)
    return positions.astype(np.float32), color.astype(np.float32), float(spacing)


class _Jets:
    """Where the crown's rim breaks up: N_JETS angles, uneven on purpose, and how far each one
    shoots."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.angle = (np.arange(N_JETS) + rng.uniform(-0.26, 0.26, N_JETS)) / N_JETS * TAU
        self.reach = rng.uniform(0.55, 1.0, N_JETS)

    def crown_height(self, angle: np.ndarray) -> np.ndarray:
        """Height of the rim above the wall's foot: uneven by itself, and pulled up at every jet."""
        height = CROWN_HEIGHT * (1 + 0.09 * np.sin(angle + 0.6) + 0.05 * np.sin(3 * angle + 2.0))
        for a, reach in zip(self.angle, self.reach, strict=True):
            away = (angle - a + np.pi) % TAU - np.pi
            height = height + 0.085 * reach * np.exp(-((away / 0.095) ** 2))
        return height - 0.03


def _surface(r: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Height of the pool's surface: a hollow inside the crown, its raised foot, and ripples that
    die away."""
    out = r - CROWN_RADIUS
    hollow = -0.055 / (1 + np.exp(out / 0.03))
    foot = 0.06 * np.exp(-((out / 0.06) ** 2))
    ripple = 0.020 * np.cos(out * 36 - 2.4 + 0.25 * np.sin(2 * angle)) * np.exp(-(((out - 0.24) / 0.2) ** 2))
    inner = 0.010 * np.cos(r * 60) * np.exp(-((r / 0.25) ** 2))
    swell = 0.006 * np.sin(5 * r * np.cos(angle - 0.7) + 1) * np.clip(out * 4, 0, 1)
    return hollow + foot + ripple + inner + swell


def _wall_point(level: np.ndarray, angle: np.ndarray, jets: _Jets) -> tuple[np.ndarray, np.ndarray]:
    """Radius and height of the crown's middle sheet: level 0 at its foot, 1 at the rim."""
    r = CROWN_RADIUS + 0.02 * level + 0.13 * level**2 + 0.006 * np.sin(4 * angle + 1) * level
    return r, 0.045 + (jets.crown_height(angle) - 0.045) * level


def _pool(s: float) -> np.ndarray:
    """Rings of columns; each column is stretched a little so that it ends at the surface."""
    r, angle = _disc(1.0, s)
    height = DEPTH + _surface(r, angle)
    n = np.maximum(1, np.round(height / s)).astype(int)
    step = np.repeat(height / n, n)
    k = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n)
    return _from_polar(np.repeat(r, n), (k + 0.5) * step - DEPTH, np.repeat(angle, n))


def _column(s: float) -> np.ndarray:
    """The jet in the middle: a wide foot, a neck, a bulb; and a drop that has just left it."""
    foot = float(_surface(np.zeros(1), np.zeros(1))[0])
    layers = []
    top, bulb = 0.63, 0.062
    for y in np.arange(foot + s / 2, top, s):
        radius = 0.030 + 0.16 * np.exp(-(y - foot) / 0.06) + 0.006 * np.cos(y * 22)
        if y > top - 2 * bulb:  # the end is a ball, which the neck runs into
            radius = max(radius * (y < top - bulb), np.sqrt(max(0.0, bulb**2 - (y - top + bulb) ** 2)))
        r, angle = _disc(radius, s, phase=7 * y)
        keep = y > _surface(r, angle) + 0.4 * s
        lean = np.array([0.03, 0.0, -0.02]) * y**2
        layers.append(_from_polar(r[keep], np.full(int(keep.sum()), y), angle[keep]) + lean)
    return np.concatenate([*layers, _ball((0.020, 0.80, -0.014), 0.078, s), _ball((0.030, 0.985, -0.020), 0.030, s)])


def _wall(s: float, jets: _Jets) -> np.ndarray:
    """The crown's sheet, thinner upwards: rows around, each row stretched with the rim's height."""
    rows = max(2, round(CROWN_HEIGHT * 1.08 / s))
    out = []
    for row in range(rows):
        level = (row + 0.5) / rows
        thickness = 0.06 - 0.03 * level
        n_layers = max(2, round(thickness / s))
        for layer in range(n_layers):
            offset = ((layer + 0.5) / n_layers - 0.5) * max(thickness, 1.6 * s)
            n = max(6, round(TAU * (CROWN_RADIUS + 0.15 * level**2 + offset) / s))
            angle = (np.arange(n) + 0.5 * ((row + layer) % 2)) / n * TAU
            r, y = _wall_point(np.full(n, level), angle, jets)
            slope = (0.02 + 0.26 * level) / CROWN_HEIGHT  # offsets go along the sheet's normal
            out.append(_from_polar(r + offset, y - slope * offset, angle))
    return np.concatenate(out)


def _rim(s: float, jets: _Jets) -> np.ndarray:
    """The roll along the crown's edge."""
    n = round(TAU * (CROWN_RADIUS + 0.15) / s)
    angle = np.arange(n) / n * TAU
    r, y = _wall_point(np.ones(n), angle, jets)
    across, around = _disc(0.026, s)
    return np.concatenate(
        [_from_polar(r + a * np.cos(b), y + a * np.sin(b), angle) for a, b in zip(across, around, strict=True)]
    )


def _spray(s: float, jets: _Jets, rng: np.random.Generator) -> list[np.ndarray]:
    """Jets that leave the rim on bent paths, thin out and end in a bulb; droplets go on along the
    same paths."""
    out = []
    for angle, reach in zip(jets.angle, jets.reach, strict=True):
        r, y = _wall_point(np.ones(1), np.array([angle]), jets)
        start = _from_polar(r, y, np.array([angle]))[0]
        swing = angle + rng.uniform(-0.25, 0.25)
        speed = np.array([0.55 * np.cos(swing), 0.85, 0.55 * np.sin(swing)]) * (0.27 * reach)

        def path(t: float, start: np.ndarray = start, speed: np.ndarray = speed) -> np.ndarray:
            return start + speed * t - np.array([0.0, 0.045, 0.0]) * t * t

        n = max(2, round(float(np.linalg.norm(speed)) * 0.95 / s))
        for i in range(n):
            t = (i + 0.5) / n
            forward = path(t + 0.01) - path(t - 0.01)
            forward /= np.linalg.norm(forward)
            side = np.cross(forward, [0.0, 0.0, 1.0] if abs(forward[2]) < 0.8 else [1.0, 0.0, 0.0])
            side /= np.linalg.norm(side)
            a, b = _disc(0.026 * (1 - t) ** 0.7, s, phase=float(i))
            across = np.outer(a * np.cos(b), side) + np.outer(a * np.sin(b), np.cross(forward, side))
            out.append(path(t) + across)
        out.append(_ball(path(1.0), 0.018 + 0.014 * reach, s))
        t = 1.0
        for size in (0.026, 0.018, 0.010)[: 1 + int(3 * reach * rng.random() + 0.6)]:
            t += rng.uniform(0.42, 0.62)
            out.append(_ball(path(t) + rng.uniform(-0.012, 0.012, 3), size * rng.uniform(0.75, 1.1), s))
    for _ in range(26):  # the finest drops, thrown out farther
        angle, r = rng.uniform(0, TAU), 0.55 + 0.40 * rng.random() ** 1.6
        y = 0.30 + rng.uniform(-0.16, 0.46) * (1.3 - r)
        out.append(_ball(_from_polar(np.array([r]), np.array([y]), np.array([angle]))[0], rng.uniform(0.004, 0.018), s))
    return out


def _disc(radius: float, s: float, phase: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Polar coordinates of a disc filled with rings, the outermost half a spacing inside its
    edge."""
    n_rings = max(0, round(radius / s - 0.5))
    step = (radius - s / 2) / n_rings if n_rings else 0.0
    counts = np.array([1] + [max(1, round(TAU * k * step / s)) for k in range(1, n_rings + 1)])
    ring = np.repeat(np.arange(n_rings + 1), counts)
    j = np.arange(len(ring)) - np.repeat(np.cumsum(counts) - counts, counts)
    # A turn of the golden ratio from ring to ring, so that no spokes show.
    return ring * step, (j + (ring * 0.618 + phase) % 1.0) / counts[ring] * TAU


def _ball(center: ArrayLike, radius: float, s: float) -> np.ndarray:
    """A ball of nested spheres, each an even spiral; a single particle where the radius is about
    one spacing."""
    n_shells = max(0, round(radius / s - 0.5))
    step = (radius - s / 2) / n_shells if n_shells else 0.0
    shells = [np.zeros((1, 3))]
    for k in range(1, n_shells + 1):
        n = max(4, round(2 * TAU * (k * step / s) ** 2))
        shells.append(even_directions(n, k)[:, [0, 2, 1]] * (k * step))
    return np.concatenate(shells) + np.asarray(center, float)


def _from_polar(r: np.ndarray, y: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.stack([r * np.cos(angle), y, r * np.sin(angle)], axis=1)
