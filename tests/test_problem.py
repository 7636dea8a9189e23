# SPDX-License-Identifier: MIT
"""The change of basis against dense matrices, frames, bodies, problems of several interfaces."""

import json

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx_mortar.bodies import find_bodies
from dolfinx_mortar.frames import create_frames
from tests.block_piles import ABOVE, BELOW, EAST, WEST, create_blocks, to_dense, to_global

COMM = MPI.COMM_WORLD
STEEL = dm.Elastic(1000.0, 0.3)
ROUND_OFF = 1e-12

# a long block under two short ones, and a pile of three
BRIDGE = [(0.0, 3.0, -1.0, 0.0, 7, 2), (0.0, 1.3, 0.0, 1.0, 4, 3), (1.7, 3.0, 0.0, 1.0, 5, 2)]
PILE = [(0.0, 1.0, 0.0, 1.0, 3, 2), (0.0, 1.0, 1.0, 2.0, 4, 2), (0.0, 1.0, 2.0, 3.0, 5, 2)]


class Blocks:
    """Blocks, their space and the usual parts of a problem."""

    def __init__(self, boxes, **options):
        """Create mesh, space and displacement."""
        self.mesh, self.cells, self.facets = create_blocks(COMM, boxes, **options)
        self.V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.u = fem.Function(self.V, name="u")

    def fix(self, block, side, component=None, value=0.0):
        """Return a Dirichlet condition on a side; value may be a dolfinx Constant."""
        V = self.V if component is None else self.V.sub(component)
        dofs = fem.locate_dofs_topological(V, 1, self.facets.find(10 * block + side))
        if component is None and not isinstance(value, fem.Constant):
            value = np.full(2, value, dtype=default_scalar_type)
        elif not isinstance(value, fem.Constant):
            value = default_scalar_type(value)
        return fem.dirichletbc(value, dofs, V)

    def join(self, kind, slave, master):
        """Return an interface between two sides (block, side)."""
        tags = [10 * block + side for block, side in (slave, master)]
        return kind(self.facets, slave=tags[0], master=tags[1])

    def problem(self, interfaces, bcs, law=STEEL, **options):
        """Return the problem."""
        return dm.ContactProblem(dm.Solid(self.u, law, self.cells), interfaces, bcs=bcs, **options)

    def traction(self, block, side, value):
        """Return the virtual work of a traction."""
        ds = ufl.Measure("ds", self.mesh, subdomain_data=self.facets)
        value = fem.Constant(self.mesh, default_scalar_type(value))
        return ufl.inner(value, ufl.TestFunction(self.V)) * ds(10 * block + side)


def chain(kinds=(dm.Contact, dm.Contact), **options):
    """Return a problem in which the second interface's master nodes are slaves of the first."""
    b = Blocks(BRIDGE, **options)
    interfaces = [
        b.join(kinds[0], (1, ABOVE), (2, BELOW)),
        b.join(kinds[1], (3, BELOW), (1, ABOVE)),
    ]
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, value=-0.01), b.fix(3, ABOVE, value=-0.02)]
    return b, b.problem(interfaces, bcs)


# -- frames


@pytest.mark.parametrize("d", [2, 3])
def test_frames_are_orthonormal(d, rng):
    normals = rng.normal(size=(50, d))
    normals[:d] = np.eye(d)
    fixed = np.zeros((50, d), dtype=bool)
    fixed[10:30, 1] = True
    fixed[30:, 0] = d == 3
    normals[fixed] = 0.0
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    R, slot = create_frames(normals, fixed)
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(d)).max() < ROUND_OFF
    assert np.abs(R[:, :, 0] - normals).max() < ROUND_OFF
    assert np.array_equal(slot >= 0, fixed)
    for j, i in zip(*np.nonzero(fixed), strict=True):
        assert R[j, :, slot[j, i]] == pytest.approx(np.eye(d)[i], abs=ROUND_OFF)


# -- the change of basis


