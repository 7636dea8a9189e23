# SPDX-License-Identifier: MIT
"""Small dense bound-constrained QPs, for a model of the large one."""

from mpi4py import MPI

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import lsq_linear

from dolfinx_mortar.arrays import Actives, Floats
from dolfinx_mortar.qp.bounded import Bounded
from dolfinx_mortar.qp.tolerances import EPS, ROUND_OFF
from dolfinx_mortar.qp.updates import Found, update


def solve_dense(
    M: Floats, b: Floats, lower: Floats, upper: Floats, active: Actives
) -> tuple[Floats, Actives]:
    """Minimise 1/2 d'Md - b'd over lower <= d <= upper.

    Primal-dual active set updates; should they cycle, a bounded least-squares solver that cannot.

    Args:
        M: (k, k) symmetric positive definite.
        b: (k,) force.
        lower: (k,) lower bounds, -inf where there is none.
        upper: (k,) upper bounds, inf where there is none.
        active: (k,) guess: +1 at upper, -1 at lower, 0 free.

    Returns:
        d (k,) and its active set (k,).

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

    outcome = update(hold, active, MPI.COMM_SELF)
    if outcome.reason:
        return _least_squares(M, b, lower, upper)
    d, _ = _with_active(M, b, np.where(outcome.state > 0, upper, lower), outcome.state)
    return d, outcome.state


def _least_squares(M: Floats, b: Floats, lower: Floats, upper: Floats) -> tuple[Floats, Actives]:
    """Minimise |L'd - L^-1 b|^2 within the bounds, M = L L'."""
    L = cholesky(M, lower=True)
    above = np.where(lower >= upper, np.nextafter(upper, np.inf), upper)  # it wants an interior
    rhs = solve_triangular(L, b, lower=True)
    d = lsq_linear(L.T, rhs, (lower, above), method="bvls", tol=EPS).x
    d = np.clip(d, lower, upper)
    z = b - M @ d
    active = np.where((d >= upper) & (z > 0), 1, np.where((d <= lower) & (z < 0), -1, 0))
    return d, active.astype(np.int8)


def _with_active(M: Floats, b: Floats, bound: Floats, active: Actives) -> tuple[Floats, Floats]:
    """Return d with its active entries at the bound, and z = b - M d, exactly 0 at free ones."""
    free = active == 0
    d = np.where(free, 0.0, bound)
    if free.any():
        d[free] = cho_solve(cho_factor(M[np.ix_(free, free)]), (b - M @ d)[free])
    z = b - M @ d
    z[free] = 0.0
    return d, z
