# SPDX-License-Identifier: MIT
"""Folds that close on themselves at finite strain: in space, with friction, from afar, restored."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, create_blocks
from tests.cases.folds import RUBBER, create_hairpin, create_ring

COMM = MPI.COMM_WORLD
BAR = 1e-6
CLOSED = 1.6
pytestmark = pytest.mark.slow


def close(fold, ways, **options):
    """Return the reports of steps."""
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


@pytest.mark.mpi
def test_one_tag_for_two_bodies_that_slide_is_as_good_as_two():
    """Over eight facets, with friction: new parts come near and are found.

    Pressed by .1, the leading flank leans so far that it faces the dent in front of it: a side of
    the skin, not of the two bodies.
    """
    domain, _, facets = create_blocks(COMM, [(0, 4, -1, 0, 16, 4), (0.3, 1.3, 0.01, 1, 8, 4)])
    domain.topology.create_connectivity(1, 2)
    skin = np.sort(dolfinx.mesh.exterior_facet_indices(domain.topology))
    one = dolfinx.mesh.meshtags(domain, 1, skin, np.full(len(skin), 1, dtype=np.int32))

    def slide(contact):
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        push = fem.Constant(domain, np.zeros(2))
        top, bottom = (
            fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (20 + ABOVE, 10 + BELOW)
        )
        bcs = [fem.dirichletbc(push, top, V), fem.dirichletbc(np.zeros(2), bottom, V)]
        solid = dm.Solid(fem.Function(V), RUBBER, strain="finite")
        problem = dm.ContactProblem(solid, [contact], bcs=bcs)
        forces = []
        for k in range(9):
            push.value[:] = 0.25 * k, -0.08
            dm.newton(problem, rtol=1e-9)
            problem.commit()
            forces.append(contact.force)
        assert problem.system.searches > 4
        return np.array(forces)

    itself = slide(dm.Contact(one, slave=1, master=1, friction=0.3))
    two = slide(dm.Contact(facets, slave=20 + BELOW, master=10 + ABOVE, friction=0.3))
    # corners of the skin have normals of both faces
    assert np.abs(itself - two).max() < 1e-3 * np.abs(two).max()
