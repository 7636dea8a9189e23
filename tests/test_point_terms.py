# SPDX-License-Identifier: MIT
"""Forces and springs on single nodes: statics, derivatives, ranks, and points that are none."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from tests.cases.pressed_blocks import COMM, PressedBlocks, rejected
from tests.cases.solid import create_displacement, hold, plane, rectangle

SIZE = np.array([2.0, 1.0, 1.5])
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]


def create_solid(cell="quadrilateral", degree=1):
    d = 2 if cell in CELLS[:2] else 3
    domain = rectangle([d * [0.0], SIZE[:d]], (4, 2) if d == 2 else (2, 2, 2), cell)
    return dm.Solid(create_displacement(domain, degree), dm.Elastic(E=100.0, nu=0.3))


def moved(solid, point):
    n, d = solid.V.dofmap.index_map.size_local, len(point)
    at = np.isclose(solid.V.tabulate_dof_coordinates()[:n, :d], point).all(axis=1)
    found = np.where(at[:, None], solid.u.x.array.reshape(-1, d)[:n], 0.0).sum(axis=0)
    return COMM.allreduce(found)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_springs_of_a_block_that_nothing_else_holds(cell):
    """As many springs as rigid motions: their forces are those of statics, whatever the block."""
    solid = create_solid(cell)
    d = solid.mesh.geometry.dim
    e, k, f = np.eye(d), 30.0, np.array([5.0, -3.0, 2.0])[:d]
    pins = [(np.zeros(d), e[0]), (np.zeros(d), e[1]), (SIZE[:d] * e[0], e[1])]
    if d == 3:
        pins += [(p, e[2]) for p in (np.zeros(3), SIZE * e[0], SIZE * e[1])]
    springs = [dm.PointSpring(solid.V, point, k * np.outer(n, n)) for point, n in pins]
    load = dm.PointForce(solid.V, SIZE[:d] * [0.5, 1.0, 1.0][:d], f)
    problem = dm.ContactProblem(solid, terms=[*springs, load])
    dm.newton(problem, rtol=1e-10)
    forces = [-k * n * (n @ moved(solid, point)) for point, n in pins] + [f]
    places = [point for point, _ in pins] + [SIZE[:d] * [0.5, 1.0, 1.0][:d]]
    moments = np.einsum("ki,kj->ij", places, forces)
    np.testing.assert_allclose(np.sum(forces, axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(moments - moments.T, 0.0, atol=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_reaction_of_a_clamped_block_and_a_ramp(degree):
    """The clamp takes force and moment, at each value of the Constant."""
    solid = create_solid(degree=degree)
    f = fem.Constant(solid.mesh, np.zeros(2, dtype=default_scalar_type))
    point = np.array([1.5, 1.0]) if degree == 1 else np.array([1.75, 1.0])
    base = hold(solid.V, plane(0))
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


NO_NODE = "point [0.3, 0.1] is no node", "nearest one is (0.5, 0)"
BAD = [
    ((0.3, 0.1), 1.0, NO_NODE),
    ((1.0, np.nan), 1.0, ("point is (1.0, nan)", "2 finite coordinates")),
    *(
        ((0.0, 0.0), k, ("stiffness is", "k >= 0", "2 x 2"))
        for k in (-1.0, [[1.0, 2.0], [0.0, 4.0]])
    ),
]


@pytest.mark.mpi
@pytest.mark.parametrize(("point", "k", "words"), BAD)
def test_springs_that_are_none(point, k, words):
    with rejected("PointSpring", *words):
        dm.PointSpring(create_solid().V, point, k)


@pytest.mark.mpi
def test_values_and_spaces_that_are_none():
    solid, other = create_solid(), create_solid()
    V = solid.V
    with rejected("PointForce: value is", "2 finite components"):
        dm.PointForce(V, (0.0, 0.0), (1.0, np.inf))
    with rejected("PointForce: V is", "solid.V"):
        dm.PointForce(solid, (0.0, 0.0), (0.0, 1.0))
    with rejected("PointSpring: V has no displacement"):
        dm.PointSpring(fem.functionspace(solid.mesh, ("Lagrange", 1)), (0.0, 0.0), 1.0)
    term = dm.PointSpring(V, (0.0, 0.0), 1.0)
    with rejected("PointSpring", "acts in a problem"):
        term.energy()
    with rejected("PointSpring: V is not the space of solid.u"):
        dm.ContactProblem(other, terms=[term])
    for _ in range(2):
        dm.ContactProblem(solid, terms=[term])
    again = dm.Solid(fem.Function(V), dm.Elastic(E=1.0, nu=0.3))
    with rejected("PointSpring", "another problem"):
        dm.ContactProblem(again, terms=[term])


@pytest.mark.mpi
def test_a_point_where_two_bodies_touch():
    V = PressedBlocks().V
    with rejected("PointForce: 2 bodies have a node at the point [0.0, 0.0]", "do not touch"):
        dm.PointForce(V, (0.0, 0.0), (0.0, 1.0))
    dm.PointForce(V, (0.0, 1.0), (0.0, 1.0))
