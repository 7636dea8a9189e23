# SPDX-License-Identifier: MIT
"""Any number of active-set updates for the price of one factorisation and a few solves.

Factorise A once with all bounded unknowns B held. Then x_I follows from x_B by one solve, and what
is left is a QP for x_B with the Schur complement S = A_BB - A_BI A_II^-1 A_IB. Applying S costs one
solve; forming it would cost one per bounded unknown. So a dense model of S is kept on rank 0 (few
unknowns have bounds), the model's QP is solved to the end, and the solve that checks the result
gives one exact pair (v, S v) that improves the model (block BFGS). The first model is the square
root of a graph Laplacian, because S is a half-order operator like the Dirichlet-to-Neumann map;
later ones start from what was learnt in the last Newton iteration.

Nothing here is singular as long as the bounds, all active, hold the bodies.

What it saves in a step of benchmarks/hertz_2d.py, over both slaves, frozen and updated geometry:

    solves + factorisations (each as dear as 5 to 7 solves)    with           without
    elastic, frozen,   5 thousand unknowns                      5 + 2          3 + 1
    elastic, frozen,  50 thousand unknowns                      5 + 2          11 + 3
    elastic, updated,  5 thousand unknowns                      13..14 + 2     14..17 + 2
    elastic, updated, 50 thousand unknowns                      14..19 + 3..4  33..35 + 3
    plastic,           5 thousand unknowns                      32..36 + 5     46..52 + 4..5
    plastic,          50 thousand unknowns                      30..36 + 7..8  79..104 + 9
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.linalg import LinAlgError, cholesky

from dolfinx_mortar.arrays import Actives, Floats, Ints, Longs
from dolfinx_mortar.qp.bound_qp import BoundQP
from dolfinx_mortar.qp.dense import solve_dense
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.schur import SchurModel, half_laplacian
from dolfinx_mortar.qp.tolerances import LIMIT, SHARE

T = TypeVar("T")


@dataclass(frozen=True)
class Everywhere:
    """The bounded unknowns of all ranks as one replicated vector, in rank order."""

    comm: MPI.Comm
    own: Ints  # this rank's bounded unknowns, ascending
    counts: Longs  # (ranks,)

    @property
    def own_part(self) -> slice:
        """This rank's part of a replicated vector."""
        first = int(self.counts[: self.comm.rank].sum())
        return slice(first, first + self.own.size)

    def gather(self, values: Floats) -> Floats:
        """Return the values of all ranks."""
        result = np.empty(int(self.counts.sum()))
        counts = [int(count) for count in self.counts]
        own = np.ascontiguousarray(values, dtype=np.float64)
        self.comm.Allgatherv(own, [result, counts, None, MPI.DOUBLE])
        return result

    def block(self, A: PETSc.Mat) -> Floats:
        """Return A restricted to these unknowns, dense; on other ranks than 0 nothing."""
        rows = (self.own + A.getOwnershipRange()[0]).astype(PETSc.IntType)
        index = PETSc.IS().createGeneral(rows, comm=A.comm)
        indptr, columns, values = A.createSubMatrix(index, index).getValuesCSR()
        row = self.own_part.start + np.repeat(np.arange(self.own.size), np.diff(indptr))
        parts = self.comm.gather((row, columns, values))
        dense = np.zeros(2 * (int(self.counts.sum()) if parts else 0,))
        for i, j, a in parts or []:
            dense[i, j] = a
        return dense


def on_root(comm: MPI.Comm, function: Callable[[], T]) -> T | None:
    """Return on rank 0 what a function returns, None elsewhere; raise on all ranks what it raises.

    No rank waits for one that has failed (collective).
    """
    answer, error = None, None
    if comm.rank == 0:
        try:
            answer = function()
        except Exception as caught:
            error = caught
    error = comm.bcast(error)
    if error is not None:
        raise error
    return answer


def is_worthwhile(qp: BoundQP, linear: LinearSolver) -> bool:
    """Tell whether the linear solver is a factorisation and the dense model smaller than A.

    Measured on strips of 6 to 120 thousand unknowns with 61 to 1001 bounded ones, in processor time
    with and without: 0.55 to 0.83 where the model has fewer entries than A, 0.92 with 1.15 times as
    many, 1.08 with 1.7 times as many.
    """
    size = qp.comm.allreduce(qp.bounded.size)
    return linear.direct and 0 < size**2 <= qp.A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]


