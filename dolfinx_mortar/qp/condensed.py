# SPDX-License-Identifier: MIT
"""Prediction of the active set: the QP condensed to its bounded unknowns, with a dense model.

A is factorised once with all bounded unknowns B held. Then x_I follows from x_B by one solve, and
x_B is the solution of a QP with the Schur complement S = A_BB - A_BI A_II^-1 A_IB. To apply S costs
one solve, to form it one per bounded unknown. So S is replaced by a dense model on rank 0 (few
unknowns have bounds). The QP of the model is solved, and the solve that checks its solution gives
one exact pair (v, S v), which updates the model (BFGS). The initial model is the square root
of a graph Laplacian, because S is an operator of order one like the Dirichlet-to-Neumann map.

On one rank MUMPS gives S itself (`schur`): then one step is the solution, and the same
factorisation serves the set that is found. 47 thousand unknowns, processor time of a step with the
dense model and with S: elastic, frozen .65 -> .35 s (2 factorisations and 7 solves -> 1 and 2),
elastic, updated 1.09 -> .70 (3 + 16 -> 1 + 9), plastic, updated 2.3 -> 1.75 (6 + 42 -> 5 + 24).

The prediction depends on the QP alone. No matrix is singular if the bounds, all active, constrain
the bodies.

Solves + factorisations (each costs as much as 5 to 7 solves) of one step of
benchmarks/hertz_2d.py, slave block, with the dense model, and its processor time without prediction
over that with it:

                                          with       without     time
    elastic, frozen,   5 thousand         5 + 2       3 + 1      0.82
    elastic, frozen,  50 thousand         6 + 2      11 + 3      1.24
    elastic, updated, 50 thousand        18 + 3      35 + 3      1.23
    plastic, frozen,  50 thousand        42 + 6     106 + 9      1.5
    plastic, updated, 50 thousand        42 + 6      88 + 9      1.5
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh
from scipy.sparse import csr_array

from dolfinx_mortar.algebra.csr import csr_of
from dolfinx_mortar.arrays import EPS, HALF_OF_DIGITS, LIMIT, ROUND_OFF, Actives, Floats, Ints
from dolfinx_mortar.qp.bound_qp import Bounded, BoundQP
from dolfinx_mortar.qp.held import SHARE
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.updates import Found, update

T = TypeVar("T")


def is_worthwhile(qp: BoundQP, linear: LinearSolver) -> bool:
    """Tell whether the solver is direct, S definite and the model smaller than A (collective).

    Measured on strips of 6 to 120 thousand unknowns with 61 to 1001 bounded ones, in processor time
    with and without: 0.55 to 0.83 where the model has fewer entries than A, 0.92 with 1.15 times as
    many, 1.08 with 1.7 times as many.
    """
    if linear.setup.preconditioner.schur is not None:
        return qp.bounded.size > 0
    size = qp.comm.allreduce(qp.bounded.size)
    entries = qp.A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] if linear.direct else 0
    return bool(qp.definite and 0 < size**2 <= entries)


def predict(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, start: Actives, *, rtol: float
) -> Actives:
    """Solve the QP through its Schur complement on the bounded unknowns (collective).

    Args:
        x: (n,) out: the solution.
        start: (k,) initial active set.
        rtol: residual of the free bounded unknowns relative to the forces.

    Returns:
        The active set (k,), to be checked by the caller. The iteration ends before rtol is reached
        if the set is unchanged and a factorisation with it would cost less than further solves, or
        if round-off makes the model indefinite.

    Raises:
        LinearSolveFailed: if A is singular even with all bounded unknowns held.
    """
    order = np.argsort(qp.bounded)
    everywhere = Everywhere(qp.comm, qp.bounded[order], qp.comm.allgather(order.size))
    lower, upper = (everywhere.gather(bound[order]) for bound in qp.bounds())
    linear.factorise(everywhere.own)
    reduced = _Reduced(qp, linear, everywhere, x)
    active = np.sign(everywhere.gather(start[order].astype(np.float64))).astype(np.int8)
    w = np.where(active > 0, upper, np.where(active < 0, lower, np.clip(0.0, lower, upper)))
    rho = reduced.force(w)
    if not np.isfinite(rho).all():
        raise LinearSolveFailed("The linear solver gave NaN or infinity: check its options.")
    b_norm = qp.b.norm()
    norms: list[float] = []
    try:
        model = first_model(linear, everywhere)
        for _ in range(LIMIT):
            before = active
            d, active = _solve_model(qp.comm, model, (rho, lower - w, upper - w, active))
            force = max(float(np.linalg.norm(rho)), b_norm)
            tolerance = max(SHARE**2 * rtol * force, linear.setup.operator.round_off(x))
            if not np.array_equal(active, before):
                norms.clear()  # residuals of different sets have no rate
            reached, held = w + d, active != 0
            norms.append(float(np.linalg.norm(rho[~held])))
            stays = np.array_equal(reached[held], w[held])
            slow = linear.setup.renewal.is_slow(norms, tolerance)
            if stays and (norms[-1] <= tolerance or (slow and np.array_equal(active, before))):
                break
            reached[held] = np.where(active > 0, upper, lower)[held]
            w, rho = reduced.move(w, reached, rho, model)
            if not np.isfinite(rho).all():
                break
    except LinAlgError:  # on all ranks
        pass
    result = np.empty(order.size, dtype=np.int8)
    result[order] = active[everywhere.own_part]
    return result


class _Reduced:
    """The energy as a function of x_B, and its minimiser x for given x_B."""

    def __init__(
        self, qp: BoundQP, linear: LinearSolver, everywhere: Everywhere, x: PETSc.Vec
    ) -> None:
        self.qp, self.linear, self.everywhere, self.x = qp, linear, everywhere, x
        self.z, self.dx, self.before = (x.duplicate() for _ in range(3))

    def force(self, w: Floats) -> Floats:
        """Set x_B = w, solve for x_I and return (b - A x)_B = minus the reduced gradient."""
        own, x = self.everywhere.own, self.x
        x.array[own] = w[self.everywhere.own_part]
        self.linear.apply(self.linear.setup.operator.residual(self.qp.b, x, own), self.dx)
        self.dx.array[own] = 0.0
        x.axpy(1.0, self.dx)
        self.qp.A.mult(x, self.z)
        self.z.aypx(-1.0, self.qp.b)
        return self.everywhere.gather(self.z.array_r[own])

    def move(
        self, w: Floats, reached: Floats, rho: Floats, model: SchurModel | None
    ) -> tuple[Floats, Floats]:
        """Step from w to `reached` if that decreases the energy, else to the minimum in between.

        In between it is -t rho.d + t^2/2 d.Sd. The pair (d, Sd) updates the model in both cases.
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


