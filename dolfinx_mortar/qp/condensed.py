# SPDX-License-Identifier: MIT
"""A guess of the active set: the QP condensed to its bounded unknowns, on a dense model.

Factorise A once with all bounded unknowns B held. Then x_I follows from x_B by one solve, and what
is left is a QP for x_B with the Schur complement S = A_BB - A_BI A_II^-1 A_IB. Applying S costs one
solve; forming it would cost one per bounded unknown. So a dense model of S is kept on rank 0 (few
unknowns have bounds), the model's QP is solved to the end, and the solve that checks the result
gives one exact pair (v, S v) that improves the model (block BFGS). The first model is the square
root of a graph Laplacian, because S is a half-order operator like the Dirichlet-to-Neumann map.

The guess depends on the QP alone. Nothing here is singular as long as the bounds, all active, hold
the bodies.

Solves + factorisations (each costs as much as 5 to 7 solves) of one step of
benchmarks/hertz_2d.py, slave block, and its processor time without the guess over that with it:

                                          with       without     time
    elastic, frozen,   5 thousand         5 + 2       3 + 1      0.82
    elastic, frozen,  50 thousand         6 + 2      11 + 3      1.24
    elastic, updated, 50 thousand        18 + 3      35 + 3      1.23
    plastic, frozen,  50 thousand        40 + 6     106 + 9      1.52
    plastic, updated, 50 thousand        41 + 6      88 + 9      1.5
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh

from dolfinx_mortar.arrays import Actives, Floats, Ints, Longs
from dolfinx_mortar.qp.bound_qp import EPS, ROUND_OFF, Bounded, BoundQP
from dolfinx_mortar.qp.held import SHARE
from dolfinx_mortar.qp.linear import LinearSolveFailed, LinearSolver
from dolfinx_mortar.qp.updates import LIMIT, Found, update

T = TypeVar("T")


def is_worthwhile(qp: BoundQP, linear: LinearSolver) -> bool:
    """Tell whether a factorisation is at hand, S is definite and the model smaller than A.

    Measured on strips of 6 to 120 thousand unknowns with 61 to 1001 bounded ones, in processor time
    with and without: 0.55 to 0.83 where the model has fewer entries than A, 0.92 with 1.15 times as
    many, 1.08 with 1.7 times as many.
    """
    size = qp.comm.allreduce(qp.bounded.size)
    entries = qp.A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] if linear.direct else 0
    return bool(qp.definite and 0 < size**2 <= entries)


def predict(
    qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, start: Actives, *, rtol: float
) -> Actives:
    """Solve the QP through its Schur complement on the bounded unknowns (collective).

    Args:
        qp: the problem.
        linear: factorises A with all bounded unknowns held, unless it has done so.
        x: (n,) out: the solution.
        start: (k,) guess of the active set.
        rtol: residual of the free bounded unknowns relative to the forces.

    Returns:
        The active set (k,), which the caller has to check. Once it stays, and the residual falls so
        slowly that a factorisation with it held costs less than the solves to come, it is returned
        as it is; so is the last one where round-off makes the model indefinite.

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
    block, b_norm = everywhere.block(qp.A), qp.b.norm()
    norms: list[float] = []
    try:
        model = on_root(qp.comm, lambda: SchurModel(half_laplacian(block)))
        for _ in range(LIMIT):
            before = active
            d, active = _solve_model(qp.comm, model, (rho, lower - w, upper - w, active))
            force = max(float(np.linalg.norm(rho)), b_norm)
            tolerance = max(SHARE**2 * rtol * force, linear.attached.operator.round_off(x))
            if not np.array_equal(active, before):
                norms.clear()  # residuals of different sets have no rate
            reached, held = w + d, active != 0
            norms.append(float(np.linalg.norm(rho[~held])))
            stays = np.array_equal(reached[held], w[held])
            slow = linear.attached.renewal.is_slow(norms, tolerance)
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
        self.linear.apply(self.linear.attached.operator.residual(self.qp.b, x, own), self.dx)
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


# -- the dense model, on rank 0 ----------------------------------------------------------------


