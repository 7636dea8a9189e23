# SPDX-License-Identifier: MIT
"""Small dense bound-constrained QPs, for a model replicated on every rank."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import lsq_linear

from dolfinx_mortar.arrays import Floats

MAX_UPDATES = 40


def solve_dense(
    M: Floats, b: Floats, lower: Floats, upper: Floats, active: Floats
) -> tuple[Floats, Floats]:
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
    >>> d, active = solve_dense(M, b, np.full(2, -9.0), np.array([0.25, 9.0]), np.zeros(2))
    >>> d.tolist(), active.tolist()
    ([0.25, 0.5], [1.0, 0.0])
    """
    seen: set[bytes] = set()
    while len(seen) < MAX_UPDATES and active.tobytes() not in seen:
        seen.add(active.tobytes())
        d, z = _with_active(M, b, np.where(active > 0, upper, lower), active)
        c = np.diag(M)
        new = np.where(z + c * (d - upper) > 0, 1.0, np.where(z + c * (d - lower) < 0, -1.0, 0.0))
        if np.array_equal(new, active):
            return d, active
        active = new
    L = cholesky(M, lower=True)
    pinned = lower >= upper  # lsq_linear wants an interior
    upper_open = np.where(pinned, upper + np.abs(upper) * 1e-15 + 1e-300, upper)
    rhs = solve_triangular(L, b, lower=True)
    d = lsq_linear(L.T, rhs, (lower, upper_open), method="bvls", tol=1e-14).x
    d = np.clip(d, lower, upper)
    z = b - M @ d
    return d, np.where((d >= upper) & (z > 0), 1.0, np.where((d <= lower) & (z < 0), -1.0, 0.0))


def _with_active(M: Floats, b: Floats, bound: Floats, active: Floats) -> tuple[Floats, Floats]:
    """Return d with its active entries at the bound, and z = b - M d, exactly 0 at free ones."""
    free = active == 0
    d = np.where(free, 0.0, bound)
    if free.any():
        d[free] = cho_solve(cho_factor(M[np.ix_(free, free)]), (b - M @ d)[free])
    z = b - M @ d
    z[free] = 0.0
    return d, z
