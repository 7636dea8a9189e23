# SPDX-License-Identifier: MIT
"""Entry-wise reductions of small arrays over the ranks, and what else all ranks do together.

Mpi4py's lower-case ``allreduce`` compares whole objects, which arrays refuse.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats


def maximum(comm: MPI.Comm, *values: float | np.bool_) -> Floats:
    """Return the largest of each value over all ranks; collective.

    >>> maximum(MPI.COMM_SELF, 1.0, 2.0).tolist()
    [1.0, 2.0]
    """
    local = np.array(values, dtype=float)
    result = np.empty_like(local)
    comm.Allreduce(local, result, op=MPI.MAX)
    return result


def any_rank(comm: MPI.Comm, *flags: bool | np.bool_) -> Bools:
    """Return for each flag whether it is set on any rank; collective."""
    return maximum(comm, *(float(flag) for flag in flags)) > 0.0


def free_unused(comm: MPI.Comm) -> None:
    """Free PETSc objects that Python has let go; collective.

    On several ranks petsc4py only lists them, because the ranks' garbage collectors do not run at
    the same time; without this call they pile up.
    """
    PETSc.garbage_cleanup(comm)
