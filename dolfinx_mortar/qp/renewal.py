# SPDX-License-Identifier: MIT
"""When an old factorisation or set-up is renewed: as soon as that is cheaper than to go on with it.

The decisions depend on residuals only, never on clocks, and so are the same on all ranks.
"""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

# A numeric factorisation in 2D costs as much as 5 to 7 solves with it (measured at 5k, 50k and
# 200k unknowns, MUMPS): beyond that many iterations a new one is cheaper than an old one.
REFACTOR_AFTER = 6
# A set-up of multigrid in 3D costs as much as 25 to 40 iterations with it (GAMG, 30k to 120k
# unknowns). Renewed when an old one has cost as many more than a new one would have, so that no
# more than twice the least is lost. With half, the same time is taken up to 43k unknowns, elastic
# and plastic, but one elastic step with 148k has a second set-up for its last ten iterations.
SETUP_AFTER = 40


class Renewal:
    """The policy, and what it has seen of the operator at hand.

    Attributes:
        after: iterations that cost as much as a new factorisation or set-up.
        direct: whether it is a factorisation; then one solve decides, otherwise their sum.
    """

    def __init__(self, after: int, *, direct: bool) -> None:
        """Begin with an operator of which nothing is known."""
        self.after, self.direct = after, direct
        self.fresh_rate = 0.0  # log of the reduction per iteration when it was new
        self.excess = 0.0  # iterations above those of a new one, since it was new

    def is_slow(self, norms: Sequence[float], wanted: float) -> bool:
        """Tell whether the residuals promise that a new factorisation is cheaper.

        The rate is believed after half as many iterations as a new one costs, so that not much is
        lost if it has been slow from the start.
        """
        its = len(norms) - 1
        if 2 * its < self.after or norms[-1] <= wanted:
            return False
        rate = np.log(norms[-1] / norms[0]) / its
        return bool(rate >= 0.0 or np.log(wanted / norms[-1]) / rate > self.after)

    def is_far(self, different: int) -> bool:
        """Tell whether to renew without a try, for a mask that differs by so many unknowns.

        One more or less in the mask is a change of rank one, and costs up to one iteration.
        """
        return (different if self.direct else self.excess) > self.after

    def learn(self, norms: Sequence[float], *, stale: bool) -> None:
        """Take note of how a solve went, with a new or an old operator."""
        its, reached = len(norms) - 1, _log_reduction(norms)
        if not stale:
            self.fresh_rate, self.excess = reached / max(its, 1), 0.0
        elif self.fresh_rate < 0.0:
            self.excess += its - reached / self.fresh_rate


class SlownessTest:
    """A convergence test of PETSc: at the tolerance, or when an old operator is too slow."""

    def __init__(self, renewal: Renewal, reduction: float, limit: int, *, stale: bool) -> None:
        """Expect a reduction of the residual within a number of iterations."""
        self.renewal, self.reduction, self.limit, self.stale = renewal, reduction, limit, stale
        self.norms: list[float] = []

    def __call__(self, ksp: PETSc.KSP, its: int, norm: float) -> int:
        """Return PETSc's reason to stop, or that there is none."""
        Reason = PETSc.KSP.ConvergedReason
        self.norms.append(norm)
        if not np.isfinite(norm):
            return int(Reason.DIVERGED_NANORINF)
        wanted = self.reduction * self.norms[0]
        if norm <= wanted:
            return int(Reason.CONVERGED_RTOL)
        if its >= self.limit:
            return int(Reason.DIVERGED_MAX_IT)
        if self.stale and self.renewal.direct and self.renewal.is_slow(self.norms, wanted):
            return int(Reason.CONVERGED_ITS)
        return int(Reason.CONVERGED_ITERATING)


def _log_reduction(norms: Sequence[float]) -> float:
    if len(norms) < 2 or not norms[0] > 0.0:
        return 0.0
    return float(np.log(max(norms[-1] / norms[0], np.finfo(float).tiny)))
