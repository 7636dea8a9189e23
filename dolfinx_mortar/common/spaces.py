# SPDX-License-Identifier: MIT
"""Supported displacement spaces, and values of their Functions."""

from collections.abc import Callable
from typing import Any, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import scipy

import dolfinx
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arrays import Floats, Ints, Longs
from ufl.domain import extract_unique_domain

S = TypeVar("S", np.bool_, np.int32, np.float64)
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")
HIGHEST = 2
"""Highest degree of the displacement, and of the cells themselves."""


def check_space(
    V: dolfinx.fem.FunctionSpace, name: str = "V", *, scalar: bool = False, on_cells: bool = True
) -> None:
    """Raise a ValueError for unsupported spaces; not collective.

    Lagrange of degree 1 or 2 is supported, on cells of no higher degree (`on_cells`); scalar spaces
    if `scalar`.
    """
    if not isinstance(V, dolfinx.fem.FunctionSpace):
        of = "" if scalar else " of displacements"
        raise ValueError(f"{name} is {V!r}: give a dolfinx.fem.FunctionSpace{of}.")
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
    kinds = [((d,), d), ((), 1)] if scalar else [((d,), d)]
    if (element.reference_value_shape, bs) not in kinds or not 1 <= degree <= HIGHEST:
        found = f"Lagrange of degree {degree}" if lagrange else str(element)
        shapes = "scalar or vector" if scalar else "vector"
        raise ValueError(
            f"{name} has the element {found} with values of shape {element.reference_value_shape}; "
            f"it has to be a continuous {shapes} Lagrange element of degree 1 or 2, "
            f'functionspace(mesh, ("Lagrange", 1, ({d},))).'
        )
    curved = compat.cell_degree(V.mesh)
    if on_cells and curved > degree:
        remedy = f"make the mesh with degree {degree} (in Gmsh: mesh.setOrder({degree}))"
        if curved <= HIGHEST:
            remedy = f"give {name} the degree {curved}, or {remedy}"
        raise ValueError(
            f"{name}: the cells of the mesh are of degree {curved}, the displacement of degree "
            f"{degree}; facets would not lie on the cells: {remedy}."
        )


def find_positions(
    V: dolfinx.fem.FunctionSpace, u: dolfinx.fem.Function | None, *, same_nodes: bool
) -> tuple[dolfinx.fem.FunctionSpace, dolfinx.fem.Function | None]:
    """Vector space of positions X + u for a space V, and u in it; collective.

    Of the highest degree of V, u (None for X) and the cells; with nodes numbered as in V if
    `same_nodes`, else a ValueError.
    """
    spaces = [V]
    if u is not None:
        if not isinstance(u, dolfinx.fem.Function) or not compat.on_same_mesh(
            u.function_space.mesh, V.mesh
        ):
            raise ValueError(
                "u has to be a Function of V or of another space of displacements on the mesh of "
                f"V, or None for the reference configuration; it is {u!r}."
            )
        check_space(u.function_space, "u", on_cells=False)
        check_real("u", u)
        spaces.append(u.function_space)
    d, degrees = V.mesh.geometry.dim, [W.element.basix_element.degree for W in spaces]
    degree = max(*degrees, compat.cell_degree(V.mesh))
    if same_nodes and degree > degrees[0]:
        raise ValueError(
            f"u has degree {degree}, V degree {degrees[0]}: its facets would bend between the "
            f"nodes of V; give V the degree {degree}, or interpolate u into degree {degrees[0]}."
        )

    found = dolfinx.fem.functionspace(V.mesh, ("Lagrange", degree, (d,)))
    same = not same_nodes or np.array_equal(found.dofmap.list, V.dofmap.list)
    if not V.mesh.comm.allreduce(same, op=MPI.LAND):
        raise ValueError(
            "V numbers its nodes as no space of displacements does; make it by "
            "dolfinx.fem.functionspace."
        )
    if u is None:
        return found, u
    moved = dolfinx.fem.Function(found)
    moved.interpolate(u)
    moved.x.scatter_forward()
    return found, moved


def check_real(name: str, *values: Any) -> None:
    """Raise a ValueError unless Constants and Functions are dolfinx's, of float64."""
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
    """Mean size of the cells around the node of each owned dof; collective."""
    means = means_around(V, lambda cells: V.mesh.h(V.mesh.topology.dim, cells)[:, None])
    return np.repeat(means[:, 0], V.dofmap.index_map_bs)


