# SPDX-License-Identifier: MIT
"""The mesh of the demo: a block, and above it a tool with a round underside."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.common.arrays import Bools, Floats
from dolfinx_mortar.meshing.two_bodies import Arrays, TaggedMesh, all_at, two_bodies

BLOCK = (12.0, 4.0)  # mm, from the origin
TOOL = (0.2, 1.4, 4.5, 5.4)  # mm: left, right, lower corners, top
ARC = 0.3  # mm, by which the middle of the underside lies below its corners
RADIUS = (0.6**2 + ARC**2) / (2 * ARC)  # mm, 0.75


def block_and_tool(comm: MPI.Intracomm, h: float = 0.15) -> TaggedMesh:
    """Mesh block and tool with quadrilaterals (collective).

    Bodies: "block", "tool". Sides: "base" and "top" of the block; "underside" of the tool, with its
    flanks, and "held", its top.

    Args:
        comm: Communicator of the mesh.
        h: Length of the facets of both sides in mm; those of the block are some percent longer.
    """

    def sides(of_block: Bools, x: Floats) -> dict[str, Bools]:
        def at(y: float) -> Bools:
            return all_at(x[:, :, 1], y, 1e-9)

        held = ~of_block & at(TOOL[3])
        return {
            "base": of_block & at(0.0),
            "top": of_block & at(BLOCK[1]),
            "underside": ~of_block & ~held,
            "held": held,
        }

    bodies = "block", "tool"
    return two_bodies(
        comm, lambda: (_block(h), _tool(h)), "quadrilateral", "ironing", bodies, sides
    )


def _block(h: float) -> Arrays:
    """Cells become three times as high towards the base."""
    n = round(BLOCK[0] / (1.07 * h))
    m = round(BLOCK[1] / (2 * h))
    t = np.linspace(0.0, 1.0, m + 1)
    y = BLOCK[1] * (1.5 * t - 0.5 * t**2)
    return _grid(*np.meshgrid(np.linspace(0.0, BLOCK[0], n + 1), y))


def _tool(h: float) -> Arrays:
    """Columns end on the arc, in equal steps along it."""
    left, right, corner, top = TOOL
    middle, high = (left + right) / 2, corner - ARC + RADIUS
    half = np.arcsin((right - left) / (2 * RADIUS))
    n, m = round(2 * half * RADIUS / h), round((top - corner) / h)
    s, t = np.meshgrid(np.linspace(-1.0, 1.0, n + 1), np.linspace(0.0, 1.0, m + 1))
    low = middle + RADIUS * np.sin(half * s), high - RADIUS * np.cos(half * s)
    return _grid(
        (1 - t) * low[0] + t * (middle + s * (right - left) / 2), (1 - t) * low[1] + t * top
    )


def _grid(x: Floats, y: Floats) -> Arrays:
    """Return nodes and quadrilaterals of rows of nodes."""
    rows, columns = x.shape
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    cells = first[:, None] + np.array([0, 1, columns, columns + 1])
    return np.stack([x.ravel(), y.ravel()], axis=1), cells.astype(np.int64)
