# SPDX-License-Identifier: MIT
"""Two bodies in one distributed mesh: from arrays on one rank, or from gmsh, with names."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

import basix
import basix.ufl
import ufl
from dolfinx import mesh as dmesh
from dolfinx_mortar.arguments import POSITIVE, array, check, number
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.tags import Tags

Arrays = tuple[Floats, Longs]  # nodes (n, d), cells (m, k)

# All options of gmsh that are set here, with gmsh's defaults for those that only some meshes set.
GMSH_OPTIONS = {
    "General.Terminal": 0.0,
    "Mesh.Algorithm": 6.0,
    "Mesh.Algorithm3D": 1.0,
    "Mesh.MeshSizeExtendFromBoundary": 0.0,
    "Mesh.MeshSizeFromCurvature": 0.0,
    "Mesh.MeshSizeFromPoints": 0.0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeMin": 0.0,
    "Mesh.RecombinationAlgorithm": 1.0,
    "Mesh.RecombineAll": 0.0,
    "Mesh.SwitchElementTags": 0.0,
}


class TaggedMesh(NamedTuple):
    """A mesh with its bodies and their sides, by name."""

    mesh: dmesh.Mesh  # of all bodies
    cell_tags: Tags  # bodies
    facet_tags: Tags  # sides and supports


@contextmanager
def gmsh_model() -> Iterator[Any]:
    """Yield gmsh with an empty model of its own; leave gmsh as it was found."""
    import gmsh

    started = not gmsh.isInitialized()
    if started:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    before = {name: gmsh.option.getNumber(name) for name in GMSH_OPTIONS}
    model = gmsh.model.getCurrent()
    try:
        for name, value in GMSH_OPTIONS.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add("dolfinx_mortar body")
        try:
            yield gmsh
        finally:
            gmsh.model.remove()
    finally:
        if started:
            gmsh.finalize()
        else:
            for name, value in before.items():
                gmsh.option.setNumber(name, value)
            gmsh.model.setCurrent(model)


def set_graded_size(
    gmsh: Any, origin: int, h: float, *, core: float, limit: float, beyond: float
) -> None:
    """Let the size be h within ``core`` of the point ``origin``, then grow to limit h.

    The growth is linear, over the length ``beyond``.
    """
    field = gmsh.model.mesh.field
    distance, size = field.add("Distance"), field.add("Threshold")
    field.setNumbers(distance, "PointsList", [origin])
    for name, value in (
        ("InField", distance),
        ("SizeMin", h),
        ("SizeMax", limit * h),
        ("DistMin", core),
        ("DistMax", core + beyond),
    ):
        field.setNumber(size, name, value)
    field.setAsBackgroundMesh(size)


def read_cells(gmsh: Any, cell: str) -> Arrays:
    """Return nodes (n, 3) and cells (m, k) of the current gmsh model, all of one kind."""
    tags, x, _ = gmsh.model.mesh.getNodes()
    _, (numbers,), (cells,) = gmsh.model.mesh.getElements(gmsh.model.getDimension())
    position = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    position[tags] = np.arange(len(tags))
    # gmsh also lists points no cell uses, such as a circle's centre
    used, cells = np.unique(position[cells], return_inverse=True)
    cells = cells.reshape(len(numbers), -1)
    if cell == "quadrilateral":
        cells = cells[:, [0, 1, 3, 2]]  # gmsh goes around, dolfinx numbers like a tensor product
    return x.reshape(-1, 3)[used], cells


def on_axis(x: Floats) -> Floats:
    """Return nodes (n, d) with those at x = 0 up to round-off moved there."""
    near = np.abs(x[:, 0]) < HALF_OF_DIGITS * np.ptp(x[:, 0])
    return np.column_stack([np.where(near, 0.0, x[:, 0]), x[:, 1:]])


def mirrored(x: Floats, cells: Longs) -> Arrays:
    """Add the mirror image in x = 0, whose nodes are shared.

    >>> nodes, cells = mirrored(np.eye(4, 3), np.array([[0, 1, 2, 3]]))
    >>> nodes[:, 0].tolist(), cells.tolist()
    ([1.0, 0.0, 0.0, 0.0, -1.0], [[0, 1, 2, 3], [1, 4, 2, 3]])
    """
    x, d, k = on_axis(x), x.shape[1], cells.shape[1]
    off = x[:, 0] != 0.0
    image = np.arange(len(x))
    image[off] = len(x) + np.arange(np.count_nonzero(off))
    # an image is turned inside out; other orders of its nodes turn it back
    turn = [4, 5, 6, 7, 0, 1, 2, 3] if k == 8 else [1, 0, 2, 3][:k]
    turn = [1, 0, 3, 2] if (d, k) == (2, 4) else turn
    sign = np.where(np.arange(d) == 0, -1.0, 1.0)
    return np.concatenate([x, x[off] * sign]), np.concatenate([cells, image[cells][:, turn]])


def distribute(
    comm: MPI.Intracomm, create: Callable[[], tuple[Arrays, Arrays]], cell: str, degree: int = 1
) -> tuple[dmesh.Mesh, int]:
    """Distribute the two bodies that ``create`` returns on rank 0; collective.

    Returns the mesh, and how many of the input cells, which come first, belong to the first body.
    The nodes of a cell are in the order of dolfinx.

    Raises:
        RuntimeError: if gmsh is missing or fails, on all ranks.
    """
    d = np.asarray(basix.geometry(basix.CellType[cell])).shape[1]
    element = basix.ufl.element("Lagrange", cell, degree, shape=(d,))
    k = element.dim // d
    x: Floats = np.empty((0, d))
    cells: Longs = np.empty((0, k), dtype=np.int64)
    first, problem = 0, ""
    if comm.rank == 0:
        try:
            (x1, cells1), (x2, cells2) = create()
            x, cells = np.concatenate([x1, x2]), np.concatenate([cells1, cells2 + len(x1)])
            first = len(cells1)
        except ImportError:
            problem = "gmsh is not installed; install the Python package gmsh (or python3-gmsh)."
        except Exception as error:  # gmsh raises bare Exception
            problem = f"gmsh failed: {error}"
    first, problem = comm.bcast((first, problem))
    if problem:
        raise RuntimeError(problem)
    domain = ufl.Mesh(element)
    return dmesh.create_mesh(comm, cells=np.ascontiguousarray(cells), x=x, e=domain), first


def exterior_facets(mesh: dmesh.Mesh, in_first: Bools) -> tuple[Ints, Bools, Floats]:
    """Return the exterior facets (m,), whether they bound the first body, and their nodes.

    The nodes' coordinates have shape (m, k, 3).
    """
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    facets = dmesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(d - 1, d)
    first = np.asarray(in_first[to_cell.array[to_cell.offsets[facets]]])
    x = np.asarray(mesh.geometry.x, dtype=np.float64)
    if len(facets) == 0:  # dolfinx would divide by their number
        return facets, first, np.empty((0, d, 3))
    return facets, first, x[dmesh.entities_to_geometry(mesh, d - 1, facets)]


def name_parts(
    mesh: dmesh.Mesh,
    in_first: Bools,
    bodies: tuple[str, str],
    facets: Ints,
    sides: Mapping[str, Bools],
) -> TaggedMesh:
    """Tag two bodies and their sides with 1, 2, 3 .. in the order of their names.

    A local cell is in the first body or not (cells,); an exterior facet (m,) belongs to the last
    side that claims it.
    """
    values = np.where(in_first, 1, 2).astype(np.int32)
    every = np.arange(len(values), dtype=np.int32)
    cell_tags = dmesh.meshtags(mesh, mesh.topology.dim, every, values)
    of_facets = np.zeros(len(facets), dtype=np.int32)
    for tag, belongs in enumerate(sides.values(), start=1):
        of_facets[belongs] = tag
    chosen = of_facets > 0
    facet_tags = dmesh.meshtags(mesh, mesh.topology.dim - 1, facets[chosen], of_facets[chosen])
    cell_tags.name, facet_tags.name = "bodies", "boundary"
    names = (dict(zip(n, range(1, len(n) + 1), strict=True)) for n in (bodies, tuple(sides)))
    return TaggedMesh(mesh, Tags(cell_tags, next(names)), Tags(facet_tags, next(names)))


def name_sides(
    mesh: dmesh.Mesh,
    first: int,
    *,
    thickness: float,
    radius: float,
    gap: float,
    names: tuple[str, str],
    planes: tuple[str, ...],
) -> TaggedMesh:
    """Name the first cells a block with its top at height 0, the others a round body above it.

    The round body and its round side get the names; its flat side is at the height radius + gap.
    The planes are names of the sides at x = 0, y = 0 ..
    """
    in_block = mesh.topology.original_cell_index < first
    facets, of_block, x = exterior_facets(mesh, in_block)
    # on the scale of the body itself: the other one and the gap may be of any size
    tolerance = HALF_OF_DIGITS * np.where(of_block, thickness, radius)
    up = mesh.geometry.dim - 1

    def at(axis: int, position: float) -> Bools:
        return np.abs(x[:, :, axis] - position).max(axis=1, initial=0.0) < tolerance

    flat = ~of_block & at(up, radius + gap)
    sides = {"bottom": of_block & at(up, -thickness), "flat": flat, "top": of_block & at(up, 0.0)}
    sides |= {names[1]: ~of_block & ~flat} | {n: at(axis, 0.0) for axis, n in enumerate(planes)}
    return name_parts(mesh, in_block, ("block", names[0]), facets, sides)


def check_sizes(h: Any, radius: Any, block: Any, gap: Any, sides: str) -> tuple[float, ...]:
    """Return the element sizes of a block and of a round body on it; a ValueError names the rest.

    The block's sides are named in words, separated by commas; its thickness is the last.
    """
    wanted = "give a positive size, or two, of the block and of the round body"
    sizes = check("h", h, array((), (2,), remedy=wanted, holds=_positive))
    check("radius", radius, POSITIVE)
    wanted = f"give positive numbers: {sides}"
    count = sides.count(",") + 1
    *_, thickness = check("block", block, array((count,), remedy=wanted, holds=_positive))
    what = "0 for bodies that touch in a point, or a gap at which none reaches through the other,"
    check("gap", gap, number(what, above=-min(radius, float(thickness))))
    return tuple(map(float, np.broadcast_to(sizes, 2)))


def _positive(sizes: Floats) -> bool:
    return bool((sizes > 0.0).all())
