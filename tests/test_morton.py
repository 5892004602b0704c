"""Keys against the vectors of spec/1 (corrected) and against plain coordinate arithmetic."""

import itertools
import random

import pytest
from globule.scene.octree import morton

LEVELS = {32: 10, 64: 21}
INSIDE = {32: 1 << 30, 64: 1 << 63}
WIDTHS = (32, 64)


def interleave(x: int, y: int, z: int) -> int:
    code = 0
    for i in range(21):
        code |= (x >> i & 1) << 3 * i | (y >> i & 1) << 3 * i + 1 | (z >> i & 1) << 3 * i + 2
    return code


def cell(key: int, level: int, bits: int) -> tuple[int, int, int]:
    x, y, z = morton.decode(key & (INSIDE[bits] - 1), bits)
    shift = LEVELS[bits] - level
    return x >> shift, y >> shift, z >> shift


def key_at(x: int, y: int, z: int, level: int, bits: int) -> int:
    shift = LEVELS[bits] - level
    return INSIDE[bits] | interleave(x << shift, y << shift, z << shift)


@pytest.mark.parametrize("bits", WIDTHS)
def test_keys_parents_children_dense_indices_and_neighbors(bits):
    rng, top = random.Random(1), 2 ** LEVELS[bits] - 1
    some = [tuple(rng.randint(0, top) for _ in range(3)) for _ in range(3000)]
    for x, y, z in [(0, 0, 0), (top, top, top), (top, 0, 0), (0, top, 0), (0, 0, top), *some]:
        code = morton.encode(x, y, z, bits)
        assert (code, morton.decode(code, bits)) == (interleave(x, y, z), (x, y, z))
    rng = random.Random(2)
    for _ in range(500):
        level = rng.randint(0, LEVELS[bits] - 1)
        x, y, z = (rng.randrange(2**level) for _ in range(3))
        key = key_at(x, y, z, level, bits)
        for octant in range(8):
            child = morton.child(key, level, octant, bits)
            expected = (2 * x + (octant & 1), 2 * y + (octant >> 1 & 1), 2 * z + (octant >> 2))
            assert (cell(child, level + 1, bits), morton.parent(child, level + 1, bits)) == (expected, key)
    first = 0
    for level in range(9):
        last, one_level = first + 8**level - 1, 3 * (LEVELS[bits] - level)
        for index in (first, (first + last) // 2, last, 8, *range(64, 73)):
            if not first <= index <= last:
                continue
            key = morton.dense_key(index, bits)
            assert key == INSIDE[bits] | (index - first) << one_level
            assert morton.dense_index(key, level, bits) == index
        first = last + 1
    assert first == 19_173_961  # T(8)
    rng = random.Random(3)
    cells = [(level, *at) for level in range(4) for at in itertools.product(range(2**level), repeat=3)]
    for _ in range(300):
        level = rng.randint(4, LEVELS[bits])
        top = 2**level - 1
        cells.append((level, *(rng.choice((0, top, top // 2, top // 2 + 1, rng.randint(0, top))) for _ in "xyz")))
    for level, *at in cells:
        key = key_at(*at, level, bits)
        for step in itertools.product((-1, 0, 1), repeat=3):
            moved = [c + s for c, s in zip(at, step, strict=True)]
            inside = all(0 <= c < 2**level for c in moved)
            expected = key_at(*moved, level, bits) if inside else None
            assert morton.neighbor(key, level, *step, bits) == expected, (at, level, step)
