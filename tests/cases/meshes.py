# SPDX-License-Identifier: MIT
"""Meshes of the tests: two structured blocks that do not match at their interface."""

from collections.abc import Callable
from functools import partial
from itertools import permutations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import basix.ufl
import dolfinx

LOWER, UPPER = 1, 2
BOTTOM, TOP, TOP_OF_LOWER, BOTTOM_OF_UPPER, LEFT, RIGHT = 1, 2, 3, 4, 5, 6

Array = npt.NDArray[np.float64]


def _columns(n: int, x: tuple[float, float], splits, jitter: float, seed: int) -> Array:
    """Return the x coordinates of the grid lines of one block."""
    if splits is not None:
        return np.asarray(splits, dtype=float)
    lines = np.linspace(*x, n + 1)
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5, n - 1)
    lines[1:-1] += jitter * shift * (x[1] - x[0]) / n
    return lines


def box_points(lines, jitter: float = 0.0, seed: int = 0) -> Array:
    """Return the points of a grid, x fastest; inner ones shifted, those on a face within it."""
    d, grid = len(lines), np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    shift = np.random.default_rng(seed).uniform(-0.5, 0.5, grid.shape)
    for i, line in enumerate(lines):
        room = np.zeros(len(line))
        room[1:-1] = np.minimum(np.diff(line)[:-1], np.diff(line)[1:])
        shift[..., i] *= jitter * room.reshape([-1 if j == i else 1 for j in range(d)])
    return (grid + shift).transpose(*range(d)[::-1], d).reshape(-1, d)


def _halved(points: Array, shape: list[int]) -> Array:
    """Return the points of a grid (x fastest) of such a shape, with others half way between."""
    d, grid = len(shape), points.reshape(*shape[::-1], len(shape))
    for axis in range(d):
        grid = np.moveaxis(grid, axis, 0)
        fine = np.empty((2 * len(grid) - 1, *grid.shape[1:]))
        fine[::2], fine[1::2] = grid, (grid[:-1] + grid[1:]) / 2
        grid = np.moveaxis(fine, 0, axis)
    return grid.reshape(-1, d)


def box_cells(n, cell: str, order: int = 1) -> npt.NDArray[np.int64]:
    """Return the cells of a grid with n cells per direction; d! simplices in each box."""
    strides = np.cumprod([1, *(order * m + 1 for m in n[:-1])])
    grid = np.meshgrid(*map(np.arange, n), indexing="ij")
    grid = [i.ravel(order="FC"[len(n) - 2]) for i in grid]  # row by row in the plane
    first = order * sum(s * i for s, i in zip(strides, grid, strict=True))
    kind, variant = basix.CellType[cell], basix.LagrangeVariant.equispaced
    nodes = basix.create_element(basix.ElementFamily.P, kind, order, variant).points
    corners = [strides]
    if cell in ("triangle", "tetrahedron"):
        corners = [np.cumsum(strides[list(way)]) for way in permutations(range(len(n)))]
    steps = [np.rint(order * nodes @ c).astype(np.int64) for c in corners]
    return np.concatenate([first[:, None] + step for step in steps])


def _block(lines: Array, rows: Array, cell: str) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return points, numbered row by row, and cells of a structured block."""
    return box_points([lines, rows]), box_cells((len(lines) - 1, len(rows) - 1), cell)


def _partitioner(partition: str, comm: MPI.Comm, stripes: npt.NDArray[np.int32]):
    """Return dolfinx's partitioner, or one that sends each cell to the rank in `stripes`."""
    if comm.size == 1 or partition == "graph":
        return None
    if partition == "shared_facet":
        ghosts = dolfinx.mesh.GhostMode.shared_facet
        try:
            return dolfinx.mesh.create_cell_partitioner(ghosts, 2)
        except TypeError:  # before 0.11, which asks for the cells per facet
            return dolfinx.mesh.create_cell_partitioner(ghosts)

    def send(*_):
        destinations = dolfinx.graph.adjacencylist(stripes.reshape(-1, 1))
        return getattr(destinations, "_cpp_object", destinations)

    return send


