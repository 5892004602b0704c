"""The knife: exactly the bonds that cross, none missed, none twice."""

import functools
import itertools
from fractions import Fraction

import numpy as np
import pytest
from globule.sim import blade
from globule.sim.bonds import build_bonds
from globule.sim.tissue import Tissue
from sim_helpers import check

from bench.tables import physics_tissue as truths

D = truths.SPACING


@pytest.mark.parametrize("experiment", ["partial_cut", "thin_fast"])
def test_truths(backend, experiment):
    check(getattr(truths, experiment)(**backend))


@pytest.mark.parametrize("across", [2, 3, 6])
@pytest.mark.parametrize("height", [9.5, 9.0, 9.25])
def test_plane_breaks_5nn_minus_4n(backend, across, height):
    check(truths.plane_cut(across=across, height=height, **backend))


def orientation(a, b, c, d) -> int:
    """Exact sign of the determinant of b - a, c - a, d - a."""
    origin = [Fraction(float(o)) for o in a]
    u, v, w = ([Fraction(float(q)) - o for q, o in zip(p, origin, strict=True)] for p in (b, c, d))
    det = u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0]) + u[2] * (v[0] * w[1] - v[1] * w[0])
    return (det > 0) - (det < 0)


def crosses(triangle, p, q) -> bool:
    a, b, c = triangle
    if orientation(a, b, c, p) == orientation(a, b, c, q):
        return False
    s = {orientation(p, q, a, b), orientation(p, q, b, c), orientation(p, q, c, a)}
    assert 0 not in s
    return len(s) == 1


@functools.cache
def random_blades():
    rng = np.random.default_rng(11)
    x = truths.lattice(4, 4, 4) + rng.uniform(-0.2, 0.2, (64, 3)).astype("f4") * np.float32(D)
    bonds = build_bonds(x, D, 2500.0)
    first = bonds.first_ends
    pairs = [(t, o) for t, o in zip(first, bonds.other, strict=True) if t < o]
    blades = []
    for _ in range(4):
        swept = blade.sweep(*rng.uniform(-0.2, 1.2, (2, 4, 3)) * 3 * D)
        corners = swept.vertices[swept.triangles]
        blades.append((swept, sum(any(crosses(t, x[i], x[o]) for t in corners) for i, o in pairs)))
    return x, len(pairs), blades


def test_sweeps_in_parts_cut_as_one_and_a_sheet_always_separates(backend):
    """A bumpy sheet whose parts share edges that pass through particles."""
    x = truths.lattice(8, 8, 8)
    y = places = np.arange(-2, 10, 1.0)  # edges pass exactly through particles

    def edge(at):
        return np.stack([0 * y + at, y, 3.0 + np.rint(np.sin(at + y))], 1) * D

    parts = Tissue(x, D, 2500.0, **backend)
    sweeps = [blade.sweep(edge(a), edge(b)) for a, b in itertools.pairwise(places)]
    n_parts, whole = sum(map(parts.cut, sweeps)), Tissue(x, D, 2500.0, **backend)
    n_whole = whole.cut(np.concatenate([sweep.vertices[sweep.triangles] for sweep in sweeps]))
    assert n_parts == n_whole > 5 * 64 - 32
    assert parts.n_pieces == whole.n_pieces == 2
    assert np.array_equal(parts.piece, whole.piece)
    rng = np.random.default_rng(4)
    x = truths.lattice(7, 7, 7) + rng.uniform(-0.25, 0.25, (343, 3)).astype("f4") * np.float32(D)
    for _ in range(5):
        y = np.sort(rng.uniform(-2, 9, 9))
        y[[0, -1]] = -9, 16
        tissue, places = Tissue(x, D, 2500.0, **backend), np.linspace(-3, 10, 6)
        heights = rng.uniform(2, 4, (6, 9))
        edges = [np.stack([0 * y + a, y, h], 1) * D for a, h in zip(places, heights, strict=True)]
        for a, b in itertools.pairwise(edges):
            tissue.cut(blade.sweep(a, b))
        # Lone particles in the folds may be pieces of their own, but top and bottom part.
        top, bottom = x[:, 2].argmax(), x[:, 2].argmin()
        assert tissue.piece[top] != tissue.piece[bottom]


def test_random_blades_cut_what_exact_arithmetic_says_and_pieces_are_components(backend):
    rng, x = np.random.default_rng(8), truths.lattice(9, 9, 9)
    tissue = Tissue(x, D, 2500.0, **backend)
    for _ in range(12):
        a, b = rng.uniform(-1, 9, (2, 3)) * D
        c = rng.normal(size=3)
        tissue.cut(np.array([[a + 0.1 * c, b - 0.1 * c, a - 0.2 * rng.normal(size=3)]]))
    labels = tissue.piece
    assert len(np.unique(labels)) == tissue.n_pieces > 2
    for label in np.unique(labels):
        assert np.flatnonzero(labels == label).min() == label
    x, n_bonds, blades = random_blades()
    for swept, expected in blades:
        tissue = Tissue(x, D, 2500.0, **backend)
        assert tissue.cut(swept) == expected > 0
        assert (tissue.cut(swept), tissue.n_bonds) == (0, n_bonds - expected)


def test_the_knife_cuts_where_it_stands_and_degenerate_blades_nothing():
    knife = blade.scalpel(length=0.02, height=0.006)
    tissue = Tissue(truths.lattice(10, 4, 10) + np.float32(1e-5), D, 2500.0, device="cpu")
    pose, lower = np.eye(4), np.eye(4)
    pose[:3, 3], lower[:3, 3] = [0.0, 3.01 * D / 2, 12 * D], [0.0, 3.01 * D / 2, 9.4 * D]
    assert tissue.cut(knife.sweep(pose, lower)) > 0
    assert (tissue.n_pieces, tissue.cut(knife.sweep(lower, lower))) == (1, 0)
    tissue = Tissue(truths.lattice(4, 4, 4), D, 2500.0, device="cpu")
    point, line = np.full((1, 3, 3), 1.5 * D), np.array([[[0, D, D], [3 * D, D, D], [D, D, D]]])
    assert tissue.cut(point) == tissue.cut(line) == 0
    along = np.array([[0, D, D], [3 * D, D, D]])
    assert tissue.cut(blade.sweep(along, along + [D, 0, 0])) == 0


@pytest.mark.parametrize(("wrong", "message"), [
    (np.zeros((3, 3)), "shape"), (np.full((1, 3, 3), np.nan), "finite"),
    (([[0, 0, 0], [1, 0, 0]], [[0, 0, 0]]), "now"),
    (([[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "now: expected 2"),
])  # fmt: skip
def test_wrong_blades_are_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        blade.as_blade(wrong)
