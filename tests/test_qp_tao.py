# SPDX-License-Identifier: MIT
"""What TAO is given, and what is left of it."""

from mpi4py import MPI

import numpy as np
import pytest
from programs import from_arrays, gathered

from dolfinx_mortar.qp import QPSolution, check, solve, tao

COMM = MPI.COMM_WORLD
INF = np.inf


@pytest.mark.parametrize("backend", ["interior-point", "tron"])
def test_far_bounds_are_moved_where_they_are_reached(
    monkeypatch: pytest.MonkeyPatch, backend: str
) -> None:
    """Held at its bound, the first unknown keeps the second in place; free, both go far."""
    monkeypatch.setattr(
        tao,
        "_polish",
        lambda qp, linear, x, rtol: QPSolution(
            x, x, np.zeros(qp.bounded.size, dtype=np.int8), check(qp, x), 0, 0, 0, ""
        ),
    )
    soft = 1e-5
    A = np.array([[1.0 + soft, -1.0], [-1.0, 1.0 + soft]])
    b = np.array([-1.0, 0.0])
    qp = from_arrays(A, b, np.full(2, -INF), np.array([0.0, INF]), COMM)
    found = gathered(solve(qp, backend, rtol=1e-6).x)
    np.testing.assert_allclose(found, np.linalg.solve(A, b), rtol=1e-4)
