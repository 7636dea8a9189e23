# SPDX-License-Identifier: MIT
"""A step begins with the slips of the last one: further sliding slips, reversal sticks."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, COMM, Blocks
from tests.cases.friction import create

PRESSURE, MU = 2.0, (0.5, 0.25, 0.4)
TOWER = [
    (-3.2, 3.2, 0.0, 1.0, 12, 3),
    (-2.6, 2.6, 1.0, 2.0, 13, 4),
    (-2.2, 2.2, 2.0, 3.0, 11, 3),
    (-1.6, 1.6, 3.0, 4.0, 8, 3),
]
PRESS = 0.02
ONWARD = (0.03, 0.05, 0.07)


class Tower:
    """Four blocks on each other, pressed by a dead load and pushed at the top; frozen surfaces."""

    def __init__(self):
        """Describe the problem."""
        b = Blocks(TOWER, cell="quadrilateral")
        self.contacts = [
            dm.Contact(b.facets, slave=10 * (k + 1) + BELOW, master=10 * k + ABOVE, friction=mu)
            for k, mu in enumerate(MU, start=1)
        ]
        self.way = fem.Constant(b.mesh, 0.0)
        bcs = [b.fix(1, BELOW), b.fix(4, ABOVE, 0, self.way)]
        loads = b.traction(4, ABOVE, (0.0, -PRESSURE))
        self.problem = b.problem(self.contacts, bcs, loads=loads, geometry="reference")

    def push(self, way):
        """Solve with the top at a place, and commit; return the report."""
        self.way.value = way
        report = dm.newton(self.problem)
        self.problem.commit()
        return report


def cost(report):
    """Return updates of active sets, and factorisations, of a step."""
    counts = [(i.updates, i.factorisations) for i in report.iterations]
    return tuple(np.sum(counts, axis=0))


@pytest.mark.parametrize("way", [0.03, 0.05, 0.1, 0.2])
def test_a_block_of_a_tower_slides_on(way):
    """By the weakest interface, at its limit; begun stuck, nodes slip one by one and it fails."""
    tower = Tower()
    for before in (0.0, 0.01, 0.03):
        tower.push(before)
    slid = tower.contacts[1].dissipation
    updates, factorisations = cost(tower.push(0.03 + way))
    assert updates <= 2 and factorisations <= 3
    width = TOWER[3][1] - TOWER[3][0]
    limit = MU[1] * PRESSURE * width
    assert np.abs(tower.contacts[1].force) == pytest.approx([limit, PRESSURE * width], rel=1e-5)
    assert tower.contacts[1].dissipation - slid == pytest.approx(limit * way, rel=1e-4)


def walk(case, ways, press=PRESS):
    """Push the top of the two blocks along; return the costs of the steps."""
    found = []
    for way in ways:
        rest = (0.3 * way,) if case.problem.d == 3 else ()
        found.append(cost(case.solve(way, *rest, -press)))
    return found


@pytest.mark.parametrize(("cell", "most"), [("triangle", 1), ("hexahedron", 2)])
def test_it_costs_few_sets_to_go_on(cell, most):
    """Frozen surfaces, one QP a step: the set is that of the last step, in space it turns a bit."""
    costs = []
    for forget in (False, True):
        case = create(cell, friction=0.3)
        walk(case, [0.0, *ONWARD[:2]])
        if forget:
            case.problem.committed.sliding = None
        costs += walk(case, ONWARD[2:])
    (onward, _), (stuck, _) = costs
    assert onward <= most < stuck


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_a_reversal_costs_no_more_than_begun_stuck(cell):
    """The way of the supports tells that it goes back: then the guess is that all stick."""
    costs = []
    for forget in (False, True):
        case = create(cell, friction=0.3)
        walk(case, [0.0, *ONWARD])
        if forget:
            case.problem.committed.sliding = None
        costs += walk(case, [0.04])
    assert costs[0] == costs[1]


@pytest.mark.parametrize("column", [True, False])
def test_a_checkpoint_has_the_slips(tmp_path, column):
    """On other ranks' parts; a file without them begins stuck, and has the same answer."""
    file = COMM.bcast(tmp_path) / "sliding.h5"
    case, fresh = (
        create("triangle", friction=0.3, mesh_options={"partition": kind})
        for kind in ("graph", "stripes")
    )
    walk(case, [0.0, *ONWARD[:2]])
    kept = case.problem.committed.sliding
    if not column:
        case.problem.committed.sliding = None
    case.problem.save(file)
    fresh.problem.restore(file)
    case.problem.committed.sliding = kept
    there = fresh.problem.committed.sliding
    assert (there is not None) == column
    ((one, _),), ((other, _),) = walk(case, ONWARD[2:]), walk(fresh, ONWARD[2:])
    assert one == 1 and (other == 1) == column
    assert fresh.forces == pytest.approx(case.forces, rel=1e-9)


def test_what_opens_has_no_direction():
    """Nor has what sticks; unit vectors along the surface where it slips."""
    case = create("triangle", friction=0.3)
    walk(case, [0.0, *ONWARD[:2]])
    sliding = case.problem.committed.sliding
    size = np.linalg.norm(sliding, axis=1)
    status = case.contact.status.x.array[: case.problem.n]
    assert size[status == 2.0] == pytest.approx(1.0, rel=1e-12)
    assert not size[status != 2.0].any()
    assert COMM.allreduce(int((status == 2.0).sum()), op=MPI.SUM) > 0
    walk(case, [0.07], press=-0.01)
    assert not case.problem.committed.sliding.any()


def test_a_failed_step_leaves_the_directions():
    case = create("triangle", friction=0.3, geometry="updated")
    walk(case, [0.0, 0.03])
    kept = case.problem.committed.sliding.copy()
    assert COMM.allreduce(bool(kept.any()), op=MPI.LOR)
    case.push(-0.04, -PRESS)
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(case.problem, max_it=1, rtol=1e-12)
    assert np.array_equal(case.problem.committed.sliding, kept)
