"""A block of particles on several ranks, which are threads here, and images that must agree."""

import globule as gb
import numpy as np
from globule._base.ranks import run_threads

SIZE = (48, 36)
RNG = np.random.default_rng(5)
LATTICE = np.stack(np.meshgrid(*[np.arange(12)] * 3, indexing="ij"), -1).reshape(-1, 3)
POSITIONS = (LATTICE + RNG.uniform(-0.25, 0.25, LATTICE.shape)).astype(np.float32)
N = len(POSITIONS)
COLOR = RNG.random(POSITIONS.shape).astype(np.float32)
PARTICLES = gb.Particles(POSITIONS, color=COLOR)
CAMERA = gb.Camera.fit(POSITIONS, size=SIZE, margin=1)
CUT = gb.ClipPlane((1, 0.2, 0), 6.0)
GLASS = gb.Material(reflection=0.2, transmission=0.6, index=1.3)
ALL = {"material": GLASS, "shadows": True, "ambient_rays": 2}  # light that goes everywhere
OF_A_FEW = {"one rank has all": (3, N), "more ranks than particles": (5, 2), "none": (2, 0)}


def on(n, work, backend):

    def one(ranks):
        return work({**backend, **({} if backend["device"] == "cuda" else {"threads": 1})}, ranks)

    return run_threads(n, one)


def mine(particles, ranks):
    """A rank's own particles: in turn, so that no place has those of one rank only."""
    return particles[np.arange(ranks.rank, len(particles), ranks.size)]


def same(one, many, least=0.03):
    """0 pixels of hit or miss differ, colors by at most a level."""
    assert one.mask.mean() > least
    np.testing.assert_array_equal(one.mask, many.mask)
    assert np.abs(one.image.astype(int) - many.image.astype(int)).max() <= 1


def own_shapes():
    """Particles with kernels of their own, and the threshold of each set."""
    rng = np.random.default_rng(6)
    weight = np.where(np.arange(N) % 5 == 0, -0.6, 1.0).astype(np.float32)
    yield gb.Particles(POSITIONS, weight=weight), {"support": 2.0}
    support = rng.uniform(1.2, 2.2, N).astype(np.float32)
    yield gb.Particles(POSITIONS, support=support), {}
    support[700] = 30  # one particle over all pieces
    yield gb.Particles(POSITIONS, support=support), {"threshold": 1.0}
    skew = rng.normal(size=(N, 3, 3)) * 0.08 + 0.6 * np.eye(3)
    matrices = ((skew + skew.transpose(0, 2, 1)) / 2).astype(np.float32)
    yield gb.Particles(POSITIONS, anisotropy=matrices), {}
