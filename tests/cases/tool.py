# SPDX-License-Identifier: MIT
"""Half of a block, refined towards a corner at the origin, on which rigid tools are pressed."""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh

COMM = MPI.COMM_WORLD
BASE, SIDE, TOP, AXIS = 1, 2, 3, 4
R, DEPTH, E, NU = 8.0, 0.02, 200.0, 0.3
ELASTIC = dm.Elastic(E, NU)


def graded(t, size, fine):
    """Return coordinates in [0, size] of t in [0, 1], with the slope `fine` at 0."""
    return fine * t + (size - fine) * t**4


class Block:
    """Half of a plane block, or the section of a round one, y <= 0, u_x = 0 at x = 0.

    Its base is clamped; all of it may be turned by an angle, and measured in another unit.
    """

    def __init__(self, n=24, size=10.0, fine=1.0, cell="triangle", degree=1, angle=0.0, unit=1.0):
        """Create mesh, tags and space: n cells each way, about fine / n wide at the origin."""
        kind = getattr(mesh.CellType, cell)
        self.mesh = mesh.create_rectangle(COMM, [[0.0, 0.0], [1.0, 1.0]], [n, n], kind)
        t = self.mesh.geometry.x[:, :2].copy()
        facets, values = [], []
        for tag, where in (
            (BASE, lambda x: np.isclose(x[1], 1.0)),
            (SIDE, lambda x: np.isclose(x[0], 1.0)),
            (TOP, lambda x: np.isclose(x[1], 0.0)),
            (AXIS, lambda x: np.isclose(x[0], 0.0)),
        ):
            found = mesh.locate_entities_boundary(self.mesh, 1, where)
            facets.append(found)
            values.append(np.full(len(found), tag, dtype=np.int32))
        order = np.argsort(np.concatenate(facets))
        self.facets = mesh.meshtags(
            self.mesh, 1, np.concatenate(facets)[order], np.concatenate(values)[order]
        )
        x = np.stack([graded(t[:, 0], size, fine), -graded(t[:, 1], size, fine)], axis=1)
        c, s = np.cos(angle), np.sin(angle)
        self.turned = np.array([[c, -s], [s, c]])
        self.unit = unit
        self.mesh.geometry.x[:, :2] = unit * x @ self.turned.T
        self.V = fem.functionspace(self.mesh, ("Lagrange", degree, (2,)))
        self.u = fem.Function(self.V)

    def bcs(self):
        """Clamp the base, hold the axis."""
        fdim, zero = 1, np.zeros(2)
        base = fem.locate_dofs_topological(self.V, fdim, self.facets.find(BASE))
        conditions = [fem.dirichletbc(zero, base, self.V)]
        if self.turned[0, 1] == 0.0:
            axis = self.facets.find(AXIS)
            dofs = fem.locate_dofs_topological(self.V.sub(0), fdim, axis)
            conditions.append(fem.dirichletbc(0.0, dofs, self.V.sub(0)))
        return conditions

    def tool(self, shape, **options):
        """Return an obstacle for the top."""
        return dm.Obstacle(self.facets, slave=TOP, shape=shape, **options)

    def problem(self, interfaces, law=ELASTIC, **options):
        """Return the problem; strain and kinematics are those of `Solid`."""
        names = "kinematics", "strain", "volumetric"
        own = {name: options.pop(name) for name in names if name in options}
        solid = dm.Solid(self.u, law, **own)
        return dm.ContactProblem(solid, interfaces, bcs=self.bcs(), **options)


def fit(tool, u):
    """Return half width and peak pressure by p^2 linear in x^2 over the closed nodes."""
    found = tool.gather(u)
    on = found["active"] > 0.0
    x, p = found["x"][on, 0], found["pressure"][on]
    slope, peak = np.polyfit(x[:-1] ** 2, p[:-1] ** 2, 1)
    return np.sqrt(-peak / slope), np.sqrt(peak)
