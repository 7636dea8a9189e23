# SPDX-License-Identifier: MIT
"""Meshes of the tests in 3D: two structured boxes that do not match at their interface."""

from collections.abc import Callable
from itertools import permutations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
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


def box_points(lines: list[Array], jitter: float, seed: int) -> Array:
    """Return the points of a grid, x fastest; inner ones shifted, those on a face within it."""
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5, grid.shape)
    for i, line in enumerate(lines):
        room = np.zeros(len(line))
        room[1:-1] = np.minimum(np.diff(line)[:-1], np.diff(line)[1:])
        shift[..., i] *= jitter * room.reshape([-1 if j == i else 1 for j in range(3)])
    return (grid + shift).transpose(2, 1, 0, 3).reshape(-1, 3)


def box_cells(n: tuple[int, int, int], cell: str, order: int = 1) -> Ints:
    """Return the cells of a grid with n cells per direction; six tetrahedra per hexahedron."""
    strides = np.array([1, order * n[0] + 1, (order * n[0] + 1) * (order * n[1] + 1)])
    i, j, k = (order * a.ravel() for a in np.meshgrid(*map(np.arange, n), indexing="ij"))
    first = i * strides[0] + j * strides[1] + k * strides[2]
    kind, variant = basix.CellType[cell], basix.LagrangeVariant.equispaced
    nodes = basix.create_element(basix.ElementFamily.P, kind, order, variant).points
    if cell == "hexahedron":
        corners = [strides]
    else:
        corners = [np.cumsum(strides[list(way)]) for way in permutations(range(3))]
    steps = [np.rint(order * nodes @ c).astype(np.int64) for c in corners]
    return np.concatenate([first[:, None] + step for step in steps])


def _halved(points: Array, shape: list[int]) -> Array:
    """Return the points of a grid (x fastest) of such a shape, with others half way between."""
    grid = points.reshape(*shape[::-1], 3)
    for axis in range(3):
        grid = np.moveaxis(grid, axis, 0)
        fine = np.empty((2 * len(grid) - 1, *grid.shape[1:]))
        fine[::2], fine[1::2] = grid, (grid[:-1] + grid[1:]) / 2
        grid = np.moveaxis(fine, 0, axis)
    return grid.reshape(-1, 3)


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
    sizes = [tuple(len(line) - 1 for line in box) for box in lines]
    parts = [box_points(box, jitter, seed + i) for i, box in enumerate(lines)]
    if order > 1:
        parts = [
            _halved(x, [len(line) for line in box]) for x, box in zip(parts, lines, strict=True)
        ]
    n_l = len(parts[0])
    points = np.concatenate(parts)
    cells = np.concatenate(
        [box_cells(sizes[0], cell, order), box_cells(sizes[1], cell, order) + n_l]
    )

    def move(x: Array) -> Array:
        x = x if turn is None else x @ turn.T
        return x if transform is None else transform(x)

    where = partition, gap, heights[1]
    marks = _marks([tuple(order * n for n in size) for size in sizes], n_l)
    return _two_bodies(comm, points, cells, n_l, move, (cell, order), where, marks)


def _marks(sizes: list[tuple[int, ...]], n_l: int) -> list[tuple[int, Callable]]:
    """Return tags and conditions on node numbers for the faces of the boxes."""
    a, b = (np.array(size) + 1 for size in sizes)

    def index(i: Ints) -> list[Ints]:
        """Return the grid index of nodes in each direction."""
        below = i < n_l
        i = np.where(below, i, i - n_l)
        nx, ny = np.where(below, a[0], b[0]), np.where(below, a[1], b[1])
        return [i % nx, i // nx % ny, i // (nx * ny)]

    def low(i: Ints, axis: int) -> npt.NDArray[np.bool_]:
        return index(i)[axis] == 0

    def high(i: Ints, axis: int) -> npt.NDArray[np.bool_]:
        return index(i)[axis] == np.where(i < n_l, a[axis], b[axis]) - 1

    return [
        (LEFT, lambda i: low(i, 0)),
        (RIGHT, lambda i: high(i, 0)),
        (FRONT, lambda i: low(i, 1)),
        (BACK, lambda i: high(i, 1)),
        (BOTTOM, lambda i: low(i, 2) & (i < n_l)),
        (TOP, lambda i: high(i, 2) & (i >= n_l)),
        (TOP_OF_LOWER, lambda i: high(i, 2) & (i < n_l)),
        (BOTTOM_OF_UPPER, lambda i: low(i, 2) & (i >= n_l)),
    ]
