# SPDX-License-Identifier: MIT
"""Displacement spaces: which are supported, and values of their Functions; for all modules."""

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import dolfinx
from dolfinx_mortar import compat
from dolfinx_mortar.arrays import Floats, Ints

CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
HIGHEST = 2
"""Highest degree of the displacement, and of the cells themselves."""


def check_space(V: dolfinx.fem.FunctionSpace, name: str = "V") -> None:
    """Raise a ValueError, without communication, for spaces that are not supported.

    Args:
        name: the argument that it comes from, for messages.

    Raises:
        ValueError: For what is no function space, meshes in single precision, a complex PETSc,
            other cell types or dimensions, subspaces, other elements than vector Lagrange of
            degree 1 or 2, and cells of a higher degree than the displacement.
    """
    if not isinstance(V, dolfinx.fem.FunctionSpace):
        raise ValueError(f"{name} is {V!r}: give a dolfinx.fem.FunctionSpace of displacements.")
    if V.mesh.geometry.x.dtype != np.float64:
        raise ValueError(
            f"{name}: the coordinates of the mesh are of type {V.mesh.geometry.x.dtype}; make the "
            "mesh with dtype=numpy.float64."
        )
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise ValueError("PETSc was built for complex numbers; use a build for real numbers.")
    cell, d = V.mesh.topology.cell_name(), V.mesh.geometry.dim
    if cell not in CELLS or d != V.mesh.topology.dim:
        raise ValueError(
            f"{name}: cells of type {cell} in {d}D are not supported; use one of "
            f"{', '.join(CELLS)}, the same for all bodies."
        )
    if V.component():
        raise ValueError(f"{name} is in a part of a larger space; use V.collapse()[0].")
    element, bs = V.ufl_element(), V.dofmap.index_map_bs
    lagrange = element.family_name == "P" and not element.discontinuous
    degree = V.element.basix_element.degree if lagrange else 0
    if (element.reference_value_shape, bs) != ((d,), d) or not 1 <= degree <= HIGHEST:
        found = f"Lagrange of degree {degree}" if lagrange else str(element)
        raise ValueError(
            f"{name} has the element {found} with values of shape {element.reference_value_shape}; "
            "it has to be a continuous vector Lagrange element of degree 1 or 2, "
            f'functionspace(mesh, ("Lagrange", 1, ({d},))).'
        )
    curved = compat.cell_degree(V.mesh)
    if curved > degree:
        remedy = f"make the mesh with degree {degree} (in Gmsh: mesh.setOrder({degree}))"
        if curved <= HIGHEST:
            remedy = f"give {name} the degree {curved}, or {remedy}"
        raise ValueError(
            f"{name}: the cells of the mesh are of degree {curved}, the displacement of degree "
            f"{degree}; facets would not lie on the cells: {remedy}."
        )


def check_real(name: str, *values: Any) -> None:
    """Raise a ValueError unless Constants and Functions are those of dolfinx, of type float64.

    Args:
        values: Constants and Functions.
    """
    for value in values:
        if not isinstance(value, dolfinx.fem.Constant | dolfinx.fem.Function):
            raise ValueError(
                f"{name} holds a ufl.{type(value).__name__}, which has no values: use those of "
                "dolfinx.fem"
            )
        numbers = value.value if isinstance(value, dolfinx.fem.Constant) else value.x.array
        if numbers.dtype != np.float64:
            raise ValueError(
                f"{name} holds a {type(value).__name__} of type {numbers.dtype}: make it with real "
                "numbers of type float64"
            )


def mean_cell_sizes(V: dolfinx.fem.FunctionSpace) -> Floats:
    """Return the mean size of the cells around the node of each owned dof (n,); collective."""
    domain, d, bs = V.mesh, V.mesh.topology.dim, V.dofmap.index_map_bs
    cells = np.arange(domain.topology.index_map(d).size_local, dtype=np.int32)
    sums, counts = (dolfinx.la.vector(V.dofmap.index_map, 1) for _ in range(2))
    for total, values in ((sums, domain.h(d, cells)), (counts, np.ones(len(cells)))):
        nodes = V.dofmap.list[cells]
        np.add.at(total.array, nodes, values[:, None])
        total.scatter_reverse(dolfinx.la.InsertMode.add)
    n = V.dofmap.index_map.size_local
    return np.repeat(sums.array[:n] / counts.array[:n], bs)


def set_owned(f: dolfinx.fem.Function, values: Floats) -> None:
    """Set the owned values (n, c) of a Function, and those of ghosts; collective."""
    f.x.array[: values.size] = values.ravel()
    f.x.scatter_forward()


def with_values(V: dolfinx.fem.FunctionSpace, values: Floats) -> dolfinx.fem.Function:
    """Return a Function by its owned values (n, c); collective."""
    f = dolfinx.fem.Function(V)
    set_owned(f, values)
    return f


def connected_parts(V: dolfinx.fem.FunctionSpace) -> tuple[int, Ints]:
    """Return how many parts a mesh has that share no nodes, and the part (local nodes,) of each.

    They are numbered from 0 on, the same on all ranks; collective.
    """
    layout, comm = V.dofmap.index_map, V.mesh.comm
    n_owned, n_local = layout.size_local, layout.size_local + layout.num_ghosts
    cells = V.dofmap.list
    first, last = cells[:, :-1].ravel(), cells[:, 1:].ravel()
    graph = coo_array((np.ones(len(first)), (first, last)), shape=(n_local, n_local))
    parts, local = connected_components(graph, directed=False)

    # Parts of different ranks are one body where a ghost of one part is owned by the other.
    offset = comm.exscan(parts) or 0
    vector = dolfinx.la.vector(layout, 1)
    vector.array[:n_owned] = local[:n_owned] + offset
    vector.scatter_forward()
    touching = np.column_stack([local + offset, vector.array]).astype(np.int64)
    links = np.concatenate(comm.allgather(np.unique(touching, axis=0)))
    total = comm.allreduce(parts, op=MPI.SUM)
    joined = coo_array((np.ones(len(links)), links.T), shape=(total, total))
    _, body_of = connected_components(joined, directed=False)
    label = body_of[local + offset]
    used = np.unique(np.concatenate(comm.allgather(np.unique(label[:n_owned]))))
    return len(used), np.searchsorted(used, label).astype(np.int32)
