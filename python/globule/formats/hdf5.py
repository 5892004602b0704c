"""HDF5 files of particles: Gadget, AREPO, GIZMO, SWIFT, H5Part, H5MD, PySPH, openPMD, VTKHDF, and
others whose data sets are named plainly.

`hdf5_layouts` says what lies where. h5py reads the tree of the file in a process of its own (see
`guarded`); arrays that lie in the file as they are in memory are read here, at their offset.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from .contents import Contents, frame_index
from .errors import bad, shown
from .fields import particles_from
from .guarded import decode, need
from .hdf5_layouts import LAYOUTS, named, plain
from .hdf5_tree import Layout, Source, Tree
from .size import bytes_of

_WHAT = "an HDF5 file"
_PIECE, _THREADS = 1 << 23, 4  # bytes; threads that read large arrays
_ADVICE = 'name its data sets: --columns positions=/…,radius=/… or gb.read(path, columns={"positions": …})'


def read(
    path: str | os.PathLike[str],
    frame: int = 0,
    species: str | None = None,
    columns: Mapping[str, str] | None = None,
    rows: tuple[int, int] | None = None,
) -> Contents:
    """Read a frame of an HDF5 file.

    Args:
        path: of the file.
        frame: its number in files with several (H5Part, H5MD, openPMD, VTKHDF); negative counts
            from the end.
        species: the group of particles: "PartType1", "fluid", "electrons"; None: gas
            ("PartType0") where there is some, else the first.
        columns: field or attribute -> path of a data set, in place of a known layout.
        rows: (first, last), of the particles; default: all.

    Raises FormatError for data of an unknown layout, ValueError for a frame or species that the
    file does not have, MissingPackageError without h5py.
    """
    layout, arrays = read_layout(path, lambda tree: _some(_layout(tree, frame, species, columns), rows))
    return _contents(path, layout, arrays)


def count(
    path: str | os.PathLike[str], frame: int = 0, species: str | None = None, columns: Mapping[str, str] | None = None
) -> int:
    """Particles of a frame of an HDF5 file; arguments and errors: as those of `read`."""
    n = 0

    def none(tree: Tree) -> Layout:
        nonlocal n
        layout = _layout(tree, frame, species, columns)
        n = sum(arrays["positions"][0].n for arrays in (layout.arrays, *layout.blocks))
        return Layout({})

    read_layout(path, none)
    return n


def _some(layout: Layout, rows: tuple[int, int] | None) -> Layout:
    """With a range of the particles' rows."""
    if rows is not None:
        begin = 0
        for arrays in (layout.arrays, *layout.blocks):
            n = arrays["positions"][0].n
            first, last = (min(max(row - begin, 0), n) for row in rows)
            for name, sources in arrays.items():
                arrays[name] = [
                    s._replace(first=s.first + first, n=last - first) if s.n == n else s for s in sources
                ]  # fmt: skip
            begin += n
    return layout


def read_arrays(
    path: str | os.PathLike[str], places: Mapping[str, str], rows: Mapping[str, tuple[int, int]] | None = None
) -> dict[str, np.ndarray]:
    """The data sets at places of a file, by a name of one's own; of those in `rows` [first, last).

    Raises FormatError.
    """

    def layout(tree: Tree) -> Layout:
        found = {k: tree.source("/" + p.strip("/")) for k, p in places.items()}
        for name, (first, last) in (rows or {}).items():
            n = found[name].n
            if not 0 <= first <= last <= n:
                problem = f"expected rows up to {n}, got {first} to {last}"
                raise tree.bad(found[name].place, problem)
            found[name] = found[name]._replace(first=first, n=last - first)
        return Layout({name: [source] for name, source in found.items()})

    return read_layout(path, layout)[1]


def read_layout(path: Any, layout_of: Callable[[Tree], Layout]) -> tuple[Layout, dict[str, np.ndarray]]:
    """What layout_of chooses from the tree of a file, and its arrays. Raises FormatError."""
    need("h5py", "h5py", "formats")
    layout = Layout({})

    def choose(claim: dict) -> tuple[float, Any]:
        nonlocal layout
        tree = Tree(path, claim["tree"])
        layout = layout_of(tree)
        size, request = 0.0, []
        for source in layout.sources():
            size += _n_bytes(tree, source)
            if _offset(tree, source) < 0:
                request.append([source.place, source.first, source.n, source.frame])
        layout.tree = tree
        return size, request

    _, sent = decode("hdf5", path, _WHAT, choose=choose)
    tree, coming = layout.tree, iter(sent)
    found: list[dict[str, np.ndarray]] = []
    with open(path, "rb") as file:
        for wanted in (layout.arrays, *layout.blocks):
            arrays: dict[str, np.ndarray] = {}
            for name, sources in wanted.items():
                parts = []
                for source in sources:
                    offset = _offset(tree, source)
                    part = next(coming) if offset < 0 else _from_file(tree, source, offset, file)
                    if len(sources) > 1 and part.shape[1:] == (1,):
                        part = part[:, 0]
                    parts.append(part * source.scale if source.scale != 1.0 else part)
                arrays[name] = parts[0] if len(parts) == 1 else np.stack(parts, axis=1)
            found.append(arrays)
    return layout, found[0] if len(found) == 1 else _joined(found)


