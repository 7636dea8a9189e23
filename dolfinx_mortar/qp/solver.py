# SPDX-License-Identifier: MIT
"""Solve a bound-constrained QP with a backend chosen by name, and check the solution."""

from dataclasses import replace
from functools import partial

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.common import arguments
from dolfinx_mortar.common.arrays import Actives, Floats, Ints
from dolfinx_mortar.qp import active_set, interior_point
from dolfinx_mortar.qp.bound_qp import BoundQP, QPNotSolved, QPSolution, check, validate
from dolfinx_mortar.qp.held import State, nearest
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.preconditioner import set_apart

# Errors of a backend that are no fault of the code.
FAILURES = (
    LinearSolveFailed,
    PETSc.Error,
    np.linalg.LinAlgError,
    FloatingPointError,
    MemoryError,
)

ACTIVE_SET, INTERIOR_POINT = "active-set", "interior-point"


def available() -> list[str]:
    """Names of the backends."""
    return [ACTIVE_SET, INTERIOR_POINT]


def check_name(backend: str) -> None:
    """Raise a ValueError if there is no backend of this name."""
    arguments.check("qp", backend, arguments.one_of(*available()))


def solve(
    qp: BoundQP,
    backend: str = "active-set",
    linear: LinearSolver | None = None,
    *,
    start_active: Actives | None = None,
    start_sliding: Floats | None = None,
    start_kappa: Floats | None = None,
    guess: PETSc.Vec | None = None,
    rtol: float = 1e-10,
) -> QPSolution:
    """Solve a bound-constrained QP and check the solution (collective).

    Args:
        backend: "active-set", or for a definite matrix without friction "interior-point".
        linear: linear solver, whose factorisation is reused; by default a new one with MUMPS.
        start_active: (k,) initial active set on ``qp.bounded``: +1 upper, -1 lower, 0 free; by
            default every unknown at its bound nearest to zero.
        start_sliding: (m, t) initial directions of slip, zero at sticking nodes; by default
            everywhere.
        start_kappa: (m,) initial kappa of `qp.friction`; at most |diag(A)|, the default.
        guess: (n,) for the first linear solve; 0 by default.
        rtol: relative tolerance of the KKT check; round-off is the limit.

    Raises:
        ValueError: for an unknown backend, a problem that it cannot solve, or data without
            solution.
        QPNotSolved: if the backend fails, or its solution, an attribute of the error, fails the
            check.
    """
    check_name(backend)
    arguments.check("qp", qp, arguments.instance(BoundQP, "give a BoundQP"))
    named: dict[str, object] = {"friction": qp.friction, "implicit wear": qp.give}
    named["tools or sides that forces drive"] = qp.scalars
    given = [name for name, part in named.items() if part is not None]
    if backend == INTERIOR_POINT and (given or not qp.definite):
        why = "needs a symmetric positive definite matrix:"
        if given:
            why = f"is for bounds only: with {given[0]}"
        raise ValueError(f"qp is {backend!r}, which {why} choose {ACTIVE_SET!r}")
    validate(qp)
    if qp.scalars is None and (trivial := _nothing_to_do(qp, backend)) is not None:
        return trivial
    if linear is None:
        linear = LinearSolver(qp.comm, prefix="dolfinx_mortar_qp_")
    start = nearest(qp) if start_active is None else np.asarray(start_active, dtype=np.int8)
    lower, upper = qp.bounds
    possible = np.isfinite(np.where(start > 0, upper, lower))
    start = np.where(possible, start, 0).astype(np.int8)
    iterations, factorisations = linear.counts.iterations, linear.counts.factorisations
    try:
        first = State.create(qp, start, start_sliding, start_kappa)
        run = partial(_run, qp, backend, linear, first, rtol, guess)
        apart = set_apart(qp, linear.options) if backend == ACTIVE_SET else None
        try:
            solution = run(apart)
        except np.linalg.LinAlgError:  # indefinite, or S has too few digits
            if apart is None:
                raise
            solution = run(None)
    except FAILURES as error:
        if not isinstance(error, LinearSolveFailed):
            linear.abandon()
        raise QPNotSolved(f"The backend {backend!r} stopped: {_cause(error, linear)}") from error
    solution = replace(
        solution,
        linear_iterations=linear.counts.iterations - iterations,
        factorisations=solution.factorisations + linear.counts.factorisations - factorisations,
    )
    if not solution.kkt.satisfied(rtol):
        raise QPNotSolved(
            f"The solution of the backend {backend!r} fails the check at rtol={rtol:g}: "
            f"{solution.kkt}. {solution.note}{linear.remedy}",
            solution,
        )
    return solution


def _run(
    qp: BoundQP,
    backend: str,
    linear: LinearSolver,
    start: State,
    rtol: float,
    guess: PETSc.Vec | None,
    apart: Ints | None,
) -> QPSolution:
    """Solve by a backend; `apart` are the unknowns of S, None for an ordinary factorisation."""
    if apart is None and qp.product is not None:  # another method needs the matrix itself
        qp = replace(qp, A=qp.A.duplicate(copy=True), product=None)
    linear.set_matrix(
        qp.A,
        definite=qp.definite,
        apart=apart,
        product=qp.product,
        near=qp.near,
    )
    if backend == INTERIOR_POINT:
        return interior_point.solve(qp, linear, rtol=rtol)
    return active_set.solve(qp, linear, start=start, rtol=rtol, guess=guess)


def _cause(error: Exception, linear: LinearSolver) -> str:
    if isinstance(error, LinearSolveFailed):
        return str(error)
    return (
        f"{type(error).__name__}, {error}. Check the options of the linear solver, "
        f"{linear.options.values}, the material constants, and that every body is held"
    )


def _nothing_to_do(qp: BoundQP, backend: str) -> QPSolution | None:
    """Return x = 0 if that is the solution: an iteration would have no scale for its error."""
    x = qp.b.duplicate()
    x.set(0.0)
    if qp.b.norm() > 0.0 or (kkt := check(qp, x, x.copy())).worst > 0.0:
        return None
    active = np.zeros(qp.bounded.size, dtype=np.int8)
    sliding = None if qp.friction is None else 0.0 * qp.friction.rest
    return QPSolution(x, x.copy(), active, kkt, 0, 0, 0, backend, sliding=sliding)
