# SPDX-License-Identifier: MIT
"""Scalar unknowns of a QP: the motions q (m,) of rigid tools under given forces F.

See theory.md, Tools and sides that forces drive: w_j = x_j - e_j.q, z = b - C q - A x, and F - R x
- Q q + e.z = 0. Where q is undetermined in a state, a proximal term rho (q - q_0) is added.
"""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.congruence import ContextOf
from dolfinx_mortar.algebra.parallel import norm
from dolfinx_mortar.common.arrays import (
    HALF_OF_DIGITS,
    LIMIT,
    QUARTER_OF_DIGITS,
    ROUND_OFF,
    TINY,
    Floats,
    Ints,
)
from dolfinx_mortar.qp.bound_qp import BoundQP, Scalars, Sliding
from dolfinx_mortar.qp.held import Solver


class NoResistance(RuntimeError):
    """Nothing resists the load of a scalar.

    Attributes:
        which: (m,) share of the load that is not resisted.
    """

    def __init__(self, which: Floats) -> None:
        super().__init__(which)  # ranks pickle it
        self.which = which

    def __str__(self) -> str:
        return f"nothing resists the load of a scalar unknown, by shares: {self.which}"


def moved(qp: BoundQP, q: Floats) -> BoundQP:
    """The QP of x for given scalars q (m,)."""
    scalars = qp.scalars
    assert scalars is not None
    way, upper, b, law = q @ scalars.motions, qp.upper.copy(), qp.b.copy(), qp.friction
    lower = qp.lower.copy()
    for bound, none in ((upper, PETSc.INFINITY), (lower, PETSc.NINFINITY)):
        some = qp.bounded[bound.array_r[qp.bounded] != none]
        bound.array[some] += way[some]
    taken = q @ scalars.columns
    b.array[:] -= taken
    if law is not None:
        law = replace(law, rest=law.rest + law.pick(way))
    bounds = {"b": b, "lower": lower, "upper": upper, "taken": norm(qp.comm, taken)}
    return replace(qp, friction=law, scalars=None, **bounds)