def _joined(blocks: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """The arrays that all blocks with particles have, one after the other."""
    filled = [arrays for arrays in blocks if len(arrays["positions"])] or blocks[:1]
    return {
        name: np.concatenate([arrays[name] for arrays in filled])
        for name, one in filled[0].items()
        if all(name in arrays and arrays[name].shape[1:] == one.shape[1:] for arrays in filled)
    }


def _layout(tree: Tree, frame: int, species: str | None, columns: Any) -> Layout:
    if columns is not None:
        frame_index(tree.path, frame, 1)
        if species is not None:
            raise ValueError("species: expected none beside columns, which name data sets")
        return named(tree, columns)
    for known in LAYOUTS:
        layout = known(tree, species, lambda n: frame_index(tree.path, frame, n))
        if layout is not None:
            frame_index(tree.path, frame, layout.n_frames)
            if species is not None and not layout.species and known is not plain:
                raise ValueError(f"species: expected none for {tree.path}, which has no groups")
            return layout
    found = ", ".join(list(tree)[1:]) or "nothing"
    raise bad(tree.path, "", f"expected particles in a known layout, got {shown(found)}; {_ADVICE}")


def _offset(tree: Tree, source: Source) -> int:
    """Where the rows lie in the file as they are in memory; -1: nowhere."""
    about = tree[source.place]
    if about["offset"] < 0:
        return -1
    item, shape = np.dtype(about["dtype"]).itemsize, about["shape"]
    if source.frame is None:
        return about["offset"] + source.first * item * math.prod(shape[1:])
    row = item * math.prod(shape[2:])
    return about["offset"] + (source.frame * shape[1] + source.first) * row


def _shape(tree: Tree, source: Source) -> tuple[int, ...]:
    shape = tree[source.place]["shape"]
    return (source.n, *shape[1 if source.frame is None else 2 :]) if shape else ()


def _n_bytes(tree: Tree, source: Source) -> int:
    return math.prod(_shape(tree, source)) * np.dtype(tree[source.place]["dtype"]).itemsize


def _from_file(tree: Tree, source: Source, offset: int, file: Any) -> np.ndarray:
    dtype = np.dtype(tree[source.place]["dtype"])
    size, held = _n_bytes(tree, source), os.fstat(file.fileno()).st_size
    if offset + size > held:
        problem = f"expected {size:,} bytes at offset {offset:,}, got {max(held - offset, 0):,}"
        raise bad(tree.path, source.place, problem)
    array = np.empty(_shape(tree, source), dtype)
    if array.size and not _fill(bytes_of(array), file.fileno(), offset):
        raise bad(tree.path, source.place, f"expected {size:,} bytes, got fewer")
    return array.astype(dtype.newbyteorder("="), copy=False)


def _fill(memory: memoryview, file: int, offset: int) -> bool:
    """Read a file into memory from an offset on, large pieces in several threads: most of the time
    goes into new pages of memory. False: the file has fewer bytes."""

    def piece(first: int) -> bool:
        last = min(first + _PIECE, len(memory))
        while first < last:
            got = os.preadv(file, [memory[first:last]], offset + first)
            if not got:
                return False
            first += got
        return True

    firsts = range(0, len(memory), _PIECE)
    if len(firsts) == 1:
        return piece(0)
    with ThreadPoolExecutor(_THREADS) as threads:
        return all(list(threads.map(piece, firsts)))


def _contents(path: Any, layout: Layout, arrays: dict[str, np.ndarray]) -> Contents:
    positions = arrays.pop("positions")
    axes, moving = layout.axes
    if axes:
        placed = np.tile(np.array(layout.shift), (len(positions), 1))
        placed[:, axes] += positions.reshape(len(positions), len(axes))
        if moving:
            placed[:, moving] += arrays.pop("offset").reshape(len(positions), len(moving))
        positions = placed
    if positions.ndim != 2 or positions.shape[1] not in (2, 3):
        remedy = "read it with h5py and pass gb.Particles(positions)"
        raise bad(path, "positions", f"expected shape (N, 3), got {positions.shape}; {remedy}")
    if positions.shape[1] == 2:
        positions = np.pad(positions, ((0, 0), (0, 1)))
    if layout.box is not None:
        positions = layout.box.wrap(positions)
    for name, array in arrays.items():
        if array.ndim > 2 and len(array) == len(positions) and array.size:
            arrays[name] = array.reshape(len(positions), -1)
    arrays |= {name: np.full(len(positions), value) for name, value in layout.constants.items()}
    particles = particles_from(path, positions, arrays, layout.support_per_h)
    units = {name: unit for name, unit in layout.units.items() if unit}
    return Contents(particles, layout.box, units, layout.time, layout.n_frames, layout.species)
