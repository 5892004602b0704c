"""Small files as the programs of many origins write them, each with what must be read from it.

A ball of `X` on a lattice is the fluid of most; grains are spheres that do not touch.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

STEP = 0.1
_GRID = np.stack(np.mgrid[-4:5, -4:5, -4:5], -1).reshape(-1, 3) * STEP
X = _GRID[np.linalg.norm(_GRID, axis=1) < 0.401] + (1.0, 2.0, 3.0)
N = len(X)
FLUID = N * STEP**3
CENTERS = np.stack(np.mgrid[:4, :3, :2], -1).reshape(-1, 3) * 0.5
RADII = 0.1 + 0.005 * np.arange(len(CENTERS))
FRAMES = (X, X + (1.0, 0, 0))
SPHERES = float((4 / 3 * np.pi * RADII**3).sum())


class Kind(NamedTuple):
    """One kind of files. volume: of the surface; None: it has no certain one. names: attributes."""

    name: str
    file: str
    make: Callable[[Path], Any]
    n: int = N
    volume: float | None = FLUID
    frames: int = 1
    periodic: str | None = None
    unit: str = ""
    names: tuple[str, ...] = ()
    package: str = ""
    places: np.ndarray = X
    area: float | None = None  # of a mesh
    ghosts: bool = False
    warns: str = ""  # in the only warning


KINDS: list[Kind] = []


def kind(name: str, file: str, **expected: Any) -> Callable:
    """Add the function that writes `file`."""

    def add(make: Callable[[Path], Any]) -> Callable[[Path], Any]:
        KINDS.append(Kind(name, file, make, **expected))
        return make

    return add


def text(name: str, file: str, content: str, encoding: str = "utf-8", **expected: Any) -> None:
    """Add a file of this text."""
    kind(name, file, **expected)(lambda path: path.write_bytes(content.encode(encoding)))


def grains(**more: Any) -> dict[str, Any]:
    """What is expected of the spheres."""
    return {"n": len(CENTERS), "volume": SPHERES, "places": CENTERS} | more


def rows(x: np.ndarray, mark: str = " ", before: str = "", after: str = "") -> str:
    """A line for each place."""
    lines = (mark.join(f"{v:.6f}" for v in place) for place in x)
    return "".join(f"{before}{line}{after}\n" for line in lines)


def numbered(x: np.ndarray, mark: str = " ", after: str = "") -> str:
    """A line for each place, with its number first."""
    lines = rows(x, mark, "", after).splitlines()
    return "".join(f"{i}{mark}{line}\n" for i, line in enumerate(lines, 1))


def with_radii(mark: str = " ", factor: float = 1.0) -> str:
    """A line for each sphere, with its radius last."""
    table = np.column_stack([CENTERS, factor * RADII])
    return rows(table, mark)
