# SPDX-License-Identifier: MIT
"""A bolted joint of springs: a bolt between two plates, for tests of pretensions."""

from mpi4py import MPI

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, Blocks

COMM = MPI.COMM_WORLD
E = 1000.0


class Joint:
    """A bolt between two plates under a stiff yoke that is pulled: springs side by side."""

    def __init__(self, *, gap=0.0, slave="upper", comm=COMM):
        boxes = [(1, 2, 0, 1, 3, 3), (1, 2, 1, 2, 4, 3), (0, 1, 0, 2 - gap, 3, 5)]
        boxes += [(2, 3, 0, 2 - gap, 3, 5), (0, 3, 2, 3, 10, 3)]
        b = Blocks(boxes, cell="quadrilateral", comm=comm)
        self.mesh, self.u, self.pull = b.mesh, b.u, fem.Constant(b.mesh, 0.0)
        laws = {k: dm.Elastic(1e5 * E if k == 5 else E, 0.0) for k in range(1, 6)}
        ends = ((2, BELOW), (1, ABOVE))[:: 1 if slave == "upper" else -1]
        self.bolt, head = b.join(dm.Tie, *ends), b.join(dm.Tie, (2, ABOVE), (5, BELOW))
        self.direction = [0.0, -1.0 if slave == "upper" else 1.0]
        self.plates = [b.join(dm.Contact, (k, ABOVE), (5, BELOW)) for k in (3, 4)]
        bcs = [b.fix(k, BELOW) for k in (1, 3, 4)] + [b.fix(5, s, 0) for s in (EAST, WEST)]
        v, ds = ufl.TestFunction(b.V), ufl.Measure("ds", b.mesh, subdomain_data=b.facets)
        loads = self.pull / 3.0 * v[1] * ds(50 + ABOVE)
        self.problem = b.problem([self.bolt, head, *self.plates], bcs, laws, loads=loads)

    def clamping(self):
        """Return the force between plates and yoke."""
        return -sum(contact.force[1] for contact in self.plates)

    def tension(self):
        """Return the force of the bolt."""
        return float(self.bolt.force @ self.direction)
