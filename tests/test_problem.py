# SPDX-License-Identifier: MIT
"""Bodies, problems of several interfaces and materials, results, reports."""

import gc
import weakref

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, la
from dolfinx_mortar.solid.supports import find_bodies
from tests.cases.ball import create_problem as create_ball
from tests.cases.block_piles import (
    BELOW,
    BRIDGE,
    COMM,
    PILE,
    Blocks,
)
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.pressed_blocks import PressedBlocks

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


@pytest.mark.mpi
def test_no_vector_of_petsc_is_made_of_a_displacement(monkeypatch):
    """It would be destroyed where Python deletes u, which ranks do at different times."""

    def refuse(_):
        raise AssertionError("u.x.petsc_vec was asked for")

    monkeypatch.setattr(la.Vector, "petsc_vec", property(refuse))
    case = PressedBlocks()
    assert dm.newton(case.problem()).converged
    dm.assemble_mortar(case.V, case.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER, u=case.u)


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