def dense_transformation(problem):
    """Return T = (I - Q)^-1 W from D, M, R and S, gathered, without the interfaces' products."""
    N, d = problem.V.dofmap.index_map.size_global, problem.d
    Q, W = np.zeros((N, d, N, d)), np.einsum("ij,ab->iajb", np.eye(N), np.eye(d))
    for i in problem.interfaces:
        D, M = to_dense(i.pairing.D), to_dense(i.pairing.M)
        nodes = to_global(COMM, i.pattern.nodes + problem.V.dofmap.index_map.local_range[0])
        kept, R, S = (to_global(COMM, a) for a in (i.kept.any(axis=1), i.R, i.S))
        for j, node in zip(np.flatnonzero(kept), nodes[kept], strict=True):
            P = (M[node] - D[node] * (np.arange(N) != node)) / D[node, node]
            Q[node] = np.einsum("ab,l->alb", R[j] @ np.diag(S[j]) @ R[j].T, P)
            W[node, :, node] = R[j]
    size = d * N
    return np.linalg.solve(np.eye(size) - Q.reshape(size, size), W.reshape(size, size))


@pytest.mark.mpi
@pytest.mark.parametrize(
    "kinds", [(dm.Contact, dm.Contact), (dm.Tie, dm.Contact), (dm.Tie, dm.Tie)]
)
def test_transformation_of_a_chain(kinds):
    _, problem = chain(kinds)
    problem.audit()
    assert len(problem.transformation.factors) == 2
    T = dense_transformation(problem)
    assert np.abs(to_dense(problem.transformation.T) - T).max() < ROUND_OFF
    problem.solid.assemble_tangent(problem.K)
    K = to_dense(problem.K)
    for _ in range(2):  # created, and refilled
        transformed = to_dense(problem.transformation.transform(problem.K))
        assert np.abs(transformed - T.T @ K @ T).max() < ROUND_OFF * np.abs(K).max()


@pytest.mark.parametrize("partition", ["graph", "stripes", "bodies"])
def test_transformation_follows_the_geometry(partition, rng):
    """Inclined normals, on any partition, in place."""
    b, problem = chain(partition=partition)
    problem.audit()
    before = to_dense(problem.transformation.T)
    x = b.V.tabulate_dof_coordinates()
    b.u.x.array[:] = 0.05 * np.column_stack([np.sin(x[:, 1]), x[:, 0] ** 2]).ravel()
    problem.update_geometry()
    T = to_dense(problem.transformation.T)
    assert np.abs(T - dense_transformation(problem)).max() < ROUND_OFF
    assert np.abs(T - before).max() > 1e-3


@pytest.mark.mpi
def test_independent_interfaces_share_one_factor():
    b = Blocks(PILE)
    interfaces = [b.join(dm.Contact, (k, ABOVE), (k + 1, BELOW)) for k in (1, 2)]
    problem = b.problem(interfaces, [b.fix(k, WEST) for k in (1, 2, 3)])
    problem.audit()
    assert len(problem.transformation.factors) == 1
    T = to_dense(problem.transformation.T)
    assert np.abs(T - dense_transformation(problem)).max() < ROUND_OFF


@pytest.mark.mpi
def test_rigid_motions_are_kept():
    """A common translation of all bodies has no relative part: y = R^T u with w_n = 0."""
    _, problem = chain()
    problem.audit()
    T, N = to_dense(problem.transformation.T), problem.V.dofmap.index_map.size_global
    u = np.tile([0.3, -0.7], N)
    y = np.linalg.solve(T, u)
    bounded = to_global(COMM, problem.bounded + problem.first_dof)
    assert len(bounded) > 0 and np.abs(y[bounded]).max() < ROUND_OFF


@pytest.mark.mpi
def test_relative_and_transpose_are_adjoint(rng):
    """For all v and all slave forces f, f . R^T (v - Q v) = v . (I - Q)^T R f."""
    _, problem = chain()
    problem.audit()
    layout = problem.V.dofmap.index_map
    everywhere = rng.normal(size=(layout.size_global, 4))
    mine = everywhere[slice(*layout.local_range)]
    v = problem.K.createVecRight()
    v.array[:] = mine[:, :2].ravel()
    for i in problem.interfaces:
        f = mine[i.pattern.nodes, 2:]
        left = np.sum(f * i.relative(v))
        right = v.array_r @ i.transpose(np.einsum("nij,nj->ni", i.R, f)).ravel()
        left, right = COMM.allreduce(np.array([left, right]))
        assert left == pytest.approx(right, rel=ROUND_OFF)