def create_distributed(
    comm: MPI.Comm, points: Array, cells, cell: str, order: int = 1, partition="graph", ranks=None
) -> dolfinx.mesh.Mesh:
    """Return the mesh of which each rank gives its share; `ranks` are where stripes go."""
    mine, own = (
        slice(*(len(a) * np.array([comm.rank, comm.rank + 1]) // comm.size))
        for a in (cells, points)
    )
    stripes = np.zeros(len(cells)) if ranks is None else ranks
    return dolfinx.mesh.create_mesh(
        comm,
        cells[mine].astype(np.int64),
        x=np.ascontiguousarray(points[own]),
        e=basix.ufl.element("Lagrange", cell, order, shape=(points.shape[1],)),
        partitioner=_partitioner(partition, comm, stripes[mine].astype(np.int32)),
    )


def _two_bodies(comm, lines, move, kind, partition, jitter=0.0, seed=0):
    """Return mesh and tags of two bodies with the grid lines of each; kind: cell, order."""
    (cell, order), d = kind, len(lines[0])
    shapes = [[len(line) for line in box] for box in lines]
    parts = [box_points(box, jitter, seed + i) for i, box in enumerate(lines)]
    if order > 1:
        parts = [_halved(x, shape) for x, shape in zip(parts, shapes, strict=True)]
    n_l, points = len(parts[0]), np.concatenate(parts)
    lower, upper = (box_cells([n - 1 for n in shape], cell, order) for shape in shapes)
    cells = np.concatenate([lower, upper + n_l])
    middle = points[cells, 0].mean(axis=1)
    position = (middle - middle.min()) / (np.ptp(middle) * (1 + 1e-9))
    pieces = max(comm.size - 1, 1) if partition == "empty" else comm.size
    ranks = np.floor(pieces * position)
    if partition == "bodies" and comm.size > 1:
        rows = lines[1][-1]
        height = (points[cells, -1].mean(axis=1) - rows[0]) / (np.ptp(rows) * (1 + 1e-9))
        ranks = np.where(cells[:, 0] < n_l, 0, 1 + np.floor((comm.size - 1) * height))
    mesh = create_distributed(comm, move(points), cells, cell, order, partition, ranks)

    def on(axis, end, i):
        found = np.empty(i.shape, dtype=bool)
        for of, shape, first in ((i < n_l, shapes[0], 0), (i >= n_l, shapes[1], n_l)):
            fine = [order * (n - 1) + 1 for n in shape]
            index = np.unravel_index(i[of] - first, fine, order="F")[axis]
            found[of] = index == (fine[axis] - 1) * end
        return found

    flanks = [(axis, end) for axis in range(d - 1) for end in (0, 1)]
    marks = [(LEFT + k, partial(on, *flank)) for k, flank in enumerate(flanks)]
    marks += [
        (BOTTOM, lambda i: on(-1, 0, i) & (i < n_l)),
        (TOP, lambda i: on(-1, 1, i) & (i >= n_l)),
        (TOP_OF_LOWER, lambda i: on(-1, 1, i) & (i < n_l)),
        (BOTTOM_OF_UPPER, lambda i: on(-1, 0, i) & (i >= n_l)),
    ]
    cell_tags = _tag(mesh, d, [(LOWER, lambda i: i < n_l), (UPPER, lambda i: i >= n_l)])
    return mesh, cell_tags, _tag(mesh, d - 1, marks)


def _tag(mesh, dim: int, marks: list[tuple[int, Callable]]) -> dolfinx.mesh.MeshTags:
    """Tag entities whose nodes, numbered as in the input, all satisfy a condition."""
    mesh.topology.create_entities(dim)
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    if dim < mesh.topology.dim:
        entities = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    else:
        entities = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
    local = np.zeros((0, 1), dtype=np.int32)
    if len(entities):  # dolfinx 0.9 divides by their number
        local = dolfinx.mesh.entities_to_geometry(mesh, dim, entities).reshape(len(entities), -1)
    nodes = np.asarray(mesh.geometry.input_global_indices)[local]
    values = np.zeros(len(entities), dtype=np.int32)
    for tag, condition in marks:
        values[condition(nodes).all(axis=1)] = tag
    kept = values > 0
    order = np.argsort(entities[kept])
    return dolfinx.mesh.meshtags(mesh, dim, entities[kept][order], values[kept][order])


def skins(
    mesh: dolfinx.mesh.Mesh,
    cells: dolfinx.mesh.MeshTags,
    facets: dolfinx.mesh.MeshTags,
    keep: tuple[int, ...] = (BOTTOM, TOP),
) -> dolfinx.mesh.MeshTags:
    """Tag the whole skins of two bodies: 3 of the lower, 4 of the upper one, but for some tags."""
    dim = mesh.topology.dim
    exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    cell_of = mesh.topology.connectivity(dim - 1, dim)
    upper = np.isin(cell_of.array[cell_of.offsets[exterior]], cells.find(UPPER))
    values = np.where(upper, BOTTOM_OF_UPPER, TOP_OF_LOWER).astype(np.int32)
    for tag in keep:
        values[np.isin(exterior, facets.find(tag))] = tag
    return dolfinx.mesh.meshtags(mesh, dim - 1, exterior, values)


def two_blocks(
    comm: MPI.Comm,
    n_lower: tuple[int, int] = (2, 2),
    n_upper: tuple[int, int] = (3, 3),
    *,
    x_lower: tuple[float, float] = (0.0, 1.0),
    x_upper: tuple[float, float] = (0.0, 1.0),
    heights: tuple[float, float] = (1.0, 1.0),
    gap: float = 0.0,
    cell: str = "triangle",
    angle: float = 0.0,
    splits_lower: npt.ArrayLike | None = None,
    splits_upper: npt.ArrayLike | None = None,
    jitter: float = 0.0,
    seed: int = 0,
    transform: Callable[[Array], Array] | None = None,
    partition: str = "graph",
    order: int = 1,
) -> tuple[dolfinx.mesh.Mesh, dolfinx.mesh.MeshTags, dolfinx.mesh.MeshTags]:
    """Create a mesh of two disconnected blocks, one above the other.

    The interface lies on y = 0 (lower block) and y = gap (upper block) before everything is
    turned about the origin by `angle`.

    Args:
        comm: Communicator.
        n_lower: Number of columns and rows of the lower block.
        n_upper: Number of columns and rows of the upper block.
        x_lower: Ends of the lower block.
        x_upper: Ends of the upper block.
        heights: Heights of the lower and the upper block.
        gap: Initial gap, negative for an overlap.
        cell: "triangle" or "quadrilateral".
        angle: Inclination in radians.
        splits_lower: Grid lines of the lower block, in place of `n_lower[0]` and `x_lower`.
        splits_upper: Grid lines of the upper block, in place of `n_upper[0]` and `x_upper`.
        jitter: Random shift of the inner grid lines, in parts of the spacing (below 1).
        seed: Seed of the shift.
        transform: Map of the (n, 2) points, applied after the rotation.
        partition: "graph" (dolfinx's choice), "shared_facet" (the same, with ghost cells),
            "stripes" (every rank has a piece of both blocks and of both sides of the interface),
            "bodies" (the first rank has the lower block, the others layers of the upper one: all
            but two ranks have no facet of the interface), "empty" (stripes, and nothing for the
            last rank).
        order: Degree of the cells; `transform` bends those of degree 2.

    Returns:
        Mesh; cell tags (1 lower, 2 upper); facet tags (1 bottom of the lower block, 2 top of the
        upper one, 3 top of the lower one, 4 bottom of the upper one, 5 left, 6 right sides).
    """
    lower = _columns(n_lower[0], x_lower, splits_lower, jitter, seed)
    upper = _columns(n_upper[0], x_upper, splits_upper, jitter, seed + 1)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])

    def move(x: Array) -> Array:
        x = x @ turn if angle else x
        return x if transform is None else transform(x)

    rows = np.linspace(-heights[0], 0, n_lower[1] + 1)
    above = np.linspace(gap, gap + heights[1], n_upper[1] + 1)
    lines = [lower, rows], [upper, above]
    return _two_bodies(comm, lines, move, (cell, order), partition)
