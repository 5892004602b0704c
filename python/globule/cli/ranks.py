"""The ranks of mpiexec or srun: how `globule render` shares out its work among them."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

from .._base.device import choose, of_rank
from .._base.memory import free_bytes
from ..formats.kind import kind_of
from ..formats.ranges import has_ranges, ranges
from ..pieces.gathered import replicated_bytes
from ..render.pieces.light import turns
from ..render.settings import RenderSettings
from . import light
from .meshes import is_mesh
from .pieces import needs_all
from .shared import UserError, mistakes, reading, say, text_of

MODES = ("replicate", "pieces")


def communicator() -> Any:
    """The ranks that mpiexec or srun has started this process as one of; None: it is alone."""
    names = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "PMIX_SIZE", "MPI_LOCALNRANKS")
    if max((int(os.environ.get(n, "1")) for n in names), default=1) < 2:
        return None
    try:
        from mpi4py import MPI
    except ImportError:
        raise UserError('several ranks: expected mpi4py, which is not installed; pip install "globule[mpi]"') from None
    return MPI.COMM_WORLD if MPI.COMM_WORLD.size > 1 else None


@contextlib.contextmanager
def together(comm: Any) -> Iterator[None]:
    """One line for a mistake on the ranks: of all ranks, rank 0 says it; of one, this rank names
    itself and ends the run."""
    if comm is None:
        yield
        return
    own = comm.Dup()
    try:
        yield
    except (Exception, KeyboardInterrupt) as error:
        stopped = isinstance(error, KeyboardInterrupt)
        text = "interrupted" if stopped else text_of(error)
        note = getattr(error, "note", lambda: "")  # counts what other ranks still finish
        status = 130 if stopped else 2
        request = own.Ibarrier()
        until = time.monotonic() + 3.0
        while time.monotonic() < until:
            if request.Test():  # every rank has failed: nobody waits for anybody
                if comm.rank == 0:
                    say(text if stopped else f"error: {text}")
                    if note():
                        say(note())
                    sys.stderr.flush()
                own.Barrier()  # the launcher ends all ranks as soon as the first one leaves
                os._exit(status)
            time.sleep(0.02)
        say(f"error: rank {comm.rank}: {text}")
        if note():
            say(note())
        sys.stderr.flush()
        own.Abort(status)
    # Where others fail after this rank is done, they end the run.


def settle(options: argparse.Namespace, comm: Any) -> None:
    """Each rank its device: the GPUs of a computer in turn, or its share of the cores."""
    from mpi4py import MPI

    local = comm.Split_type(MPI.COMM_TYPE_SHARED)
    options.device = of_rank(options.device, local.rank)
    cores = frozenset(os.sched_getaffinity(0))
    if not options.threads:  # a launcher may have given each rank cores of its own
        options.threads = max(1, len(cores) // local.allgather(cores).count(cores))
    options.ranks_here = local.size
    local.Free()


def replicates(options: argparse.Namespace, lit: light.Light) -> bool:
    """Whether every rank has all particles and traces some of the pixels; else each has a piece.

    By itself: where something needs all particles in one scene, or light turns and all particles
    fit on every rank. Raises UserError where they do not fit and have to.
    """
    path = options.particles[0]
    particles = kind_of(path).kind == "particles" and not is_mesh(path, options)
    if options.ranks == "pieces" and not particles:
        raise UserError(f"--ranks: expected particles for pieces, got {path}")
    forced = options.ranks == "replicate" or not particles or needs_all(options)
    if options.ranks == "pieces" or not (forced or _turns(lit)):
        return False
    given = reading(options)
    if particles and has_ranges(path, given) and choose(options.device).backend != "cuda":
        with mistakes():
            n = ranges(path, **given).n
        here = options.ranks_here
        need, free = here * replicated_bytes(n, "smooth"), free_bytes()
        if free and need > free:
            if not forced:
                return False
            raise UserError(
                f"--ranks: expected {need / 1e9:.3g} GB for all particles on each of {here} ranks "
                f"of a computer, got {free / 1e9:.3g} GB; start fewer ranks on each, or leave out "
                "what needs all particles in one scene"
            )
    return True


def _turns(lit: light.Light) -> bool:
    """Whether light turns; particles' own factors are not known yet."""
    material = dataclasses.replace(RenderSettings().material, **lit._matter)
    return turns([], dataclasses.replace(RenderSettings(), material=material, **lit._own)) or bool(
        material.reflection or material.transmission or (material.index or 1) != 1
    )
