# SPDX-License-Identifier: MIT
"""Meshes of the tests in 3D: two structured boxes that do not match at their interface."""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
from tests.cases.meshes import _two_bodies

BOTTOM, TOP, TOP_OF_LOWER, BOTTOM_OF_UPPER, LEFT, RIGHT, FRONT, BACK = range(1, 9)

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


def rotation(axis: npt.ArrayLike, angle: float) -> Array:
    """Return the matrix that turns by an angle about an axis."""
    a = np.asarray(axis, dtype=float)
    a = a / np.linalg.norm(a)
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def two_boxes(
    comm: MPI.Comm,
    n_lower: tuple[int, int, int] = (2, 2, 2),
    n_upper: tuple[int, int, int] = (3, 3, 2),
    *,
    lower: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 1.0),
    upper: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 1.0),
    heights: tuple[float, float] = (1.0, 1.0),
    gap: float = 0.0,
    cell: str = "tetrahedron",
    turn: Array | None = None,
    splits_lower: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    splits_upper: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    jitter: float = 0.0,
    seed: int = 0,
    transform: Callable[[Array], Array] | None = None,
    partition: str = "graph",
    order: int = 1,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags, dolfinx.mesh.MeshTags]:
    """Create a mesh of two disconnected boxes, one above the other.

    The interface lies on z = 0 (lower box) and z = gap (upper box) before everything is turned.

    Args:
        comm: Communicator.
        n_lower: Number of cells of the lower box in x, y and z.
        n_upper: Number of cells of the upper box.
        lower: Ends of the lower box in x and y.
        upper: Ends of the upper box.
        heights: Heights of the lower and the upper box.
        gap: Initial gap, negative for an overlap.
        cell: "tetrahedron" or "hexahedron".
        turn: Rotation matrix.
        splits_lower: Grid lines of the lower box in x and y, in place of `n_lower` and `lower`.
        splits_upper: Grid lines of the upper box.
        jitter: Random shift of the nodes, in parts of the spacing; the faces stay flat.
        seed: Seed of the shift.
        transform: Map of the (n, 3) points, applied after the rotation.
        partition: As for `tests.cases.meshes.two_blocks`.
        order: Degree of the cells; `transform` bends those of degree 2.

    Returns:
        Mesh; cell tags (1 lower, 2 upper); facet tags (1 bottom of the lower box, 2 top of the
        upper one, 3 top of the lower one, 4 bottom of the upper one, 5 left, 6 right, 7 front and
        8 back sides: low and high x, low and high y).
    """
    lines = []
    given = ((n_lower, lower, splits_lower), (n_upper, upper, splits_upper))
    for (n, ends, splits), z in zip(
        given, ((-heights[0], 0.0), (gap, gap + heights[1])), strict=True
    ):
        plane = splits or (np.linspace(*ends[:2], n[0] + 1), np.linspace(*ends[2:], n[1] + 1))
        lines.append([*(np.asarray(s, dtype=float) for s in plane), np.linspace(*z, n[2] + 1)])

    def move(x: Array) -> Array:
        x = x if turn is None else x @ turn.T
        return x if transform is None else transform(x)

    return _two_bodies(comm, lines, move, (cell, order), partition, jitter, seed)
