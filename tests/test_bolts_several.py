# SPDX-License-Identifier: MIT
"""Several bolts: all forces hold together, in one step, and a failure leaves all as it was."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.block_piles import ABOVE, BELOW, COMM, Blocks
from tests.cases.pressed_blocks import rejected
from tests.cases.tightened_bar import tighten

E = 1000.0
SOUGHT = 1e-6


class Flange:
    """Bolts (unit sections, length 2) beside gaskets (width 1, height 2) under a stiff yoke.

    From left to right gasket, bolt, gasket, bolt, .., gasket; all without Poisson's ratio, so that
    they are springs: E / 2 of a bolt, the gasket's E / 2 of a gasket.
    """

    def __init__(self, count, *, gasket=E, law=None):
        """Create the parts and the problem."""
        boxes, contacts, cuts = [], [], []
        columns = 2 * count + 1
        for k in range(columns):
            if k % 2:
                cuts.append(len(boxes) + 1)
                boxes += [(k, k + 1, 0, 1, 1, 1), (k, k + 1, 1, 2, 1, 1)]
            else:
                contacts.append(len(boxes) + 1)
                boxes.append((k, k + 1, 0, 2, 1, 1))
        boxes.append((0, columns, 2, 3, 2 * columns, 1))
        yoke = len(boxes)
        b = Blocks(boxes, cell="quadrilateral")
        laws = {k: law or dm.Elastic(E, 0.0) for k in range(1, yoke)}
        laws |= {k: dm.Elastic(gasket, 0.0) for k in contacts}
        laws[yoke] = dm.Elastic(1e4 * E, 0.0)
        self.bolts = [
            dm.Tie(b.facets, slave=10 * (k + 1) + BELOW, master=10 * k + ABOVE) for k in cuts
        ]
        heads = [
            dm.Tie(b.facets, slave=10 * (k + 1) + ABOVE, master=10 * yoke + BELOW) for k in cuts
        ]
        gaskets = [
            dm.Contact(b.facets, slave=10 * k + ABOVE, master=10 * yoke + BELOW) for k in contacts
        ]
        feet = [b.fix(k, BELOW) for k in (*contacts, *cuts)]
        bcs = [*feet, b.fix(yoke, ABOVE, component=0)]
        solid = dm.Solid(b.u, laws, b.cells)
        self.problem = dm.ContactProblem(solid, [*self.bolts, *heads, *gaskets], bcs=bcs)

    def tensions(self):
        """Return the forces of the bolts."""
        return [-bolt.force[1] for bolt in self.bolts]


def shown(problem, ties):
    """Return what a failure must leave as it was."""
    found = [problem.u.x.array.copy(), problem.solid.stress.x.array.copy()]
    return [*found, *(tie.tightening.copy() for tie in ties), *(tie.force.copy() for tie in ties)]


@pytest.mark.mpi
@pytest.mark.parametrize("gasket", [E, 0.05 * E])
def test_all_forces_hold_together(gasket):
    """On a soft gasket each bolt unloads the others: one by one would take hundreds of passes."""
    flange, forces = Flange(3, gasket=gasket), [3.0, 5.0, 4.0]
    wanted = dict(zip(flange.bolts, forces, strict=True))
    report = tighten(flange.problem, wanted, [0.0, -1.0])
    assert flange.tensions() == pytest.approx(forces, rel=2 * SOUGHT)
    assert report.newton_iterations <= 6
    found = [bolt.tightening for bolt in flange.bolts]
    tighten(flange.problem, wanted, [0, -2])
    for bolt, jump in zip(flange.bolts, found, strict=True):  # they are there already
        assert np.allclose(bolt.tightening, jump, rtol=1e-6, atol=0.0)
    dm.newton(flange.problem, rtol=1e-9)  # and stay
    assert flange.tensions() == pytest.approx(forces, rel=10 * SOUGHT)


def test_bolts_that_yield():
    """As one step with the jumps that were found."""
    law = dm.VonMises(E, 0.0, 5.0, 50.0)
    flange, forces = Flange(2, law=law), [7.0, 6.5]
    tighten(flange.problem, dict(zip(flange.bolts, forces, strict=True)), [0.0, -1.0])
    assert flange.tensions() == pytest.approx(forces, rel=2 * SOUGHT)
    flown = flange.problem.solid.state["plastic_strain"].x.array.copy()
    other = Flange(2, law=law)
    for bolt, old in zip(other.bolts, flange.bolts, strict=True):
        bolt.tightening = old.tightening
    dm.newton(other.problem, rtol=1e-9)
    other.problem.commit()
    now = other.problem.solid.state["plastic_strain"].x.array
    largest = COMM.allreduce(np.abs(flown).max(initial=0.0), op=MPI.MAX)
    assert largest > 1e-4 and np.abs(flown - now).max(initial=0.0) < 1e-5 * largest


@pytest.mark.mpi
def test_a_failure_leaves_all_as_it_was():
    flange = Flange(2, law=dm.VonMises(E, 0.0, 5.0, 50.0))
    tighten(flange.problem, dict.fromkeys(flange.bolts, 1.0), [0.0, -1.0])
    before = shown(flange.problem, flange.bolts)
    wanted = dict(zip(flange.bolts, (2.0, 9.0), strict=True))
    with rejected("max_it=1 iterations", "as before", error=dm.NewtonNotConverged):
        tighten(flange.problem, wanted, [0.0, -1.0], max_it=1)
    assert all(map(np.array_equal, before, shown(flange.problem, flange.bolts)))
