# SPDX-License-Identifier: MIT
"""Mesh tying in 3D: orders on flat non-matching and on cylindrical interfaces."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.meshes_3d import BOTTOM_OF_UPPER, TOP_OF_LOWER, two_boxes
from tests.choice import quick

COMM = MPI.COMM_WORLD
E, NU = 1000.0, 0.3
MARGIN = 0.2  # of the observed orders
OUTER = (1, 2, 5, 6, 7, 8)


def to_sector(x):
    """Map (angle, length, radius - 2) to a sector of two concentric rings."""
    angle, radius = 0.8 * x[:, 0], 2.0 + x[:, 2]
    return np.column_stack([radius * np.sin(angle), x[:, 1], radius * np.cos(angle)])


def field(x, m):
    """Return a smooth displacement, with the functions of NumPy or UFL."""
    return (
        m.sin(1.5 * x[0] + x[1]) * m.cos(x[2]),
        m.cos(x[0]) * m.exp(0.5 * x[1]) + 0.3 * m.sin(x[2]),
        m.sin(x[2] + 0.5 * x[0] * x[1]),
    )


class Symbols:
    sin, cos, exp = staticmethod(ufl.sin), staticmethod(ufl.cos), staticmethod(ufl.exp)


def solve_smooth(n, cell, slave, transform, degree=1, order=1):
    """Return the errors in L2 and H1 with 2n and 3n cells along the edges of the boxes."""
    boxes = (2 * n,) * 3, (3 * n,) * 3
    mesh, _, facets = two_boxes(COMM, *boxes, cell=cell, transform=transform, order=order)
    V = fem.functionspace(mesh, ("Lagrange", degree, (3,)))
    given = fem.Function(V)
    given.interpolate(lambda x: np.array(field(x, np)))
    dofs = [fem.locate_dofs_topological(V, 2, facets.find(tag)) for tag in OUTER]
    bc = fem.dirichletbc(given, np.unique(np.concatenate(dofs)))
    x, v = ufl.SpatialCoordinate(mesh), ufl.TestFunction(V)
    exact = ufl.as_vector(field(x, Symbols))
    mu, lam = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    stress = 2 * mu * ufl.sym(ufl.grad(exact)) + lam * ufl.div(exact) * ufl.Identity(3)
    u = fem.Function(V)
    tags = (TOP_OF_LOWER, BOTTOM_OF_UPPER)
    tags = tags if slave == "lower" else tags[::-1]
    problem = dm.ContactProblem(
        dm.Solid(u, dm.Elastic(E, NU)),
        [dm.Tie(facets, slave=tags[0], master=tags[1])],
        bcs=[bc],
        loads=-ufl.dot(ufl.div(stress), v) * ufl.dx(degree=2 + 2 * degree),
    )
    dm.newton(problem)
    e = u - exact
    squares = [ufl.dot(e, e), ufl.inner(ufl.grad(e), ufl.grad(e))]
    dx = ufl.dx(degree=2 + 2 * degree)
    return [np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(s * dx)))) for s in squares]


def check_orders(sizes, *case, expected=(2.0, 1.0)):
    errors = np.array([solve_smooth(n, *case) for n in sizes])
    ratio = np.log2(np.array(sizes[1:]) / np.array(sizes[:-1]))
    orders = np.log2(errors[:-1] / errors[1:]) / ratio[:, None]
    print(f"{case[:2]}: errors {errors.tolist()}, orders {orders.tolist()}")
    assert np.all(orders[-1] > np.array(expected) - MARGIN)


@pytest.mark.parametrize("transform", quick([None, to_sector], to_sector), ids=["flat", "cylinder"])
def test_orders_of_hexahedra(transform):
    check_orders((1, 2, 3), "hexahedron", "upper", transform)


@pytest.mark.slow
@pytest.mark.parametrize("transform", [None, to_sector], ids=["flat", "cylinder"])
@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_orders(cell, slave, transform):
    """L2 order 2 and H1 order 1, coarse or fine side as slave."""
    check_orders((2, 4, 6), cell, slave, transform)


@pytest.mark.slow
@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize("curved", [False, True], ids=["flat", "cylinder"])
def test_orders_of_second_order_hexahedra(slave, curved):
    """L2 order 3 and H1 order 2, on flat sides and on isoparametric cells of a cylinder."""
    shape = (to_sector, 2, 2) if curved else (None, 2, 1)
    check_orders((1, 2), "hexahedron", slave, *shape, expected=(3.0, 2.0))


@pytest.mark.parametrize("slave", quick(["lower", "upper"], "lower"))
@pytest.mark.parametrize(
    "curved",
    [False, pytest.param(True, marks=pytest.mark.slow)],
    ids=["flat", "cylinder"],
)
def test_orders_of_second_order_tetrahedra(slave, curved):
    """The same orders, though only constants are in the space of multipliers.

    Vertices share the functions of the middles beside them. The theory bounds the order in H1 by
    1.5, which shows with other shares.
    """
    shape = (to_sector, 2, 2) if curved else (None, 2, 1)
    check_orders((1, 2), "tetrahedron", slave, *shape, expected=(3.0, 2.0))


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "finer"), [("tetrahedron", 0), ("tetrahedron", 1), ("hexahedron", 0)]
)
def test_corner_facets_without_a_multiplier_are_told_of(cell, finer):
    """A linear field, given on all walls: exact unless such facets meet several of the master."""
    mesh, _, facets = two_boxes(COMM, (3, 3, 1), (2, 2, 1), cell=cell)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    given = fem.Function(V)
    given.interpolate(lambda x: 1e-3 * np.array([x[1] - 2 * x[0], x[2], x[0] - 3 * x[2]]))
    dofs = [fem.locate_dofs_topological(V, 2, facets.find(tag)) for tag in OUTER]
    bc = fem.dirichletbc(given, np.unique(np.concatenate(dofs)))
    slave, master = (BOTTOM_OF_UPPER, TOP_OF_LOWER)[:: -1 if finer else 1]
    tie = dm.Tie(facets, slave=slave, master=master)
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, NU))
    problem = dm.ContactProblem(solid, [tie], bcs=[bc])
    (audited,) = problem.audit().interfaces
    dm.newton(problem, rtol=1e-10)
    off = np.abs(solid.u.x.array - given.x.array).max(initial=0.0)
    exact = COMM.allreduce(off, op=MPI.MAX) < 1e-12
    assert exact == (audited.unheld == 0)
    told = "2 slave facets have no multiplier" in "".join(problem.audit().warnings)
    assert told == (not exact) == (cell == "tetrahedron" and not finer)
