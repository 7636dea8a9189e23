# SPDX-License-Identifier: MIT
"""Ties of smooth surfaces: rigid motions, pressures and moments are right where facets' are not."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.close_fits import hold, rings
from tests.cases.meshes import two_blocks
from tests.cases.meshes_3d import two_boxes
from tests.cases.mortar import largest
from tests.cases.shells import OUTER, RADIUS, to_arc, to_sphere
from tests.cases.two_bodies import CELLS, create_problem, held
from tests.choice import crosswise

COMM = MPI.COMM_WORLD
RADII = (1.0, 2.0, 3.0)
LAME = (1 - 1 / 2**2) / (1 - 1 / 3**2)  # pressure at 2 under 1 from outside
ROUND_OFF = 1e-12
SPIN = np.array([[0.0, -1.0, 0.5], [1.0, 0.0, 0.7], [-0.5, -0.7, 0.0]])  # W: u = W x


# -- the operator: u_s = Q u_m ---------------------------------------------------------------------


def sides(comm, cell, transform, n=3, **options):
    """Return the mesh of two bodies whose sides have 2 n and 3 n facets along, and its tags."""
    options = {"jitter": 0.4} | options | {"cell": cell, "transform": transform}
    if cell in CELLS[:2]:
        found = two_blocks(comm, (2 * n, 2), (3 * n, 2), **options)
    else:
        found = two_boxes(comm, (2 * n, 2 * n, 1), (3 * n, 3 * n, 1), **options)
    return found[0], found[2]


def couple(mesh, tags, *, swap=False, bcs=None, **options):
    """Return the link of a tie with the first or the second body's side as slave."""
    V = fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,)))
    tie = dm.Tie(tags, slave=3 + swap, master=4 - swap, **options)
    problem = create_problem(V, [tie], bcs(V) if bcs else [])
    problem.update_geometry()
    return problem.system.links[0]


def jumps(link, field):
    """Return what the tie takes for a slip (n, d) at the slave nodes, and these (n, 3)."""
    V, n = link.sides.V, link.sides.n_owned
    x = V.tabulate_dof_coordinates()[:n]
    v = link.Q.createVecRight()
    v.array[:] = field(x)[:, : link.coupling.R.shape[1]].ravel()
    return np.where(link.constrained, link.relative(v), 0.0), x[link.nodes]


def spin(x):
    return x @ SPIN.T + [0.3, -0.2, 0.1]


@pytest.mark.mpi
@pytest.mark.parametrize(("swap", "gap"), crosswise([False, True], [0.0, 0.3]))
@pytest.mark.parametrize("cell", CELLS)
def test_rigid_motions_are_no_slip(cell, gap, swap):
    """Exactly, on uneven meshes of curved sides, also of such that are far apart."""
    mesh, tags = sides(COMM, cell, to_arc if cell in CELLS[:2] else to_sphere, gap=gap)
    slip, _ = jumps(couple(mesh, tags, swap=swap), spin)
    assert largest(slip) < ROUND_OFF
    slip, _ = jumps(couple(mesh, tags, swap=swap, surface="facets"), spin)
    assert largest(slip) > 1e-3


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_rigid_motions_are_no_slip_where_directions_differ_in_their_nodes(cell):
    """Some nodes have Dirichlet data for x alone, and their functions are others'."""
    mesh, tags = sides(COMM, cell, to_arc if cell in CELLS[:2] else to_sphere, gap=0.1)
    link = couple(mesh, tags, bcs=lambda V: [held(V, tags, 5, 0.0, 0)])
    kept = COMM.allreduce(link.coupling.kept.sum(axis=0))
    assert kept[0] < kept[1] and largest(jumps(link, spin)[0]) < ROUND_OFF


@pytest.mark.parametrize("surface", ["facets", "smooth"])
@pytest.mark.parametrize("cell", CELLS)
def test_orders_of_a_dilatation(cell, surface):
    """Sides that widen stay one surface: of second order in h for facets, of fourth for smooth."""
    errors = []
    for n in (3, 6):
        mesh, tags = sides(COMM, cell, to_arc if cell in CELLS[:2] else to_sphere, n, jitter=0.0)
        slip, x = jumps(couple(mesh, tags, surface=surface), lambda x: x)
        across = np.abs(x[:, : mesh.geometry.dim - 1]).max(axis=1)
        errors.append(largest(slip[across < 0.16 * RADIUS]))  # normals lean at the rims
    order = np.log2(errors[0] / errors[1])
    assert order == pytest.approx(2.0 if surface == "facets" else 4.0, abs=0.15)


@pytest.mark.parametrize("surface", ["facets", "smooth"])
@pytest.mark.parametrize("cell", CELLS)
def test_flat_sides_have_the_operator_of_the_paper(cell, surface):
    """Q = P I: to the last digit for facets, to round-off for smooth surfaces."""
    mesh, tags = sides(COMM, cell, None)
    coupling = couple(mesh, tags, surface=surface).coupling
    scalar = coupling.P[:, :, None] * np.eye(coupling.R.shape[1])
    assert largest(coupling.blocks - scalar) <= (0.0 if surface == "facets" else 1e-14)


# -- what it corrects ------------------------------------------------------------------------------


def pressure_errors(sizes, slave):
    """Return the largest errors of the pressure of rings, relative to Lame's, and its spreads."""
    found = []
    for k in sizes:
        domain, tags = rings(COMM, RADII[:2], RADII[1:], (24 * k, 36 * k), (4 * k, 4 * k))
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        tie, ds = (
            dm.Tie(tags, slave=slave, master=5 - slave),
            ufl.Measure("ds", subdomain_data=tags),
        )
        push = -ufl.dot(ufl.FacetNormal(domain), ufl.TestFunction(V)) * ds(OUTER)
        problem = create_problem(V, [tie], hold(V, RADII[2]), loads=push)
        dm.newton(problem, rtol=1e-10)
        pressure = tie.gather(problem.u)["pressure"] / LAME
        found.append([np.abs(pressure - 1.0).max(), pressure.std()])
    return np.array(found)


@pytest.mark.parametrize("slave", [2, 3])
def test_the_pressure_of_tied_rings_is_lames(slave):
    """Uniform and right, both of second order, whatever the slave."""
    errors = pressure_errors((1, 2, 4), slave)
    orders = np.log2(errors[:-1] / errors[1:])
    assert orders[-1].min() > 1.8 and errors[-1, 0] < 4e-4


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_moments_balance_across_a_gap(cell):
    """A body that is sheared and pressed, far above the one to which it is tied."""
    mesh, tags = sides(COMM, cell, None, gap=0.3)
    d = mesh.geometry.dim
    imbalance = []
    for surface in ("smooth", "facets"):
        V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
        ds, v = ufl.Measure("ds", mesh, subdomain_data=tags), ufl.TestFunction(V)
        tie, loads = dm.Tie(tags, slave=3, master=4, surface=surface), (v[0] - v[d - 1]) * ds(2)
        problem = create_problem(V, [tie], [held(V, tags, 1)], loads=loads)
        imbalance.append(dm.newton(problem).certificate.moment_balance)
    assert imbalance[0] < 1e-12 and imbalance[1] > 0.05
