"""Light across pieces: the rays of a wave go from piece to piece, until they meet something.

A rank shades its squares of the image; the core makes its waves of rays (src/pipeline/waves.hpp)
and asks here what they meet. A ray goes to the rank that owns the piece where it begins, which
traces it through its own cells, and on to the owner of the next cells; the answer goes straight to
the ray's home (docs/design/pieces.md).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ..._base.ranks import Alone
from ...pieces.partition import Partition
from ...pieces.pieces import Pieces
from ...scene.scene import SceneBase

MARCH, SHADOW, MET, LIT = range(4)  # what a row is: two kinds of rays, their answers
# Columns of a row, float32. A ray: origin, direction, how far it has come (below 0: it begins at
# the surface), side, distance to look, light left, crossings, whether to test the side first.
NUMBER, WHAT, RAY, FROM, SIDE, DISTANCE, LEFT, CROSSINGS, TEST = 0, 1, 2, 8, 9, 10, 11, 12, 13
# An answer: distance or light left, side, clip of a cut face, looks.
FOUND, FOUND_SIDE, FOUND_CAP, FOUND_LOOKS = 2, 3, 4, 5
WIDTH = 14
FAR = 1e6  # margins, past which float32 distances are too coarse: such rays begin at the space
MOST_CROSSINGS = 64  # as in src/trace/occlude.hpp


class Spread(NamedTuple):
    """One layer in pieces, as rays see it."""

    pieces: Pieces
    clips: list[Any]  # as the core takes them
    material: Any
    opaque: bool = False  # light ends where it meets the layer; each such place is decided exactly


class Answers:
    """Who answers for one layer of an image."""

    def __init__(self, wavefront: Wavefront, layer: int):
        self.wavefront, self.layer = wavefront, layer

    def march(self, ray: Any, side: Any, t: Any, cap: Any, looks: Any) -> None:
        """What rays (n, 6) meet first: distances (n,), clips of cut faces (n,), looks (n, 8); and
        sides (n,), which may be 0 at first. All in the core's memory."""
        self.wavefront.march(self.layer, np.asarray(ray), side, t, cap, looks)

    def occlude(self, ray: Any, distance: Any, side: Any, left: Any) -> None:
        """What share of light (n,) comes through along rays (n, 6) up to distances (n,)."""
        self.wavefront.occlude(self.layer, np.asarray(ray), distance, side, left)


