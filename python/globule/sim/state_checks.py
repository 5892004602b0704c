"""What a checkpoint's arrays must be, before the solver reads them: it trusts indices and sizes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .._base.memory import room
from .materials import MOST_SUBSTEPS, MOST_TERMS
from .settings import MAX_PHASES

MOST_IN_A_CELL = 4096  # particles in a cube of the spacing: their pairs would fill the memory
_BYTES_OF_AN_ID = 16  # that each id ever given takes
_BLOCK = 32  # particles of tissue whose bonds lie interleaved (sim/bonds.hpp)
_NOBODY = 0xFFFFFFFF
_TERM_ROWS = 8  # of a Prony term: share, rate, six of a metric (sim/memory.hpp)
_MOST_TRACE = 6.01  # of a metric, with what rounding adds
_MOST_HOLD = 10  # FREE, FIXED, GONE and eight grasps
# The arrays of tissue, whose bytes are uint8: how many a particle, or a bond's entry, has of each.
_OF_PARTICLES = {"at": "4f4", "velocity": "4f4", "phase": "u1", "scarred": "u1", "volume": "f4",
                 "whose": "u1", "wetness": "f4", "before": "3u4", "id": "u4"}  # fmt: skip
_OF_BONDS = {"length": "f4", "stiffness": "f4", "vessel": "u1"}


def number_of(name: str, value: Any, least: float, most: float) -> float:
    """One finite number in a range; anything else is a ValueError."""
    found = np.asarray(value)
    if found.shape != () or found.dtype.kind not in "iuf" or not least <= found <= most:
        raise ValueError(f"{name}: expected a number from {least:g} to {most:g}")
    return float(found)


def check_clock(state: Mapping[str, np.ndarray]) -> None:
    """Refuse a time or counts that cannot be. Raises ValueError."""
    number_of("time", state["time"], 0.0, 1e12)
    counts = np.asarray(state["counts"])
    if counts.shape != (2,) or counts.dtype.kind not in "iu" or counts.min() < 0:
        raise ValueError("counts: expected the ids given and the steps")
    if int(counts[0]) >= 2**31 or _BYTES_OF_AN_ID * int(counts[0]) > room():
        raise ValueError(f"counts: expected ids that fit in memory, got {int(counts[0]):,}")
    if int(counts[1]) >= 2**62:
        raise ValueError(f"counts: expected steps below 2^62, got {int(counts[1])}")


def check_crowds(place: np.ndarray, spacing: float) -> None:
    """Refuse particles at one place: the lists of their pairs would not fit. Raises ValueError."""
    cells = np.floor(place[:, :3].astype(np.float64) / spacing)
    cells = np.clip(cells, -(2**20), 2**20 - 1).astype(np.int64)
    keys = (cells[:, 0] << 42) ^ ((cells[:, 1] & 0x1FFFFF) << 21) ^ (cells[:, 2] & 0x1FFFFF)
    inside = (np.abs(cells) < 2**20 - 1).all(axis=1)
    most = int(np.unique(keys[inside], return_counts=True)[1].max(initial=0))
    if most > MOST_IN_A_CELL:
        expected = f"expected at most {MOST_IN_A_CELL} particles in a cube of the spacing"
        raise ValueError(f"place: {expected}, got {most}")


def check_tissue(state: Mapping[str, np.ndarray], next_id: int, n_phases: int, n_vessels: int, longest: float) -> None:
    """Refuse tissue whose arrays do not fit together.

    Args:
        state: of a checkpoint; arrays of tissue are named tissue_….
        next_id: ids given.
        n_phases, n_vessels: of the simulation.
        longest: step, s.

    Raises:
        ValueError: names the array.
        KeyError: a missing array.
    """
    if "tissue_hold" not in state:
        strange = [name for name in state if name.startswith("tissue_") and name != "tissue_pools"]
        if strange:
            raise ValueError(f"{strange[0]}: expected tissue_hold beside it, got none")
        return
    hold = _numbers(state, "hold", "u1")
    n = len(hold)
    t = {name: _numbers(state, name, kind) for name, kind in _OF_PARTICLES.items()}
    for name, values in t.items():
        _check_length(name, values, n)
    other = _numbers(state, "other", "u4") if "tissue_other" in state else np.empty(0, np.uint32)
    bonds = {name: _numbers(state, name, kind) if len(other) else np.empty(0, kind)
             for name, kind in _OF_BONDS.items()}  # fmt: skip
    for name, values in bonds.items():
        _check_length(name, values, len(other))
    for name, values, most in (
        ("hold", hold, _MOST_HOLD), ("phase", t["phase"], min(n_phases, MAX_PHASES) - 1),
        ("other", other, n - 1), ("vessel", bonds["vessel"], n_vessels), ("whose", t["whose"], n_vessels),
    ):  # fmt: skip
        if values.max(initial=0) > max(most, 0):
            got = values.max()
            raise ValueError(f"tissue_{name}: expected numbers up to {most}, got {got}")
    ids = t["id"][t["id"] != _NOBODY]
    if ids.max(initial=0) >= max(next_id, 1) or len(np.unique(ids)) != len(ids):
        raise ValueError("tissue_id: expected each once and below the number of ids given")
    first = _numbers(state, "first", "u4").astype(np.int64)
    _check_length("first", first, -(-n // _BLOCK) + 1)
    steps = np.diff(first)
    if first[0] != 0 or first[-1] != len(other) or (steps < 0).any() or (steps % _BLOCK).any():
        raise ValueError("tissue_first: expected blocks of bonds one after the other")
    _check_ends(n, first, other, bonds["length"])
    _check_length("body", _numbers(state, "body", "u4"), n)
    ends = np.repeat(np.arange(len(steps)), steps)  # blocks; at.w is the inverse of the mass
    lane = (np.arange(len(other)) - first[ends]) % _BLOCK
    if "tissue_pressed" in state:
        _check_length("pressed", _numbers(state, "pressed", "3f4"), n)
    if "tissue_loads" in state:
        loads = _numbers(state, "loads", "4f4")
        _check_length("loads", loads, 2 * n)
        if (loads < 0).any() or (loads[:, 1] > 1).any():
            raise ValueError("tissue_loads: expected loads of at least 0 and shares from 0 to 1")
    if "tissue_rest" in state:
        _check_solid(state, n, longest)
        if (bonds["stiffness"] < 0).any():
            raise ValueError("tissue_stiffness: expected stiffnesses of at least 0")
        return
    light = t["at"].reshape(-1, 4)[:, 3].astype(np.float64)
    if (light < 0).any() or (bonds["stiffness"] < 0).any():
        raise ValueError("tissue_stiffness: expected masses and stiffnesses of at least 0")
    mine = np.minimum(_BLOCK * ends + lane, n - 1)
    rates = bonds["stiffness"] * (light[mine] + light[other])
    if longest * np.sqrt(rates.max(initial=0.0)) > MOST_SUBSTEPS:
        raise ValueError(f"tissue_stiffness: expected at most {MOST_SUBSTEPS:,} substeps a step")


def _check_solid(state: Mapping[str, np.ndarray], n: int, longest: float) -> None:
    """What a solid has beside its bonds."""
    _check_length("rest", _numbers(state, "rest", "4f4"), n)
    lame, frequency = _numbers(state, "lame", "f4"), _numbers(state, "frequency", "f4")
    _check_length("lame", lame, 2 * _BLOCK * -(-n // _BLOCK))
    _check_length("frequency", frequency, 1)
    if (lame < 0).any() or not 0 < longest * frequency[0] <= MOST_SUBSTEPS:
        expected = f"expected positive moduli and at most {MOST_SUBSTEPS:,} substeps a step"
        raise ValueError(f"tissue_lame: {expected}")
    spared = _numbers(state, "spared", "f4")
    _check_length("spared", spared, n)
    if (spared < -1).any():
        raise ValueError("tissue_spared: expected densities, or -1")
    rows = _BLOCK * -(-n // _BLOCK)
    if "tissue_terms" in state:
        terms = _numbers(state, "terms", "f4")
        if len(terms) not in [_TERM_ROWS * rows * k for k in range(1, MOST_TERMS + 1)]:
            raise ValueError(f"tissue_terms: expected 1 to {MOST_TERMS} terms of each particle")
        terms = terms.reshape(-1, _TERM_ROWS, rows)
        shares, rates = terms[:, 0], terms[:, 1]
        if (shares < 0).any() or (shares.sum(0) >= 1).any() or (rates < 0).any():
            raise ValueError("tissue_terms: expected shares from 0 to 1 and rates of at least 0")
        for metric in terms[:, 2:]:
            _check_metric("terms", metric)
    if "tissue_stays" in state:
        stays = _numbers(state, "stays", "f4")
        _check_length("stays", stays, 6 * rows)
        _check_metric("stays", stays.reshape(6, rows))


def _check_metric(name: str, less_one: np.ndarray) -> None:
    """(6, N) xx xy xz yy yz zz of G - 1: G is that of a shape that there can be."""
    xx, xy, xz, yy, yz, zz = less_one.astype(np.float64) + [[1], [0], [0], [1], [0], [1]]
    G = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], 1).reshape(-1, 3, 3)
    if (np.linalg.eigvalsh(G) <= 0).any() or (xx + yy + zz > _MOST_TRACE).any():
        expected = f"expected positive metrics of traces up to {_MOST_TRACE:g}"
        raise ValueError(f"tissue_{name}: {expected}")


def _check_ends(n: int, first: np.ndarray, other: np.ndarray, length: np.ndarray) -> None:
    """Every bond stands at both of its ends: the solver looks for the other without a limit."""
    block = np.repeat(np.arange(len(first) - 1), np.diff(first))
    mine = _BLOCK * block + (np.arange(len(other)) - first[block]) % _BLOCK
    there = other.astype(np.int64)
    real = (length != 0) & (mine < n)
    entries = mine * n + there
    if not np.isin(there[real] * n + mine[real], entries).all():
        raise ValueError("tissue_other: expected every bond at both of its ends")


def _numbers(state: Mapping[str, np.ndarray], name: str, kind: str) -> np.ndarray:
    """An array of tissue from its bytes; finite."""
    raw = np.asarray(state[f"tissue_{name}"])
    dtype = np.dtype(kind)
    if raw.dtype != np.uint8 or raw.ndim != 1 or raw.size % dtype.itemsize:
        raise ValueError(f"tissue_{name}: expected bytes of {dtype.base} in one row")
    base = dtype.base
    values = np.frombuffer(np.ascontiguousarray(raw).tobytes(), base)
    if base.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"tissue_{name}: expected finite numbers, got a NaN or an infinity")
    return values.reshape(-1, dtype.shape[0]) if dtype.shape else values


def _check_length(name: str, values: np.ndarray, n: int) -> None:
    if len(values) != n:
        raise ValueError(f"tissue_{name}: expected {n} of them, got {len(values)}")
