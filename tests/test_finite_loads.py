# SPDX-License-Identifier: MIT
"""A pressure that follows its surface: closed solutions, its derivatives, and no locking."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.pressed_blocks import COMM, failing, rejected
from tests.cases.solid import create_displacement, create_domain, set_wave

INNER, OUTER = 1.0, 2.0


def quarter(kinematics, n, nu_like=2000.0, law=None):
    """Return a quarter of a thick cylinder, or of a sphere's section, with a pressure inside."""
    shape = (n, 2 * n)
    domain = mesh.create_rectangle(COMM, [(0, 0), (1, 1)], shape, mesh.CellType.quadrilateral)
    x = domain.geometry.x
    r, a = INNER + (OUTER - INNER) * x[:, 0], np.pi / 2 * x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(a), r * np.sin(a)
    u = create_displacement(domain)
    V, bcs = u.function_space, []
    for i in range(2):
        flat = mesh.locate_entities_boundary(
            domain, 1, lambda x, i=i: np.isclose(x[i], 0.0, atol=1e-9)
        )
        dofs = fem.locate_dofs_topological(V.sub(i), 1, flat)
        bcs.append(fem.dirichletbc(default_scalar_type(0.0), dofs, V.sub(i)))
    found = mesh.locate_entities_boundary(
        domain, 1, lambda x: np.isclose(np.hypot(x[0], x[1]), INNER, atol=1e-9)
    )
    tags = mesh.meshtags(domain, 1, np.sort(found), np.full(len(found), 7, dtype=np.int32))
    how = {"kinematics": kinematics, "strain": "finite"}
    if law is None:
        law, how["volumetric"] = dm.MooneyRivlin(0.5, 0.0, nu_like), "reduced"
    solid, p = dm.Solid(u, law, **how), fem.Constant(domain, default_scalar_type(0.0))
    pressure = dm.Pressure(solid, tags, 7, p, closed=kinematics != "plane_stress")
    return dm.ContactProblem(solid, [], bcs=bcs, terms=[pressure]), pressure, p


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
    """Nearly incompressible, K/mu = 2000: radii in closed form; forces and tangent of p V."""
    problem, pressure, p = quarter(kinematics, 6)
    for share in (0.6, 1.0):
        p.value = share * top
        dm.newton(problem, max_it=60)
        problem.commit()
    u, x = problem.u, problem.V.tabulate_dof_coordinates()
    r = np.hypot(*(x[:, :2] + u.x.array.reshape(-1, 2)).T)
    radii = COMM.allgather(r[np.isclose(np.hypot(x[:, 0], x[:, 1]), INNER)])
    assert exact_pressure(float(np.concatenate(radii).mean()), n) == pytest.approx(top, rel=0.01)

    rng = np.random.default_rng(4)
    v = fem.Function(problem.V)
    v.x.array[:] = rng.standard_normal(v.x.array.size)
    for i in range(2):  # the edges of the surface slide in planes through the origin
        v.x.array[i::2][np.isclose(x[:, i], 0.0)] = 0.0
    v.x.scatter_forward()
    start, K, t = u.x.array.copy(), problem.solid.create_matrix(), 1e-6
    pressure.add_tangent(K)
    K.assemble()
    change = (K * v.x.petsc_vec).array.copy()

    def at(s):
        u.x.array[:] = start + s * v.x.array
        F = K.createVecLeft()
        pressure.add_forces(F)
        return COMM.allreduce(pressure.energy()), F.array.copy()

    (above, F), (below, G), (_, here) = at(t), at(-t), at(0.0)
    free = np.ones((len(here) // 2, 2), dtype=bool)
    free &= ~np.isclose(x[: len(free), :2], 0.0)
    work = COMM.allreduce(here @ v.x.array[: len(here)])
    assert (above - below) / (2 * t) == pytest.approx(work, rel=1e-7)
    off = np.abs((F - G) / (2 * t) - change)[free.ravel()].max(initial=0.0)
    assert off < 1e-7 * max(COMM.allgather(np.abs(change).max(initial=0.0)))


def test_a_pressure_beyond_what_a_shell_bears():
    """A thick ball bears at most 0.89: the error says what the tangents were, and what to do."""
    problem, _, p = quarter("axisymmetric", 3)
    p.value = 0.3
    dm.newton(problem)
    problem.commit()
    before = problem.u.x.array.copy()
    p.value = 2.0
    with failing(problem, "indefinite in ", "prescribe displacements"):
        dm.newton(problem)
    assert np.array_equal(problem.u.x.array, before)


def test_pressure_turns_with_the_body():
    """Forces on a turned square are the turned forces, and those of a closed surface cancel."""
    domain = create_domain("quadrilateral", 3)
    u = create_displacement(domain)
    domain.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(domain.topology)
    tags = mesh.meshtags(domain, 1, facets, np.ones(len(facets), dtype=np.int32))
    solid = dm.Solid(u, dm.NeoHooke(10.0, 0.3), strain="finite")
    pressure, K = dm.Pressure(solid, tags, 1, 2.0, closed=True), solid.create_matrix()

    def forces():
        F = K.createVecLeft()
        pressure.add_forces(F)
        return F.array.reshape(-1, 2).copy()

    before = forces()
    R = np.array([[0.0, -1.0], [1.0, 0.0]])
    u.interpolate(lambda x: R @ x[:2] - x[:2])
    after = forces()
    assert np.allclose(after, before @ R.T, atol=1e-13)
    assert np.abs(COMM.allreduce(after.sum(axis=0))).max() < 1e-13
    assert COMM.allreduce(pressure.energy()) == pytest.approx(2.0 * 2.0)  # p times the area 1 x 2


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_the_tangent_of_an_open_side_is_the_symmetric_part(cell):
    """v.K w is the mean of v.dF[w] and w.dF[v], of a side with free edges that has turned far.

    What is left out is half of their difference, nothing where a potential is declared.
    """
    domain = create_domain(cell, 3)  # nodes inside of the side, too
    u, d = create_displacement(domain), domain.geometry.dim
    v, w = (fem.Function(u.function_space) for _ in range(2))
    right = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(x[0], 1.0))
    tags = mesh.meshtags(domain, d - 1, np.sort(right), np.full(len(right), 1, dtype=np.int32))
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
    nodes = u.function_space.dofmap.index_map.size_local
    X = u.function_space.tabulate_dof_coordinates()[:nodes, :d]
    ends = np.isclose(X[:, 1:], 0.0) | np.isclose(X[:, 1:], (2.0, 1.5)[: d - 1])
    rim = np.isclose(X[:, 0], 1.0) & ends.any(axis=1)
    said, free = dm.Pressure(solid, tags, 1, 2.0, closed=True), np.ones((nodes, d), dtype=bool)
    assert said.skew() is None
    assert not pressure.has_potential(free) and not said.has_potential(free)
    free[rim] = False
    assert said.has_potential(free)
    free[np.isclose(X[:, 0], 1.0)] = False  # no node of the side can move
    assert said.has_potential(free)


def press_askew(p, *, skew=True):
    """Press a block from one side, where it is free, against a tool at its other side.

    Return the iterations of steps to a pressure p, and the force on the tool.
    """
    domain = create_domain("quadrilateral", 6)
    u = create_displacement(domain)
    V = u.function_space
    left, right = (
        mesh.locate_entities_boundary(domain, 1, lambda x, at=at: np.isclose(x[0], at))
        for at in (0.0, 1.0)
    )
    left = left[mesh.compute_midpoints(domain, 1, left)[:, 1] > 0.9]
    both, sides = np.concatenate([left, right]), np.repeat([1, 2], [len(left), len(right)])
    order = np.argsort(both)
    tags = mesh.meshtags(domain, 1, both[order], sides[order].astype(np.int32))
    solid = dm.Solid(u, dm.NeoHooke(3.0, 0.3), strain="finite")
    value = fem.Constant(domain, default_scalar_type(0.0))
    pressure = dm.Pressure(solid, tags, 1, value)
    if not skew:
        pressure.skew = lambda: None
    base = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.0))
    bc = fem.dirichletbc(np.zeros(2, dtype=default_scalar_type), base, V)
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
        pytest.param("triangle", 1, dm.Elastic(10.0, 0.3), marks=pytest.mark.slow),
        pytest.param("quadrilateral", 2, dm.NeoHooke(10.0, 0.3), marks=pytest.mark.slow),
    ],
)
def test_the_edge_of_a_plate_has_the_pressure_on_its_present_thickness(cell, degree, law):
    """Pressed along y alone, a plate has the stress -p in all of it, and thickens by 3 %."""
    domain = mesh.create_unit_square(COMM, 3, 2, mesh.CellType[cell])
    V = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    solid = dm.Solid(fem.Function(V), law, kinematics="plane_stress", strain="finite")
    bcs = []
    for i in range(2):
        low = mesh.locate_entities_boundary(domain, 1, lambda x, i=i: np.isclose(x[i], 0.0))
        dofs = fem.locate_dofs_topological(V.sub(i), 1, low)
        bcs.append(fem.dirichletbc(default_scalar_type(0.0), dofs, V.sub(i)))
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 1.0))
    tags = mesh.meshtags(domain, 1, np.sort(top), np.full(len(top), 1, dtype=np.int32))
    pressure = dm.Pressure(solid, tags, 1, 1.0)
    dm.newton(dm.ContactProblem(solid, [], bcs=bcs, terms=[pressure]), rtol=1e-9)
    assert solid.max("stress_yy") == pytest.approx(-1.0, rel=1e-7)
    assert np.allclose(solid.fields.values("stress_yy"), -1.0, rtol=1e-7)
    assert np.abs(solid.fields.values("stress_xx")).max(initial=0.0) < 1e-7