class SchurModel:
    """A symmetric positive definite model of the Schur complement on the bounded unknowns.

    Attributes:
        base: (k, k) before any pair is known.
        V: (k, j) directions, conjugate: V' W = 1.
        W: (k, j) S V.
    """

    def __init__(self, base: Floats) -> None:
        """Begin without pairs."""
        self.base = base
        self.V, self.W = np.zeros((2, base.shape[0], 0))

    def matrix(self) -> Floats:
        """Return base - base V (V' base V)^-1 V' base + W W', which maps V to W.

        Raises:
            LinAlgError: if round-off has made the base indefinite.
        """
        if self.V.shape[1] == 0:
            return self.base
        C = self.base @ self.V
        M = self.base - C @ cho_solve(cho_factor(self.V.T @ C), C.T) + self.W @ self.W.T
        return np.asarray(0.5 * (M + M.T))

    def learn(self, v: Floats, w: Floats) -> None:
        """Add the pair w = S v, made conjugate to the pairs at hand."""
        whole = v @ w
        for _ in range(2):  # twice is enough
            c = self.W.T @ v
            v, w = v - self.V @ c, w - self.W @ c
        energy = v @ w
        least = max(float(whole), float(np.linalg.norm(v) * np.linalg.norm(w)))
        if not energy > np.sqrt(EPS) * least:
            return  # half of the digits are gone: what is left of the pair is mostly its errors
        if self.V.shape[1] == 0:  # the first pair knows the scale
            self.base = self.base * (energy / (v @ self.base @ v))
        scale = 1.0 / np.sqrt(energy)
        self.V = np.column_stack([self.V, scale * v])
        self.W = np.column_stack([self.W, scale * w])


def half_laplacian(block: Floats) -> Floats:
    """Return diag^(1/2) sqrt(L) diag^(1/2), with L the Laplacian of the graph of A_BB.

    For linear elements on a curve this is the energy of the Dirichlet-to-Neumann map up to a
    factor, whatever the mesh sizes; diag(A) brings in the stiffness. All edges weigh the same: the
    entries of A_BB reflect the angles of the elements, which S hardly feels (measured on a graded
    mesh: condition number of M^-1 S 6 without weights, 17 with |a_ij| as weights).
    """
    diagonal = np.sqrt(np.diag(block))
    edges = (np.abs(block) > ROUND_OFF * EPS * np.outer(diagonal, diagonal)).astype(np.float64)
    np.fill_diagonal(edges, 0.0)
    values, vectors = eigh(np.diag(edges.sum(axis=1)) - edges)
    # the size of the body bounds the softest mode: one wavelength over all bounded unknowns
    shift = max(values.max(initial=0.0), 1.0) / max(1, values.size) ** 2
    root = (vectors * np.sqrt(np.maximum(values, 0.0) + shift)) @ vectors.T
    return np.asarray(root * np.outer(diagonal, diagonal))


def solve_dense(
    M: Floats, b: Floats, lower: Floats, upper: Floats, active: Actives
) -> tuple[Floats, Actives]:
    """Minimise 1/2 d'Md - b'd over lower <= d <= upper by primal-dual active-set updates.

    Args:
        M: (k, k) symmetric positive definite.
        b: (k,) force.
        lower: (k,) lower bounds, -inf where there is none.
        upper: (k,) upper bounds, inf where there is none.
        active: (k,) guess: +1 at upper, -1 at lower, 0 free.

    Returns:
        d (k,) and its active set (k,); of the last set where the updates cycle.

    Raises:
        LinAlgError: if M is not positive definite.

    >>> M, b = np.array([[2.0, 0.0], [0.0, 4.0]]), np.array([2.0, 2.0])
    >>> upper, none = np.array([0.25, 9.0]), np.zeros(2, dtype=np.int8)
    >>> d, active = solve_dense(M, b, np.full(2, -9.0), upper, none)
    >>> d.tolist(), active.tolist()
    ([0.25, 0.5], [1, 0])
    """

    def hold(active: Actives, level: int) -> Found[Actives]:
        d, z = _with_active(M, b, np.where(active > 0, upper, lower), active)
        found = Bounded(d, z, lower, upper, np.diag(M))
        new = found.predicted()
        noise = ROUND_OFF * EPS * float(np.linalg.norm(np.diag(M) * d))
        return Found(new, int(found.strong(active, new, noise).sum()), satisfied=True)

    last = update(hold, active, MPI.COMM_SELF).state
    return _with_active(M, b, np.where(last > 0, upper, lower), last)[0], last


def _with_active(M: Floats, b: Floats, bound: Floats, active: Actives) -> tuple[Floats, Floats]:
    """Return d with its active entries at the bound, and z = b - M d, exactly 0 at free ones."""
    free = active == 0
    d = np.where(free, 0.0, bound)
    if free.any():
        d[free] = cho_solve(cho_factor(M[np.ix_(free, free)]), (b - M @ d)[free])
    z = b - M @ d
    z[free] = 0.0
    return d, z


def _solve_model(
    comm: MPI.Comm, model: SchurModel | None, problem: tuple[Floats, Floats, Floats, Actives]
) -> tuple[Floats, Actives]:
    """Solve the model's QP on rank 0 and send the answer, so that it is bitwise the same."""

    def solve() -> tuple[Floats, Actives]:
        assert model is not None
        return solve_dense(model.matrix(), *problem)

    answer: tuple[Floats, Actives] = comm.bcast(on_root(comm, solve))
    return answer


# -- ranks -------------------------------------------------------------------------------------


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
