# SPDX-License-Identifier: MIT
"""The QP that TAO receives, and the release of its objects."""

from mpi4py import MPI

import numpy as np
from programs import from_arrays, gathered

from dolfinx_mortar.qp import (
    QPSolution,
    active_set,
    check,
    interior_point,
    solve,
)

COMM = MPI.COMM_WORLD
INF = np.inf


def recorded(monkeypatch, module, name):
    """Return a list that fills with the objects of a class."""
    found = []

    def __init__(self, *args, **options):
        found.append(self)
        cls.__init__(self, *args, **options)

    cls = getattr(module, name)
    monkeypatch.setattr(module, name, type(name, (cls,), {"__init__": __init__}))
    return found


def test_distant_bounds_are_not_reached(
    monkeypatch,
):
    """Held at its bound, the first unknown keeps the second in place; free, both go far."""

    def as_found(qp, *_, guess, **options):
        none = np.zeros(qp.bounded.size, dtype=np.int8)
        return QPSolution(guess, guess, none, check(qp, guess), 0, 0, 0, "")

    monkeypatch.setattr(active_set, "solve", as_found)
    scaled = recorded(monkeypatch, interior_point, "_Scaled")
    soft = 1e-5
    A = np.array([[1.0 + soft, -1.0], [-1.0, 1.0 + soft]])
    b = np.array([-1.0, 0.0])
    qp = from_arrays(A, b, np.full(2, -INF), np.array([0.0, INF]), COMM)
    found = gathered(solve(qp, "interior-point", rtol=1e-6).x)
    np.testing.assert_allclose(found, np.linalg.solve(A, b), rtol=1e-4)
    assert len(scaled) == 1 and not scaled[0].A
