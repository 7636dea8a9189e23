# SPDX-License-Identifier: MIT
"""Bodies on whose tops rigid tools are pressed: half of a plane block, and a box."""

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from tests.cases.two_bodies import create_problem, held

COMM = MPI.COMM_WORLD
BASE, SIDE, TOP, AXIS = 1, 2, 3, 4
R, DEPTH, E, NU = 8.0, 0.02, 200.0, 0.3
ELASTIC = dm.Elastic(E, NU)
STEEL = dm.VonMises(E, NU, 0.3, 10.0)
DISC, BALL = dm.shapes.Cylinder([0.0, R], R), dm.shapes.Sphere([0.0, R], R)


def graded(t, size, fine):
    """Return coordinates in [0, size] of t in [0, 1], with the slope `fine` at 0."""
    return fine * t + (size - fine) * t**4


def mark(domain, places):
    """Return facet tags of {tag: (axis, coordinate)}."""
    dim, tags = domain.topology.dim - 1, {}
    for tag, (axis, at) in places.items():
        found = mesh.locate_entities_boundary(
            domain, dim, lambda x, axis=axis, at=at: np.isclose(x[axis], at)
        )
        tags |= dict.fromkeys(found.tolist(), tag)
    facets = np.array(sorted(tags), dtype=np.int32)
    return mesh.meshtags(domain, dim, facets, np.array([tags[f] for f in facets], dtype=np.int32))


class Body:
    """What has a space V, facet tags and a displacement u, clamped at its base."""

    def __init__(self, domain, facets, degree):
        self.mesh, self.facets, d = domain, facets, domain.geometry.dim
        self.V = fem.functionspace(domain, ("Lagrange", degree, (d,)))
        self.u = fem.Function(self.V)

    def hold(self, tag, axis=None, value=0.0):
        """Return a Dirichlet condition on a side, for all components or one."""
        return held(self.V, self.facets, tag, value, axis)

    def bcs(self):
        """Clamp the base."""
        return [self.hold(BASE)]

    def tool(self, shape, **options):
        """Return an obstacle for the top."""
        return dm.Obstacle(self.facets, slave=TOP, shape=shape, **options)

    def problem(self, interfaces, law=ELASTIC, **options):
        """Return the problem; strain and kinematics are those of `Solid`."""
        return create_problem(self.u, interfaces, options.pop("bcs", self.bcs()), law, **options)

    def press(self, tool, depth=DEPTH, rtol=1e-10, **options):
        """Lower a tool, or one of a shape; return tool, problem and report."""
        tool = self.tool(tool) if isinstance(tool, dm.shapes.Shape) else tool
        problem = self.problem([tool], **options)
        tool.position.value[-1] -= depth
        return tool, problem, dm.newton(problem, rtol=rtol)


class Block(Body):
    """Half of a plane block, or the section of a round one, y <= 0, u_x = 0 at x = 0."""

    def __init__(self, n=24, size=10.0, fine=1.0, cell="triangle", degree=1, angle=0.0):
        domain = mesh.create_rectangle(COMM, [[0.0, 0.0], [1.0, 1.0]], [n, n], mesh.CellType[cell])
        facets = mark(domain, {BASE: (1, 1.0), SIDE: (0, 1.0), TOP: (1, 0.0), AXIS: (0, 0.0)})
        t = domain.geometry.x[:, :2]
        x = np.stack([graded(t[:, 0], size, fine), -graded(t[:, 1], size, fine)], axis=1)
        c, s = np.cos(angle), np.sin(angle)
        self.turned = np.array([[c, -s], [s, c]])
        domain.geometry.x[:, :2] = x @ self.turned.T
        super().__init__(domain, facets, degree)

    def bcs(self):
        """Clamp the base, hold the axis."""
        return super().bcs() + ([self.hold(AXIS, 0)] if self.turned[0, 1] == 0.0 else [])


class Box(Body):
    """A box in the plane or in space with a base at low[axis]; `move` maps its points."""

    def __init__(
        self,
        cell="hexahedron",
        n=(2, 2, 1),
        low=(0.0, 0.0, 0.0),
        high=(1.0, 1.0, 1.0),
        *,
        axis=-1,
        degree=1,
        move=None,
        comm=COMM,
    ):
        make, d = (mesh.create_rectangle if len(n) == 2 else mesh.create_box), len(n)
        domain = make(comm, [low[:d], high[:d]], n, mesh.CellType[cell])
        facets = mark(domain, {BASE: (axis % d, low[:d][axis]), TOP: (axis % d, high[:d][axis])})
        if move is not None:
            domain.geometry.x[:, :d] = move(domain.geometry.x[:, :d].copy())
        super().__init__(domain, facets, degree)