def means_around(V: dolfinx.fem.FunctionSpace, of_cells: Callable[[Ints], Floats]) -> Floats:
    """Means (n, c) at owned nodes of values (m, c) of the cells around; collective."""
    cells = np.arange(V.mesh.topology.index_map(V.mesh.topology.dim).size_local, dtype=np.int32)
    values = np.column_stack([of_cells(cells), np.ones(len(cells))])
    sums = dolfinx.la.vector(V.dofmap.index_map, values.shape[1])
    table = sums.array.reshape(-1, values.shape[1])
    table[:] = 0.0
    np.add.at(table, V.dofmap.list[cells], values[:, None])
    sums.scatter_reverse(dolfinx.la.InsertMode.add)
    owned = table[: V.dofmap.index_map.size_local]
    return np.asarray(owned[:, :-1] / owned[:, -1:], dtype=np.float64)


def set_owned(f: dolfinx.fem.Function, values: Floats) -> None:
    """Set the owned values (n, c) of a Function, and ghosts; collective."""
    f.x.array[: values.size] = values.ravel()
    f.x.scatter_forward()


def with_values(V: dolfinx.fem.FunctionSpace, values: Floats) -> dolfinx.fem.Function:
    """Return a Function of owned values (n, c); collective."""
    f = dolfinx.fem.Function(V)
    set_owned(f, values)
    return f


def connected_parts(V: dolfinx.fem.FunctionSpace) -> tuple[int, Ints]:
    """Number of connected parts, and part (local nodes,) of nodes; collective."""
    layout, comm = V.dofmap.index_map, V.mesh.comm
    n_owned, n_local = layout.size_local, layout.size_local + layout.num_ghosts
    cells = V.dofmap.list
    local = components(cells[:, :-1].ravel(), cells[:, 1:].ravel(), n_local)
    parts = int(local.max(initial=-1)) + 1

    # a ghost of one part may be owned by another
    local = local + np.int32(comm.exscan(parts) or 0)
    touching = np.column_stack([local, with_ghosts(V, local[:n_owned])])
    links = np.concatenate(comm.allgather(np.unique(touching, axis=0)))
    label = components(links[:, 0], links[:, 1], comm.allreduce(parts))[local]
    used = np.unique(np.concatenate(comm.allgather(np.unique(label[:n_owned]))))
    return len(used), np.searchsorted(used, label).astype(np.int32)


def components(first: Longs | Ints, second: Longs | Ints, count: int) -> Ints:
    """Number (count,) of the connected component of each of some things that pairs join."""
    graph = scipy.sparse.coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def check_nodal(
    name: str, function: dolfinx.fem.Function, shape: tuple[int, ...], wanted: str
) -> None:
    """Raise a ValueError unless values are nodal, of shape () or (d,)."""
    V = function.function_space
    element = V.ufl_element()
    if V.component():
        raise ValueError(f"{name} is a part of a Function: give function.sub(i).collapse()")
    if element.family_name != "P" or element.discontinuous:
        raise ValueError(
            f"{name} is a Function with the element {element}, which has not one value at every "
            f"node: interpolate it into a Lagrange space; {wanted}"
        )
    if element.reference_value_shape != shape:
        raise ValueError(
            f"{name} is a Function with values of shape {element.reference_value_shape}: {wanted}"
        )


def check_mesh(name: str, value: Any, V: dolfinx.fem.FunctionSpace) -> None:
    """Raise a ValueError for a value on another mesh."""
    known = isinstance(value, dolfinx.fem.Constant | dolfinx.fem.Function)
    if known and extract_unique_domain(value) != V.mesh.ufl_domain():
        raise ValueError(
            f"{name} is a {type(value).__name__} on another mesh than solid.u: make it on "
            "solid.mesh"
        )


def with_ghosts(V: dolfinx.fem.FunctionSpace, owned: npt.NDArray[S]) -> npt.NDArray[S]:
    """Marks or numbers (owned nodes,) or (owned nodes, c) extended to ghosts; collective."""
    vector = dolfinx.la.vector(V.dofmap.index_map, int(np.prod(owned.shape[1:])))
    vector.array[: owned.size] = owned.ravel()
    vector.scatter_forward()
    return vector.array.reshape(-1, *owned.shape[1:]).astype(owned.dtype)
