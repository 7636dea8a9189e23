# SPDX-License-Identifier: MIT
"""Exact solutions with friction: constant stress, a block on a slope, bodies that turn together."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases import meshes, meshes_3d
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, Blocks
from tests.cases.friction import COMM, ELASTIC
from tests.cases.pressed_blocks import failing
from tests.choice import crosswise

EXACT = 1e-10
MU, P = 0.3, 2.0


def largest(array):
    """Return the largest absolute value of all ranks."""
    return float(COMM.allreduce(float(np.abs(array).max(initial=0.0)), op=MPI.MAX))


def rotation(d, angle):
    """Return a matrix (d, d) that turns, in space about an oblique axis."""
    if d == 2:
        return meshes_3d.rotation((0.0, 0.0, 1.0), angle)[:2, :2]
    return meshes_3d.rotation((1.0, 2.0, 3.0), angle)


def blocks(cell, angle):
    """Return mesh, tags and rotation of two blocks that are as wide as each other."""
    if cell in ("triangle", "quadrilateral"):
        turn = rotation(2, angle)
        size = {"angle": angle, "jitter": 0.3}
        return *meshes.two_blocks(COMM, (5, 2), (4, 3), cell=cell, **size), turn
    turn = rotation(3, angle)
    options = {"turn": turn, "jitter": 0.3, "cell": cell}
    return *meshes_3d.two_boxes(COMM, (3, 3, 2), (2, 4, 2), **options), turn


class Patch:
    """Blocks in a homogeneous state of stress; the upper one is held by contact alone."""

    def __init__(self, cell, share, *, degree=1, angle=0.0, slave="lower", geometry="reference"):
        """Put pressure P and shear share * MU * P on the interface, by tractions all around."""
        mesh, cells, facets, turn = blocks(cell, angle)
        d = mesh.geometry.dim
        way = turn[:, 0] if d == 2 else turn[:, :2] @ (0.8, 0.6)
        normal = turn[:, -1]
        shear = share * MU * P * np.outer(way, normal)
        self.stress = shear + shear.T - P * np.outer(normal, normal)
        E, nu = ELASTIC.E, ELASTIC.nu
        mean = np.trace(self.stress) * np.eye(d)
        strain = (1 + nu) / E * (self.stress - (nu if d == 2 else nu / (1 + nu)) * mean)
        V = fem.functionspace(mesh, ("Lagrange", degree, (d,)))
        self.exact = fem.Function(V)
        self.exact.interpolate(lambda x: strain @ x[:d])
        bottom = fem.locate_dofs_topological(V, d - 1, facets.find(meshes.BOTTOM))
        outside = (meshes.TOP, *range(5, 7 if d == 2 else 9))
        ds = ufl.Measure("ds", mesh, subdomain_data=facets)
        value = fem.Constant(mesh, default_scalar_type(self.stress))
        traction = ufl.dot(value, ufl.FacetNormal(mesh))
        loads = ufl.inner(traction, ufl.TestFunction(V)) * ds(outside)
        sides = (meshes.TOP_OF_LOWER, meshes.BOTTOM_OF_UPPER)[:: 1 if slave == "lower" else -1]
        self.contact = dm.Contact(facets, slave=sides[0], master=sides[1], friction=MU)
        self.problem = dm.ContactProblem(
            dm.Solid(fem.Function(V), ELASTIC, cells),
            [self.contact],
            bcs=[fem.dirichletbc(self.exact, bottom)],
            loads=loads,
            geometry=geometry,
        )
        on_slave = (1.0 if slave == "lower" else -1.0) * way
        self.traction = share * MU * P * on_slave


@pytest.mark.parametrize(
    ("cell", "degree", "slave"),
    crosswise(
        [
            *(("triangle", 1), ("triangle", 2), ("quadrilateral", 2), ("quadrilateral", 1)),
            *(("tetrahedron", 1), ("hexahedron", 1), ("hexahedron", 2)),
        ],
        ["lower", "upper"],
    ),
)
def test_constant_shear_below_the_limit(cell, degree, slave):
    """Tau = 0.9 mu p everywhere: nothing slips, and displacement and tractions are exact."""
    patch = Patch(cell, 0.9, degree=degree, slave=slave, angle=0.4)
    problem, contact = patch.problem, patch.contact
    dm.newton(problem, rtol=1e-12)
    exact = patch.exact.x.array
    assert largest(problem.u.x.array - exact) < EXACT * largest(exact)
    nodes = contact.gather(problem.u)
    on = nodes["status"] == 1.0
    assert on.sum() >= 4 and not (nodes["status"] == 2.0).any()
    assert largest(nodes["pressure"][on] - P) < EXACT * P
    assert largest(nodes["traction"][on] - patch.traction) < EXACT * P
    assert largest(nodes["step_slip"]) == 0.0


@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_the_limit_lies_where_it_should(geometry):
    """At 0.99 of it all sticks; at 1.01 nothing holds the upper block, which the error says."""
    patch = Patch("triangle", 0.99, geometry=geometry)
    dm.newton(patch.problem, rtol=1e-11)
    nodes = patch.contact.gather(patch.problem.u)
    assert not (nodes["status"] == 2.0).any() and (nodes["status"] == 1.0).sum() >= 4
    patch = Patch("triangle", 1.01, geometry=geometry)
    before = patch.problem.u.x.array.copy()
    with failing(patch.problem, "The loads may exceed what friction carries"):
        dm.newton(patch.problem)
    assert np.array_equal(patch.problem.u.x.array, before)


# -- a block on a slope


def on_slope(slope, mu, *, cell="triangle", slave="lower", geometry="reference"):
    """Return a problem: a block on a wide one, under gravity that leans by tan(angle) = slope."""
    space = cell == "hexahedron"
    if space:
        size = {"n_lower": (4, 4, 1), "n_upper": (2, 3, 2), "lower": (-0.5, 1.5, -0.5, 1.5)}
        mesh, cells, facets = meshes_3d.two_boxes(COMM, cell=cell, **size)
    else:
        size = {"n_lower": (7, 2), "n_upper": (4, 2), "x_lower": (-0.5, 1.5)}
        mesh, cells, facets = meshes.two_blocks(COMM, cell=cell, heights=(1.0, 0.5), **size)
    d = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", 1, (d,)))
    bottom = fem.locate_dofs_topological(V, d - 1, facets.find(meshes.BOTTOM))
    way = np.array([1.0] if d == 2 else [0.6, 0.8])
    gravity = np.append(way * slope, -1.0) / np.hypot(slope, 1.0)
    dx = ufl.Measure("dx", mesh, subdomain_data=cells)
    weight = fem.Constant(mesh, default_scalar_type(gravity))
    loads = ufl.inner(weight, ufl.TestFunction(V)) * dx(meshes.UPPER)
    sides = (meshes.TOP_OF_LOWER, meshes.BOTTOM_OF_UPPER)[:: 1 if slave == "lower" else -1]
    contact = dm.Contact(facets, slave=sides[0], master=sides[1], friction=mu, surface="facets")
    zero = fem.Constant(mesh, np.zeros(d))
    problem = dm.ContactProblem(
        dm.Solid(fem.Function(V), ELASTIC, cells),
        [contact],
        bcs=[fem.dirichletbc(zero, bottom, V)],
        loads=loads,
        geometry=geometry,
    )
    return problem, contact, gravity


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "hexahedron"])
@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_a_block_on_a_slope_stays(cell, slave):
    """Where tan(angle) = 0.99 mu, friction carries its weight."""
    problem, contact, gravity = on_slope(0.99 * MU, MU, cell=cell, slave=slave)
    dm.newton(problem, rtol=1e-11)
    force = contact.force if slave == "upper" else contact.master_force
    weight = 0.5 if len(gravity) == 2 else 1.0
    assert force == pytest.approx(-weight * gravity, rel=1e-9)
    nodes = contact.gather(problem.u)
    if len(gravity) == 2:
        assert (nodes["status"] == 1.0).any()
    else:  # all may slip, each in a direction of its own, as far as the foot spreads
        assert largest(nodes["slip"]) < largest(problem.u.x.array)


@pytest.mark.parametrize(
    "cell", ["triangle", "quadrilateral", pytest.param("hexahedron", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_a_block_on_a_steeper_slope_slides(cell, slave):
    """Where tan(angle) = 1.01 mu there is no equilibrium; the displacement stays."""
    problem, *_ = on_slope(1.01 * MU, MU, cell=cell, slave=slave)
    said = "The loads may exceed what friction carries", "slides or rolls freely"
    with failing(problem, *said) as caught:
        dm.newton(problem)
    if problem.linear.direct:
        assert "choose a factorisation" not in caught.value.message
    assert largest(problem.u.x.array) == 0.0


@pytest.mark.parametrize("mu", [0.05, 0.3, 0.8])
def test_slopes_and_coefficients(mu):
    """The same for flat and steep slopes."""
    for share, stays in ((0.95, True), (1.05, False)):
        problem, *_ = on_slope(share * mu, mu, cell="quadrilateral")
        if stays:
            assert dm.newton(problem).converged
        else:
            with pytest.raises(dm.NewtonNotConverged):
                dm.newton(problem)


# -- bodies that turn together


def turned_pair(steps, degrees):
    """Turn two pressed blocks as one by their whole outsides; return contact and last slips.

    The displacement prescribed is (R F - I) X, F a compression.
    """
    mesh, cells, facets = meshes.two_blocks(COMM, (5, 2), (4, 3), jitter=0.3)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    value = fem.Function(V)
    outside = np.concatenate([facets.find(tag) for tag in (1, 2, 5, 6)])
    dofs = fem.locate_dofs_topological(V, 1, np.unique(outside))
    contact = dm.Contact(
        facets, slave=meshes.TOP_OF_LOWER, master=meshes.BOTTOM_OF_UPPER, friction=5.0
    )
    solid = dm.Solid(fem.Function(V), ELASTIC, cells)
    problem = dm.ContactProblem(solid, [contact], bcs=[fem.dirichletbc(value, dofs)])
    squeeze = np.diag([1.0, 0.9])
    for k in range(steps + 1):
        A = rotation(2, np.radians(degrees) * k / steps) @ squeeze - np.eye(2)
        value.interpolate(lambda x, A=A: A @ x[:2])
        dm.newton(problem, rtol=1e-11)
        problem.commit()
    return problem, contact, A


@pytest.mark.slow
def test_turning_together_is_no_slip():
    """Thirty degrees in thirty steps: nothing slips, all tractions are those of the stress.

    Strains are small ones, which a rotation changes, so the stress is that of (R F - I).
    """
    problem, contact, A = turned_pair(30, 30.0)
    E, nu = ELASTIC.E, ELASTIC.nu
    strain = (A + A.T) / 2
    mean = nu / (1 - 2 * nu) * np.trace(strain) * np.eye(2)
    stress = E / (1 + nu) * (strain + mean)
    R = rotation(2, np.radians(30.0))
    n, t = R[:, 1], R[:, 0]
    nodes = contact.gather(problem.u)
    on = nodes["status"] == 1.0
    assert on.sum() >= 3 and not (nodes["status"] == 2.0).any()
    assert largest(nodes["slip"]) == 0.0 and contact.dissipation == 0.0
    force = stress @ (0.0, 1.0)  # per area at X, along which nothing has grown longer
    pressure = -n @ force
    assert pressure > 10.0
    assert largest(nodes["pressure"][on] - pressure) < 1e-8 * pressure
    expected = (t @ force) * t
    assert largest(nodes["traction"][on] - expected) < 1e-8 * pressure


CORNER = [(0.0, 1.0, 0.0, 1.0, 3, 2), (1.0, 2.0, 0.0, 1.0, 4, 3), (0.0, 2.0, 1.0, 2.0, 5, 2)]


@pytest.mark.mpi
def test_blocks_that_meet_in_a_corner_shrink_without_slip():
    """One law, no gaps: all is one block that is pressed together, by 10 per cent in one step."""
    pile, shrink = Blocks(CORNER, cell="quadrilateral"), -0.1
    sides = [(10 + EAST, 20 + WEST), (10 + ABOVE, 30 + BELOW), (20 + ABOVE, 30 + BELOW)]
    rough = [dm.Contact(pile.facets, slave=s, master=m, friction=MU) for s, m in sides]
    whole = fem.Function(pile.V)
    whole.interpolate(lambda x: shrink * x[:2])
    rim = fem.locate_dofs_geometrical(pile.V, lambda x: np.isclose(abs(x[:2] - 1), 1).any(axis=0))
    solid = dm.Solid(pile.u, dm.NeoHooke(E=1000.0, nu=0.3), strain="finite")
    dm.newton(dm.ContactProblem(solid, rough, bcs=[fem.dirichletbc(whole, rim)]), rtol=1e-11)
    mu, lame, stretch = 1000.0 / 2.6, 300.0 / (1.3 * 0.4), 1.0 + shrink
    pressure = -(mu * (stretch**2 - 1.0) + 2.0 * lame * np.log(stretch)) / stretch**2
    assert largest(pile.u.x.array - whole.x.array) < EXACT
    for contact in rough:
        nodes = contact.gather(pile.u)
        closed = nodes["active"] > 0.0
        assert np.allclose(nodes["pressure"][closed], pressure, rtol=1e-9)
        assert largest(nodes["step_slip"]) < EXACT