def hole_under_pressure(p, mu, lame):
    """Return the inner radius of a plate of neo-Hooke's law with a pressure in its hole.

    dP_r/dR + (P_r - P_t) / R = 0, where P_i = mu (l_i - 1 / l_i) + lame ln J / l_i with the stretch
    z through the thickness from mu (z^2 - 1) + lame ln J = 0, so that P_i = mu (l_i - z^2 / l_i).
    On the present area P_r = -p l_t z inside, outside it is 0.
    """

    def through(a, b):
        z = np.ones_like(a)
        for _ in range(20):
            wrong = mu * (z**2 - 1) + lame * np.log(a * b * z)
            z = z - wrong / (2 * mu * z + lame / z)
        return z

    def along(a, b):
        return mu * (a - through(a, b) ** 2 / a)

    def rates(R, y):
        a, b, h = y[1], y[0] / R, 1e-5
        by_a = (along(a + h, b) - along(a - h, b)) / (2 * h)
        by_b = (along(a, b + h) - along(a, b - h)) / (2 * h)
        return np.stack([a, (along(b, a) - along(a, b) - by_b * (a - b)) / (R * by_a)])

    def ends(inner, outer):
        b = inner[0] / INNER
        return np.array(
            [along(inner[1], b) + p * b * through(inner[1], b), along(outer[1], outer[0] / OUTER)]
        )

    R = np.linspace(INNER, OUTER, 50)
    found = solve_bvp(rates, ends, R, np.stack([R, np.ones_like(R)]), tol=1e-8)
    assert found.success
    return found.y[0, 0]


