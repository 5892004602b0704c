"""The tracing of the source thesis, beside the exact one: for its figures, and to compare."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from .. import _core
from .._base.arrays import address, rays
from .._base.checks import whole
from .._base.fixed import Fixed, read_only
from .._base.settings import Choice, Number, Switch, Whole, check_all, setting
from ..data.particles import Particles

ROOTS = ("march", "bezier")
POLYNOMIAL_KERNELS = ("murakami", "wyvill")  # polynomials along a ray
MAX_THRESHOLDS = 16


@read_only
@dataclass(frozen=True)
class Thesis(Fixed):
    """The thesis's method of tracing rays, §5.2-5.4; the scene's octree must be dense.

    Each ray visits leaves by itself, with a stack. A leaf sees its own particles and those of its
    26 neighbors. The result is correct only while no support is larger than the edge of a leaf.
    """

    root: str = setting(Choice(*ROOTS), "march", "points along the ray (Fig. 5.5); bezier: Bézier "
        "clipping (Nishita & Nakamae 1994; kernels murakami and wyvill)")  # fmt: skip
    step: float = setting(Number(1e-4, 1e4), 0.25, "step of the march before the first threshold, "
        "in supports. The march may miss parts that are thinner than a step")  # fmt: skip
    thresholds: int = setting(Whole(0, MAX_THRESHOLDS), 4, "number of thresholds below the scene's "
        "own, evenly spaced; each passed threshold halves the step")  # fmt: skip
    ghosts: bool = setting(Switch(), True, "leaves see the particles of their neighbors (ghost "
        "particles), and rays also visit the leaves beside occupied leaves. False: the artifacts "
        "of Fig. 5.6")  # fmt: skip
    face_rule: bool = setting(Switch(), True, "a ray does not fetch the nine neighbors across the "
        "face of entry again (Fig. 5.7). The image is the same")  # fmt: skip
    exterior: bool = setting(Switch(), True, "the spheres of radius a bound the search; a lone "
        "sphere needs no search (Figs. 5.3, 5.4)")  # fmt: skip
    refine: bool = setting(Switch(), True, "a search refines the march's sign change. False: the "
        "terraces of Fig. 5.1")  # fmt: skip
    averaged_normals: bool = setting(Switch(), False, "normals away from the mean of the centers "
        "that reach the hit (Fig. 5.8a) instead of the gradient's")  # fmt: skip

    def _choices(self) -> tuple[int, float, int, bool, bool, bool, bool, bool]:
        made: Any = check_all(self) | {"root": ROOTS.index(self.root)}
        return tuple(made.values())

    @cached_property
    def _packed(self) -> Any:
        return _core.Thesis(*self._choices(), False)


class Traced(Protocol):
    """What of a scene is asked here: its kernel, its octree and the core's own scene."""

    kernel: str
    _kernel: int
    _tree: tuple[int, int, bool, list[float]]  # key bits, level, whether dense, space

    @property
    def threshold(self) -> float:
        """Iso-value of the surface."""

    @property
    def _scene(self) -> Any: ...


def check_tracing(scene: Traced, thesis: Thesis | None) -> None:
    """Refuse choices with which `scene` cannot be traced."""
    if thesis is None:
        return
    if not isinstance(thesis, Thesis):
        raise TypeError(f"thesis: expected a Thesis, got {thesis!r}")
    if not scene._tree[2]:
        raise ValueError('octree: expected a scene with octree="dense" for the thesis, got sparse')
    if thesis.root == "bezier" and scene.kernel not in POLYNOMIAL_KERNELS:
        raise ValueError(
            f"kernel: expected {' or '.join(POLYNOMIAL_KERNELS)} for Bézier clipping, got {scene.kernel!r}"
        )


def work(scene: Traced, origins: Any, directions: Any, thesis: Thesis) -> tuple[np.ndarray, np.ndarray]:
    """The cost of rays up to their first hit.

    Args:
        origins, directions: (M, 3) world, as for `intersect`.

    Returns:
        leaves (M,) uint32 visited; sums (M,) uint32 over the candidates: evaluations of the field
        when marching, polynomials when clipping.
    """
    o, d = rays(origins, directions)
    n = o.shape[0]
    check_tracing(scene, thesis)
    t, counts = np.empty(n, np.float32), np.empty((n, 2), np.uint32)
    normal, color = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    scene._scene.intersect(
        scene._kernel, scene.threshold, _core.Thesis(*thesis._choices(), True), n, o.place,
        d.place, address(t), address(normal), address(color),
    )  # fmt: skip
    scene._scene.thesis_work(n, address(counts))
    return counts[:, 0], counts[:, 1]


def default_support(positions: Any, level: int) -> float:
    """The thesis's support (§3.6): half the edge of a leaf of the octree around `positions`.

    Args:
        positions: (N, 3) world, or `Particles`.
        level: deepest level of the octree, 0 to 8.

    Returns:
        The support, world units.

    Raises:
        TypeError, ValueError: the level is no whole number from 0 to 8, or the positions have no
            extent, so that a leaf has no edge.
    """
    level = whole("level", level, 0, 8)
    particles = positions if isinstance(positions, Particles) else Particles(positions)
    lo, hi = particles.bounds()
    extent = float(np.max(hi - lo))
    if not extent > 0:
        raise ValueError(f"positions: expected some extent, got {extent:g}")
    return 0.5 * extent / 2**level


def fitting_level(extent: float, largest: float) -> int:
    """Deepest level of an octree of this extent, 0 to 8, with cells no smaller than the largest
    support."""
    return int(np.clip(np.floor(np.log2(extent / largest)), 0, 8))
