# SPDX-License-Identifier: MIT
"""Two blocks, one above the other, glued with a jump: parts of problems, and their errors."""

import numpy as np

import dolfinx_mortar as dm
from tests.cases.meshes import LEFT, RIGHT, UPPER
from tests.cases.meshes_3d import BACK, FRONT
from tests.cases.mortar import largest
from tests.cases.two_bodies import CELLS, COMM, TwoBodies

__all__ = ["CELLS", "COMM", "CONFINED", "NU", "Bar", "E", "largest"]

E, NU = 1000.0, 0.3
# Of a unit strain along an axis, none across.
CONFINED = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))


class Bar(TwoBodies):
    """Non-matching blocks of height 1 that meet at 0; jumps are those of the upper one."""

    def __init__(
        self, cell="triangle", *, slave="upper", degree=1, law=None, kinematics=None, **options
    ):
        """Create mesh, space, tie and solid."""
        super().__init__(cell, degree, **{"jitter": 0.4} | options)
        self.sign = 1.0 if slave == "upper" else -1.0  # of the jump that moves the upper one
        self.tie = self.interface(dm.Tie, swap=slave == "upper")
        chosen = {} if kinematics is None else {"kinematics": kinematics}
        self.solid = dm.Solid(self.u, law or dm.Elastic(E, NU), self.cells, **chosen)

    def hold(self, tag, axis=None, value=0.0):
        """Return a condition on all components of a side, or on one of them."""
        return self.held(tag, value, axis)

    def rollers(self):
        """Return conditions that leave strain along the last axis alone."""
        sides = [LEFT, RIGHT, FRONT, BACK][: 2 * self.d - 2]
        return [self.hold(tag, k // 2) for k, tag in enumerate(sides)]

    def problem(self, bcs, **options):
        """Return the problem of the two blocks."""
        return dm.ContactProblem(self.solid, [self.tie], bcs=bcs, **options)

    def along(self, value):
        """Return the vector that has a value along the last axis."""
        return np.array([0.0] * (self.d - 1) + [value])

    def error(self, exact):
        """Return the largest difference of u from a field of (x, is upper); collective."""
        u = self.u.x.array.reshape(-1, self.d)
        upper = np.zeros(len(u), dtype=bool)
        upper[self.V.dofmap.list[self.cells.find(UPPER)].ravel()] = True
        x, n = self.V.tabulate_dof_coordinates(), self.V.dofmap.index_map.size_local
        return largest((u - exact(x, upper))[:n])
