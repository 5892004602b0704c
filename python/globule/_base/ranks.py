"""Who works together: one process, the ranks of an MPI communicator, or threads of one process.

All three have the same methods; all ranks must call each of them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from .checks import optional


class Alone:
    """One process."""

    rank, size = 0, 1
    sent = 0  # bytes to other ranks
    only_image = False  # frames have nothing but their image: less to send

    def least(self, value: Any) -> Any:
        """The smallest of all ranks' values, item by item."""
        return np.minimum.reduce(self.all(value))

    def most(self, value: Any) -> Any:
        """The largest."""
        return np.maximum.reduce(self.all(value))

    def total(self, value: Any) -> Any:
        """The sum, in the order of the ranks."""
        return np.add.reduce(self.all(value))

    def all(self, value: Any) -> list[Any]:
        """Every rank's value."""
        return [value]

    def from_root(self, value: Any) -> Any:
        """Rank 0's value."""
        return self.all(value)[0]

    def local(self) -> tuple[int, int]:
        """This rank's number among those on the same computer, and how many these are."""
        return self.rank, self.size

    @cached_property
    def one_host(self) -> bool:
        """Whether all ranks are on one computer; all must ask."""
        return self.local()[1] == self.size

    def together(self, work: Callable[[], Any]) -> Any:
        """What `work` returns, on every rank. Where it fails on some, all raise the error of the
        first of them, with its rank: nobody waits for a rank that has given up."""
        value, error = None, None
        try:
            value = work()
        except Exception as own:
            if self.size == 1:
                raise
            error = own
        self.agreed(error)
        return value

    def agreed(self, error: BaseException | None, value: Any = None) -> list[Any]:
        """Every rank's value. Where some have an error, all raise the first of these."""
        kinds = (ValueError, TypeError, MemoryError, OSError, RuntimeError)
        kind = next((k for k in kinds if isinstance(error, k)), RuntimeError)
        text = None if error is None else str(error) or type(error).__name__
        states = self.all((kind, text, value))
        for rank, (its_kind, its_text, _) in enumerate(states):
            if its_text is not None:
                raise its_kind(f"rank {rank}: {its_text}") from error if rank == self.rank else None
        return [own for _, _, own in states]

    def same(self, **named: Any) -> None:
        """Raise ValueError on all ranks where one has another value than rank 0."""
        all_named = self.all(named)
        self.check_same(**{name: [own[name] for own in all_named] for name in named})

    @staticmethod
    def check_same(**named: Sequence[Any]) -> None:
        """The same, of all ranks' values."""
        for name, values in named.items():
            for rank, value in enumerate(values):
                if value != values[0]:
                    raise ValueError(
                        f"{name}: expected the same on all ranks, got {values[0]} on rank 0 and {value} on rank {rank}"
                    )

    def exchange(self, rows: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Rows (N, K) of float32 to their ranks, counts (size,) to each in order; what came, in
        the order of the ranks."""
        ends = np.cumsum(counts)
        parts = self.all([rows[e - c : e] for e, c in zip(ends, counts, strict=True)])
        self.sent += 4 * rows.shape[1] * int(np.sum(counts) - counts[self.rank])
        return np.concatenate([part[self.rank] for part in parts])

    def concatenated(self, rows: np.ndarray) -> np.ndarray:
        """Every rank's rows (N, K) of float32, one rank's after the other's."""
        self.sent += rows.nbytes * (self.size - 1)
        return np.concatenate(self.all(rows))

    def swap(self, data: np.ndarray, bounds: np.ndarray) -> list[np.ndarray]:
        """Of every rank's bytes (N,), those from bounds[rank] to bounds[rank + 1]."""
        first, last = bounds[self.rank], bounds[self.rank + 1]
        return [part[first:last] for part in self.all(data)]

    def gather(self, data: np.ndarray, counts: Sequence[int]) -> np.ndarray | None:
        """Every rank's bytes (counts[rank],), one rank's after the other's, on rank 0."""
        parts = self.all(data)
        return None if self.rank else np.concatenate(parts)


class Threads(Alone):
    """One rank of several that are threads of this process; `run_threads` makes them."""

    def __init__(self, rank: int, size: int, places: list[Any], barrier: threading.Barrier):
        self.rank, self.size = rank, size
        self._places, self._barrier = places, barrier

    def all(self, value: Any) -> list[Any]:
        """Every rank's value, the object itself."""
        self._places[self.rank] = value
        self._barrier.wait()
        found = list(self._places)
        self._barrier.wait()  # before anybody puts the next one there
        return found


def run_threads(n: int, work: Callable[[Threads], Any]) -> list[Any]:
    """Call work(ranks) in n threads, each a rank of its own; what they return.

    For several devices of one process. An error of one rank ends all and is raised.
    """
    places: list[Any] = [None] * n
    barrier, results = threading.Barrier(n), [None] * n
    errors: list[BaseException] = []

    def one(rank: int) -> None:
        try:
            results[rank] = work(Threads(rank, n, places, barrier))
        except threading.BrokenBarrierError:
            pass  # another rank has failed
        except BaseException as error:
            errors.append(error)
            barrier.abort()

    crew = [threading.Thread(target=one, args=(rank,), daemon=True) for rank in range(n)]
    for thread in crew:
        thread.start()
    for thread in crew:
        thread.join()
    if errors:
        raise errors[0]
    return results


class Ranks(Alone):
    """The ranks of an mpi4py communicator."""

    def __init__(self, comm: Any):
        MPI = optional("mpi4py.MPI", "mpi", "mpi4py")
        if not isinstance(comm, MPI.Intracomm):
            raise TypeError(f"comm: expected an mpi4py communicator, got {type(comm).__name__}")
        self._comm, self._mpi = comm, MPI
        self.rank, self.size = comm.Get_rank(), comm.Get_size()

    def local(self) -> tuple[int, int]:
        """This rank's number among those on the same computer, and how many these are."""
        local = self._comm.Split_type(self._mpi.COMM_TYPE_SHARED)
        found = local.Get_rank(), local.Get_size()
        local.Free()
        return found

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

    def concatenated(self, rows: np.ndarray) -> np.ndarray:
        """Every rank's rows (N, K) of float32, one rank's after the other's."""
        counts = np.array(self._comm.allgather(len(rows)))
        width = rows.shape[1]
        row = self._mpi.FLOAT.Create_contiguous(max(width, 1)).Commit()
        out = np.empty((int(counts.sum()), width), np.float32)
        own = np.ascontiguousarray(rows, np.float32)
        self._comm.Allgatherv([own, len(own), row], [out, (counts, _starts(counts)), row])
        row.Free()
        self.sent += own.nbytes * (self.size - 1)
        return out

    def swap(self, data: np.ndarray, bounds: np.ndarray) -> list[np.ndarray]:
        """Of every rank's bytes (N,), those from bounds[rank] to bounds[rank + 1]."""
        n = int(bounds[self.rank + 1] - bounds[self.rank])
        out = np.empty((self.size, n), np.uint8)
        self._comm.Alltoallv(
            [data, (np.diff(bounds), bounds[:-1]), self._mpi.BYTE],
            [out, ([n] * self.size, n * np.arange(self.size)), self._mpi.BYTE],
        )
        self.sent += len(data) - n
        return list(out)

    def gather(self, data: np.ndarray, counts: Sequence[int]) -> np.ndarray | None:
        """Every rank's bytes (counts[rank],), one rank's after the other's, on rank 0."""
        if self.rank:
            self._comm.Gatherv(data, None)
            self.sent += data.nbytes
            return None
        out = np.empty(sum(counts), np.uint8)
        self._comm.Gatherv(data, [out, (counts, _starts(np.asarray(counts))), self._mpi.BYTE])
        return out


def ranks_of(comm: Any) -> Alone:
    """The ranks of an mpi4py communicator, of `Threads`, or none but this one."""
    if comm is None:
        return Alone()
    return comm if isinstance(comm, Alone) else Ranks(comm)


def dealt(comm: Any, n: int) -> Iterator[int]:
    """0 to n - 1, dealt to the ranks of an mpi4py communicator: each gets the next number when it
    asks for it. All ranks must go on to the end."""
    from mpi4py import MPI

    if MPI.Query_thread() < MPI.THREAD_MULTIPLE:  # nobody can deal while rank 0 works
        yield from range(comm.Get_rank(), n, comm.Get_size())
        return
    own, numbers, lock = comm.Dup(), iter(range(n)), threading.Lock()

    def following() -> int | None:
        with lock:
            return next(numbers, None)

    def deal() -> None:
        status, asking = MPI.Status(), own.Get_size() - 1
        while asking:
            if not own.Iprobe(status=status):
                time.sleep(0.002)  # no busy loop beside rank 0's own work
                continue
            own.recv(source=status.source)
            number = following()
            own.send(number, status.source)
            asking -= number is None

    dealer = None
    if own.Get_rank() == 0:
        dealer = threading.Thread(target=deal, name="deal", daemon=True)
        dealer.start()
    while True:
        number = following() if dealer else own.sendrecv(None, 0, source=0)
        if number is None:
            break
        yield number
    if dealer:
        dealer.join()
    own.Free()


def local_rank(comm: Any) -> int:
    """This rank's number among those of an mpi4py communicator on the same computer."""
    return Ranks(comm).local()[0]


def _starts(counts: Any) -> np.ndarray:
    return np.cumsum(counts) - counts
