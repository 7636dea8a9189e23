# SPDX-License-Identifier: MIT
"""Two bodies in one distributed mesh: from arrays on one rank, or from gmsh, with names."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

import basix.ufl
import ufl
from dolfinx import mesh as dmesh
from dolfinx_mortar.arguments import as_numbers, is_number
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
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
}
GMSH_TYPE = {"triangle": 2, "quadrilateral": 3, "tetrahedron": 4}
NODES = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}
DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
ON_PLANE = 1e-9  # a point closer to a plane, in sizes of its body, is on it


class TaggedMesh(NamedTuple):
    """A mesh with its bodies and their sides, by name."""

    mesh: dmesh.Mesh
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
    """Let the size be h within ``core`` of a point, then grow linearly to limit h over ``beyond``.

    Args:
        gmsh: the module, with a synchronised model.
        origin: number of the point.
        h: smallest size.
        core: distance from the point at which the growth starts.
        limit: largest size over h.
        beyond: length over which it is reached.
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
    """Return nodes (n, 3) and cells (m, k) of the current gmsh model, without unused points."""
    tags, x, _ = gmsh.model.mesh.getNodes()
    _, cells = gmsh.model.mesh.getElementsByType(GMSH_TYPE[cell])
    position = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    position[tags] = np.arange(len(tags))
    # gmsh also lists points no cell uses, such as a circle's centre
    used, cells = np.unique(position[cells], return_inverse=True)
    cells = cells.reshape(-1, NODES[cell])
    if cell == "quadrilateral":
        cells = cells[:, [0, 1, 3, 2]]  # gmsh goes around, dolfinx numbers like a tensor product
    return x.reshape(-1, 3)[used], cells


def distribute(
    comm: MPI.Intracomm, create: Callable[[], tuple[Arrays, Arrays]], cell: str, degree: int = 1
) -> tuple[dmesh.Mesh, int]:
    """Distribute the two bodies that ``create`` returns on rank 0; collective.

    Args:
        comm: communicator of the mesh.
        create: returns the arrays of both bodies; the nodes of a cell in the order of dolfinx.
        cell: name of the cells.
        degree: of the cells.

    Returns:
        The mesh, and how many of the input cells, which come first, belong to the first body.

    Raises:
        RuntimeError: if gmsh is missing or fails, on all ranks.
    """
    d = DIMENSION[cell]
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

    Args:
        mesh: of both bodies.
        in_first: (cells,) whether a local cell is in the first body.
        bodies: their names.
        facets: (m,) exterior facets.
        sides: which of the facets belong to a side, by its name; the last side takes a facet.
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


def positive(name: str, value: Any, parts: str, *, one: bool = False) -> tuple[float, ...]:
    """Return positive, finite numbers.

    Args:
        name: of the argument.
        value: what was given for it.
        parts: what the numbers are, separated by commas, which says how many there are.
        one: whether one number may stand for all of them.

    Raises:
        ValueError: for anything else.
    """
    count = len(parts.split(", "))
    numbers = as_numbers(value)
    shapes = {() if count == 1 else (count,)} | ({()} if one else set())
    good = numbers is not None and numbers.shape in shapes and np.isfinite(numbers).all()
    if numbers is None or not good or not (numbers > 0.0).all():
        more = ", or one for all" if one else ""
        raise ValueError(f"{name} = {value!r} must be finite and positive: {parts}{more}.")
    return tuple(float(number) for number in np.broadcast_to(numbers, count))


def check_gap(gap: Any, deepest: float) -> None:
    """Raise a ValueError unless bodies can be so far apart, or so deep in each other.

    Args:
        gap: what was given for it.
        deepest: the overlap at which one body reaches through the other one.
    """
    if not (is_number(gap) and gap > -deepest):
        raise ValueError(
            f"gap = {gap!r} must be a number above {-deepest:g}, where one body reaches through "
            "the other one; use 0 for bodies that touch in a point."
        )