def test_a_pressure_in_the_hole_of_a_plate():
    """The stretch on the edge is of first order in the cells of degree 1, and extrapolated here.

    On the thickness at X the hole would grow by 3 % more.
    """
    grown, errors = hole_under_pressure(1.0, 10.0 / 2.6, 3.0 / (1.3 * 0.4)) - INNER, []
    for n in (8, 16):
        problem, _, p = quarter("plane_stress", n, law=dm.NeoHooke(10.0, 0.3))
        p.value = 1.0
        dm.newton(problem)
        u, x = problem.u.x.array.reshape(-1, 2), problem.V.tabulate_dof_coordinates()
        inside = np.isclose(np.hypot(x[:, 0], x[:, 1]), INNER)
        errors.append(np.hypot(*u[inside].T).mean() / grown - 1)
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.05)
    assert abs(2 * errors[1] - errors[0]) < 0.001


def test_what_pressure_needs():
    domain = create_domain("quadrilateral", 2)
    u = create_displacement(domain)
    tags = mesh.meshtags(domain, 1, np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    with rejected("Pressure", "strain='finite'"):
        dm.Pressure(dm.Solid(u, dm.Elastic(1.0, 0.3)), tags, 1, 1.0)
    with rejected("Pressure", "closed", "plane stress"):
        plate = dm.Solid(u, dm.NeoHooke(1.0, 0.3), strain="finite", kinematics="plane_stress")
        domain.topology.create_connectivity(1, 2)
        skin = mesh.exterior_facet_indices(domain.topology)
        skin = mesh.meshtags(domain, 1, skin, np.ones(len(skin), dtype=np.int32))
        dm.Pressure(plate, skin, 1, 1.0, closed=True)
    solid = dm.Solid(u, dm.NeoHooke(1.0, 0.3), strain="finite")
    with rejected("Pressure", "no facet"):
        dm.Pressure(solid, tags, 1, 1.0)
    with rejected("Pressure", "without a test function"):
        dm.Pressure(solid, skin, 1, ufl.TestFunction(u.function_space)[0])
    with rejected("Pressure", "closed is 'no'"):
        dm.Pressure(solid, skin, 1, 1.0, closed="no")
    every = np.arange(domain.topology.index_map(1).size_local, dtype=np.int32)
    with rejected("Pressure", "tag is 1", "facets inside the mesh"):
        dm.Pressure(solid, mesh.meshtags(domain, 1, every, np.ones_like(every)), 1, 1.0)


def pressed_top(p, *, rising=True):
    """Return bodies, a pressure on their top, 1 long, and p as a Constant."""
    domain = create_domain("quadrilateral", 4)
    solid = dm.Solid(create_displacement(domain), dm.NeoHooke(1.0, 0.3), strain="finite")
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 2.0))
    top = np.sort(top)[:: 1 if rising else -1].copy()
    tags = mesh.meshtags(domain, 1, top, np.ones_like(top))
    p = fem.Constant(domain, default_scalar_type(p))
    return solid, dm.Pressure(solid, tags, 1, p), p


