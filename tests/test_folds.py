# SPDX-License-Identifier: MIT
"""Folds that close on themselves at finite strain: in space, with friction, from afar, restored."""

from mpi4py import MPI

import numpy as np
import pytest

from tests.cases.folds import create_hairpin, create_ring

COMM = MPI.COMM_WORLD
BAR = 1e-6
CLOSED = 1.6
pytestmark = pytest.mark.slow


def close(fold, ways, **options):
    return [fold.close(way, **options) for way in ways]


@pytest.mark.mpi
def test_friction_of_a_surface_on_itself():
    """Coulomb's law holds in a hairpin that is closed and then sheared."""
    fold = create_hairpin(friction=0.3)
    reports = close(fold, (0.3, 0.42, 0.44, 0.46), rtol=1e-9)
    values = fold.contact.gather(fold.problem.u)
    on = values["pressure"] > 0.0
    traction = np.linalg.norm(values["traction"], axis=1)
    assert on.sum() >= 5 and (traction[on] > 0.0).any()
    limit = 0.3 * values["pressure"][on]
    assert (traction[on] <= limit + 1e-6 * limit.max()).all()
    assert reports[-1].certificate.force_balance < BAR
    above, below = fold.reactions
    assert np.abs(above + below).max() < BAR * np.abs(above).max()


def ring_in_space(comm):
    """Close a ring in space; return its force, what a pole carries, and nodes in contact."""
    fold = create_ring(comm, cells=(20, 1, 2))
    reports = close(fold, (0.8, 1.3, 1.45, CLOSED), rtol=1e-9)
    assert max(r.certificate.crossing for r in reports) == 0.0
    above, below = fold.reactions
    assert np.abs(above + below)[:2].max() < BAR * abs(above[1])
    assert reports[-1].certificate.force_balance < BAR
    assert reports[-1].certificate.moment_balance < 5 * BAR  # sides that are not parallel
    force = fold.contact.force
    assert fold.active > 3 and abs(force[0]) < BAR * abs(force[1])
    return np.array([force[1], above[1], fold.active])


@pytest.mark.mpi
def test_a_ring_in_space():
    found = ring_in_space(COMM)
    alone = COMM.bcast(ring_in_space(MPI.COMM_SELF) if COMM.rank == 0 else None)
    np.testing.assert_allclose(found, alone, rtol=1e-7)
