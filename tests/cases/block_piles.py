# SPDX-License-Identifier: MIT
"""Meshes of any number of rectangular blocks, and results gathered from all ranks."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx
import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import _block, _tag, create_distributed
from tests.cases.two_bodies import create_problem, held

BELOW, EAST, ABOVE, WEST = 1, 2, 3, 4
"""Sides; the facet tag of a side of block k (from 1 on) is 10 k + side."""

Box = tuple[float, float, float, float, int, int]  # x_0, x_1, y_0, y_1, columns, rows


def create_blocks(
    comm: MPI.Comm, boxes: list[Box], *, partition: str = "graph", cell: str = "triangle"
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags, dolfinx.mesh.MeshTags]:
    """Create disconnected blocks; return mesh, cell tags (block number) and facet tags."""
    points, cells, sides = [], [], []
    first = 0
    for x_0, x_1, y_0, y_1, nx, ny in boxes:
        p, c = _block(np.linspace(x_0, x_1, nx + 1), np.linspace(y_0, y_1, ny + 1), cell)
        points.append(p)
        cells.append(c + first)
        row, column = np.divmod(np.arange(len(p)), nx + 1)
        sides.append(np.stack([row == 0, column == nx, row == ny, column == 0]))
        first += len(p)
    block_of_point = np.repeat(np.arange(len(boxes)), [len(p) for p in points])
    block_of_cell = np.repeat(np.arange(len(boxes)), [len(c) for c in cells])
    on_side = np.concatenate(sides, axis=1)
    x, e = np.concatenate(points), np.concatenate(cells)
    middle = x[e, 0].mean(axis=1)
    ranks = np.floor(comm.size * (middle - middle.min()) / (np.ptp(middle) * (1 + 1e-9)))
    ranks = block_of_cell % comm.size if partition == "bodies" else ranks
    ranks = np.arange(len(e)) % comm.size if partition == "dealt out" else ranks
    mesh = create_distributed(comm, x, e, cell, 1, partition, ranks)
    blocks = range(len(boxes))
    cell_marks = [(k + 1, lambda i, k=k: block_of_point[i] == k) for k in blocks]
    facet_marks = [
        (10 * (k + 1) + s, lambda i, k=k, s=s: (block_of_point[i] == k) & on_side[s - 1, i])
        for k in blocks
        for s in (BELOW, EAST, ABOVE, WEST)
    ]
    return mesh, _tag(mesh, 2, cell_marks), _tag(mesh, 1, facet_marks)


def to_dense(A: PETSc.Mat) -> npt.NDArray[np.float64]:
    """Return a distributed matrix on every rank."""
    indptr, columns, values = A.getValuesCSR()
    rows = np.zeros((len(indptr) - 1, A.getSize()[1]))
    np.add.at(rows, (np.repeat(np.arange(len(rows)), np.diff(indptr)), columns), values)
    return np.concatenate(A.comm.tompi4py().allgather(rows))


def dense_transformation(problem: dm.ContactProblem) -> npt.NDArray[np.float64]:
    """Return T, the product of the factors I + S, on every rank."""
    factors = [to_dense(factor.C) for factor in problem.system.transformation.factors]
    T = np.eye(len(factors[0]))
    for S in factors:
        T = T + T @ S
    return T


def to_global(comm: MPI.Comm, own: npt.NDArray) -> npt.NDArray:
    """Return the concatenation of the ranks' arrays on every rank."""
    return np.concatenate(comm.allgather(own))


COMM = MPI.COMM_WORLD
STEEL = dm.Elastic(1000.0, 0.3)

# a long block under two short ones, and a pile of three
BRIDGE = [(0.0, 3.0, -1.0, 0.0, 7, 2), (0.0, 1.3, 0.0, 1.0, 4, 3), (1.7, 3.0, 0.0, 1.0, 5, 2)]
PILE = [(0.0, 1.0, 0.0, 1.0, 3, 2), (0.0, 1.0, 1.0, 2.0, 4, 2), (0.0, 1.0, 2.0, 3.0, 5, 2)]


class Blocks:
    """Blocks, their space and the usual parts of a problem."""

    def __init__(self, boxes, **options):
        """Create mesh, space and displacement."""
        comm = options.pop("comm", COMM)
        self.mesh, self.cells, self.facets = create_blocks(comm, boxes, **options)
        self.V = fem.functionspace(self.mesh, ("Lagrange", 1, (2,)))
        self.u = fem.Function(self.V, name="u")

    def fix(self, block, side, component=None, value=0.0):
        """Return a Dirichlet condition on a side; value may be a dolfinx Constant."""
        return held(self.V, self.facets, 10 * block + side, value, component)

    def join(self, kind, slave, master):
        """Return an interface between two sides (block, side)."""
        tags = [10 * block + side for block, side in (slave, master)]
        return kind(self.facets, slave=tags[0], master=tags[1])

    def problem(self, interfaces, bcs, law=STEEL, **options):
        """Return the problem."""
        return create_problem(self.u, interfaces, bcs, law, self.cells, **options)

    def traction(self, block, side, value):
        """Return the virtual work of a traction."""
        ds = ufl.Measure("ds", self.mesh, subdomain_data=self.facets)
        value = fem.Constant(self.mesh, default_scalar_type(value))
        return ufl.inner(value, ufl.TestFunction(self.V)) * ds(10 * block + side)


def chain(kinds=(dm.Contact, dm.Contact), **options):
    """Return a problem in which the second interface's master nodes are slaves of the first."""
    b = Blocks(BRIDGE, **options)
    interfaces = [
        b.join(kinds[0], (1, ABOVE), (2, BELOW)),
        b.join(kinds[1], (3, BELOW), (1, ABOVE)),
    ]
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, value=-0.01), b.fix(3, ABOVE, value=-0.02)]
    return b, b.problem(interfaces, bcs)