# -- the dense model, on rank 0 ----------------------------------------------------------------


class SchurModel:
    """A symmetric positive definite model M of the Schur complement on the bounded unknowns."""

    def __init__(self, base: Floats, *, exact: bool = False) -> None:
        self.M, self.scaled, self.exact = base, False, exact

    def learn(self, v: Floats, w: Floats) -> None:
        """Update M by a pair w = S v (BFGS): then M v = w."""
        energy = float(v @ w)
        if self.exact or not energy > HALF_OF_DIGITS * float(np.linalg.norm(v) * np.linalg.norm(w)):
            return
        if not self.scaled:
            self.M, self.scaled = self.M * (energy / (v @ self.M @ v)), True
        u = self.M @ v
        self.M = self.M - np.outer(u, u) / (v @ u) + np.outer(w, w) / energy


def first_model(linear: LinearSolver, everywhere: Everywhere) -> SchurModel | None:
    """Return S itself where the factorisation gives it, else a guess; on rank 0; collective."""
    schur = linear.setup.preconditioner.schur
    if schur is not None:
        return SchurModel(schur.model(), exact=True)
    block = everywhere.block(linear.setup.operator.A)
    return on_root(everywhere.comm, lambda: SchurModel(half_laplacian(block)))


def half_laplacian(block: Floats) -> Floats:
    """Return diag^(1/2) sqrt(L) diag^(1/2), with L the Laplacian of the graph of A_BB.

    For linear elements on a curve this is the energy of the Dirichlet-to-Neumann map up to a
    factor, for any mesh sizes. The graph has no weights: the entries of A_BB depend on the angles
    of the elements, S hardly does (measured on a graded mesh: condition number of M^-1 S 6 without
    weights, 17 with |a_ij| as weights).
    """
    diagonal = np.sqrt(np.diag(block))
    edges = (np.abs(block) > ROUND_OFF * np.outer(diagonal, diagonal)).astype(np.float64)
    np.fill_diagonal(edges, 0.0)
    values, vectors = eigh(np.diag(edges.sum(axis=1)) - edges)
    # the lowest mode has about one wavelength over all bounded unknowns
    shift = max(values.max(initial=0.0), 1.0) / max(1, values.size) ** 2
    root = (vectors * np.sqrt(np.maximum(values, 0.0) + shift)) @ vectors.T
    return np.asarray(root * np.outer(diagonal, diagonal))


