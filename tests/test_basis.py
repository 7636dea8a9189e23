# SPDX-License-Identifier: MIT
"""The change of basis against dense matrices, and frames."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.mortar.duals import default_keep, node_weights
from dolfinx_mortar.mortar.integrals import find_segments
from tests.cases.block_piles import (
    ABOVE,
    BELOW,
    COMM,
    EAST,
    PILE,
    WEST,
    Blocks,
    chain,
    dense_transformation,
    to_dense,
    to_global,
)
from tests.cases.meshes import BOTTOM, LEFT, TOP
from tests.cases.mortar import node_matrices
from tests.cases.pressed_blocks import PressedBlocks

ROUND_OFF = 1e-12


# -- frames


# -- the change of basis


def choices(link):
    """Return D and M for each choice of nodes, assembled anew where there are several."""
    pairing, operators = link.mortar
    if isinstance(link.interface, dm.Contact):
        found = [(pairing.D.matrix(operators.D[:, 0]), pairing.M.matrix(operators.M[:, 0]))]
    else:
        points, _ = find_segments(pairing, None)
        weights, slave, found = node_weights(pairing, points), link.sides.slave, []
        for c in range(link.coupling.R.shape[1]):
            allowed = ~link.sides.fixed[slave.nodes, c] & ~link.banned[slave.nodes]
            keep = default_keep(pairing, points, *weights, allowed)
            found.append(node_matrices(pairing, points, keep))
    return [(to_dense(D), to_dense(M)) for D, M in found]


def expected_transformation(problem):
    """Return T = (I - Q)^-1 W from D, M, R and S, gathered, without the interfaces' products."""
    N, d = problem.V.dofmap.index_map.size_global, problem.d
    Q, W = np.zeros((N, d, N, d)), np.einsum("ij,ab->iajb", np.eye(N), np.eye(d))
    for i in problem.system.links:
        nodes = to_global(COMM, i.nodes + problem.V.dofmap.index_map.local_range[0])
        kept = i.coupling.kept.any(axis=1)
        kept, R, S = (to_global(COMM, a) for a in (kept, i.coupling.R, i.constrained))
        for a, (D, M) in enumerate(choices(i)):
            for j in np.flatnonzero(S[:, a]):
                node, r = nodes[j], R[j][:, a]
                P = (M[node] - D[node] * (np.arange(N) != node)) / D[node, node]
                Q[node] += np.einsum("a,b,l->alb", r, r, P)
        W[nodes[kept], :, nodes[kept]] = R[kept]
    size = d * N
    return np.linalg.solve(np.eye(size) - Q.reshape(size, size), W.reshape(size, size))


@pytest.mark.mpi
@pytest.mark.parametrize("kinds", [(dm.Contact, dm.Contact), (dm.Tie, dm.Contact)])
def test_transformation_of_a_chain(kinds):
    """Flat at first, then with inclined normals, in place; on any partition."""
    b, problem = chain(kinds, partition="stripes")
    problem.audit()
    assert len(problem.system.transformation.factors) == 2
    problem.solid.assemble_tangent(problem.K)
    K, x = to_dense(problem.K), b.V.tabulate_dof_coordinates()
    for way in (0.0, 0.05):
        b.u.x.array[:] = way * np.column_stack([np.sin(x[:, 1]), x[:, 0] ** 2]).ravel()
        problem.update_geometry()
        T = expected_transformation(problem)
        assert np.abs(dense_transformation(problem) - T).max() < ROUND_OFF
        transformed = to_dense(problem.system.transformation.transform(problem.K))
        assert np.abs(transformed - T.T @ K @ T).max() < ROUND_OFF * np.abs(K).max()


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "factors", "kind"), [("tetrahedron", 2, dm.Contact), ("hexahedron", 1, dm.Tie)]
)
def test_transformation_of_second_order_in_space(cell, factors, kind, rng):
    """Middles of six-node facets depend on their ends; some nodes are removed, some held."""
    case = PressedBlocks(
        d=3, degree=2, n_lower=(1, 1, 1), n_upper=(2, 1, 1), upper=(0.0, 1.3, 0.0, 0.8), cell=cell
    )
    bcs = [case.bc(BOTTOM), case.bc(TOP), case.roller(LEFT, 0)]
    problem = case.problem([kind(case.facets, slave=3, master=4)], bcs)
    problem.audit()
    T, basis = dense_transformation(problem), problem.system.transformation
    assert len(basis.factors) == factors
    assert np.abs(T - expected_transformation(problem)).max() < ROUND_OFF
    y, u = (problem.K.createVecRight() for _ in range(2))
    y.array[:] = rng.normal(size=len(T))[slice(*y.owner_range)]
    basis.apply(y, u)
    assert np.abs((basis.inverse(u) - y).array).max(initial=0.0) < ROUND_OFF
    assert np.abs((u - y - basis.change * y).array).max(initial=0.0) < ROUND_OFF


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_prescribed_components_of_slave_nodes(kind):
    """Dirichlet data on slave nodes with inclined normals hold exactly, in every component."""
    b = Blocks(PILE[:2])
    b.mesh.geometry.x[:, 1] += 0.2 * b.mesh.geometry.x[:, 0] ** 2
    bcs = [
        b.fix(1, BELOW, component=1),
        b.fix(1, EAST, component=0, value=2e-3),
        b.fix(1, WEST, component=0, value=-1e-3),
        b.fix(2, EAST, component=0, value=1e-3),
        b.fix(2, ABOVE, component=1, value=-1e-2),
    ]
    problem = b.problem([b.join(kind, (1, ABOVE), (2, BELOW))], bcs, geometry="reference")
    report = dm.newton(problem, rtol=1e-10)
    expected = fem.Function(b.V)
    expected.x.array[:] = b.u.x.array
    for bc in bcs:
        bc.set(expected.x.array)
    assert np.abs(b.u.x.array - expected.x.array).max(initial=0.0) < 1e-15
    assert report.certificate.equilibrium < 1e-9