class Wavefront:
    """The rays of one image on their way."""

    def __init__(self, ranks: Alone):
        self.ranks, self.turns = ranks, 0
        self.layers: dict[int, Spread] = {}
        self._waiting: dict[tuple[int, int], list[np.ndarray]] = {}  # by layer and piece, here
        self._out: dict[int, list[np.ndarray]] = {}  # by rank
        self._pending, self._told = 0, False
        self._builds: list[int] | None = None  # of this rank's scenes when the image was made
        self._found: np.ndarray = np.empty((0, WIDTH), np.float32)

    def run(self, make: Callable[[], Any]) -> Any:
        """What `make` makes of this rank's pixels; meanwhile, and until all ranks are done, this
        rank traces others' rays. An error of one rank is raised on all."""
        self._waiting, self._out, self._told = {}, {}, False
        scenes = [list(spread.pieces.here().values()) for spread in self.layers.values()]
        builds = [scene.builds for part in scenes for scene in part]
        if self._builds not in (None, builds):
            raise ValueError("refine: expected the scene as it was rendered, but it was updated since: render it again")
        self._builds = builds
        try:
            made = make()
            while self.ranks.size > 1 and not self._turn(True):
                pass
            return made
        except BaseException as error:
            if self.ranks.size > 1 and not self._told:
                known = isinstance(error, Exception)
                with contextlib.suppress(*() if known else (Exception,)):
                    self.ranks.agreed(error if known else RuntimeError("interrupted"))
            raise

    def march(self, layer: int, ray: np.ndarray, side: Any, t: Any, cap: Any, looks: Any) -> None:
        """`Answers.march`."""
        offset = self._ask(layer, MARCH, ray, side, None)
        found = self._found
        t[:] = found[:, FOUND] + offset
        cap[:] = found[:, FOUND_CAP]
        side[:] = np.where(side == 0, found[:, FOUND_SIDE], side)
        looks[:] = found[:, FOUND_LOOKS : FOUND_LOOKS + 8]

    def occlude(self, layer: int, ray: np.ndarray, distance: Any, side: Any, left: Any) -> None:
        """`Answers.occlude`."""
        self._ask(layer, SHADOW, ray, side, distance)
        left[:] = self._found[:, FOUND]

    def _ask(self, layer: int, kind: int, ray: np.ndarray, side: Any, distance: Any) -> np.ndarray:
        """Send rays on their way and wait for all answers; by how much each begins later."""
        partition = self.layers[layer].pieces.partition
        n = len(ray)
        rows = np.zeros((n, WIDTH), np.float32)
        rows[:, RAY : RAY + 6], rows[:, SIDE] = ray, side
        rows[:, DISTANCE] = np.inf if distance is None else distance
        rows[:, LEFT] = 1
        o, d = rays_of(rows)
        enter, last = partition.enter(o, d)
        inside, going = enter == 0, (enter <= last) & (enter <= rows[:, DISTANCE])
        rows[:, FROM] = np.where(inside & (rows[:, SIDE] != 0), -1, enter)
        rows[~inside, SIDE] = 1  # the field vanishes outside of the space
        offset = np.zeros(n, np.float32)
        far = np.flatnonzero(enter > FAR * partition.space.margin)
        offset[far] = rows[far, FROM]
        rows[far, RAY : RAY + 3] = (o[far] + offset[far, None].astype(np.float64) * d[far]).astype(np.float32)
        rows[far, FROM] = 0
        rows[far, DISTANCE] -= offset[far]
        rows[:, NUMBER] = bits(np.arange(n))
        rows[:, WHAT] = bits(np.full(n, kind | layer << 2 | self.ranks.rank << 8))
        self._found = np.zeros((n, WIDTH), np.float32)
        self._found[:, FOUND] = np.inf if kind == MARCH else 1
        self._found[:, FOUND_SIDE], self._found[:, FOUND_CAP] = 1, -1
        self._pending = int(going.sum())
        self._take(self._send_on(layer, rows[going]))
        self._trace_here()
        while self._pending:
            self._turn(False)
        return offset

    def _turn(self, done: bool) -> bool:
        """All ranks' rays and answers one step on; whether all ranks are done."""
        try:
            states = self.ranks.agreed(None, done)
        except BaseException:
            self._told = True
            raise
        if all(states):
            return True
        self.turns += 1
        parts = [self._out.get(rank, []) for rank in range(self.ranks.size)]
        counts = np.array([sum(map(len, part)) for part in parts], np.int64)
        rows = joined([rows for part in parts for rows in part])
        self._out = {}
        came = self.ranks.exchange(rows, counts)
        what = whole_numbers(came[:, WHAT])
        kind, layer = what & 3, what >> 2 & 63
        self._take(came[kind >= MET])
        for k in self.layers:
            mine = came[(kind < MET) & (layer == k)]
            if len(mine):
                self._waiting.setdefault((k, self.ranks.rank), []).append(mine)
        self._trace_here()
        return False

    def _take(self, answers: np.ndarray) -> None:
        """Answers to this rank's rays."""
        self._found[whole_numbers(answers[:, NUMBER])] = answers
        self._pending -= len(answers)

    def _trace_here(self) -> None:
        """All rays that wait for pieces of this process, until they have left these."""
        while self._waiting:
            for layer in sorted({layer for layer, _ in self._waiting}):
                pieces = self.layers[layer].pieces
                for piece, scene in pieces.visit(partial(self._waits, layer)):
                    rows = self._waiting.pop((layer, piece), None)
                    if rows is not None:
                        self._trace(layer, scene, joined(rows))

    def _waits(self, layer: int, piece: int) -> bool:
        return (layer, piece) in self._waiting

    def _trace(self, layer: int, scene: SceneBase, rows: np.ndarray) -> None:
        spread = self.layers[layer]
        kind = whole_numbers(rows[:, WHAT]) & 3
        for which, trace in ((MARCH, march_part), (SHADOW, occlude_part)):
            some = rows[kind == which]
            if not len(some):
                continue
            o, d = rays_of(some)
            leave = spread.pieces.partition.leave(o, d, np.maximum(some[:, FROM], 0))
            answered, answers = trace(spread, scene, some, leave)
            if len(answers):
                self._reply(answers)
            self._reply(self._send_on(layer, some[~answered]))

    def _send_on(self, layer: int, rows: np.ndarray) -> np.ndarray:
        """Rays to the owners of the places where they have come to; answers of those that have left
        the space or their distance."""
        pieces = self.layers[layer].pieces
        partition = pieces.partition
        o, d = rays_of(rows)
        start, last = np.maximum(rows[:, FROM], 0).astype(np.float64), partition.enter(o, d)[1]
        ends = (start > last) | (start >= rows[:, DISTANCE])
        ends &= rows[:, TEST] == 0
        place = np.where(ends, 0, start)  # of the others it may be infinite
        owner = np.where(ends, -1, partition.owner(o + place[:, None] * d))
        skip_empty(partition, pieces.held, o, d, start, last, owner)
        past = (start > 0) & (rows[:, FROM] < start)  # empty pieces
        rows[past, FROM] = start[past]
        for piece in np.unique(owner[owner >= 0]):
            some = rows[owner == piece]
            if pieces.ranks.size > 1 and piece != pieces.ranks.rank:
                self._out.setdefault(int(piece), []).append(some)
            else:
                self._waiting.setdefault((layer, int(piece)), []).append(some)
        return answers_of(rows[owner < 0], None)

    def _reply(self, answers: np.ndarray) -> None:
        """Answers to the homes of their rays."""
        home = whole_numbers(answers[:, WHAT]) >> 8
        for rank in np.unique(home):
            some = answers[home == rank]
            if rank == self.ranks.rank:
                self._take(some)
            else:
                self._out.setdefault(int(rank), []).append(some)


