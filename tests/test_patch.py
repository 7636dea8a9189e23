# SPDX-License-Identifier: MIT
"""Contact patch tests: a constant stress state across a non-matching interface, to round-off."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.meshes import two_blocks

E, NU, P = 1000.0, 0.4, 10.0
EXACT = 1e-10

pytestmark = pytest.mark.mpi


def rotation(angle):
    """Return the matrix that turns by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def exact_displacement(angle):
    """Return u(x) (2, n) of the uniaxial plane-strain stress -P normal to the interface."""
    R = rotation(angle)
    strain = R @ np.diag([NU * (1 + NU) / E * P, -(1 - NU**2) / E * P]) @ R.T
    return lambda x: strain @ x[:2]


def beyond(x, cut, lines, outside):
    """Return a traction share: moments of 1 beyond ``cut``, linear on the facet that is cut.

    On facets wholly beyond it is 1, on the others 0; on the one that holds the cut the linear
    function has the same integrals against both shape functions as the indicator.
    """
    k = int(np.searchsorted(lines, cut)) - 1
    if not 0 <= k < len(lines) - 1 or np.isclose(cut, lines[k + 1], rtol=0, atol=1e-14):
        return outside(x, cut)
    a, b = lines[k], lines[k + 1]
    h, s = b - a, (cut - a) / (b - a)
    moments = h * np.array([(1 - s) ** 2 / 2, (1 - s**2) / 2])
    alpha, beta = np.linalg.solve(h / 6 * np.array([[2.0, 1.0], [1.0, 2.0]]), moments)
    inside = alpha + (beta - alpha) * (x - a) / h
    return ufl.conditional(ufl.And(x > a, x < b), inside, outside(x, b))


def solve_patch(slave="lower", lower=None, upper=None, angle=0.0, cell="triangle", seed=0, hold="edge"):
    """Press the upper block on the lower one; return problem, contact and the exact solution."""
    lower = np.linspace(0, 1, 4) if lower is None else np.asarray(lower)
    upper = np.linspace(0, 1, 5) if upper is None else np.asarray(upper)
    mesh, _, facets = two_blocks(
        MPI.COMM_WORLD,
        (len(lower) - 1, 3),
        (len(upper) - 1, 4),
        splits_lower=lower,
        splits_upper=upper,
        angle=angle,
        cell=cell,
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, exact = fem.Function(V), fem.Function(V)
    exact.interpolate(exact_displacement(angle))
    solid = dm.Solid(u, dm.Elastic(E, NU))
    R = rotation(angle)
    t, n = (ufl.as_vector(c.tolist()) for c in R.T)
    v, ds = ufl.TestFunction(V), ufl.Measure("ds", mesh, subdomain_data=facets)
    x = ufl.dot(ufl.SpatialCoordinate(mesh), t)
    loads = -P * ufl.dot(n, v) * ds(2)
    # Where one block sticks out beyond the other, the pressure acts on it directly.
    for tag, lines, end, sign in ((3, lower, upper[-1], 1.0), (4, upper, lower[-1], -1.0)):
        if lines[-1] > end:
            share = beyond(x, end, lines, lambda x, c: ufl.conditional(x > c, 1.0, 0.0))
            loads += -sign * P * share * ufl.dot(n, v) * ds(tag)
    fixed = []
    bottom = fem.locate_dofs_topological(V, 1, facets.find(1))
    if hold == "edge":  # slave ends on a Dirichlet edge; nothing holds the upper block vertically
        left, below = (
            fem.locate_dofs_topological(V.sub(i), 1, facets.find(tag)) for i, tag in ((0, 5), (1, 1))
        )
        zero = default_scalar_type(0)
        lift = default_scalar_type((1 - NU**2) / E * P)  # of the bottom; the interface stays
        fixed += [fem.dirichletbc(zero, left, V.sub(0)), fem.dirichletbc(lift, below, V.sub(1))]
    else:  # the bottom moves as it would, one node on top is held
        top = fem.locate_dofs_geometrical(
            V, lambda y: np.isclose(R.T[0] @ y[:2], upper[0]) & np.isclose(R.T[1] @ y[:2], 1.0)
        )
        fixed += [fem.dirichletbc(exact, dofs) for dofs in (bottom, top)]
    slave, master = (3, 4) if slave == "lower" else (4, 3)
    contact = dm.Contact(facets, slave=slave, master=master)
    problem = dm.ContactProblem(solid, [contact], bcs=fixed, loads=loads, geometry="reference")
    return problem, contact, exact


def check(problem, contact, exact):
    """Solve and compare displacement and pressure with the constant stress state."""
    report = dm.newton(problem, rtol=1e-11)
    error = np.abs(problem.u.x.array - exact.x.array).max(initial=0.0)
    scale = np.abs(exact.x.array).max(initial=0.0)
    error, scale = MPI.COMM_WORLD.allreduce(np.array([error, scale]), op=MPI.MAX)
    assert error < EXACT * scale
    kept = contact.S[:, 0]
    assert np.abs(contact.multiplier[kept] - P).max(initial=0.0) < EXACT * P
    on_slave = contact.slave_nodes & (contact.pressure.x.array != 0)
    assert np.abs(contact.pressure.x.array[on_slave] - P).max(initial=0.0) < EXACT * P
    assert report.certificate.equilibrium < EXACT
    assert report.certificate.force_balance < EXACT
    return report


@pytest.mark.parametrize("slave", ["lower", "upper"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("hold", ["edge", "node"])
def test_equal_lengths(slave, cell, hold):
    """Both blocks end together, slave ends on a Dirichlet edge or free."""
    check(*solve_patch(slave, cell=cell, hold=hold))