def solve_dense(
    M: Floats, b: Floats, lower: Floats, upper: Floats, active: Actives
) -> tuple[Floats, Actives]:
    """Minimise 1/2 d'Md - b'd over lower <= d <= upper by the primal-dual active-set method.

    Args:
        M: (k, k) symmetric positive definite.
        b: (k,) force.
        lower: (k,) lower bounds, -inf where there is none.
        upper: (k,) upper bounds, inf where there is none.
        active: (k,) initial set: +1 at upper, -1 at lower, 0 free.

    Returns:
        d (k,) and its active set (k,); after a cycle those of the last set.

    Raises:
        LinAlgError: if M is not positive definite.

    >>> M, b = np.array([[2.0, 0.0], [0.0, 4.0]]), np.array([2.0, 2.0])
    >>> upper, none = np.array([0.25, 9.0]), np.zeros(2, dtype=np.int8)
    >>> d, active = solve_dense(M, b, np.full(2, -9.0), upper, none)
    >>> d.tolist(), active.tolist()
    ([0.25, 0.5], [1, 0])
    """
    if not (np.diag(M) > 0.0).all():  # it scales distances, infinite ones, too
        raise LinAlgError("M is not positive definite")

    def hold(active: Actives, level: int) -> Found[Actives]:
        d, z = _with_active(M, b, np.where(active > 0, upper, lower), active)
        found = Bounded(d, z, lower, upper, np.diag(M))
        new = found.predicted()
        noise = ROUND_OFF * float(np.linalg.norm(np.diag(M) * d))
        return Found(new, int(found.strong(active, new, noise).sum()), satisfied=True)

    last = update(hold, active, MPI.COMM_SELF).state
    return _with_active(M, b, np.where(last > 0, upper, lower), last)[0], last


def _with_active(M: Floats, b: Floats, bound: Floats, active: Actives) -> tuple[Floats, Floats]:
    """Return d with its active entries at the bound, and z = b - M d, exactly 0 at free ones.

    Raises:
        LinAlgError: if M is singular on the free entries: a pivot is no more than its round-off,
            which for a Cholesky factorisation of order k is k EPS M_jj.
    """
    free = active == 0
    d = np.where(free, 0.0, bound)
    if free.any():
        part = M[np.ix_(free, free)]
        factor = cho_factor(part)
        if (np.diag(factor[0]) ** 2 <= len(part) * EPS * np.diag(part)).any():
            raise LinAlgError("M is singular: contact alone holds a body")
        d[free] = cho_solve(factor, (b - M @ d)[free])
    z = b - M @ d
    z[free] = 0.0
    return d, z


def _solve_model(
    comm: MPI.Comm, model: SchurModel | None, problem: tuple[Floats, Floats, Floats, Actives]
) -> tuple[Floats, Actives]:
    """Solve the QP of the model on rank 0; all ranks return the same bits (collective)."""

    def solve() -> tuple[Floats, Actives]:
        assert model is not None
        return solve_dense(model.M, *problem)

    answer: tuple[Floats, Actives] = comm.bcast(on_root(comm, solve))
    return answer


# -- ranks -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Everywhere:
    """The bounded unknowns of all ranks, in rank order, as vectors that every rank has."""

    comm: MPI.Comm
    own: Ints  # this rank's bounded unknowns, ascending
    counts: list[int]  # of each rank

    @property
    def own_part(self) -> slice:
        """This rank's part of such a vector."""
        first = sum(self.counts[: self.comm.rank])
        return slice(first, first + self.own.size)

    def gather(self, values: Floats) -> Floats:
        """Return the values of all ranks (collective)."""
        return np.concatenate(self.comm.allgather(values))

    def block(self, A: PETSc.Mat) -> Floats:
        """Return A restricted to these unknowns, dense, on rank 0; empty elsewhere (collective)."""
        rows = (self.own + A.getOwnershipRange()[0]).astype(PETSc.IntType)
        index = PETSc.IS().createGeneral(rows, comm=A.comm)
        indptr, columns, values = csr_of(A.createSubMatrix(index, index))
        size = self.own.size, sum(self.counts)
        parts = self.comm.gather(csr_array((values, columns, indptr), shape=size))
        return np.vstack([part.toarray() for part in parts]) if parts else np.zeros((0, 0))


def on_root(comm: MPI.Comm, function: Callable[[], T]) -> T | None:
    """Call a function on rank 0 and return its value there; raise its error on all; collective."""
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
