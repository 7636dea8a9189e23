# SPDX-License-Identifier: MIT
"""Bound-constrained quadratic programs: data, backends chosen by name, one check for all of them.

A backend is a module of `qp.backends` with a function

    solve(qp: BoundQP, linear: LinearSolver, *, start: int8 (k,), rtol: float, settled: bool)

that returns a QPSolution

and the name of its file with dashes; nothing else has to be registered.
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.arrays import Actives
from dolfinx_mortar.qp import backends
from dolfinx_mortar.qp.bound_qp import KKT, BoundQP, QPNotSolved, QPSolution, check, validate
from dolfinx_mortar.qp.linear import MULTIGRID, LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.multigrid import Preconditioning

__all__ = [
    "KKT",
    "MULTIGRID",
    "BoundQP",
    "LinearSolveFailed",
    "LinearSolver",
    "Preconditioning",
    "QPNotSolved",
    "QPSolution",
    "available",
    "check",
    "check_name",
    "solve",
]


@cache
def available() -> list[str]:
    """Return the names of the backends."""
    names = [module.name for module in iter_modules(backends.__path__)]
    return sorted(name.replace("_", "-") for name in names)


def check_name(backend: str) -> None:
    """Raise ValueError if there is no backend of this name."""
    if backend not in available():
        raise ValueError(f"qp is {backend!r}: choose one of {', '.join(map(repr, available()))}")


def solve(
    qp: BoundQP,
    backend: str = "active-set",
    linear: LinearSolver | None = None,
    *,
    start_active: Actives | None = None,
    rtol: float = 1e-10,
    settled: bool = False,
) -> QPSolution:
    """Solve a bound-constrained QP (collective).

    Args:
        qp: the problem.
        backend: "active-set", "interior-point" or "tron".
        linear: linear solver, whose factorisation is reused if it was used before; a MUMPS
            Cholesky factorisation by default.
        start_active: (k,) guess of the active set on ``qp.bounded``: +1 upper, -1 lower, 0 free.
            By default every unknown at its nearest bound, which holds every body.
        rtol: tolerance of the KKT check, relative; round-off is the limit.
        settled: the guess is expected to be right up to a few unknowns; a wrong promise costs
            time only.

    Returns:
        The solution, which has passed the check.

    Raises:
        ValueError: for an unknown backend or data that have no solution.
        QPNotSolved: if the result fails the check; the exception carries it.
    """
    check_name(backend)
    validate(qp)
    if (trivial := _nothing_to_do(qp, backend)) is not None:
        return trivial
    if linear is None:
        linear = LinearSolver(qp.comm, prefix="dolfinx_mortar_qp_")
    module = import_module(f"{backends.__name__}.{backend.replace('-', '_')}")
    start = _nearest(qp) if start_active is None else np.asarray(start_active, dtype=np.int8)
    lower, upper = qp.bounds()
    start = np.where((start > 0) & np.isinf(upper), 0, start)
    start = np.where((start < 0) & np.isinf(lower), 0, start).astype(np.int8)
    before = (linear.counts.iterations, linear.counts.factorisations)
    try:
        linear.attach(qp.A)
        solution: QPSolution = module.solve(qp, linear, start=start, rtol=rtol, settled=settled)
    except LinearSolveFailed as error:
        raise QPNotSolved(f"The backend {backend!r} stopped: {error}") from error
    except PETSc.Error as error:
        raise QPNotSolved(
            f"The backend {backend!r} stopped in PETSc: {error}. Check the options of the linear "
            f"solver, {linear.options}"
        ) from error
    solution.linear_iterations += linear.counts.iterations - before[0]
    solution.factorisations += linear.counts.factorisations - before[1]
    if not solution.kkt.satisfied(rtol):
        raise QPNotSolved(
            f"The solution of the backend {backend!r} fails the check at rtol={rtol:g}: "
            f"{solution.kkt}. {solution.note}",
            solution,
        )
    return solution


def _nothing_to_do(qp: BoundQP, backend: str) -> QPSolution | None:
    """Return x = 0 if no force acts and no bound forbids it.

    An iteration would only come near, and have nothing to measure its error against.
    """
    lower, upper = qp.bounds()
    outside = bool((lower > 0.0).any() or (upper < 0.0).any())
    if qp.comm.allreduce(outside or bool(qp.b.array_r.any()), op=MPI.LOR):
        return None
    x, z = qp.b.duplicate(), qp.b.duplicate()
    x.set(0.0)
    z.set(0.0)
    active = np.zeros(qp.bounded.size, dtype=np.int8)
    return QPSolution(x, z, active, check(qp, x, z), 0, 0, 0, backend)


def _nearest(qp: BoundQP) -> Actives:
    """Return every bounded unknown at the bound nearest to zero."""
    lower, upper = qp.bounds()
    return np.where(np.abs(upper) <= np.abs(lower), 1, -1).astype(np.int8)
