"""Meshes of any number of boxes in space that have no nodes in common."""

from mpi4py import MPI

import numpy as np

import dolfinx
from tests.cases.meshes import create_distributed
from tests.cases.meshes_3d import box_cells, box_points

Box = tuple[tuple[float, float, float], tuple[float, float, float], tuple[int, int, int]]

# A base, and two boxes on it, side by side: all three meet in an edge.
THREE = (
    ((0.0, 0.0, -1.0), (2.0, 1.0, 0.0)),
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    ((1.0, 0.0, 0.0), (2.0, 1.0, 1.0)),
)


def create_boxes(
    comm: MPI.Comm, boxes: list[Box], cell: str = "hexahedron"
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags]:
    """Create boxes, each of its lowest and highest corner and cells in three directions."""
    points, cells, first = [], [], 0
    for low, high, n in boxes:
        lines = [np.linspace(a, b, m + 1) for a, b, m in zip(low, high, n, strict=True)]
        points.append(box_points(lines, 0.0, 0))
        cells.append(first + box_cells(n, cell))
        first += len(points[-1])
    x, e = np.concatenate(points), np.concatenate(cells)
    mesh = create_distributed(comm, x, e, cell)
    count = mesh.topology.index_map(3).size_local
    middle = dolfinx.mesh.compute_midpoints(mesh, 3, np.arange(count, dtype=np.int32))
    inside = [
        ((middle > np.array(low)) & (middle < np.array(high))).all(axis=1) for low, high, _ in boxes
    ]
    numbers = 1 + np.argmax(inside, axis=0).astype(np.int32)
    return mesh, dolfinx.mesh.meshtags(mesh, 3, np.arange(count, dtype=np.int32), numbers)