@pytest.mark.mpi
def test_second_claims_and_cycles_are_removed_and_said():
    b = Blocks(PILE)
    up = b.join(dm.Contact, (1, ABOVE), (2, BELOW))
    bcs = [b.fix(k, WEST) for k in (1, 2, 3)]
    for later, why in (
        (b.join(dm.Contact, (2, BELOW), (1, ABOVE)), "cycle"),
        (b.join(dm.Tie, (1, ABOVE), (2, BELOW)), "claimed by an earlier interface"),
    ):
        problem = b.problem([up, later], bcs)
        audit = problem.audit()
        assert any(why in w and repr(later) in w for w in audit.warnings), audit
        T = to_dense(problem.transformation.T)
        assert np.abs(T - dense_transformation(problem)).max() < ROUND_OFF
        assert np.linalg.matrix_rank(T) == len(T)
        assert audit.interfaces[1].kept_nodes == 0 < audit.interfaces[0].kept_nodes


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_prescribed_components_of_slave_nodes(kind):
    """Dirichlet data on slave nodes with inclined normals hold exactly, in every component."""
    b = Blocks(PILE[:2])
    b.mesh.geometry.x[:, 1] += 0.2 * b.mesh.geometry.x[:, 0] ** 2
    bcs = [
        b.fix(1, BELOW),
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


# -- bodies


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["graph", "shared_facet", "stripes", "bodies"])
def test_bodies_on_any_partition(partition):
    b = Blocks(BRIDGE, partition=partition)
    bodies = find_bodies(b.V)
    assert bodies.count == 3
    order = np.lexsort(bodies.centre.T)
    assert bodies.centre[order] == pytest.approx(np.array([[1.5, -0.5], [0.65, 0.5], [2.35, 0.5]]))
    x = b.V.tabulate_dof_coordinates()[: len(bodies.label)]
    below = bodies.label == order[0]
    assert (x[below, 1] <= 1e-9).all() and (x[~below, 1] >= -1e-9).all()


@pytest.mark.mpi
def test_free_motions_are_named():
    """Each body of the pile lacks another support."""
    b = Blocks(PILE)
    bcs = [b.fix(1, BELOW, component=1), b.fix(2, WEST, component=0), b.fix(3, ABOVE)]
    with pytest.raises(ValueError) as caught:
        b.problem([], bcs).audit()
    message = str(caught.value)
    assert "translation x of the body around [0.5, 0.5]" in message
    assert "translation y of the body around [0.5, 1.5]" in message
    assert "[0.5, 2.5]" not in message and "rotation" not in message


# -- whole problems


def support_force(problem):
    """Return the sum of the forces of the supports, F(u) - f + contact forces where u is given."""
    problem.solid.assemble_residual(problem.vectors["F"])
    r = (problem.vectors["F"] - problem.vectors["f"]).array_r.reshape(-1, problem.d)
    for contact in problem.contacts:
        r = r + contact.transpose((contact.weight * contact.multiplier[:, None]) * contact.normals)
    return COMM.allreduce(np.where(problem.fixed[: problem.n], r, 0.0).sum(axis=0))


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_chain_under_load(geometry):
    """Forces of contact and tie balance with tractions, body forces and supports."""
    b = Blocks(BRIDGE)
    contact, tie = (
        b.join(dm.Contact, (1, ABOVE), (2, BELOW)),
        b.join(dm.Tie, (3, BELOW), (1, ABOVE)),
    )
    weight = fem.Constant(b.mesh, default_scalar_type((0.0, -0.5)))
    dx = ufl.Measure("dx", b.mesh, subdomain_data=b.cells)
    loads = b.traction(2, ABOVE, (0.0, -2.0)) + b.traction(3, EAST, (1.0, 0.0))
    loads += ufl.inner(weight, ufl.TestFunction(b.V)) * dx(2)
    bcs = [b.fix(1, BELOW), b.fix(2, WEST, component=0)]
    law = {1: STEEL, 2: dm.Elastic(500.0, 0.2), 3: dm.VonMises(800.0, 0.3, 50.0, 10.0)}
    problem = b.problem([contact, tie], bcs, law=law, loads=loads, geometry=geometry)
    report = dm.newton(problem, rtol=1e-11)
    exact = 1e-8 if geometry == "updated" else 1e-9
    # upwards on the upper bodies: on the master of the contact, on the slave of the tie
    assert contact.master_force[1] == pytest.approx(1.3 * (2.0 + 0.5), rel=exact)
    assert contact.force == pytest.approx(-contact.master_force, rel=exact)
    assert tie.force == pytest.approx([-1.0, 0.0], abs=exact)
    assert support_force(problem) == pytest.approx([-1.0, 1.3 * 2.5], rel=1e-7)
    c = report.certificate
    assert max(c.equilibrium, c.gap, c.sign, c.complementarity, c.force_balance) < 1e-8
    assert c.row_sum_error < ROUND_OFF


