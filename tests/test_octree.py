"""The octree against a NumPy one built from the definition, and the same bits everywhere."""

import functools

import globule as gb
import numpy as np
import oracle
import pytest
from globule.scene.octree import morton
from scenes import Case, cloud, lattice

LEVELS = {32: 10, 64: 21}
LEAF = 32  # a cell with more particles is split
COMBINATIONS = (
    {"key_bits": 32}, {"key_bits": 64}, {"key_bits": 32, "level": 4}, {"key_bits": 64, "level": 13},
    {"octree": "dense"}, {"octree": "dense", "level": 3}, {"level": 0},
)  # fmt: skip
ids = [" ".join(f"{k}={v}" for k, v in c.items()) for c in COMBINATIONS]


@functools.cache
def points(name: str) -> np.ndarray:
    rng = np.random.default_rng(20)
    if name == "cloud":
        return cloud(6000, 20)
    if name == "clusters":
        scale, middle = 10 ** rng.uniform(-5, 0, (4000, 1)), rng.integers(0, 3, (4000, 1))
        return (rng.normal(size=(4000, 3)) * scale + middle).astype(np.float32)
    if name == "flat":
        return lattice(50, 60, 1)
    if name == "twins":  # equal keys: their order is the caller's
        return np.repeat(cloud(150, 21), 40, 0)[rng.permutation(6000)]
    spoilt = cloud(3000, 22)
    spoilt[rng.choice(3000, 90, False)] = rng.choice(
        np.array([np.nan, np.inf, -np.inf, 1e30, -1e30], np.float32), (90, 3)
    )
    spoilt[7] = [0.1, np.nan, 0.2]
    return spoilt


NAMES = ("cloud", "clusters", "flat", "twins", "spoilt")


