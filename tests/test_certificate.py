# SPDX-License-Identifier: MIT
"""What the certificate says of the mortar operators."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.steps.certificate import operator_errors
from tests.ball_case import STEEL, create_problem
from tests.meshes_3d import BOTTOM, BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER, rotation, two_boxes

COMM = MPI.COMM_WORLD


def press_boxes(cell="hexahedron"):
    """Return the certificate and the problem of two flat boxes, apart at first, turned in space."""
    turn = rotation((1.0, 2.0, 0.5), 0.7)
    options = {"gap": 0.05, "jitter": 0.4, "turn": turn, "cell": cell}
    mesh, _, facets = two_boxes(COMM, (3, 3, 2), (4, 4, 2), **options)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    bcs = []
    for tag, depth in ((BOTTOM, 0.0), (TOP, 0.06)):
        dofs = fem.locate_dofs_topological(V, 2, facets.find(tag))
        bcs.append(fem.dirichletbc(-depth * turn[:, 2], dofs, V))
    contact = dm.Contact(facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    solid = dm.Solid(fem.Function(V), STEEL)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="reference")
    return dm.newton(problem).certificate, problem


def press_ball(slave, h):
    """Return the certificate of the quarter ball on the block."""
    return dm.newton(create_problem(h=h, slave=slave, depth=0.05)[0]).certificate


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_flat_interfaces_reproduce_linear_fields(cell):
    certificate, _ = press_boxes(cell)
    assert certificate.linear_field_error < 1e-12
    assert certificate.row_sum_error < 1e-12


def test_a_curved_slave_shows_the_angle_of_its_facets():
    """Far from the contact the ball is millimetres off; only the facets' angles may count."""
    assert press_ball("block", 0.5).linear_field_error < 1e-12
    errors = [press_ball("ball", h).linear_field_error for h in (0.5, 0.25)]
    assert errors[0] < 0.3
    assert errors[1] < 0.75 * errors[0]


def test_a_broken_operator_is_seen():
    """A tenth of D_jj moved to another master node keeps the row sums, not linear fields."""
    problem = press_boxes()[1]
    link = problem.system.links[0]
    D, M = link.pairing.D, link.pairing.M
    first = M.getOwnershipRange()[0]
    for row in link.nodes[link.coupling.kept[:, 0]][:1] + first:
        columns = M.getRow(row)[0][[0, -1]]
        moved = 0.1 * D.getDiagonal().array_r[row - first]
        M.setValues(row, columns.astype(np.int32), [moved, -moved], addv=PETSc.InsertMode.ADD)
    M.assemble()
    linear, sums = operator_errors(link, problem.system.facet_length)
    assert linear > 0.01
    assert sums < 1e-12
