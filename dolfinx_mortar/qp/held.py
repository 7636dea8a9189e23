# SPDX-License-Identifier: MIT
"""The large problem with a set held at its bounds: a linear system, solved as well as needed."""

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import norm
from dolfinx_mortar.arrays import Actives, Ints
from dolfinx_mortar.qp.bound_qp import BoundQP, QPSolution, check, on_bounded, reaction
from dolfinx_mortar.qp.linear import LinearSolver
from dolfinx_mortar.qp.tolerances import EPS, LIMIT, ROUND_OFF, SHARE
from dolfinx_mortar.qp.updates import TIGHT, Found, Outcome


class HeldProblem:
    """The QP with a set held, for `updates.update`.

    Level l asks for the accuracy rtol^(2^(l - 2)): the fourth root, the square root, rtol itself,
    and its square where the check still says that a small step lies under large forces. Loose
    accuracies are shares of the reactions at the bounds, which is all that the next set is read
    from; rtol is one of all forces.

    Args:
        qp: the problem.
        linear: linear solver, attached to qp.A.
        x: (n,) in: a guess; out: the last solution.
        rtol: tolerance of the check.
    """

    def __init__(self, qp: BoundQP, linear: LinearSolver, x: PETSc.Vec, rtol: float) -> None:
        """Measure the forces of the guess."""
        self.qp, self.linear, self.x, self.rtol = qp, linear, x, rtol
        self.lower, self.upper = qp.bounds()
        self.z = reaction(qp, x)
        self.b_norm = qp.b.norm()
        self.reactions: float | None = None  # at the bounds; unknown before the first solve

    def hold(self, active: Actives, level: int) -> Found:
        """Solve with a set held; x and z are the solution (collective).

        Raises:
            LinearSolveFailed: if the set leaves a body free.
        """
        held = active != 0
        bounded = self.qp.bounded[held]
        self.x.array[bounded] = np.where(active > 0, self.upper, self.lower)[held]
        atol = self._solve(np.sort(bounded), level)
        found = on_bounded(self.qp, self.x, self.z)
        new = found.predicted()
        strong = found.strong(active, new, max(atol, self.linear.round_off(self.x)))
        changes = int(self.qp.comm.allreduce(int(strong.sum())))
        satisfied = changes == 0 and level >= TIGHT and self._is_accurate(level)
        return Found(new, changes, satisfied)

    def solution(self, outcome: Outcome, name: str) -> QPSolution:
        """Return the last solution."""
        kkt = check(self.qp, self.x, self.z)
        return QPSolution(self.x, self.z, outcome.active, kkt, outcome.updates, 0, 0, name)

    def _accuracy(self, level: int) -> float:
        return float(max(self.rtol ** (2.0 ** (level - TIGHT)), ROUND_OFF * EPS))

    def _is_accurate(self, level: int) -> bool:
        """Tell whether the check agrees, or cannot be satisfied any better."""
        finest = self._accuracy(level) <= ROUND_OFF * EPS
        return finest or check(self.qp, self.x, self.z).satisfied(self.rtol)

    def _solve(self, held: Ints, level: int) -> float:
        """Solve until the accuracy holds with the reactions that come out; return the tolerance."""
        if self.reactions is None:
            self.reactions = max(self.z.norm(), reaction(self.qp, self.x).norm())
        atol = self._tolerance(level)
        for _ in range(LIMIT):
            self.linear.solve(self.qp.b, self.x, held, atol=SHARE * atol)
            self.z = reaction(self.qp, self.x)
            zb = self.z.array_r[held]
            self.reactions = norm(self.qp.comm, zb)
            reached, atol = atol, self._tolerance(level)
            if SHARE * reached <= atol:
                break
        return reached

    def _tolerance(self, level: int) -> float:
        """Return the largest residual at a level."""
        assert self.reactions is not None
        force = max(self.b_norm, self.reactions)
        if level >= TIGHT:
            return self._accuracy(level) * force
        return max(self.rtol * force, self._accuracy(level) * self.reactions)