@pytest.mark.mpi
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_pressure_that_is_no_number(value):
    """An error of its own, before the audit, whose eigenvalues do not exist."""
    solid, pressure, p = pressed_top(value)
    work = p * ufl.inner(solid.u, ufl.TestFunction(solid.V)) * ufl.dx
    for term in (pressure, dm.WeakForm(solid, residual=work)):
        with rejected("terms[0]", "at the present displacement", "check its coefficients"):
            dm.newton(dm.ContactProblem(solid, [], terms=[term]))


@pytest.mark.mpi
@pytest.mark.parametrize("rising", [True, False])
def test_a_pressure_acts_on_all_of_a_side(rising):
    """The sum of its forces at u = 0, p times the length, in whatever order the facets are."""
    solid, pressure, _ = pressed_top(3.0, rising=rising)
    F = solid.create_matrix().createVecLeft()
    pressure.add_forces(F)
    forces = COMM.allreduce(F.array_r.reshape(-1, 2).sum(axis=0))
    np.testing.assert_allclose(forces, [0.0, 3.0], atol=1e-14)


def flap(p, *, closed, held=False):
    """Return a strip, its left end held, perhaps the right one, with a pressure on its top."""
    domain = mesh.create_rectangle(COMM, [(1, 1), (2, 1.05)], (10, 1), mesh.CellType.quadrilateral)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 2, (2,))))
    ends, top = (
        mesh.locate_entities_boundary(domain, 1, lambda x, i=i, a=a: np.isin(x[i].round(9), a))
        for i, a in ((0, (1.0, 2.0) if held else (1.0,)), (1, (1.05,)))
    )
    dofs = fem.locate_dofs_topological(u.function_space, 1, ends)
    support = fem.dirichletbc(np.zeros(2, dtype=default_scalar_type), dofs, u.function_space)
    tags = mesh.meshtags(domain, 1, np.sort(top), np.full(len(top), 1, dtype=np.int32))
    solid = dm.Solid(u, dm.NeoHooke(200.0, 0.3), strain="finite")
    pressure = dm.Pressure(solid, tags, 1, p, closed=closed)
    return dm.ContactProblem(solid, [], bcs=[support], terms=[pressure]), pressure


@pytest.mark.mpi
def test_a_pressure_said_to_be_closed_that_is_not():
    """Its right edge is free: the line search fails, and the error says why."""
    problem, _ = flap(5e-4, closed=True)
    with failing(problem, "line search", "closed=True", "leave it out"):
        dm.newton(problem)
    problem, pressure = flap(5e-4, closed=True, held=True)
    assert pressure.has_potential(~problem.supports.owned)
    assert dm.newton(problem).converged


@pytest.mark.mpi
def test_a_step_that_fails_without_the_potential_of_a_pressure():
    problem, _ = flap(5e-3, closed=False)
    with failing(problem, "no potential", "smaller load steps"):
        dm.newton(problem, max_it=12)
