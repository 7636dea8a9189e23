# SPDX-License-Identifier: MIT
"""A pressure that follows its surface: closed solutions, its derivatives, and no locking."""

import numpy as np
import pytest
from scipy.integrate import quad

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.pressed_blocks import COMM, failing, rejected
from tests.cases.solid import (
    create_displacement,
    create_domain,
    hold,
    plane,
    rectangle,
    rollers,
    set_wave,
    stand,
    tag_facets,
)

INNER, OUTER = 1.0, 2.0


def quarter(kinematics, n):
    """Return a quarter of a thick cylinder, or of a sphere's section, with a pressure inside."""
    domain = rectangle([(0, 0), (1, 1)], (n, 2 * n))
    tags, x = tag_facets(domain, plane(0), plane(1), plane(1, 1.0)), domain.geometry.x
    r, a = INNER + (OUTER - INNER) * x[:, 0], np.pi / 2 * x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(a), r * np.sin(a)
    how = {"kinematics": kinematics, "strain": "finite", "volumetric": "reduced"}
    law, p = dm.MooneyRivlin(0.5, 0.0, 2000.0), fem.Constant(domain, default_scalar_type(0.0))

    def pressure(solid):
        return [dm.Pressure(solid, tags, 1, p, closed=True)]

    return stand(domain, law, rollers, [], pressure, **how), p


def exact_pressure(a, n):
    """Return the pressure at the inner radius a, of an incompressible cylinder or sphere, n = 1, 2.

    Of neo-Hookean rubber with mu = 1: p = int n (l^2 - l^(-2n)) dr / r, l = r / R.
    """

    def integrand(R):
        ratio = (R ** (n + 1) + a ** (n + 1) - INNER ** (n + 1)) ** (1 / (n + 1)) / R
        return n * (ratio**2 - ratio ** (-2 * n)) / (R * ratio ** (n + 1))

    return quad(integrand, INNER, OUTER)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kinematics", "n", "top"), [("plane_strain", 1, 0.4), ("axisymmetric", 2, 0.5)]
)
def test_thick_shells_under_pressure(kinematics, n, top):
    """Nearly incompressible, K/mu = 2000: radii in closed form."""
    problem, p = quarter(kinematics, 6)
    for share in (0.6, 1.0):
        p.value = share * top
        dm.newton(problem, max_it=60)
        problem.commit()
    u, x = problem.u, problem.V.tabulate_dof_coordinates()
    r = np.hypot(*(x[:, :2] + u.x.array.reshape(-1, 2)).T)
    radii = COMM.allgather(r[np.isclose(np.hypot(x[:, 0], x[:, 1]), INNER)])
    assert exact_pressure(float(np.concatenate(radii).mean()), n) == pytest.approx(top, rel=0.01)


def test_a_pressure_beyond_what_a_shell_bears():
    """A thick ball bears at most 0.89: the error says what the tangents were, and what to do."""
    problem, p = quarter("axisymmetric", 3)
    p.value = 0.3
    dm.newton(problem)
    problem.commit()
    before = problem.u.x.array.copy()
    p.value = 2.0
    with failing(problem, "indefinite in ", "prescribe displacements"):
        dm.newton(problem)
    assert np.array_equal(problem.u.x.array, before)


