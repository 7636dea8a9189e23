# SPDX-License-Identifier: MIT
"""Interior point: PETSc TAO's bqpip for the scaled QP, in the place of the paper's quadprog."""

from dataclasses import replace

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import from_callbacks
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, LIMIT, QUARTER_OF_DIGITS
from dolfinx_mortar.qp import active_set
from dolfinx_mortar.qp.bound_qp import BoundQP, QPSolution, check, on_bounded, reaction
from dolfinx_mortar.qp.held import SHARE, State
from dolfinx_mortar.qp.linear import LinearSolver


@from_callbacks()
def solve(qp: BoundQP, linear: LinearSolver, *, rtol: float) -> QPSolution:
    """Solve a bound-constrained QP, then once more with the active set found (collective).

    A is symmetric and positive definite, without friction; TAO's linear solver has the options of
    `linear`.
    """
    scaled = _Scaled(qp, linear)
    try:
        x, iterations, reason = _iterate(qp, linear, scaled, 1.0 / HALF_OF_DIGITS, rtol)
    finally:
        scaled.A.destroy()
    start = State.create(qp, on_bounded(qp, x, reaction(qp, x)).predicted())
    polished = active_set.solve(qp, linear, start=start, rtol=rtol, guess=x)
    note = f"TAO bqpip did not reach the tolerance itself, reason {reason}"
    return replace(
        polished,
        backend="interior-point",
        updates=polished.updates + iterations,
        factorisations=iterations,
        note="" if reason == PETSc.TAO.Reason.CONVERGED_USER else note,
    )


def _iterate(
    qp: BoundQP, linear: LinearSolver, scaled: "_Scaled", box: float, rtol: float
) -> tuple[PETSc.Vec, int, int]:
    """Run TAO within |y| <= box; return x, the iterations and TAO's reason to stop."""
    prefix = f"{linear.options.prefix}tao_"
    exact = replace(qp, extent=0.0)  # forces below the noise of bounds decide nothing
    tao = PETSc.TAO().create(qp.A.comm)
    tao.setOptionsPrefix(prefix)
    tao.setType(PETSc.TAO.Type.BQPIP)

    def objective(_: PETSc.TAO, y: PETSc.Vec, gradient: PETSc.Vec) -> float:
        scaled.A.mult(y, gradient)
        gradient.axpy(-1.0, scaled.b)
        return float(0.5 * (y.dot(gradient) - y.dot(scaled.b)))

    def stop(tao: PETSc.TAO) -> None:
        if check(exact, scaled.unscale(tao.getSolution())).satisfied(SHARE * rtol):
            tao.setConvergedReason(PETSc.TAO.Reason.CONVERGED_USER)

    y, gradient = scaled.start.copy(), scaled.b.duplicate()
    tao.setObjectiveGradient(objective, gradient)
    tao.setHessian(lambda *_: None, scaled.A)
    tao.setVariableBounds(scaled.bounds(box))
    tao.setTolerances(gatol=0.0, grtol=0.0, gttol=0.0)  # only our check stops it
    tao.setMaximumIterations(LIMIT)
    tao.setMonitor(stop)
    try:
        with linear.options.database(prefix):
            tao.setFromOptions()
            tao.solve(y)
        return scaled.unscale(y), tao.getIterationNumber(), int(tao.getConvergedReason())
    finally:
        tao.destroy()


class _Scaled:
    """The QP in y = x / (s l), s = diag(A)^(-1/2), with y of size 1: TAO has absolute constants.

    Bounds are finite, as TAO averages the complementarity.
    """

    def __init__(self, qp: BoundQP, linear: LinearSolver) -> None:
        self.qp = qp
        self.s = qp.A.getDiagonal()
        self.s.sqrtabs()
        self.s.reciprocal()
        lower, upper = qp.bounds
        x = qp.b.duplicate()
        x.set(0.0)
        x.array[qp.bounded] = np.clip(0.0, lower, upper)
        force = max(qp.b.norm(), reaction(qp, x).norm())
        linear.solve(qp.b, x, np.sort(qp.bounded), atol=QUARTER_OF_DIGITS * force)
        x.pointwiseDivide(x, self.s)
        self.length = x.norm(PETSc.NormType.INFINITY) or 1.0
        x.scale(1.0 / self.length)
        self.start = x
        self.A = qp.A.copy()
        self.A.diagonalScale(self.s, self.s)
        self.A.setOption(PETSc.Mat.Option.SPD, True)
        self.b = qp.b.duplicate()
        self.b.pointwiseMult(qp.b, self.s)
        self.b.scale(1.0 / self.length)

    def bounds(self, box: float) -> tuple[PETSc.Vec, PETSc.Vec]:
        own = self.qp.bounded
        sides = self.b.duplicate(), self.b.duplicate()
        for side, values, far in zip(sides, self.qp.bounds, (-box, box), strict=True):
            side.set(far)
            scaled = values / (self.s.array_r[own] * self.length)
            side.array[own] = np.where(np.isfinite(scaled), scaled, far)
        return sides

    def unscale(self, y: PETSc.Vec) -> PETSc.Vec:
        x = y.duplicate()
        x.pointwiseMult(y, self.s)
        x.scale(self.length)
        return x
