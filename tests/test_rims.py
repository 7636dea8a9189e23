# SPDX-License-Identifier: MIT
"""Slave nodes at the rim of the master side, on the threshold of carrying a multiplier."""

import numpy as np
import pytest

from dolfinx_mortar.report.resolution import notes_on_rims
from tests.pressed_blocks import COMM, PressedBlocks
from tests.sweep.run import run

pytestmark = pytest.mark.mpi
END, FACET = 0.62, 0.5  # of the master, over the last of two slave facets on (0, 1)


class Rim:
    """The upper block ends over the last slave facet; its share of the last node is a square."""

    def __init__(self):
        """Pair the sides."""
        self.blocks = PressedBlocks(n_lower=(2, 2), n_upper=(3, 2), x_upper=(-1.0, END))
        self.problem = self.blocks.problem(geometry="updated")
        self.problem.update_geometry(0.0)

    def carries(self, share, *, onward=True):
        """Cover that share of the last node; tell whether it carries a multiplier."""
        u = self.blocks.u
        moved = 0.5 + FACET * np.sqrt(share) - END
        u.x.array.reshape(-1, 2)[self.of_upper(), 0] = moved
        if onward:
            self.problem.follow_geometry()
        else:
            self.problem.update_geometry(0.0)
        (link,) = self.problem.system.links
        last = self.blocks.V.tabulate_dof_coordinates()[link.nodes, 0] > 1.0 - 1e-9
        return COMM.allreduce(int((link.coupling.kept[:, 0] & last).sum())) == 1

    def of_upper(self):
        V = self.blocks.V
        cells = self.blocks.cells.find(2)
        return np.unique(V.dofmap.list[cells])

    @property
    def notes(self):
        return notes_on_rims(self.problem.system.links)


def test_who_has_returned_stays():
    """The second loss in a step is refused, down to half of the coverage that others need."""
    rim = Rim()
    assert rim.carries(0.053) and not rim.carries(0.042)
    assert rim.notes == []
    assert rim.carries(0.053) and rim.carries(0.042) and rim.carries(0.026)
    assert len(rim.notes) == 1 and ": 1 slave nodes at the rim" in rim.notes[0]
    assert rim.carries(0.06) and rim.notes == []  # it has only been elsewhere on the way
    assert not rim.carries(0.024) and not rim.carries(0.042) and rim.carries(0.053)


def test_a_step_remembers_nothing_of_another():
    """What the last one or an audit has found does not matter, nor do first losses."""
    rim = Rim()
    for _ in range(3):
        assert rim.carries(0.053, onward=False) and not rim.carries(0.042, onward=False)
        assert rim.notes == []
    assert rim.carries(0.053) and rim.carries(0.06) and not rim.carries(0.049)


@pytest.mark.serial
@pytest.mark.slow
def test_a_box_whose_rim_carries_in_turns():
    """With a multiplier its share is .042, without .053: the geometry had alternated without end.

    Of second order; the check knows which nodes have stayed, and nothing else of them.
    """
    outcome = run("second3", 20001)
    assert not outcome.failure
    assert outcome.cuts == 0 and max(outcome.iterations) <= 12
