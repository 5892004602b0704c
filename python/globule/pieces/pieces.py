"""A scene in pieces: particles that do not fit into one memory."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from .._base.arrays import box_corners, to_host
from .._base.checks import choice, positive, whole
from .._base.device import choose
from .._base.memory import resident_bytes, trim
from .._base.owner import Owner
from .._base.ranks import ranks_of
from ..data.attributes import checked_range, color_by, ends_of_map, listed
from ..data.particles import Particles
from ..data.spacing import normal_of
from ..fluids.likeness import RADII, suitable_surface
from ..scene.fitting import octree_bytes, room_on
from ..scene.scene import KERNELS, REACH, SMOOTH_SUPPORT, SPHERE_SUPPORT, SURFACES, SceneBase, threshold_of
from ..scene.sources import in_spacing
from .partition import Partition, Space, cells_of, codes_of, histogram, space_around
from .store import CHUNK, TELLING, Columns, Files, Layout, Source, both, check_reach, source_of
from .survey import radii_of, reach_of, survey

# Bytes that a piece takes for each of its particles while it is read, built and traced, measured:
# 58 and 95 on a CPU, with the rows themselves.
BYTES = {"balls": 80, "spheres": 80, "smooth": 125}
DEVICE_SHARE = 0.8  # of the memory that a GPU has free, for a piece and its image
OVERHEAD = 160_000_000  # bytes of the chunk that is being dealt out, or of an image
SMOOTH_REACH = 3.375  # spacings: of a smooth kernel, and of the neighbors that shape it
WHOLE = 1_000_000  # particles: of at most so many, spacing and surface are measured at all
SAMPLE = 40_000  # of more, at about so many
MOST_PIECES = 4096
IMBALANCE = 1.25  # most particles of a rank over the mean; past it all are divided anew
SLACK = 0.125  # of the extent, on each side, for particles that have left the space once


class Piece(SceneBase):
    """The scene of a piece. Its own copy of the positions is empty when the octree is there."""

    _gives_up = True


class Pieces(Owner):
    """A scene whose particles are in pieces: read, built and traced one after the other, or one
    on each rank of an MPI communicator. `render` takes it like a `Scene`.

        render(Pieces("huge.npy", memory=8e9, support=0.02)).save("huge.png")
        render(Pieces(local_particles, comm=MPI.COMM_WORLD))  # on every rank; the image is rank 0's

    The image is that of one scene with all particles (docs/design/pieces.md). Rays of light go from
    piece to piece: images with shadows, ambient rays, reflection or transmission visit each piece
    several times.

    Args:
        particles: the name of a file whose ranges can be read (HDF5, raw .vtu; .npy, .npz and
            .bgeo without compression), or what `Scene` takes. With `comm`, this rank's share.
        n: number of pieces; default: as `memory` asks for. With `comm`, one a rank.
        memory: bytes that this process may take; default: no limit.
        comm: an mpi4py communicator; all its ranks make the same calls. The particles may be
            anywhere at first; each goes to the rank that owns it, and as a copy to those beside.
        color_by, colormap, range: as for `render`.
        kernel, threshold, support, surface, spacing, device, threads, key_bits: as for `Scene`;
            surface may be "auto". What is not given is measured as of one
            scene; of more than a million particles where they are densest.

    Raises:
        FormatError, OSError: the file cannot be read.
        MemoryError: the memory does not suffice for a piece.
        MissingPackageError: `comm` without mpi4py.
    """

    in_pieces = True  # by which `render` knows them

    def __init__(
        self,
        particles: Any,
        n: int | None = None,
        memory: float | None = None,
        comm: Any = None,
        *,
        color_by: str | None = None,
        colormap: str = "auto",
        range: tuple[float, float] | None = None,
        kernel: str = "murakami",
        threshold: float | None = None,
        support: float | None = None,
        surface: str = "balls",
        spacing: float | None = None,
        device: str = "auto",
        threads: int = 0,
        key_bits: int = 32,
    ):
        choice("kernel", kernel, KERNELS)
        choice("surface", surface, (*SURFACES, "auto"))
        self.kernel, self.device = kernel, choose(device)
        self.ranks, self._on_ranks = ranks_of(comm), comm is not None
        self.support = None if support is None else positive("support", support)
        self.spacing = None if spacing is None else positive("spacing", spacing)
        self._color = (color_by, colormap, None if range is None else checked_range(range))
        self._options: dict[str, Any] = {"device": device, "threads": threads}
        self._options["key_bits"] = key_bits
        self._memory = None if memory is None else positive("memory", memory)
        self._base = resident_bytes() + OVERHEAD
        self.ranks.same(kernel=kernel, surface=surface, support=self.support,
                        spacing=self.spacing, threshold=threshold)  # fmt: skip
        self._scenes: dict[int, SceneBase] = {}
        self._updates = 0
        self._files: Files | None = None
        source = source_of(particles)
        self._survey(source)
        self._settle(source, surface, threshold)
        if n is not None:
            whole("n", n, 1, MOST_PIECES)
        self.space = self._space(0.0)
        if self._on_ranks:
            self.partition, self._best = self._balanced(source)
            self.divisions = 1  # how often the particles have been divided
            self._to_ranks(source)
        else:
            self._divide(source, n)

    def update(self, particles: Any) -> None:
        """The next frame of pieces on ranks: this rank's particles, as many as it has now.

        Ranks keep their parts of space until one has 1.25 times the mean number of particles, or
        particles have left the space; then all is divided anew. What was measured stays.

        Raises ValueError without `comm`, and as the constructor does. After an error while
        particles are on their way, there are none: update again.
        """
        if not self._on_ranks:
            raise ValueError("update: expected pieces on ranks, got pieces one after the other")
        trim()  # what an image has left
        source = self.ranks.together(lambda: source_of(particles))
        self._survey(source)
        if self.surface == "spheres" and self.spacing is None and not self._has_radii:
            self._measure(source, False)
        self._kernels()
        most = max(IMBALANCE, 1.1 * self._best)
        if not self._in_space() or self._imbalance(source) > most:
            self.space = self._space(SLACK)
            self.partition, self._best = self._balanced(source)
            self.divisions += 1
        self._to_ranks(source)

    def _survey(self, source: Source) -> None:
        """What must be known of all particles before they are divided."""
        ranks = self.ranks
        part = ranks.together(lambda: survey(source, self.support, self._color))
        self.n_particles = int(ranks.total(np.int64(part.n)))
        self.up, self._origin = source.up, source.origin
        self._outlined = source if self.n_particles <= WHOLE else None
        lows, highs = ranks.least(part.low), ranks.most(part.high)
        empty = not np.isfinite(lows).all()
        self.low: np.ndarray = np.zeros(3) if empty else lows
        self.high: np.ndarray = np.zeros(3) if empty else highs
        # The kernel `solid` is negative in its outer part.
        self.negative = float(ranks.least(np.float64(part.weight))) < 0 or self.kernel == "solid"
        self.factors = float(ranks.most(np.float64(part.factors)))
        self._reach, self._radii = ranks.most(np.array(part.reach)).reshape(2, 2)
        ends = np.array([ranks.least(part.values[:1])[0], ranks.most(part.values[1:])[0]])
        if self._color[0] is not None:
            name, colormap, own = self._color
            known = ends[np.isfinite(ends)]
            self._color = name, colormap, own or ends_of_map(name, known, self.n_particles)
        self.kinds = listed({value: word for one in ranks.all(part.kinds) for value, word in one.items()})
        layouts = [one for one in ranks.all(part.layout) if one is not None] or [Layout((), {})]
        check_reach(layouts)
        for one in layouts[1:]:
            layouts[0] = both(layouts[0], one)
        self._layout = layouts[0]
        if self._color[0] is not None:
            self._layout = self._layout.with_each("color")

    @property
    def origin(self) -> tuple[float, float, float]:
        """(x, y, z) float64, world, from which positions are given."""
        return self._origin()

    @property
    def range(self) -> tuple[float, float] | None:
        """Values at the ends of the color map."""
        return self._color[2]

    def one(self, name: str) -> Any:
        """The value that a field has for all particles; None where it has several, or none."""
        return self._layout.one.get(name)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(lowest, highest) corner of the particles: (3,) float64 each, world."""
        return self.low, self.high

    def outline(self) -> np.ndarray:
        """The positions (N, 3) of all ranks' particles, as one scene's camera is fitted to them; of
        more than a million the corners (8, 3) of their box."""
        if self._outlined is None or not self.n_particles:
            return box_corners(self.low, self.high)
        parts = [to_host(some.positions) for some in self._outlined.chunks()]
        own = np.concatenate([np.empty((0, 3), np.float32), *parts])
        return self.ranks.concatenated(own)

    @property
    def normal(self) -> np.ndarray | None:
        """Unit normal (3,) of the plane that holds all particles, if it is one across an axis."""
        return normal_of(box_corners(self.low, self.high).astype(np.float32))

    def _settle(self, source: Source, surface: str, threshold: float | None) -> None:
        """Surface, support and spacing, measured where nobody says them."""
        self.surface = surface
        own = self._reach[1] > 0 or self.support is not None
        auto = self.surface == "auto"
        asked = self.support is not None or threshold is not None or self.kernel != "murakami"
        if auto and asked:
            self.surface, auto = "balls", False
        if self.surface in ("smooth", "spheres"):
            if self.kernel != "murakami" or self.support is not None:
                raise ValueError(
                    f"surface: {self.surface!r} has the kernel murakami and supports of its own, "
                    f"got {self.kernel} and support {self.support}"
                )
        elif self.spacing is not None and not auto:
            raise ValueError("spacing: expected surface='smooth' with it, got 'balls'")
        made = self.surface == "smooth" or (self.surface == "spheres" and not self._has_radii)
        unknown = self.spacing is None if made else self.surface == "balls" and not own
        if auto or unknown:
            self._measure(source, auto)
        default = threshold_of(self.surface, self.kernel)
        self.threshold = default if threshold is None else positive("threshold", threshold)
        self._kernels()

    def _kernels(self) -> None:
        """How far kernels reach, and what their particles' rows have."""
        if self.surface == "smooth":
            assert self.spacing is not None
            self._layout = self._layout.without("support").with_each("weight")
            self.support = SMOOTH_SUPPORT * self.spacing
            self._typical = self.reach = 2 * SMOOTH_REACH * self.spacing
        elif self.surface == "spheres" and self._has_radii:
            self._typical, self.reach = map(float, self._radii)
        elif self.surface == "spheres":
            assert self.spacing is not None
            self.support = self.reach = self._typical = SPHERE_SUPPORT * self.spacing
        else:
            one = self.support
            self._typical, self.reach = (one, one) if one else (float(v) for v in self._reach)
        radii = self.surface == "spheres" and self._has_radii
        self._layout = self._layout.without(*(name for name in TELLING if name != "radius" or not radii))

    @property
    def _has_radii(self) -> bool:
        """Whether spheres have radii of their own."""
        known = "radius" in self._layout.each and self._radii[1] > 0
        return self.spacing is None and (known or not self.n_particles)

    def _space(self, slack: float) -> Space:
        """The cells around all particles, and so much of their extent on each side."""
        more = slack * float((self.high - self.low).max())
        typical, largest = 1.001 * self._typical, 1.001 * self.reach
        return space_around(self.low - more, self.high + more, typical, largest)

    def _in_space(self) -> bool:
        """Whether the cells still hold all that kernels reach, with a wide enough margin."""
        space = self.space
        room = 1.0005 * self.reach + 2 * space.margin
        within = (self.low - room >= space.low) & (self.high + room <= space.low + space.extent)
        return bool(within.all()) and self._space(0.0).margin <= space.margin

    def _measure(self, source: Source, auto: bool) -> None:
        """Spacing, and which surface: those of one scene with all particles. Of more than fit,
        those of the particles in the fullest cube, in an order of their own."""
        if self.n_particles <= WHOLE:
            rows = [self._layout.rows(some) for some in source.chunks()]
        else:
            rows = self._fullest(source)
        rows.append(np.empty((0, self._layout.width), np.float32))
        near = self.ranks.concatenated(np.concatenate(rows))
        if self.n_particles > WHOLE:
            near = near[np.lexsort(near.T)]
        sample = self._layout.particles(near)
        scene = SceneBase(Particles(sample.positions), self.kernel, device="cpu",
                          threads=self._options["threads"])  # fmt: skip
        why = ""
        if auto:
            self.surface, why = suitable_surface(sample, scene)
        if self.surface == "balls":
            self.support = self.support or (None if self._reach[1] > 0 else float(scene.support))
        elif self.spacing is None and why != RADII:
            scene.become(self.surface)
            self.spacing = scene.spacing or 1.0

    def _fullest(self, source: Source) -> list[np.ndarray]:
        """The rows of this rank's particles in the cube that has most."""
        level = int(np.clip(round(math.log(self.n_particles / SAMPLE, 8)), 0, 5))
        space = space_around(self.low, self.high, 0.0, 0.0)._replace(level=level)
        counts = np.zeros(8**level, np.int64)
        for some in source.chunks():
            counts += histogram(space, to_host(some.positions))
        fullest = int(np.argmax(self.ranks.total(counts)))
        found, n = [], 0
        for some in source.chunks():
            inside = codes_of(cells_of(space, to_host(some.positions))) == fullest
            found.append(self._layout.rows(some[inside]))
            n += len(found[-1])
            if n > 50 * SAMPLE:
                break
        return found

    def _counts(self, source: Source) -> np.ndarray:
        """Particles of all ranks in each cell."""
        counts = np.zeros(8**self.space.level, np.int64)
        for some in source.chunks():
            counts += histogram(self.space, to_host(some.positions))
        return self.ranks.total(counts)

    def _balanced(self, source: Source) -> tuple[Partition, float]:
        """As many particles for each rank, and the imbalance that is left."""
        counts, n = self._counts(source), self.ranks.size
        partition = Partition(self.space, counts, n)
        own = np.bincount(partition.owners, counts, n)
        return partition, float(own.max() * n / max(own.sum(), 1))

    def _imbalance(self, source: Source) -> float:
        """Most particles that a rank owns, over the mean."""
        own: np.ndarray = np.zeros(self.ranks.size, np.int64)
        for some in source.chunks():
            owner = self.partition.owner(to_host(some.positions))
            own += np.bincount(owner, minlength=len(own))
        own = self.ranks.total(own)
        return float(own.max() * len(own) / max(own.sum(), 1))

    def _divide(self, source: Source, n: int | None) -> None:
        """Every particle to its piece, and to those beside that it reaches."""
        counts = self._counts(source)
        most = self._most_particles()
        wanted = n or min(max(1, math.ceil(1.1 * self.n_particles / most)), MOST_PIECES)
        self.partition = Partition(self.space, counts, wanted)
        while True:
            files = Files(self.partition.n, self._layout.width)
            try:
                for some in source.chunks():
                    rows, piece = self._placed(some)
                    ends = np.searchsorted(piece, np.arange(self.partition.n + 1))
                    for k in np.flatnonzero(np.diff(ends)):
                        files.add(int(k), rows[ends[k] : ends[k + 1]])
            except BaseException:
                files.close()
                raise
            self._files, largest = files, max(files.counts)
            if n is not None or largest <= most:
                return
            files.close()
            more = math.ceil(1.1 * self.partition.n * largest / most)
            if more > MOST_PIECES or self.partition.n >= 8**self.space.level:
                need = largest * self._bytes() + self._base
                if need <= (self._memory or math.inf):
                    raise MemoryError(
                        f"memory: expected room on {self.device.name} for the smallest possible "
                        f"piece, {largest:,} particles, got room for {most:,.0f}"
                    )
                raise MemoryError(
                    f"memory: expected at least {need / 1e9:.2g} GB for the smallest possible "
                    f"piece, {largest:,} particles, got {(self._memory or 0) / 1e9:.2g} GB"
                )
            self.partition = Partition(self.space, counts, more)

    def _to_ranks(self, source: Source) -> None:
        """Every particle to the rank that owns it, and to those beside that it reaches; some at a
        time, so that what is sent and what has come are not both in memory."""
        ranks = self.ranks
        if self.device.backend != "cuda":
            self._scenes.clear()  # the new rows take the place of the old octree
        rounds = max(1, math.ceil(ranks.most(np.int64(source.n)) / CHUNK))
        came = Columns(self._layout)
        for k in range(rounds):
            first, last = (source.n * i // rounds for i in (k, k + 1))
            came.add(ranks.exchange(*ranks.together(partial(self._dealt, source, first, last))))
        self._updates += 1
        trim()

        def build() -> SceneBase:
            scene = self._scenes.get(ranks.rank)
            if scene is None:
                scene = self._built(came.particles())
            else:
                scene.update(came.particles())
            scene.builds = self._updates
            return scene

        self._scenes[ranks.rank] = ranks.together(build)
        trim()

    def _dealt(self, source: Source, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """The rows of some particles, by the rank they go to, and how many go to each."""
        rows, piece = np.empty((0, self._layout.width), np.float32), np.empty(0, np.int64)
        for some in source.chunks(first, last):  # one chunk, or none
            rows, piece = self._placed(some)
        return rows, np.bincount(piece, minlength=self.ranks.size)

    def _placed(self, some: Particles) -> tuple[np.ndarray, np.ndarray]:
        """The rows (M, width) of the pieces, and whose they are (M,), in order."""
        axes = reach_of(some, self.support) if self.surface == "balls" else None
        if self.surface == "spheres" and self._has_radii:
            axes = radii_of(some)
        reach = self.reach if axes is None else axes
        positions = to_host(some.positions)
        row, piece = self.partition.needed(positions, reach)
        if self.surface == "smooth":
            some = replace(some, weight=in_spacing(some, self.spacing))
        name, colormap, ends = self._color
        rows = self._layout.rows(some if name is None else color_by(some, name, colormap, ends))
        rows = rows[row]
        if self.surface == "smooth":
            # Of the halo's outer half, which knows not all its neighbors, no kernel counts.
            inner, near = self.partition.needed(positions, self.reach / 2)
            n = self.partition.n
            rows[~np.isin(row * n + piece, inner * n + near), self._layout.place("weight")] = 0.0
        return rows, piece

    def _bytes(self) -> int:
        return BYTES[self.surface] + 4 * 2 * (self._layout.width - 3)

    def _most_particles(self) -> float:
        """Particles that a piece may have."""
        most = math.inf
        if self.device.backend == "cuda" and not self._on_ranks:
            each = octree_bytes(1, self.surface, self._options["key_bits"])
            most = DEVICE_SHARE * room_on(self.device) / (each + 4 * self._layout.width)
        if self._memory is None:
            return most
        room = self._memory - self._base
        if room <= 0:
            raise MemoryError(
                f"memory: expected more than the {self._base / 1e6:,.0f} MB that the program, an "
                f"image and a range of the file take, got {self._memory / 1e6:,.6g} MB"
            )
        return min(most, room / self._bytes())

    @property
    def held(self) -> np.ndarray:
        """Which pieces are visited: (n,) bool. A rank's is, even without particles."""
        n = self.partition.n
        return np.ones(n, bool) if self._files is None else np.array(self._files.counts) > 0

    def visit(self, wanted: Callable[[int], bool] | None = None) -> Iterator[tuple[int, SceneBase]]:
        """The pieces of this process, or those wanted, one after the other, each with its scene."""
        if self._files is None:
            yield from self.here().items()
            return
        for k, count in enumerate(self._files.counts):
            if count and (wanted is None or wanted(k)):
                yield k, self._built(self._layout.particles(self._files.read(k)))

    def here(self) -> dict[int, SceneBase]:
        """This rank's piece and its scene."""
        if self._on_ranks and not self._scenes:
            raise ValueError("pieces: expected particles, got none since an update failed: update")
        return self._scenes

    def _built(self, particles: Particles) -> SceneBase:
        if self.surface == "balls":
            return Piece(particles, self.kernel, self.threshold, self.support, **self._options)
        return Piece(particles, threshold=self.threshold, surface=self.surface,
                     spacing=self.spacing, **self._options)  # fmt: skip

    def close(self) -> None:
        """Remove the temporary files."""
        if self._files is not None:
            self._files.close()

    def __len__(self) -> int:
        return self.n_particles

    def __repr__(self) -> str:
        return (
            f"Pieces({self.n_particles} particles in {self.partition.n} pieces, {self.kernel}, "
            f"threshold {self.threshold:g}, {self.device.name})"
        )

    @property
    def outside(self) -> float:
        """How far from a particle the surface may lie, world units."""
        return REACH[self.kernel] * float(self.support or self.reach)
