# SPDX-License-Identifier: MIT
"""Forces and springs on single nodes: statics, derivatives, ranks, and points that are none."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.meshes import two_blocks
from tests.cases.pressed_blocks import COMM, rejected

SIZE = np.array([2.0, 1.0, 1.5])
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
WAY = np.array([[2.0, -1.0, 0.5], [-1.0, 3.0, 0.0], [0.5, 0.0, 1.0]])  # positive definite


def create_solid(cell="quadrilateral", degree=1, law=None):
    """Return an elastic block from the origin to SIZE."""
    d = 2 if cell in CELLS[:2] else 3
    if d == 2:
        domain = mesh.create_rectangle(COMM, [(0, 0), SIZE[:2]], (4, 2), mesh.CellType[cell])
    else:
        domain = mesh.create_box(COMM, [(0, 0, 0), SIZE], (2, 2, 2), mesh.CellType[cell])
    u = fem.Function(fem.functionspace(domain, ("Lagrange", degree, (d,))))
    return dm.Solid(u, law or dm.Elastic(E=100.0, nu=0.3))


def moved(solid, point):
    """Return the displacement of the node at a point, on all ranks."""
    n, d = solid.V.dofmap.index_map.size_local, len(point)
    at = np.isclose(solid.V.tabulate_dof_coordinates()[:n, :d], point).all(axis=1)
    found = np.where(at[:, None], solid.u.x.array.reshape(-1, d)[:n], 0.0).sum(axis=0)
    return COMM.allreduce(found)


def clamp(V, where=lambda x: np.isclose(x[0], 0.0)):
    facets = mesh.locate_entities_boundary(V.mesh, V.mesh.topology.dim - 1, where)
    dofs = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)
    return fem.dirichletbc(np.zeros(V.mesh.geometry.dim, default_scalar_type), dofs, V)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_forces_and_tangent_are_derivatives(cell):
    """Of a quadratic energy differences of any length are exact."""
    solid = create_solid(cell, degree=2)
    d = solid.mesh.geometry.dim
    corner, middle = SIZE[:d], np.r_[0.0, SIZE[1:d] / 2]
    terms = [
        dm.PointForce(solid.V, corner, np.arange(1.0, 1.0 + d)),
        dm.PointSpring(solid.V, corner, WAY[:d, :d]),
        dm.PointSpring(solid.V, middle, 7.0),
    ]
    problem = dm.ContactProblem(solid, bcs=[clamp(solid.V)], terms=terms)
    rng, n = np.random.default_rng(3), problem.owned_u.size
    u, w = rng.normal(size=(2, n))

    def at(t):
        problem.owned_u[:] = u + t * w
        F, energy = problem.vector(), 0.0
        for term in terms:
            term.add_forces(F)
            energy += term.energy().sum()
        return COMM.allreduce(energy), F.array_r.copy()

    K, (e1, f1), (e0, f0), (_, f) = problem.terms.stiffness(), at(1.0), at(-1.0), at(0.0)
    power = COMM.allreduce(f @ w)
    assert (e1 - e0) / 2 == pytest.approx(power, rel=1e-12)
    np.testing.assert_allclose((f1 - f0) / 2, (K * problem.vector(w)).array_r, atol=1e-13)
    assert K.isSymmetric()
    trace = COMM.allreduce(K.getDiagonal().array_r.sum())
    assert trace == pytest.approx(np.trace(WAY[:d, :d]) + 7.0 * d)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_springs_of_a_block_that_nothing_else_holds(cell):
    """As many springs as rigid motions: their forces are those of statics, whatever the block."""
    solid = create_solid(cell)
    d = solid.mesh.geometry.dim
    e, k, f = np.eye(d), 30.0, np.array([5.0, -3.0, 2.0])[:d]
    pins = [(np.zeros(d), e[0]), (np.zeros(d), e[1]), (SIZE[:d] * e[0], e[1])]
    if d == 3:
        pins += [(SIZE * e[1], e[0]), *((p, e[2]) for p in (np.zeros(3), SIZE * e[0], SIZE * e[1]))]
        pins.pop(3)  # five of six would do without it
    springs = [dm.PointSpring(solid.V, point, k * np.outer(n, n)) for point, n in pins]
    load = dm.PointForce(solid.V, SIZE[:d] * [0.5, 1.0, 1.0][:d], f)
    problem = dm.ContactProblem(solid, terms=[*springs, load])
    dm.newton(problem, rtol=1e-10)
    place = np.zeros((len(pins) + 1, 3))
    force = np.zeros_like(place)
    for i, (point, n) in enumerate(pins):
        place[i, :d] = point
        force[i, :d] = -k * n * (n @ moved(solid, point))
    place[-1, :d], force[-1, :d] = SIZE[:d] * [0.5, 1.0, 1.0][:d], f
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(place, force).sum(axis=0), 0.0, atol=1e-9)
    if d == 2:
        expected = [(-f[0], 0.0), (0.0, -f[1] - (f[0] - f[1]) / 2), (0.0, (f[0] - f[1]) / 2)]
        np.testing.assert_allclose(force[:3, :2], expected, atol=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_reaction_of_a_clamped_block_and_a_ramp(degree):
    """The clamp takes force and moment, at each value of the Constant."""
    solid = create_solid(degree=degree)
    f = fem.Constant(solid.mesh, np.zeros(2, dtype=default_scalar_type))
    point = np.array([1.5, 1.0]) if degree == 1 else np.array([1.75, 1.0])
    base = clamp(solid.V)
    problem = dm.ContactProblem(solid, bcs=[base], terms=[dm.PointForce(solid.V, point, f)])
    ramp = {f: [(0.0, (0.0, 0.0)), (1.0, (1.0, -2.0))]}
    for step in dm.load_steps(problem, [0.5, 1.0], ramp=ramp):
        found = dm.reaction(problem, base)
        force = step.time * np.array([1.0, -2.0])
        np.testing.assert_allclose(found.force, -force, atol=1e-10)
        assert found.moment == pytest.approx(-(point[0] * force[1] - point[1] * force[0]), abs=1e-9)
    f.value[0] = np.nan
    with rejected("PointForce: value is [nan", "2 finite components"):
        dm.newton(problem, level=2.0)


@pytest.mark.mpi
def test_a_force_that_presses_a_block_on_a_plane():
    """The plane takes the force, the spring beside it nothing: a frictionless block stands."""
    solid = create_solid()
    tags = mesh.locate_entities_boundary(solid.mesh, 1, lambda x: np.isclose(x[1], 0.0))
    tags = mesh.meshtags(solid.mesh, 1, np.sort(tags), np.ones_like(tags))
    floor = dm.Obstacle(tags, slave=1, shape=dm.shapes.Plane((0.0, 0.0), (0.0, 1.0)))
    aside = np.diag([40.0, 0.0])
    terms = [
        dm.PointSpring(solid.V, (0.0, 0.0), aside),
        dm.PointForce(solid.V, (1.0, 1.0), (0.0, -6.0)),
    ]
    problem = dm.ContactProblem(solid, [floor], terms=terms)
    dm.newton(problem)
    np.testing.assert_allclose(floor.force, [0.0, 6.0], atol=1e-9)
    assert moved(solid, (0.0, 0.0))[0] == pytest.approx(0.0, abs=1e-10)


BAD = {
    "no node": ((0.3, 0.1), "PointForce: point [0.3, 0.1] is no node", "nearest one is (0.5, 0)"),
    "numbers": ((1.0, 0.0, 0.0), "point is (1.0, 0.0, 0.0)", "2 finite coordinates"),
    "NaN": ((1.0, np.nan), "2 finite coordinates"),
    "text": ("tip", "point is 'tip'", "2 finite coordinates"),
}


@pytest.mark.mpi
@pytest.mark.parametrize("name", BAD)
def test_points_that_are_none(name):
    point, *words = BAD[name]
    V = create_solid().V
    with rejected(*words):
        dm.PointForce(V, point, (0.0, 1.0))
    with rejected("PointSpring", *(word.replace("PointForce", "") for word in words)):
        dm.PointSpring(V, point, 1.0)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "k", [-1.0, np.nan, "stiff", np.eye(3), np.diag([1.0, -1.0]), [[1.0, 2.0], [0.0, 4.0]]]
)
def test_stiffnesses_that_are_none(k):
    with rejected("PointSpring: stiffness is", "k >= 0", "2 x 2"):
        dm.PointSpring(create_solid().V, (0.0, 0.0), k)


@pytest.mark.mpi
def test_values_and_spaces_that_are_none():
    solid, other = create_solid(), create_solid()
    V = solid.V
    for value in (1.0, (1.0, np.inf), "down", fem.Constant(solid.mesh, 1.0)):
        with rejected("PointForce: value is", "2 finite components"):
            dm.PointForce(V, (0.0, 0.0), value)
    with rejected("PointForce: V is", "solid.V"):
        dm.PointForce(solid, (0.0, 0.0), (0.0, 1.0))
    with rejected("PointSpring: V has no displacement"):
        dm.PointSpring(fem.functionspace(solid.mesh, ("Lagrange", 1)), (0.0, 0.0), 1.0)
    term = dm.PointSpring(V, (0.0, 0.0), 1.0)
    with rejected("PointSpring", "acts in a problem"):
        term.energy()
    with rejected("PointSpring: V is not the space of solid.u"):
        dm.ContactProblem(other, terms=[term])
    dm.ContactProblem(solid, terms=[term])
    dm.ContactProblem(solid, terms=[term])
    again = dm.Solid(fem.Function(V), dm.Elastic(E=1.0, nu=0.3))
    with rejected("PointSpring", "another problem"):
        dm.ContactProblem(again, terms=[term])


@pytest.mark.mpi
def test_a_point_where_two_bodies_touch():
    domain, _, _ = two_blocks(COMM)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    with rejected("PointForce: 2 bodies have a node at the point [0.0, 0.0]", "do not touch"):
        dm.PointForce(V, (0.0, 0.0), (0.0, 1.0))
    dm.PointForce(V, (0.0, 1.0), (0.0, 1.0))


@pytest.mark.mpi
def test_ranks_give_the_same():
    if COMM.size == 1:
        return
    V, last = create_solid().V, COMM.rank == COMM.size - 1
    with rejected("point differs between the ranks"):
        dm.PointForce(V, (2.0, 0.0 if last else 1.0), (0.0, 1.0))
    with rejected("stiffness differs between the ranks"):
        dm.PointSpring(V, (2.0, 0.0), 2.0 if last else 1.0)
