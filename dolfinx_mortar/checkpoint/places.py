# SPDX-License-Identifier: MIT
"""Places: coordinates that identify nodes and integration points on any ranks, in any numbering.

Numbers of cells and nodes depend on the ranks, and numbers of the input are kept only for meshes
that were read or made in the same order, not for refined ones. Coordinates alone are not unique:
sides in contact have nodes at the same point. The place of a node, or of an integration point, is

    (x, c),    c the mean of the midpoints of its cells,

and c differs between two sides that touch.
"""

import numpy as np

from dolfinx import fem, la, mesh
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats


def find_places(V: fem.FunctionSpace) -> Floats:
    """Return the places (n, 2d) of nodes or integration points, up to round-off; collective.

    Args:
        V: a Lagrange or a quadrature space; its owned blocks are the nodes or points.
    """
    domain, imap = V.mesh, V.dofmap.index_map
    d, owned = domain.geometry.dim, domain.topology.index_map(domain.topology.dim).size_local
    cells = np.arange(owned, dtype=np.int32)
    midpoints = mesh.compute_midpoints(domain, domain.topology.dim, cells)[:, :d]
    sums = la.vector(imap, d + 1)
    table = sums.array.reshape(-1, d + 1)
    table[:] = 0.0
    counted = np.column_stack([midpoints, np.ones(owned)])
    np.add.at(table, V.dofmap.list[:owned], counted[:, None])
    sums.scatter_reverse(la.InsertMode.add)
    n = imap.size_local
    x = V.tabulate_dof_coordinates()[:n, :d]
    return np.asarray(np.hstack([x, table[:n, :d] / table[:n, d:]]), dtype=np.float64)


def size_of(domain: mesh.Mesh) -> float:
    """Return the largest coordinate of a mesh, which scales the round-off of all; collective."""
    return float(maximum(domain.comm, np.abs(domain.geometry.x).max(initial=0.0))[0])


def box_of(places: Floats) -> Floats:
    """Return the corners (2, k) of the box around places (n, k), of none an empty one.

    >>> box_of(np.array([[1.0, 2.0], [0.0, 3.0]])).tolist()
    [[0.0, 2.0], [1.0, 3.0]]
    """
    return np.array([places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)])
