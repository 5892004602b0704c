"""Bonds: stiffness, momentum, tearing, pieces, grasps; on every backend."""

import numpy as np
import pytest
from globule.sim.bonds import along, build_bonds
from globule.sim.tissue import BALL, Tissue
from sim_helpers import check

from bench.tables import physics_tissue as truths

D = truths.SPACING


@pytest.mark.few_backends
@pytest.mark.parametrize(
    "experiment", ["column", "cantilever", "stiffness", "momentum", "free_fall", "tearing", "creep", "contact"]
)
def test_truths(backend, experiment):
    check(getattr(truths, experiment)(**backend))


def test_bonds():
    rng = np.random.default_rng(1)
    x = truths.lattice(6, 6, 6) + rng.uniform(-0.2, 0.2, (216, 3)).astype("f4") * D
    b = build_bonds(x, D, 2500.0)
    pairs = set(zip(b.first_ends.tolist(), b.other.tolist(), strict=True))
    assert len(pairs) == len(b.other)
    assert all((o, t) in pairs for t, o in pairs)
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    assert len(pairs) == ((distance <= np.float32(1.5 * D)) & ~np.eye(216, dtype=bool)).sum()
    # The stiffness of two materials is in series.
    soft_hard = build_bonds(np.array([[0, 0, 0], [D, 0, 0]]), D, [1000.0, 3000.0])
    assert np.allclose(soft_hard.stiffness, 0.4 * 1500.0 * D)
    # Bodies are not bonded to each other.
    x = truths.lattice(2, 2, 4)
    b = build_bonds(x, D, 2500.0, body=truths.layers(x) // 2)
    assert (truths.layers(x)[b.first_ends] // 2 == truths.layers(x)[b.other] // 2).all()


@pytest.mark.few_backends
def test_jittered_particles_are_about_as_stiff_as_asked(backend):
    rng, x = np.random.default_rng(5), truths.lattice(6, 6, 24)
    z = truths.layers(x)
    x = x + rng.uniform(-0.15, 0.15, x.shape).astype("f4") * D
    tissue = Tissue(x, D, 2500.0, fixed=z == z.max(), damping=25.0, **backend)
    pull = np.zeros_like(x)
    pull[z == 0, 2] = -0.003 * 2500.0 * D**2 / (1000.0 * D**3)
    tissue.accelerate(pull)
    y = truths.settle(tissue, 1.0) - x
    assert 0.75 < 0.003 / ((y[z == 16, 2].mean() - y[z == 8, 2].mean()) / (8 * D)) < 1.15


@pytest.mark.parametrize("model", ["bonds", "solid"])
def test_same_bits_whatever_the_threads(model):
    x, found = truths.lattice(15, 15, 15), []
    for threads in (1, 2, 3):
        fixed = x[:, 2] < D / 2
        tissue = Tissue(x, D, 2500.0, fixed=fixed, model=model, device="cpu", threads=threads)
        tissue.velocities = np.random.default_rng(2).normal(0, 0.1, x.shape)
        for _ in range(3):
            tissue.advance(0.01, truths.GRAVITY)
            tissue.cut(np.array([[[0.01, -1, -1], [0.01, 1, -1], [0.01, 0, 1]]]))
        found.append((tissue.positions, tissue.velocities, tissue.piece))
    for other in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_elastic_energy_is_that_of_the_springs_and_a_ball_pushes(backend):
    x = truths.lattice(4, 4, 5)
    tissue = Tissue(x, D, 2500.0, model="bonds", **backend)
    assert tissue.elastic_energy < 1e-15
    tissue.positions = x * [1, 1, 1.05]
    b, y = build_bonds(x, D, 2500.0), x.astype("f8") * [1, 1, 1.05]
    stretch = np.linalg.norm(y[b.first_ends] - y[b.other], axis=1) - b.length
    expected = (0.25 * b.stiffness * stretch**2).sum()
    assert abs(tissue.elastic_energy / expected - 1) < 1e-4
    x = truths.lattice(8, 8, 8)
    tissue = Tissue(x, D, 2500.0, fixed=x[:, 2] < D / 2, **backend)
    center = np.array([3.5 * D, 3.5 * D, 7 * D + 0.006])
    tissue.instruments(shapes=[(BALL, tuple(center), (0, 0, 0), 0.005, (0.0, 0.0, -0.1))])
    tissue.advance(0.03)
    center = center - [0, 0, 0.003]
    assert np.linalg.norm(tissue.positions - center, axis=1).min() > 0.005 * (1 - 1e-3)
    assert tissue.positions[:, 2].max() < 7.5 * D


def test_what_lies_along_a_polyline():
    course = [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    points = np.array([[0.5, 0.1, 0], [0.5, 0.3, 0], [-0.1, 0, 0], [1.1, 0.9, 0.1], [1, 1.3, 0]])
    assert along(course, 0.2, points).tolist() == [True, False, True, True, False]
