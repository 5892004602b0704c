"""Who holds the pieces: one process, or the ranks of an MPI communicator.

Both have the same methods; all ranks must call each of them. Rank 0 has the image.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.checks import missing
from .hits import Hits


class Alone:
    """One process that holds all pieces."""

    rank, size = 0, 1

    def least(self, value: Any) -> Any:
        """The smallest of all ranks' values, item by item."""
        return value

    def most(self, value: Any) -> Any:
        """The largest."""
        return value

    def total(self, value: Any) -> Any:
        """The sum."""
        return value

    def all(self, value: Any) -> list[Any]:
        """Every rank's value."""
        return [value]

    def nearest(self, hits: Hits) -> Hits:
        """The nearest of all ranks' hits, on rank 0."""
        return hits

    def from_root(self, value: Any) -> Any:
        """Rank 0's value."""
        return value


class Ranks:
    """The ranks of an mpi4py communicator; one piece each."""

    def __init__(self, comm: Any):
        try:
            from mpi4py import MPI
        except ImportError:
            raise missing("mpi4py", "mpi") from None
        if not isinstance(comm, MPI.Intracomm):
            raise TypeError(f"comm: expected an mpi4py communicator, got {type(comm).__name__}")
        self._comm, self._mpi = comm, MPI
        self.rank, self.size = comm.Get_rank(), comm.Get_size()
        self.sent = 0  # bytes to other ranks

    def _reduced(self, value: Any, how: Any) -> Any:
        array = np.array(value)
        out = np.empty_like(array)
        self._comm.Allreduce(array, out, how)
        return out if array.ndim else out[()]

    def least(self, value: Any) -> Any:
        """The smallest of all ranks' values, item by item."""
        return self._reduced(value, self._mpi.MIN)

    def most(self, value: Any) -> Any:
        """The largest."""
        return self._reduced(value, self._mpi.MAX)

    def total(self, value: Any) -> Any:
        """The sum."""
        return self._reduced(value, self._mpi.SUM)

    def all(self, value: Any) -> list[Any]:
        """Every rank's value."""
        return self._comm.allgather(value)

    def from_root(self, value: Any) -> Any:
        """Rank 0's value."""
        return self._comm.bcast(value, 0)

    def exchange(self, rows: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Rows (N, K) of float32 to their ranks, counts (size,) to each in order; what came, in
        the order of the ranks."""
        width = rows.shape[1]
        coming = np.empty(self.size, np.int64)
        self._comm.Alltoall(np.asarray(counts, np.int64), coming)
        row = self._mpi.FLOAT.Create_contiguous(max(width, 1)).Commit()
        out = np.empty((int(coming.sum()), width), np.float32)
        self._comm.Alltoallv(
            [np.ascontiguousarray(rows, np.float32), (counts, _starts(counts)), row],
            [out, (coming, _starts(coming)), row],
        )
        row.Free()
        self.sent += 4 * width * int(np.sum(counts) - counts[self.rank])
        return out

    def nearest(self, hits: Hits) -> Hits:
        """The nearest of all ranks' hits, on rank 0: each rank sends its hits in a stripe of the
        image to the stripe's rank (direct-send), which keeps the nearest and sends them on."""
        n = len(hits.t)
        bounds = n * np.arange(self.size + 1) // self.size
        rays, rows = hits.packed()
        counts = np.diff(np.searchsorted(rays, bounds))
        found = self.exchange(np.column_stack([rays.astype(np.int32).view(np.float32), rows])
                              .astype(np.float32, copy=False), counts)  # fmt: skip
        best = Hits(n)
        best.put_all(np.ascontiguousarray(found[:, 0]).view(np.int32), found[:, 1:])
        rays, rows = best.packed()
        everything = np.zeros(self.size, np.int64)
        everything[0] = len(rays)
        found = self.exchange(np.column_stack([rays.astype(np.int32).view(np.float32), rows])
                              .astype(np.float32, copy=False), everything)  # fmt: skip
        whole = Hits(n)
        whole.put_all(np.ascontiguousarray(found[:, 0]).view(np.int32), found[:, 1:])
        return whole


def _starts(counts: np.ndarray) -> np.ndarray:
    return np.cumsum(counts) - counts
