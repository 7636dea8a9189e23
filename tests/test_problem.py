# SPDX-License-Identifier: MIT
"""Bodies, problems of several interfaces and materials, results, reports."""

import gc
import weakref

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, la
from dolfinx_mortar.problem.linearisation import find_balance, to_displacement, to_reduced
from dolfinx_mortar.solid.supports import find_bodies
from tests.cases.ball import create_problem as create_ball
from tests.cases.block_piles import (
    ABOVE,
    BELOW,
    BRIDGE,
    COMM,
    EAST,
    PILE,
    STEEL,
    WEST,
    Blocks,
    chain,
)
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, TOP_OF_LOWER
from tests.cases.pressed_blocks import PressedBlocks

ROUND_OFF = 1e-12


# -- bodies


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["shared_facet", "bodies", "empty"])
def test_bodies_on_any_partition(partition):
    b = Blocks(BRIDGE, partition=partition)
    bodies = find_bodies(b.V)
    assert bodies.count == 3
    order = np.lexsort(bodies.centre.T)
    assert bodies.centre[order] == pytest.approx(np.array([[1.5, -0.5], [0.65, 0.5], [2.35, 0.5]]))
    x = b.V.tabulate_dof_coordinates()[: len(bodies.label)]
    below = bodies.label == order[0]
    assert (x[below, 1] <= 1e-9).all() and (x[~below, 1] >= -1e-9).all()


# -- whole problems


def support_force(problem):
    """Return the sum of the forces of the supports, F(u) - f + contact forces where u is given."""
    r = -find_balance(problem, problem.begin_step()).r.array_r.reshape(-1, problem.d)
    for contact in problem.contacts:
        link = problem.system.link(contact)
        reaction = link.coupling.weight * contact.multiplier[:, None]
        r = r + sum(link.transpose(reaction * link.coupling.normals))
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


def test_energy_and_forces_agree(rng):
    """The derivative of J along T dy is (F - f) . T dy, by central differences."""
    b, problem = chain()
    problem.audit()
    problem.begin_step()
    own = problem.d * problem.n
    mine = slice(problem.first_dof, problem.first_dof + own)
    size = problem.d * problem.V.dofmap.index_map.size_global
    u, y = 1e-2 * rng.normal(size=(2, size))
    dy = problem.K.createVecRight()
    dy.array[:] = y[mine]
    du = to_displacement(problem.system.transformation, dy)

    def energy(t):
        b.u.x.array[:own] = u[mine] + t * du.array_r
        b.u.x.scatter_forward()
        return COMM.allreduce(problem.solid.energy())

    h = 1e-3
    difference = (energy(h) - energy(-h)) / (2 * h)
    energy(0.0)
    internal = problem.vector()
    problem.solid.assemble_residual(internal)
    work = to_reduced(problem.system.transformation, internal).dot(dy)
    assert difference == pytest.approx(work, rel=1e-9)


@pytest.mark.mpi
def test_no_vector_of_petsc_is_made_of_a_displacement(monkeypatch):
    """It would be destroyed where Python deletes u, which ranks do at different times."""

    def refuse(_):
        raise AssertionError("u.x.petsc_vec was asked for")

    monkeypatch.setattr(la.Vector, "petsc_vec", property(refuse))
    case = PressedBlocks()
    assert dm.newton(case.problem()).converged
    dm.assemble_mortar(case.V, case.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, u=case.u)


# -- the report


# -- Dirichlet data


@pytest.mark.mpi
@pytest.mark.parametrize("known_to", ["owners", "others"])
def test_dirichlet_values_known_to_some_ranks_only(known_to):
    """Dofs may have been located by their owners alone, or only where they are ghosts."""
    b = Blocks(PILE[:1], partition="stripes")
    layout = b.V.dofmap.index_map
    owned, local = layout.size_local, layout.size_local + layout.num_ghosts
    nodes = np.arange(owned) if known_to == "owners" else np.arange(owned, local)
    if known_to == "others":  # the bottom has a condition of its own
        nodes = nodes[b.V.tabulate_dof_coordinates()[nodes, 1] > 0.0]
    value = np.array([0.3, -0.7])
    bcs = [b.fix(1, BELOW), fem.dirichletbc(value, nodes.astype(np.int32), b.V)]
    problem = b.problem([], bcs if known_to == "others" else bcs[1:])
    target = problem.begin_step().target
    marks = la.vector(layout, 1)
    marks.array[:] = 0.0
    marks.array[nodes] = 1.0
    marks.scatter_reverse(la.InsertMode.add)
    meant = marks.array[:owned] > 0
    assert problem.fixed[:owned][meant].all()
    assert (target.reshape(-1, 2)[meant] == value).all()
    assert COMM.allreduce(int(meant.sum())) > 0 or COMM.size == 1


# -- results at the ends of the contact


@pytest.mark.mpi
@pytest.mark.parametrize("end", [1.1, 1.25])
def test_pressure_and_gap_end_where_the_master_ends(end):
    """A uniform pressure on [0, end]: nodes beyond face no master, whatever their neighbours."""
    case = PressedBlocks(n_lower=(8, 2), n_upper=(5, 2), x_lower=(0.0, 2.0), x_upper=(0.0, end))
    bcs = [case.roller(BOTTOM, 1), case.roller(LEFT, 0)]
    law, loads = dm.Elastic(1000.0, 0.0), case.pull((0.0, -5.0))
    problem = case.problem(bcs=bcs, law=law, loads=loads, geometry="reference")
    dm.newton(problem)
    (contact,) = problem.contacts
    assert contact.force[1] == pytest.approx(-5.0 * end, rel=1e-9)
    nodes = contact.gather(case.u)
    x = nodes["X"][:, 0]
    beyond = x >= end + 0.25 - 1e-9  # the facet that holds the end reaches no further
    assert beyond.any() and not beyond.all()
    assert (nodes["pressure"][beyond] == 0.0).all() and np.isnan(nodes["gap"][beyond]).all()
    assert (nodes["pressure"][x < end] > 0.0).all()


@pytest.mark.serial
def test_a_problem_that_is_let_go_is_freed_at_once():
    """Also after a step with multigrid: a circle of references would keep all matrices."""
    gc.collect()
    gc.disable()
    try:
        problem, _ = create_ball(depth=0.05)
        dm.newton(problem)
        product = problem.operator.matrix.getPythonContext()
        whole = (problem, problem.linear, problem.solid, product)
        parts = [weakref.ref(part) for part in whole]
        del problem, product, whole
        assert not any(part() for part in parts)
    finally:
        gc.enable()