class Bordered:
    """A QP with scalars as a QP in (w, q), with rows A x + C q and R x + Q q + e.(A x + C q).

    The last rank has q after its part of w. Linear systems are solved for x at given q and for
    dx/dq; then m equations give q.

    Attributes:
        qp: in (w, q).
        share: of the proximal term in the stiffness of nodes.
        rho: (m,) of the term, zero where a state resists.
        centre: (m,) its q_0.
        least: (m,) forces that count as zero in the last solve.
    """

    def __init__(self, inner: BoundQP, linear: Solver) -> None:
        self.inner, self.linear = inner, linear
        self.rho, self.centre = np.zeros((2, len(self.scalars.loads)))
        self.least = self.scalars.noise
        self.share = QUARTER_OF_DIGITS
        self.weights = self.scalars.sizes(inner)
        if not self.weights.all():
            raise NoResistance((self.weights == 0.0).astype(np.float64))
        self._X = np.zeros_like(self.scalars.motions)
        self._stiffness: Floats | None = None  # of the last state
        self._last: tuple[Ints, Sliding | None] = np.zeros(0, np.int32), None
        size = inner.b.getLocalSize() + self.last
        A = PETSc.Mat().createPython([(size, None)] * 2, ContextOf(self), inner.b.comm)
        b, lower, upper = A.createVecRight(), A.createVecRight(), A.createVecRight()
        none = np.full_like(self.rho, PETSc.INFINITY)
        b.array[:] = self.join(inner.b.array_r, self._loads())
        lower.array[:] = self.join(inner.lower.array_r, -none)
        upper.array[:] = self.join(inner.upper.array_r, none)
        bounds = lower, upper, inner.bounded, inner.friction
        own = BoundQP(A, b, *bounds, definite=inner.definite, extent=inner.extent)
        self.qp = replace(own, give=inner.give)

    @property
    def scalars(self) -> Scalars:
        """The data of q."""
        assert self.inner.scalars is not None
        return self.inner.scalars

    @property
    def comm(self) -> MPI.Comm:
        """Communicator of the QP."""
        return self.inner.comm

    @property
    def last(self) -> int:
        """Number of scalars on this rank."""
        return len(self.scalars.loads) if self.comm.rank == self.comm.size - 1 else 0

    def join(self, w: Floats, q: Floats) -> Floats:
        """This rank's part of (w, q)."""
        return np.concatenate([w, q[: self.last]])

    def at(self, values: Floats) -> tuple[Floats, Floats]:
        """Return x (n,) and q (m,) of (w, q); collective."""
        n = len(values) - self.last
        q = self.comm.bcast(values[n:], root=self.comm.size - 1)
        return values[:n] + q @ self.scalars.motions, q

    def _sum(self, values: Floats) -> Floats:
        return self.comm.allreduce(values)

    def _loads(self) -> Floats:
        own = self.scalars.motions @ self.inner.b.array_r
        return self.scalars.loads + self._sum(own) + self.rho * self.centre

    # -- the matrix, called by PETSc -------------------------------------------------------------

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y."""
        at, q = self.at(x.array_r)
        given, product = self.inner.b.duplicate(), self.inner.b.duplicate()
        given.array[:] = at
        self.inner.A.mult(given, product)
        top = product.array_r + q @ self.scalars.columns
        below = self._sum(self.scalars.rows @ at + self.scalars.motions @ top)
        y.array[:] = self.join(top, below + self.scalars.block @ q + self.rho * q)

    def getDiagonal(self, mat: PETSc.Mat, y: PETSc.Vec) -> None:
        """Set y, with the weights of the scalars."""
        y.array[:] = self.join(self.inner.diagonal.array_r, self.weights)

    # -- the solver, see `held.Solver` -----------------------------------------------------------

    exact = False

    def round_off(self, x: PETSc.Vec) -> float:
        """See `held.Solver`."""
        at = self.inner.b.duplicate()
        at.array[:] = self.at(x.array_r)[0]
        return self.linear.round_off(at)

    def solve(
        self,
        b: PETSc.Vec,
        x: PETSc.Vec,
        held: Ints,
        *,
        atol: float,
        sliding: Sliding | None = None,
        **others: object,
    ) -> PETSc.Vec:
        """See `held.Solver`; collective."""
        at, q = self.at(x.array_r)
        y, right, E = self.inner.b.duplicate(), self.inner.b.duplicate(), self.scalars.motions
        y.array[:] = at
        before, missing, self._last, self._stiffness = np.inf, 0.0 * q, (held, sliding), None
        for _ in range(LIMIT):
            y.array[held] = x.array_r[held] + (q @ E)[held]
            right.array[:] = self.inner.b.array_r - q @ self.scalars.columns
            law = None if sliding is None else _shifted(sliding, q @ E, 1.0)
            found = self.linear.solve(right, y, held, atol=atol, sliding=law).array_r.copy()
            missing, size = self._missing(y.array_r, found, q)
            self.least = np.maximum.reduce([self.scalars.noise, ROUND_OFF * size, 0.0 * q + atol])
            worst = float((np.abs(missing) / np.maximum(self.least, TINY)).max())
            if worst <= 1.0 or not worst < before:
                break
            before = worst
            step = self._step(q, missing)
            y.array[:] += step @ self._X
            q = q + step
        x.array[:] = self.join(y.array_r - q @ E, q)
        result = x.duplicate()
        result.array[:] = self.join(found, missing)
        return result

    def _missing(self, x: Floats, z: Floats, q: Floats) -> tuple[Floats, Floats]:
        """F - R x - Q q + e.z (m,), and the sizes of its forces; collective."""
        parts = self.scalars.motions * z - self.scalars.rows * x
        total, size = self._sum(np.stack([parts.sum(axis=1), np.abs(parts).sum(axis=1)]))
        size = np.maximum(size, np.abs(self.scalars.loads))
        spring = self.rho * (self.centre - q)
        return self.scalars.loads + total - self.scalars.block @ q + spring, size

    def resistance(self) -> Floats:
        """Stiffness of the last state against q (m, m), -d(F - R x - Q q + e.z)/dq; collective."""
        if self._stiffness is None:
            Z, E, R = np.zeros_like(self._X), self.scalars.motions, self.scalars.rows
            for a in range(len(Z)):
                self._X[a], Z[a] = self._column(a, *self._last)
            self._stiffness = self._sum(R @ self._X.T - E @ Z.T) + self.scalars.block
        return self._stiffness

    def _column(self, a: int, held: Ints, sliding: Sliding | None) -> tuple[Floats, Floats]:
        """Return dx/dq_a (n,) and dz/dq_a (n,); collective."""
        right, y = self.inner.b.duplicate(), self.inner.b.duplicate()
        right.array[:] = -self.scalars.columns[a]
        y.array[held] = self.scalars.motions[a][held]
        law = None if sliding is None else _shifted(sliding, self.scalars.motions[a], 0.0)
        z = right.copy()
        self.inner.A.mult(y, z)
        z.aypx(-1.0, right)
        z = self.linear.solve(right, y, held, atol=HALF_OF_DIGITS * z.norm(), sliding=law)
        return y.array_r.copy(), z.array_r.copy()

    def _step(self, q: Floats, missing: Floats) -> Floats:
        if not self.rho.any() and self.proximal().any():
            self.hold(q)
        scale = 1.0 / np.sqrt(self.weights)
        relative = (self.resistance() + np.diag(self.rho)) * np.outer(scale, scale)
        return scale * np.linalg.solve(relative, scale * missing)

    def proximal(self) -> Floats:
        """Coefficients rho (m,) of the last state, zero where it resists; collective."""
        if self.rho.any():
            return self.rho
        scale = 1.0 / np.sqrt(self.weights)
        relative = self.resistance() * np.outer(scale, scale)
        singular = np.linalg.svd(relative, compute_uv=False).min() <= HALF_OF_DIGITS
        return self.share * singular * self.weights

    def hold(self, q: Floats | None) -> None:
        """Set the proximal term about q, or none."""
        self.rho = 0.0 * self.rho if q is None else self.proximal()
        self.centre = 0.0 * self.rho if q is None else q.copy()
        self.qp.b.array[self.inner.b.getLocalSize() :] = self._loads()[: self.last]


def _shifted(sliding: Sliding, way: Floats, given: float) -> Sliding:
    """Law of slips from points that move along a direction (n,), or of their rates."""
    law = sliding.law
    rest = given * law.rest + law.pick(way)
    return replace(sliding, law=replace(law, rest=rest, cohesion=given * law.cohesion))