@pytest.mark.mpi
def test_results_after_a_step():
    """Force against pressure and supports, moment, gap, status, stress and state."""
    b = Blocks(PILE[:2])
    down = fem.Constant(b.mesh, default_scalar_type((0.0, -0.02)))
    contact = b.join(dm.Contact, (1, ABOVE), (2, BELOW))
    law = dm.VonMises(1000.0, 0.3, 5.0, 100.0)
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, value=down)]
    problem = b.problem([contact], bcs, law=law, geometry="reference")
    report = dm.newton(problem, rtol=1e-11)
    problem.solid.assemble_residual(problem.vectors["F"])
    below = fem.locate_dofs_topological(b.V, 1, b.facets.find(10 + BELOW))
    below = below[below < problem.n]
    F = problem.vectors["F"].array_r.reshape(-1, 2)[below]
    assert COMM.allreduce(F.sum(axis=0)) == pytest.approx(-contact.force, rel=1e-8, abs=1e-8)
    assert contact.force[1] < 0.0
    nodes = contact.pattern.nodes
    weighted = contact.weight[:, 0] * contact.pressure.x.array[nodes]
    assert COMM.allreduce(weighted.sum()) == pytest.approx(-contact.force[1], rel=1e-10)
    x = b.V.tabulate_dof_coordinates()[nodes, :2] + b.u.x.array.reshape(-1, 2)[nodes]
    moment = COMM.allreduce(float((-weighted * x[:, 0]).sum()))
    assert contact.moment == pytest.approx([0.0, 0.0, moment], rel=1e-9)
    on = contact.active.x.array[nodes] > 0
    assert COMM.allreduce(int(on.sum())) == report.certificate.active_nodes > 0
    assert np.abs(contact.gap.x.array[nodes][on]).max(initial=0.0) < 1e-10
    assert (contact.pressure.x.array >= 0.0).all()

    assert not problem.solid.state["plastic_strain"].x.array.any()
    problem.commit()
    assert problem.solid.max("plastic_strain_norm") > 0.0
    stress = problem.solid.stress.x.array.reshape(-1, 4)
    assert COMM.allreduce(float(stress[:, 1].min(initial=0.0)), op=MPI.MIN) < 0.0
    fields = problem.output_fields()
    assert {"displacement", "stress", "pressure", "gap", "status"} <= set(fields)


def test_energy_and_forces_agree(rng):
    """The derivative of J along T dy is (F - f) . T dy, by central differences."""
    b, problem = chain()
    problem.audit()
    problem.begin_step()
    own = problem.vectors["du"].array_r.size
    mine = slice(problem.first_dof, problem.first_dof + own)
    size = problem.d * problem.V.dofmap.index_map.size_global
    u, y = 1e-2 * rng.normal(size=(2, size))
    dy = problem.K.createVecRight()
    dy.array[:] = y[mine]
    du = problem.to_displacement(dy).copy()

    def energy(t):
        b.u.x.array[:own] = u[mine] + t * du.array_r
        b.u.x.scatter_forward()
        return problem.solid.energy()

    h = 1e-3
    difference = (energy(h) - energy(-h)) / (2 * h)
    energy(0.0)
    problem.solid.assemble_residual(problem.vectors["F"])
    work = problem.to_reduced(problem.vectors["F"]).dot(dy)
    assert difference == pytest.approx(work, rel=1e-9)


