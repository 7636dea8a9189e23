# SPDX-License-Identifier: MIT
"""Mesh tying: exact for linear fields, and of the order of the elements for smooth ones."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, RIGHT, TOP, TOP_OF_LOWER
from tests.cases.meshes_3d import BACK, FRONT, rotation
from tests.cases.mortar import largest
from tests.cases.shells import to_arc
from tests.cases.two_bodies import CELLS, COMM, TwoBodies

E, NU = 1000.0, 0.3
LAME = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
FLANKS = LEFT, RIGHT, FRONT, BACK
STRAIN = np.array([[1e-3, 4e-4, 2e-4], [-2e-4, 2e-3, 3e-4], [5e-4, 1e-4, -1e-3]])


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "degree", "swap"),
    [(*kind, i % 3 == 1) for i, kind in enumerate(product(CELLS, (1, 2)))],
)
def test_linear_field(cell, degree, swap):
    """A linear field with shear passes through an inclined non-matching interface exactly."""
    if cell in CELLS[:2]:
        turn = rotation((0, 0, 1), np.pi / 6)[:2, :2]
        sizes = {"n_lower": (3, 3), "n_upper": (4, 3), "angle": np.pi / 6, "jitter": 0.5}
    else:
        turn = rotation((1.0, 2.0, 0.5), 0.7)
        sizes = {"n_lower": (2, 3, 2), "n_upper": (3, 2, 2), "turn": turn, "jitter": 0.4}
    case, d = TwoBodies(cell, degree, **sizes), len(turn)
    strain, (mu, lam) = STRAIN[:d, :d], LAME
    exact = fem.Function(case.V)
    exact.interpolate(lambda x: strain @ x[:d])
    stress = mu * (strain + strain.T) + lam * np.trace(strain) * np.eye(d)
    traction = ufl.dot(fem.Constant(case.mesh, stress), ufl.FacetNormal(case.mesh))
    ds = ufl.Measure("ds", case.mesh, subdomain_data=case.facets)
    loads = ufl.dot(traction, ufl.TestFunction(case.V)) * ds(FLANKS[: 2 * d - 2])
    # the interface's ends have no Dirichlet data but bottom and top have
    bcs, tie = [case.held(tag, exact) for tag in (BOTTOM, TOP)], case.interface(dm.Tie, swap=swap)
    report = dm.newton(case.problem([tie], bcs, loads=loads), rtol=1e-11)
    assert largest(case.u.x.array - exact.x.array) < 1e-10 * largest(exact.x.array)
    assert report.certificate.force_balance < 1e-10
    # the resultant on the slave side is that of the traction on a unit of the interface
    expected = stress @ turn[:, -1] * (-1 if swap else 1)
    assert np.allclose(tie.force, expected, rtol=1e-8, atol=1e-10)


def field(x, m):
    """Return a smooth displacement, with the functions of NumPy or UFL."""
    z = x[2] if len(x) > 2 else 0.0 * x[0]
    u = m.sin(1.5 * x[0] + x[1]) * m.cos(z), m.cos(x[0]) * m.exp(0.5 * x[1]) + 0.3 * m.sin(z)
    return (*u, m.sin(z + 0.5 * x[0] * x[1]))[: len(x)]


SYMBOLS = SimpleNamespace(sin=ufl.sin, cos=ufl.cos, exp=ufl.exp)


def solve_smooth(n, slave, cell, degree=1, curved=False):
    """Return the errors in L2 and H1 with 2n and 3n cells along the edges of the bodies."""
    d = 2 if cell in CELLS[:2] else 3
    sizes = {"n_lower": (2 * n,) * d, "n_upper": (3 * n,) * d}
    shape = {"transform": to_arc, "order": degree} if curved else {}
    case = TwoBodies(cell, degree, **sizes, **shape)
    given, V = fem.Function(case.V), case.V
    given.interpolate(lambda x: np.array(field(x[:d], np)))
    exact = ufl.as_vector(field(ufl.SpatialCoordinate(case.mesh), SYMBOLS))
    mu, lam = LAME
    stress = 2 * mu * ufl.sym(ufl.grad(exact)) + lam * ufl.div(exact) * ufl.Identity(d)
    loads = -ufl.dot(ufl.div(stress), ufl.TestFunction(V)) * ufl.dx(degree=2 + 2 * degree)
    bcs = [case.held(tag, given) for tag in (BOTTOM, TOP, *FLANKS[: 2 * d - 2])]
    tie = case.interface(dm.Tie, swap=slave == "upper")
    dm.newton(case.problem([tie], bcs, dm.Elastic(E, NU), loads=loads, geometry="reference"))
    e = case.u - exact
    squares = [ufl.dot(e, e), ufl.inner(ufl.grad(e), ufl.grad(e))]
    dx = ufl.dx(degree=2 + 2 * degree)
    return [np.sqrt(COMM.allreduce(fem.assemble_scalar(fem.form(s * dx)))) for s in squares]


def slow(*row):
    return pytest.param(*row, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("cell", "degree", "curved", "slave", "sizes"),
    [
        ("triangle", 1, False, "lower", (4, 8)),
        ("quadrilateral", 1, True, "upper", (4, 8)),
        ("triangle", 2, True, "lower", (4, 8)),
        ("quadrilateral", 2, False, "upper", (4, 8)),
        ("hexahedron", 1, True, "upper", (2, 3)),
        ("tetrahedron", 2, False, "lower", (1, 2)),
        slow("tetrahedron", 1, True, "lower", (4, 6)),
        slow("tetrahedron", 2, True, "upper", (1, 2)),
        slow("hexahedron", 2, True, "lower", (1, 2)),
    ],
)
def test_orders(cell, degree, curved, slave, sizes):
    """Degree + 1 in L2, degree in H1, on flat sides and on isoparametric cells of an arc."""
    errors = np.array([solve_smooth(n, slave, cell, degree, curved) for n in sizes])
    orders = np.log2(errors[0] / errors[1]) / np.log2(sizes[1] / sizes[0])
    margin = 0.15 if cell in CELLS[:2] else 0.2
    assert (orders > np.array([degree + 1, degree]) - margin).all(), orders


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "finer"), [("tetrahedron", 0), ("tetrahedron", 1), ("hexahedron", 0)]
)
def test_corner_facets_without_a_multiplier_are_told_of(cell, finer):
    """A linear field, given on all walls: exact unless such facets meet several of the master."""
    case = TwoBodies(cell, n_lower=(3, 3, 1), n_upper=(2, 2, 1))
    given = fem.Function(case.V)
    given.interpolate(lambda x: 1e-3 * np.array([x[1] - 2 * x[0], x[2], x[0] - 3 * x[2]]))
    bcs = [case.held(tag, given) for tag in (BOTTOM, TOP, *FLANKS)]
    tie = case.interface(dm.Tie, slave=TOP_OF_LOWER if finer else BOTTOM_OF_UPPER)
    problem = case.problem([tie], bcs)
    (audited,) = problem.audit().interfaces
    dm.newton(problem, rtol=1e-10)
    exact = largest(case.u.x.array - given.x.array) < 1e-12
    assert exact == (audited.unheld == 0)
    told = "2 slave facets have no multiplier" in "".join(problem.audit().warnings)
    assert told == (not exact) == (cell == "tetrahedron" and not finer)