def skin(domain):
    return tag_facets(domain, lambda x: np.full(x.shape[1], True))


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_the_tangent_of_an_open_side_is_the_symmetric_part(cell):
    """v.K w is the mean of v.dF[w] and w.dF[v], of a side with free edges that has turned far.

    What is left out is half of their difference, nothing where a potential is declared.
    """
    domain = create_domain(cell, 3)  # nodes inside of the side, too
    u, d = create_displacement(domain), domain.geometry.dim
    v, w = (fem.Function(u.function_space) for _ in range(2))
    tags = tag_facets(domain, plane(0, 1.0))
    solid = dm.Solid(u, dm.NeoHooke(10.0, 0.3), strain="finite")
    pressure, K = dm.Pressure(solid, tags, 1, 2.0), solid.create_matrix()
    R = np.eye(d)
    R[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    u.interpolate(lambda x: R @ x[:d] - x[:d] + 0.1 * np.sin(x[:d]))
    set_wave(v, 1.0)
    set_wave(w, 1.0, 0.7)
    K.zeroEntries()
    pressure.add_tangent(K)
    K.assemble()
    start, t = u.x.array.copy(), 1e-5

    def change(along):
        sides = []
        for sign in (1, -1):
            u.x.array[:] = start + sign * t * along.x.array
            F = K.createVecLeft()
            pressure.add_forces(F)
            sides.append(F)
        u.x.array[:] = start
        return (sides[0] - sides[1]) / (2 * t)

    one, other = change(w).dot(v.x.petsc_vec), change(v).dot(w.x.petsc_vec)
    assert abs(one - other) > 1e-2 * abs(one)  # no potential
    found = v.x.petsc_vec.dot(K * w.x.petsc_vec)
    assert found == pytest.approx((one + other) / 2, rel=1e-7)
    skew = v.x.petsc_vec.dot(pressure.skew() * w.x.petsc_vec)
    assert skew == pytest.approx((one - other) / 2, rel=1e-7)
    assert dm.Pressure(solid, tags, 1, 2.0, closed=True).skew() is None


def press_askew(p, *, skew=True):
    """Press a block from one side, where it is free, against a tool at its other side.

    Return the iterations of steps to a pressure p, and the force on the tool.
    """
    domain = create_domain("quadrilateral", 6)
    u = create_displacement(domain)
    V = u.function_space
    tags = tag_facets(domain, lambda x: plane(0)(x) & (x[1] > 0.75), plane(0, 1.0))
    solid = dm.Solid(u, dm.NeoHooke(3.0, 0.3), strain="finite")
    value = fem.Constant(domain, default_scalar_type(0.0))
    pressure = dm.Pressure(solid, tags, 1, value)
    if not skew:
        pressure.skew = lambda: None
    bc = hold(V, plane(1))
    tool = dm.Obstacle(tags, slave=2, shape=dm.shapes.Plane((1.02, 1.0), (-1.0, 0.0)))
    problem, iterations = dm.ContactProblem(solid, [tool], bcs=[bc], terms=[pressure]), []
    for k in range(1, 6):
        value.value = p * k / 5
        iterations.append(dm.newton(problem).newton_iterations)
        problem.commit()
    return iterations, tool.tool_force


@pytest.mark.mpi
def test_where_contact_is_closed_the_tangent_of_an_open_side_is_whole():
    """With the symmetric part alone steps to p = .2 E take 6 to 14 iterations."""
    few, force = press_askew(0.6)
    many, same = press_askew(0.6, skew=False)
    assert max(few) <= 4 < min(many)
    assert np.allclose(force, same, rtol=3e-6, atol=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "degree", "law"),
    [
        ("triangle", 1, dm.NeoHooke(10.0, 0.3)),
        ("quadrilateral", 2, dm.Elastic(10.0, 0.3)),
    ],
)
def test_the_edge_of_a_plate_has_the_pressure_on_its_present_thickness(cell, degree, law):
    """Pressed along y alone, a plate has the stress -p in all of it, and thickens by 3 %."""
    domain = rectangle([(0, 0), (1, 1)], (3, 2), cell)
    tags = tag_facets(domain, plane(1, 1.0))

    def pressure(solid):
        return [dm.Pressure(solid, tags, 1, 1.0)]

    how = {"kinematics": "plane_stress", "strain": "finite", "degree": degree}
    problem = stand(domain, law, rollers, [], pressure, **how)
    dm.newton(problem, rtol=1e-9)
    solid = problem.solid
    assert solid.max("stress_yy") == pytest.approx(-1.0, rel=1e-7)
    assert np.allclose(solid.fields.values("stress_yy"), -1.0, rtol=1e-7)
    assert np.abs(solid.fields.values("stress_xx")).max(initial=0.0) < 1e-7