@pytest.mark.mpi
def test_values_that_change_in_time():
    """A Constant, a Function and a load, set anew before every step, linear response."""
    b = Blocks(PILE[:2])
    down = fem.Constant(b.mesh, default_scalar_type((0.0, 0.0)))
    push = fem.Constant(b.mesh, default_scalar_type((0.0, 0.0)))
    ds = ufl.Measure("ds", b.mesh, subdomain_data=b.facets)
    loads = ufl.inner(push, ufl.TestFunction(b.V)) * ds(10 + WEST)
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, value=down)]
    problem = b.problem([b.join(dm.Tie, (1, ABOVE), (2, BELOW))], bcs, loads=loads)
    problem.geometry = "reference"

    def on_time(t):
        down.value[:] = (0.0, -0.01 * t)
        push.value[:] = (0.1 * t, 0.0)

    found = []
    for step in dm.load_steps(problem, [1.0, 2.0, -1.0], on_time=on_time, rtol=1e-10):
        found.append((step.time, b.u.x.array.copy(), problem.ties[0].force.copy()))
    for t, u, force in found[1:]:
        assert np.abs(u - t * found[0][1]).max(initial=0.0) < 1e-12
        assert force == pytest.approx(t * found[0][2], rel=1e-8)


def test_frozen_geometry_is_that_of_the_mesh(rng):
    """With geometry="reference" a start from u != 0 does not move normals and segments."""
    b, problem = chain()
    frozen = b.problem(problem.interfaces, problem.bcs, geometry="reference")
    frozen.audit()
    at_rest = to_dense(frozen.transformation.T)
    b.u.x.array[:] = 0.1 * np.sin(np.arange(len(b.u.x.array)))
    b.u.x.scatter_forward()
    again = b.problem(problem.interfaces, problem.bcs, geometry="reference")
    again.audit()
    assert np.array_equal(to_dense(again.transformation.T), at_rest)


@pytest.mark.mpi
def test_no_interface_is_plain_plasticity():
    """Uniaxial tension in plane strain against the closed form of the elastic law."""
    b = Blocks(PILE[:1])
    bcs = [b.fix(1, BELOW, component=1), b.fix(1, WEST, component=0)]
    problem = b.problem([], bcs, loads=b.traction(1, ABOVE, (0.0, 10.0)))
    report = dm.newton(problem, rtol=1e-10)
    x = b.V.tabulate_dof_coordinates()
    strain = 10.0 / 1000.0 * np.array([-0.3 * 1.3, 1 - 0.3**2])
    assert np.abs(b.u.x.array.reshape(-1, 2) - x[:, :2] * strain).max() < 1e-12
    assert report.certificate.kept_nodes == 0
    json.dumps(report.as_dict())


# -- the report


@pytest.mark.mpi
@pytest.mark.parametrize("qp", ["active-set", "interior-point", "tron"])
def test_report(qp):
    """A table to read, plain numbers for JSON, and sums that agree with the iterations."""
    _, problem = chain()
    report = dm.newton(problem, qp=qp)
    text = str(report)
    for word in ("converged", "certificate", "equilibrium", "complementarity", "seconds", qp):
        assert word in text
    assert all(len(line) < 160 for line in text.splitlines() if not line.startswith("note"))
    back = json.loads(json.dumps(report.as_dict()))
    assert back["newton_iterations"] == len(back["iterations"]) == report.newton_iterations
    assert back["residual_history"] == [i["increment"] for i in back["iterations"]]
    assert back["qp_iterations"] == sum(i["updates"] for i in back["iterations"])
    assert back["certificate"]["newton_iterations"] == back["newton_iterations"]
    assert set(back["seconds"]) >= {"total", "assembly", "linear_solves", "mortar"}
    assert back["certificate"]["smallest_coverage"] <= 1.0