def numpy_keys(p: np.ndarray, bits: int, bounds=None) -> np.ndarray:
    """(u - lo) * (cells / extent) in float32, truncated and clamped; 0 outside."""
    if bounds is None:
        inside = (np.abs(p) <= np.float32(1e18)).all(1)
        lo, hi = p[inside].min(0), p[inside].max(0)
    else:
        lo, hi = np.asarray(bounds, np.float32)
        inside = ((p >= lo) & (p <= hi)).all(1)
    cells, extent = np.float32(2 ** LEVELS[bits]), (hi - lo).max()
    scale = cells / extent if extent > 0 else np.float32(0)
    q = (p[inside] - lo) * scale
    assert q.dtype == np.float32
    q = np.where(q >= cells, cells - 1, q).astype(np.uint64)
    key = np.zeros(len(q), np.uint64)
    for bit in range(LEVELS[bits]):
        for axis in range(3):
            key |= (q[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    keys = np.zeros(len(p), np.uint64)
    keys[inside] = key | np.uint64(1 << (30 if bits == 32 else 63))
    return keys


def numpy_nodes(keys: np.ndarray, bits: int, depth: int) -> tuple[int, int, int]:
    """Nodes, leaves and deepest level, cell by cell from the root."""
    cells, nodes, leaves = [np.sort(keys[keys != 0])], 0, 0
    for level in range(depth + 1):
        split = [c for c in cells if len(c) > LEAF and level < depth]
        nodes += len(cells)
        leaves += len(cells) - len(split)
        if not split:
            return nodes, leaves, level
        cells = []
        for c in split:
            prefix = c >> np.uint64(3 * (LEVELS[bits] - level - 1))
            cells += np.split(c, np.nonzero(np.diff(prefix))[0] + 1)
    raise AssertionError


def check_keys(octree, expected):
    order = np.argsort(expected, kind="stable")
    keys, index = octree.sorted_keys(len(expected))
    np.testing.assert_array_equal(keys, expected[order])
    np.testing.assert_array_equal(index, order)
    assert octree.n_inside == np.count_nonzero(expected)


@pytest.mark.parametrize("bits", LEVELS)
@pytest.mark.parametrize("name", NAMES)
def test_sorted_keys(backend, name, bits):
    p = points(name)
    check_keys(gb.Scene(p, support=0.1, key_bits=bits, **backend).octree, numpy_keys(p, bits))


@pytest.mark.parametrize("bits", LEVELS)
def test_fixed_space(backend, bits):
    p, bounds = points("spoilt"), ((-0.5, -0.6, -0.7), (0.9, 0.8, 0.3))
    scene = gb.Scene(p, support=0.1, key_bits=bits, bounds=bounds, **backend)
    expected = numpy_keys(p, bits, bounds)
    check_keys(scene.octree, expected)
    np.testing.assert_array_equal(scene.octree.lo, np.float32(bounds[0]))
    at = cloud(500, 23)
    np.testing.assert_allclose(scene.field(at), Case(p[expected != 0], support=0.1).field(at)[0], atol=1e-6)
    scene.update(positions=p * np.float32(0.5))  # some re-enter
    assert scene.octree.n_inside == np.count_nonzero(numpy_keys(p * np.float32(0.5), bits, bounds))


@pytest.mark.parametrize(("bits", "depth"), [(32, 10), (64, 21), (32, 4), (32, 0), (64, 13)])
@pytest.mark.parametrize("name", NAMES)
def test_sparse_nodes(backend, name, bits, depth):
    p = points(name)
    octree = gb.Scene(p, support=0.1, key_bits=bits, level=depth, **backend).octree
    expected = numpy_nodes(numpy_keys(p, bits), bits, depth)
    assert (octree.n_nodes, octree.n_leaves, octree.level) == expected


@pytest.mark.parametrize("bits", LEVELS)
def test_what_python_calls_of_the_keys(bits):
    """tests/cpp/keys.cpp has their truths."""
    assert (morton.encode(1, 2, 3, bits), morton.decode(0b110101, bits)) == (0b110101, (1, 2, 3))
    root = morton.dense_key(0, bits)
    child = morton.child(root, 0, 5, bits)  # x 1, y 0, z 1
    assert (morton.parent(child, 1, bits), morton.dense_index(child, 1, bits)) == (root, 1 + 5)
    assert morton.neighbor(child, 1, -1, 1, 0, bits) == morton.child(root, 0, 6, bits)
    assert morton.neighbor(child, 1, 1, 0, 0, bits) is None


def test_dense_nodes(backend):
    for depth, total in ((0, 1), (3, 585), (6, 299_593)):
        octree = gb.Scene(points("cloud"), support=0.1, octree="dense", level=depth, **backend).octree
        assert (octree.n_nodes, octree.n_inside) == (total, 6000)


@pytest.mark.parametrize("options", COMBINATIONS, ids=ids)
@pytest.mark.parametrize("name", NAMES)
def test_same_bits_everywhere(backend, reference, name, options):
    p = points(name)
    particles = gb.Particles(p, support=np.random.default_rng(24).uniform(0.05, 0.2, len(p)))
    octree = gb.Scene(particles, **options, **backend).octree
    expected = reference(particles, **options).octree
    assert (octree.key_hash, octree.node_hash) == (expected.key_hash, expected.node_hash)


def rows(found) -> list[np.ndarray]:
    offsets, indices = found
    assert (offsets.dtype, indices.dtype, offsets[0], offsets[-1]) == (np.uint64, np.uint32, 0, len(indices))
    return np.split(indices, offsets[1:-1].astype(np.int64))


@pytest.mark.few_backends
@pytest.mark.parametrize("options", COMBINATIONS, ids=ids)
@pytest.mark.parametrize("name", NAMES)
def test_neighbors(backend, name, options):
    p = points(name)
    scene = gb.Scene(p, support=0.1, **options, **backend)
    for at, radius in ((cloud(120, 30, 1.2), 0.15), (p[100:160], 0.01), (cloud(5, 31), 50.0)):
        at, rank = at[np.isfinite(at).all(1)], np.empty(len(p), np.int64)
        rank[scene.octree.sorted_keys(len(p))[1]] = np.arange(len(p))
        for mine, truth in zip(rows(scene.neighbors(at, radius)), oracle.neighbors(p, at, radius), strict=True):
            np.testing.assert_array_equal(np.sort(mine), truth)
            assert (np.diff(rank[mine]) > 0).all()  # in Morton order


def test_neighbors_exactly_at_the_radius(backend):
    scene = gb.Scene(lattice(5, 5, 5), **backend)
    assert len(rows(scene.neighbors(np.zeros((1, 3)), 1.0))[0]) == 7
    assert [len(array) for array in scene.neighbors(np.zeros((0, 3)), 1.0)] == [1, 0]


@pytest.mark.parametrize("octree", ["sparse", "dense"])
def test_update(backend, octree):
    scene = gb.Scene(cloud(1000, 32), support=0.2, octree=octree, **backend)
    at = cloud(200, 33)
    for n, seed in ((1000, 34), (5000, 35), (3, 36), (0, 37), (1500, 38), (1, 39), (40_000, 40)):
        p = cloud(n, seed, 1 + seed % 3)
        scene.update(positions=p)
        assert len(scene) == scene.octree.n_inside == n
        fresh = gb.Scene(p, support=0.2, octree=octree, **backend)
        assert (scene.octree.key_hash, scene.octree.node_hash) == (fresh.octree.key_hash, fresh.octree.node_hash)
        if n <= 5000:
            truth = oracle.neighbors(p, at, 0.2)
            for mine, expected in zip(rows(scene.neighbors(at, 0.2)), truth, strict=True):
                np.testing.assert_array_equal(np.sort(mine), expected)
        np.testing.assert_array_equal(scene.field(at), fresh.field(at))


def test_update_of_single_fields(backend):
    p = cloud(500, 41)
    scene, at = gb.Scene(gb.Particles(p, support=0.3), **backend), cloud(300, 42)
    weight = np.linspace(-1, 2, 500).astype(np.float32)
    scene.update(weight=weight)
    np.testing.assert_allclose(scene.field(at), Case(p, 0.3, weight).field(at)[0], atol=1e-5)
    support = np.linspace(0.1, 0.5, 500).astype(np.float32)
    scene.update(support=support)
    np.testing.assert_allclose(scene.field(at), Case(p, support, weight).field(at)[0], atol=1e-5)
    scene.update(gb.Particles(p[:100], support=0.2))
    np.testing.assert_allclose(scene.field(at), Case(p[:100], 0.2).field(at)[0], atol=1e-5)


@pytest.mark.parametrize("options", [{}, {"key_bits": 64}, {"octree": "dense", "level": 5}], ids=str)
def test_steady_state_needs_no_more_memory(backend, options):
    scene = gb.Scene(cloud(20_000, 43), support=0.1, **options, **backend)
    sizes = []
    for i in range(20):
        scene.update(positions=cloud(20_000, 44 + i))
        sizes.append(scene.octree.bytes)
    assert len(set(sizes[2:])) == 1, sizes


def test_nodes_are_never_lost_when_the_tree_grows(backend):
    """A flat set becomes clusters: many more nodes from the same number of particles."""
    scene = gb.Scene(np.zeros((4000, 3)), support=0.1, **backend)
    p = points("clusters")
    at = p[::20] + np.float32(0.01)
    for _ in range(3):
        scene.update(positions=p)
        np.testing.assert_allclose(scene.field(at), Case(p, 0.1).field(at)[0], rtol=1e-5)
        octree = scene.octree
    assert (octree.n_nodes, octree.n_leaves, octree.level) == numpy_nodes(numpy_keys(p, 32), 32, 10)
