# SPDX-License-Identifier: MIT
"""Mesh tying: exact for linear fields, and of the order of the elements for smooth ones."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from tests.cases.meshes import two_blocks
from tests.choice import crosswise, quick

E, NU = 1000.0, 0.3
MARGIN = 0.15  # of the observed orders
COMM = MPI.COMM_WORLD


def boundary_condition(V, facets, expression, tags=(1, 2, 5, 6)):
    """Prescribe a field on whole sides."""
    exact = fem.Function(V)
    exact.interpolate(expression)
    dofs = [fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in tags]
    return exact, fem.dirichletbc(exact, np.unique(np.concatenate(dofs)))


def create_tie(facets, slave):
    """Return the tie with the lower or the upper side as slave."""
    tags = (3, 4) if slave == "lower" else (4, 3)
    return dm.Tie(facets, slave=tags[0], master=tags[1])


@pytest.mark.mpi
@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("angle", [0.0, np.pi / 6])
@pytest.mark.parametrize("degree", [1, 2])
def test_linear_field(slave, cell, angle, degree):
    """A linear field with shear passes through a non-matching interface exactly."""
    mesh, _, facets = two_blocks(COMM, (3, 3), (4, 3), cell=cell, angle=angle, jitter=0.5)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))
    strain = np.array([[1e-3, 4e-4], [-2e-4, 2e-3]])
    # the interface's ends have no Dirichlet data but bottom and top have
    exact, bc = boundary_condition(V, facets, lambda x: strain @ x[:2], tags=(1, 2))
    stress = (
        E / (1 + NU) * ((strain + strain.T) / 2 + NU / (1 - 2 * NU) * np.trace(strain) * np.eye(2))
    )
    n, v = ufl.FacetNormal(mesh), ufl.TestFunction(V)
    traction = ufl.dot(fem.Constant(mesh, stress), n)
    ds = ufl.Measure("ds", mesh, subdomain_data=facets)
    u = fem.Function(V)
    tie = create_tie(facets, slave)
    problem = dm.ContactProblem(
        dm.Solid(u, dm.Elastic(E, NU)), [tie], bcs=[bc], loads=ufl.dot(traction, v) * ds((5, 6))
    )
    report = dm.newton(problem, rtol=1e-10)
    error, size = maximum(
        COMM,
        np.abs(u.x.array - exact.x.array).max(initial=0.0),
        np.abs(exact.x.array).max(initial=0.0),
    )
    assert error < 1e-10 * size
    assert report.certificate.force_balance < 1e-10
    # the resultant on the slave side is that of the traction on an edge of length 1
    normal = np.array([-np.sin(angle), np.cos(angle)])
    expected = stress @ normal * (1 if slave == "lower" else -1)
    assert np.allclose(tie.force, expected, rtol=1e-8, atol=1e-10)


def bend(x):
    """Bend the interface into a wave, with the blocks."""
    return x + np.column_stack([0.05 * x[:, 1], 0.15 * np.sin(2.5 * x[:, 0] + 0.4)])


def solve_smooth(n, slave, cell, degree=1, transform=None, order=1):
    """Return the errors of a manufactured smooth solution in L2 and H1."""
    shape = {"cell": cell, "transform": transform, "order": order}
    mesh, _, facets = two_blocks(COMM, (2 * n, 2 * n), (3 * n, 3 * n), **shape)
    V = fem.functionspace(mesh, ("Lagrange", degree, (2,)))

    def field(x, m):
        return m.sin(2 * x[0] + x[1]), m.cos(x[0]) * m.exp(0.5 * x[1])

    class Symbols:
        sin, cos, exp = staticmethod(ufl.sin), staticmethod(ufl.cos), staticmethod(ufl.exp)

    _, bc = boundary_condition(V, facets, lambda x: np.array(field(x, np)))
    x, v = ufl.SpatialCoordinate(mesh), ufl.TestFunction(V)
    exact = ufl.as_vector(field(x, Symbols))
    mu, lam = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    stress = 2 * mu * ufl.sym(ufl.grad(exact)) + lam * ufl.div(exact) * ufl.Identity(2)
    u = fem.Function(V)
    problem = dm.ContactProblem(
        dm.Solid(u, dm.Elastic(E, NU)),
        [create_tie(facets, slave)],
        bcs=[bc],
        loads=-ufl.dot(ufl.div(stress), v) * ufl.dx(degree=2 + 2 * degree),
        geometry="reference",
    )
    dm.newton(problem)
    e = u - exact
    squares = [ufl.dot(e, e), ufl.inner(ufl.grad(e), ufl.grad(e))]
    dx = ufl.dx(degree=3 + 2 * degree)
    return [np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(s * dx)))) for s in squares]


@pytest.mark.parametrize(
    ("slave", "cell"), crosswise(["lower", "upper"], ["triangle", "quadrilateral"])
)
def test_orders(slave, cell):
    """L2 order 2 and H1 order 1 on non-matching meshes, coarse or fine side as slave."""
    errors = np.array([solve_smooth(n, slave, cell) for n in (2, 4, 8)])
    order = np.log2(errors[:-1] / errors[1:])
    print(f"{cell}, slave {slave}: orders {order.tolist()}")
    assert np.all(order[-1] > np.array([2.0, 1.0]) - MARGIN)


@pytest.mark.parametrize("slave", quick(["lower", "upper"], "lower"))
@pytest.mark.parametrize(
    ("curved", "cell"), crosswise([False, True], ["triangle", "quadrilateral"])
)
def test_orders_of_second_order(slave, cell, curved):
    """L2 order 3 and H1 order 2, on a straight interface and on isoparametric cells of a wave."""
    kind = {"transform": bend, "order": 2} if curved else {}
    errors = np.array([solve_smooth(n, slave, cell, 2, **kind) for n in (2, 4, 8)])
    order = np.log2(errors[:-1] / errors[1:])
    print(f"{cell}, slave {slave}: orders {order.tolist()}")
    assert np.all(order[-1] > np.array([3.0, 2.0]) - MARGIN)