def predict(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, start: Actives, *, rtol: float
) -> Actives:
    """Solve the QP through its Schur complement on the bounded unknowns (collective).

    Args:
        qp: the problem.
        linear: factorises A with all bounded unknowns held, unless it has done so; keeps the model.
        x: (n,) out: the solution.
        start: (k,) guess of the active set.
        rtol: residual of the free bounded unknowns relative to the forces.

    Returns:
        The active set (k,), which the caller has to check. Once it stays, and the residual falls so
        slowly that a factorisation with it held costs less than the solves to come, it is returned
        as it is.

    Raises:
        LinearSolveFailed: if A is singular even with all bounded unknowns held.
    """
    order = np.argsort(qp.bounded)
    everywhere = Everywhere(qp.comm, qp.bounded[order], np.array(qp.comm.allgather(order.size)))
    lower, upper = (everywhere.gather(bound[order]) for bound in qp.bounds())
    linear.factorise(everywhere.own)
    reduced = _Reduced(qp, linear, everywhere, x)
    active = np.sign(everywhere.gather(start[order].astype(np.float64))).astype(np.int8)
    w = np.where(active > 0, upper, np.where(active < 0, lower, np.clip(0.0, lower, upper)))
    rho = reduced.force(w)
    if not np.isfinite(rho).all():
        raise LinearSolveFailed("The linear solver gave NaN or infinity: check its options.")
    model = _create_model(qp, linear, everywhere)
    b_norm = qp.b.norm()
    norms: list[float] = []
    for _ in range(LIMIT):
        before = active
        d, active = _solve_model(qp, model, (rho, lower - w, upper - w, active))
        force = max(float(np.linalg.norm(rho)), b_norm)
        tolerance = max(SHARE**2 * rtol * force, linear.round_off(x))
        if not np.array_equal(active, before):
            norms.clear()  # residuals of different sets have no rate
        reached, held = w + d, active != 0
        norms.append(float(np.linalg.norm(rho[~held])))
        stays = np.array_equal(reached[held], w[held])
        if stays and norms[-1] <= tolerance:
            break
        if stays and np.array_equal(active, before) and linear.renewal.is_slow(norms, tolerance):
            break
        reached[held] = np.where(active > 0, upper, lower)[held]
        w, rho = reduced.move(w, reached, rho, model)
        if not np.isfinite(rho).all():
            break
    result = np.empty(order.size, dtype=np.int8)
    result[order] = active[everywhere.own_part]
    return result


class _Reduced:
    """The energy as a function of x_B alone, with x kept up to date."""

    def __init__(
        self, qp: BoundQP, linear: LinearSolver, everywhere: Everywhere, x: PETSc.Vec
    ) -> None:
        self.qp, self.linear, self.everywhere, self.x = qp, linear, everywhere, x
        self.z, self.dx, self.before = (x.duplicate() for _ in range(3))

    def force(self, w: Floats) -> Floats:
        """Set x_B = w, solve for x_I and return (b - A x)_B = minus the reduced gradient."""
        own, x = self.everywhere.own, self.x
        x.array[own] = w[self.everywhere.own_part]
        self.linear.apply(self.linear.residual(self.qp.b, x, own), self.dx)
        self.dx.array[own] = 0.0
        x.axpy(1.0, self.dx)
        self.qp.A.mult(x, self.z)
        self.z.aypx(-1.0, self.qp.b)
        return self.everywhere.gather(self.z.array_r[own])

    def move(
        self, w: Floats, reached: Floats, rho: Floats, model: SchurModel | None
    ) -> tuple[Floats, Floats]:
        """Go from w to `reached` if that lowers the energy, else to its minimum on the way.

        Along the way it is -t rho.d + t^2/2 d.Sd. The model learns the pair either way. Whole steps
        put held unknowns exactly on their bounds.
        """
        self.x.copy(self.before)
        after = self.force(reached)
        d, Sd = reached - w, rho - after
        if model is not None:
            model.learn(d, Sd)
        slope, energy = rho @ d, d @ Sd
        if slope <= 0.0 or 0.5 * energy <= slope:
            return reached, after
        step = slope / energy
        self.x.aypx(step / (1.0 - step), self.before)  # (before + s/(1-s) x) (1-s)
        self.x.scale(1.0 - step)
        return w + step * d, rho - step * Sd


def _create_model(qp: BoundQP, linear: LinearSolver, everywhere: Everywhere) -> SchurModel | None:
    """Return, on rank 0, a model without pairs: what was learnt about an earlier A, or one of A."""
    unknowns, last = linear.learnt.bounded, linear.learnt.model
    fits = unknowns is not None and np.array_equal(unknowns, everywhere.own)
    base = None
    if qp.comm.allreduce(fits, op=MPI.LAND):
        base = on_root(qp.comm, lambda: None if last is None else _learnt(last))
    if not qp.comm.bcast(base is not None):
        block = everywhere.block(qp.A)
        base = on_root(qp.comm, lambda: half_laplacian(block))
    model = None if base is None else SchurModel(base, *np.zeros((2, base.shape[0], 0)))
    linear.learnt = replace(linear.learnt, bounded=everywhere.own.copy(), model=model)
    return model


def _learnt(model: SchurModel) -> Floats | None:
    """Return the matrix of a model, or None if round-off has made it indefinite."""
    try:
        M = model.matrix()
        cholesky(M)
    except LinAlgError:
        return None
    return M


def _solve_model(
    qp: BoundQP, model: SchurModel | None, problem: tuple[Floats, Floats, Floats, Actives]
) -> tuple[Floats, Actives]:
    """Solve the model's QP on rank 0 and send the answer, so that it is bitwise the same.

    The pairs are dropped where round-off has made the model indefinite.
    """

    def solve() -> tuple[Floats, Actives]:
        assert model is not None
        try:
            return solve_dense(model.matrix(), *problem)
        except LinAlgError:
            model.forget()
            return solve_dense(model.base, *problem)

    answer: tuple[Floats, Actives] = qp.comm.bcast(on_root(qp.comm, solve))
    return answer
