# SPDX-License-Identifier: MIT
"""Two blocks, one above the other, glued with a jump: parts of problems, and their errors."""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from tests.cases.meshes import BOTTOM_OF_UPPER, LEFT, RIGHT, TOP_OF_LOWER, UPPER, two_blocks
from tests.cases.meshes_3d import BACK, FRONT, two_boxes

COMM = MPI.COMM_WORLD
E, NU = 1000.0, 0.3
CELLS = ["triangle", "quadrilateral", "tetrahedron", "hexahedron"]
# Of a unit strain along an axis, none across.
CONFINED = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))


class Bar:
    """Blocks of height 1 that meet at 0, non-matching; what is given is said in terms of the upper.

    Args:
        cell: of the mesh.
        slave: "upper" or "lower".
        degree: of the displacement.
        law: of both blocks.
        kinematics: of the solid.
        **options: of `two_blocks` or `two_boxes`.
    """

    def __init__(
        self, cell="triangle", *, slave="upper", degree=1, law=None, kinematics=None, **options
    ):
        """Create mesh, space, tie and solid."""
        options = {"jitter": 0.4, "cell": cell} | options
        if cell in CELLS[:2]:
            found = two_blocks(COMM, (2, 2), (3, 3), **options)
        else:
            found = two_boxes(COMM, (2, 2, 2), (3, 3, 2), **options)
        self.mesh, self.cells, self.facets = found
        self.d = self.mesh.geometry.dim
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (self.d,)))
        self.u = fem.Function(self.V)
        tags = (BOTTOM_OF_UPPER, TOP_OF_LOWER)
        slave_tag, master = tags if slave == "upper" else tags[::-1]
        self.sign = 1.0 if slave == "upper" else -1.0  # of the jump that moves the upper one
        self.tie = dm.Tie(self.facets, slave=slave_tag, master=master)
        chosen = {} if kinematics is None else {"kinematics": kinematics}
        self.solid = dm.Solid(self.u, law or dm.Elastic(E, NU), self.cells, **chosen)

    def hold(self, tag, axis=None, value=0.0):
        """Return a condition on all components of a side, or on one of them."""
        space = self.V if axis is None else self.V.sub(axis)
        dofs = fem.locate_dofs_topological(space, self.d - 1, self.facets.find(tag))
        if axis is None:
            return fem.dirichletbc(np.full(self.d, value), dofs, self.V)
        held = value if isinstance(value, fem.Constant) else fem.Constant(self.mesh, value)
        return fem.dirichletbc(held, dofs, space)

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


def largest(values):
    """Return the largest absolute value on any rank; collective."""
    return float(maximum(COMM, np.abs(values).max(initial=0.0))[0])