def march_part(spread: Spread, scene: SceneBase, rows: np.ndarray, leave: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rays through one piece's cells: which have met something, and their answers; the others'
    rows go on."""
    n, margin = len(rows), spread.pieces.partition.space.margin
    ray, begin = columns(rows, RAY, 6), columns(rows, FROM)
    to = (leave + margin / 2).astype(np.float32)
    side = rows[:, SIDE].astype(np.int8)
    t, cap = np.empty(n, np.float32), np.empty(n, np.int32)
    looks = np.zeros((n, 8), np.float32)
    scene._scene.march_parts(
        scene._kernel, scene.threshold, spread.clips, n,
        *(a.ctypes.data for a in (ray, begin, to, side, t, cap, looks)),
    )  # fmt: skip
    met = np.isfinite(t)
    rows[:, SIDE] = side
    rows[:, FROM] = leave + margin / 4
    return met, answers_of(rows[met], t[met], cap[met], looks[met])


def occlude_part(
    spread: Spread, scene: SceneBase, rows: np.ndarray, leave: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shadow rays through one piece's cells, as `march_part`."""
    if spread.opaque:
        met, found = march_part(spread, scene, rows, leave)
        met[met] = found[:, FOUND] < rows[met, DISTANCE]
        rows[met, LEFT] = 0
        return met, answers_of(rows[met], None)
    n, margin = len(rows), spread.pieces.partition.space.margin
    ray, begin, distance = columns(rows, RAY, 6), columns(rows, FROM), columns(rows, DISTANCE)
    to = (leave + margin / 4).astype(np.float32)
    side, test = rows[:, SIDE].astype(np.int8), rows[:, TEST].astype(np.int8)
    left, on = columns(rows, LEFT), np.empty(n, np.float32)
    crossings = rows[:, CROSSINGS].astype(np.int32)
    scene._scene.occlude_parts(
        scene._kernel, scene.threshold, spread.clips, spread.material, n,
        *(a.ctypes.data for a in (ray, begin, to, side, distance, left, on, crossings, test)),
    )  # fmt: skip
    rows[:, FROM], rows[:, SIDE], rows[:, LEFT] = on, side, left
    rows[:, CROSSINGS], rows[:, TEST] = crossings, test
    done = (left == 0) | (crossings > MOST_CROSSINGS)
    return done, answers_of(rows[done], None)


def answers_of(rows: np.ndarray, t: np.ndarray | None, cap: Any = -1, looks: Any = 0.0) -> np.ndarray:
    """Answers to rays: at t; None: they have met nothing, or what is left of their light."""
    out = np.zeros((len(rows), WIDTH), np.float32)
    what = whole_numbers(rows[:, WHAT])
    out[:, NUMBER], out[:, WHAT] = rows[:, NUMBER], bits(what | MET)
    light = (what & 3) == SHADOW
    out[:, FOUND] = np.where(light, rows[:, LEFT], np.inf if t is None else t)
    out[:, FOUND_SIDE], out[:, FOUND_CAP] = rows[:, SIDE], cap
    out[:, FOUND_LOOKS : FOUND_LOOKS + 8] = looks
    return out


def skip_empty(partition: Partition, held: np.ndarray, o: Any, d: Any, start: Any, last: Any, waiting: Any) -> None:
    """Rays that wait for pieces without particles go on to the next one, in place."""
    while True:
        k = np.flatnonzero((waiting >= 0) & ~held[waiting])
        if not len(k):
            return
        start[k] = partition.leave(o[k], d[k], start[k]) + partition.space.margin / 4
        waiting[k] = -1
        k = k[np.isfinite(start[k]) & (start[k] <= last[k])]
        waiting[k] = partition.owner(o[k] + start[k, None] * d[k])


def rays_of(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (n, 3) float64."""
    both = rows[:, RAY : RAY + 6].astype(np.float64)
    return both[:, :3], both[:, 3:]


def columns(rows: np.ndarray, first: int, n: int = 0) -> np.ndarray:
    """Columns of rows in memory of their own."""
    return np.array(rows[:, first : first + n] if n else rows[:, first], np.float32, order="C")


def bits(numbers: np.ndarray) -> np.ndarray:
    """Whole numbers as the bits of float32."""
    return np.ascontiguousarray(numbers, np.int32).view(np.float32)


def whole_numbers(column: np.ndarray) -> np.ndarray:
    """What `bits` made."""
    return np.ascontiguousarray(column).view(np.int32)


def joined(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Rows one after the other; none of no parts."""
    return np.concatenate(parts) if parts else np.empty((0, WIDTH), np.float32)
