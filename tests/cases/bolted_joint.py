# SPDX-License-Identifier: MIT
"""A bolted joint of springs: a bolt between two plates, for tests of pretensions."""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, create_blocks

COMM = MPI.COMM_WORLD
E = 1000.0


class Joint:
    """A bolt between two plates under a stiff yoke that is pulled: springs side by side."""

    def __init__(self, *, gap=0.0, slave="upper", comm=COMM):
        boxes = [(1, 2, 0, 1, 3, 3), (1, 2, 1, 2, 4, 3), (0, 1, 0, 2 - gap, 3, 5)]
        boxes += [(2, 3, 0, 2 - gap, 3, 5), (0, 3, 2, 3, 10, 3)]
        self.mesh, cells, tags = create_blocks(comm, boxes, cell="quadrilateral")
        V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.u, self.pull = fem.Function(V), fem.Constant(self.mesh, 0.0)
        soft, stiff = dm.Elastic(E, 0.0), dm.Elastic(1e5 * E, 0.0)
        solid = dm.Solid(self.u, {k: stiff if k == 5 else soft for k in range(1, 6)}, cells)
        sides = (20 + BELOW, 10 + ABOVE) if slave == "upper" else (10 + ABOVE, 20 + BELOW)
        self.bolt = dm.Tie(tags, slave=sides[0], master=sides[1])
        self.direction = [0.0, -1.0 if slave == "upper" else 1.0]
        head = dm.Tie(tags, slave=20 + ABOVE, master=50 + BELOW)
        self.plates = [dm.Contact(tags, slave=k + ABOVE, master=50 + BELOW) for k in (30, 40)]
        held = [fem.locate_dofs_topological(V, 1, tags.find(k + BELOW)) for k in (10, 30, 40)]
        walls = [fem.locate_dofs_topological(V.sub(0), 1, tags.find(50 + s)) for s in (EAST, WEST)]
        zero = fem.Constant(self.mesh, 0.0)
        bcs = [fem.dirichletbc(np.zeros(2), np.concatenate(held), V)]
        bcs.append(fem.dirichletbc(zero, np.concatenate(walls), V.sub(0)))
        v, ds = ufl.TestFunction(V), ufl.Measure("ds", self.mesh, subdomain_data=tags)
        self.problem = dm.ContactProblem(
            solid,
            [self.bolt, head, *self.plates],
            bcs=bcs,
            loads=self.pull / 3.0 * v[1] * ds(50 + ABOVE),
        )

    def clamping(self):
        """Return the force between plates and yoke."""
        return -sum(contact.force[1] for contact in self.plates)

    def tension(self):
        """Return the force of the bolt."""
        return float(self.bolt.force @ self.direction)
