# SPDX-License-Identifier: MIT
"""The square plate with a square hole of the reference computation."""

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import mesh
from tests.cases.solid import plane, tag_facets


def create_plate(comm: MPI.Comm, element: str, level: int) -> mesh.Mesh:
    """Create (0,10)^2 minus (0,5)^2, squares of side 2^-level, cut from lower right to upper left.

    Args:
        comm: communicator.
        element: "P1" (triangles) or "Q1" (squares).
        level: refinement.
    """
    n = 10 * 2**level
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n)))
    keep = (i >= n // 2) | (j >= n // 2)
    corner = (i + (n + 1) * j)[keep]
    square = np.stack([corner, corner + 1, corner + n + 1, corner + n + 2], axis=1)
    cells = square if element == "Q1" else square[:, [[0, 1, 2], [1, 3, 2]]].reshape(-1, 3)
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 4 if element == "Q1" else 3)
    points = np.stack([used % (n + 1), used // (n + 1)], axis=1) * (10.0 / n)
    if comm.rank > 0:
        cells, points = cells[:0], points[:0]
    cell = "quadrilateral" if element == "Q1" else "triangle"
    coordinates = basix.ufl.element("Lagrange", cell, 1, shape=(2,))
    return mesh.create_mesh(comm, cells=cells.astype(np.int64), x=points, e=ufl.Mesh(coordinates))


def top(domain: mesh.Mesh) -> ufl.Measure:
    """Return the measure of y = 10."""
    return ufl.Measure("ds", domain, subdomain_data=tag_facets(domain, plane(1, 10.0)))(1)