def pressed_top(p):
    """Return bodies, a pressure on their top, 1 long, facets unsorted, and p as a Constant."""
    domain = create_domain("quadrilateral", 4)
    solid = dm.Solid(create_displacement(domain), dm.NeoHooke(1.0, 0.3), strain="finite")
    top = tag_facets(domain, plane(1, 2.0)).indices[::-1].copy()
    tags = mesh.meshtags(domain, 1, top, np.ones_like(top))
    p = fem.Constant(domain, default_scalar_type(p))
    return solid, dm.Pressure(solid, tags, 1, p), p


@pytest.mark.mpi
def test_a_pressure_that_is_no_number():
    """An error of its own, before the audit, whose eigenvalues do not exist."""
    solid, pressure, p = pressed_top(np.nan)
    work = p * ufl.inner(solid.u, ufl.TestFunction(solid.V)) * ufl.dx
    for term in (pressure, dm.WeakForm(solid, residual=work)):
        with rejected("terms[0]", "at the present displacement", "check its coefficients"):
            dm.newton(dm.ContactProblem(solid, [], terms=[term]))


@pytest.mark.mpi
def test_a_pressure_acts_on_all_of_a_side():
    """The sum of its forces at u = 0, p times the length, in whatever order the facets are."""
    solid, pressure, _ = pressed_top(3.0)
    F = solid.create_matrix().createVecLeft()
    pressure.add_forces(F)
    forces = COMM.allreduce(F.array_r.reshape(-1, 2).sum(axis=0))
    np.testing.assert_allclose(forces, [0.0, 3.0], atol=1e-14)


def flap(*, held=False):
    """Return a strip, its left end held, perhaps the right one, with a pressure on its top."""
    domain = rectangle([(1, 1), (2, 1.05)], (10, 1))
    tags, ends = tag_facets(domain, plane(1, 1.05)), (1.0, 2.0) if held else (1.0,)

    def support(V):
        return [hold(V, lambda x: np.isin(x[0].round(9), ends))]

    def pressure(solid):
        return [dm.Pressure(solid, tags, 1, 5e-4, closed=True)]

    law, how = dm.NeoHooke(200.0, 0.3), {"degree": 2, "strain": "finite"}
    problem = stand(domain, law, support, [], pressure, **how)
    return problem, problem.terms.named[-1][1]


@pytest.mark.mpi
def test_a_pressure_said_to_be_closed_that_is_not():
    """Its right edge is free: the line search fails, and the error says why."""
    problem, pressure = flap()
    assert not pressure.has_potential(~problem.supports.owned)
    with failing(problem, "line search", "closed=True", "leave it out"):
        dm.newton(problem)
    problem, pressure = flap(held=True)
    assert pressure.has_potential(~problem.supports.owned)
    assert dm.newton(problem).converged


@pytest.mark.parametrize(
    ("solid", "tags", "value", "words"),
    [
        ({"strain": "small"}, skin, 1.0, ("strain='finite'",)),
        ({"kinematics": "plane_stress"}, skin, 1.0, ("closed", "plane stress")),
        ({}, lambda domain: tag_facets(domain, plane(0, 9.0)), 1.0, ("no facet",)),
        ({}, skin, ufl.TestFunction, ("without a test function",)),
        (
            {},
            lambda domain: mesh.meshtags(domain, 1, np.arange(8, dtype=np.int32), 1),
            1.0,
            ("tag is 1", "facets inside the mesh"),
        ),
    ],
)
def test_what_pressure_needs(solid, tags, value, words):
    domain = create_domain("quadrilateral", 2)
    finite = solid.get("strain") != "small"
    law = dm.NeoHooke(1.0, 0.3) if finite else dm.Elastic(1.0, 0.3)
    options = {"strain": "finite"} | solid
    body = dm.Solid(create_displacement(domain), law, **options)
    with rejected("Pressure", *words):
        value = value(body.V)[0] if callable(value) else value
        dm.Pressure(body, tags(domain), 1, value, closed=True)


def test_closed_is_true_or_false():
    solid, _, _ = pressed_top(1.0)
    with rejected("Pressure", "closed is 'no'"):
        dm.Pressure(solid, skin(solid.mesh), 1, 1.0, closed="no")
