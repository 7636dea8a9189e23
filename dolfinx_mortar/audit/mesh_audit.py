# SPDX-License-Identifier: MIT
"""Audit of the mesh: NaN coordinates; collapsed, inverted or folded cells.

dolfinx orders nodes freely, so that only the signs of the Jacobian within a cell are compared, and
the sides of a facet on which two simplices lie.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
from dolfinx import la
from dolfinx.mesh import Mesh
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arrays import Bools, Floats, Longs
from dolfinx_mortar.common.spaces import HIGHEST
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.interfaces.coupling import Sides
from dolfinx_mortar.solid.kinematics import on_axis
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.supports import Dirichlet

SIMPLICES = ("triangle", "tetrahedron")
CELLS = (*SIMPLICES, "quadrilateral", "hexahedron")


def check_mesh(mesh: Mesh) -> None:
    """Raise a ValueError on all ranks for invalid cells; collective.

    Unsupported degree, NaN or infinite coordinates, no volume, Jacobians that change sign, overlaps
    with neighbours. Unsupported kinds of cells are ignored.
    """
    kind, d = mesh.topology.cell_name(), mesh.topology.dim
    if kind not in CELLS or mesh.geometry.dim != d:
        return
    degree = compat.cell_degree(mesh)
    if degree > HIGHEST:
        raise ValueError(
            f"mesh: the geometry has degree {degree}; make the mesh with degree 1 or {HIGHEST}"
        )
    geometry, owned = mesh.geometry, mesh.topology.index_map(d).size_local
    dofs = np.ascontiguousarray(compat.cell_nodes(mesh)[:owned].T)
    x = np.moveaxis(np.asarray(geometry.x[dofs, :d], dtype=np.float64), 2, 1)  # (k, d, n)
    reject = partial(_reject, mesh.comm, x)
    reject(
        ~np.isfinite(x).all(axis=(0, 1)),
        "have coordinates that are NaN or infinite",
        "check the mesh",
    )
    # two points per edge of tensor cells, three for degree 2
    exact = 3 * degree - 2 if kind in SIMPLICES else 2 * degree + 1
    points, _ = map(np.asarray, basix.make_quadrature(basix.CellType[kind], exact))
    most, least = x.max(axis=0), x.min(axis=0)
    largest, extent = np.maximum(most, -least).max(axis=0), (most - least).max(axis=0)
    with np.errstate(under="ignore"):
        noise, J = ROUND_OFF * largest * extent ** (d - 1), jacobians(x, kind, points, degree)
    reject((np.abs(J) <= noise).all(axis=0), "have collapsed, without volume", "remesh there")
    order = "the nodes of a cell are in dolfinx's order (a tensor product, not around it)"
    remedy = f"check that no node was moved too far, and that {order}"
    mixed = (J > noise).any(axis=0) & (J < -noise).any(axis=0)
    reject(mixed, "are inverted: the Jacobian changes sign inside", remedy)
    if kind in SIMPLICES:
        nodes = geometry.index_map().local_to_global(dofs[: d + 1].ravel().astype(np.int32))
        beside = _beside_neighbour(mesh, nodes.reshape(d + 1, -1), x[: d + 1])
        what = "lie on the same side of a facet as a neighbour: one of the two is inverted or"
        reject(beside, f"{what} folded", "check that no node was moved through a cell")


def jacobians(x: Floats, kind: str, points: Floats, degree: int = 1) -> Floats:
    """Jacobians (q, n) of cells x (k, d, n) at reference points (q, d).

    >>> square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0], [2.0, 1.0]])[:, :, None]
    >>> jacobians(square, "quadrilateral", np.array([[0.25, 0.5]])).round(12).tolist()
    [[2.0]]
    """
    cell, variant = basix.CellType[kind], basix.LagrangeVariant.equispaced
    element = basix.create_element(basix.ElementFamily.P, cell, degree, variant)
    slopes = np.asarray(element.tabulate(1, points))[1:, :, :, 0]  # (d, q, k)
    return np.linalg.det(np.einsum("dqk,kin->qndi", slopes, x))


def _beside_neighbour(mesh: Mesh, nodes: Longs, x: Floats) -> Bools:
    """Mask (n,) of simplices on the same side of a facet as their neighbour; collective."""
    topology, d = mesh.topology, x.shape[1]
    topology.create_entities(d - 1)
    topology.create_connectivity(d, d - 1)
    # facet i lacks vertex i; oriented as the cell with ascending nodes
    order = np.argsort(nodes, axis=0)
    ascending = np.take_along_axis(x, order[:, None], axis=0)
    orientation = np.sign(np.linalg.det((ascending[1:] - ascending[0]).transpose(2, 0, 1)))
    sides = orientation * (-1.0) ** np.argsort(order, axis=0)
    facets = topology.connectivity(d, d - 1).array[: sides.size].reshape(-1, d + 1).T
    total = la.vector(topology.index_map(d - 1))
    total.array[:] = np.bincount(facets.ravel(), sides.ravel(), minlength=len(total.array))
    total.scatter_reverse(la.InsertMode.add)
    total.scatter_forward()
    return np.asarray((np.abs(total.array) == 2.0)[facets].any(axis=0))


def _reject(comm: MPI.Comm, x: Floats, bad: Any, what: str, remedy: str) -> None:
    count, total = comm.allreduce(np.array([bad.sum(), len(bad)]), op=MPI.SUM)
    if count == 0:
        return
    some = np.moveaxis(x[:, :, bad], 2, 0)
    finite = np.isfinite(some)
    centres = np.where(finite, some, 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1)
    every = np.concatenate(comm.allgather(centres))
    first, *others = sorted(tuple(float(f"{v:.4g}") + 0.0 for v in centre) for centre in every)
    more = " and elsewhere" if others else ""
    raise ValueError(f"mesh: {count} of {total} cells {what}, around {first}{more}; {remedy}")


def check_axis(solid: Solid, supports: Dirichlet, sides: Sequence[Sides]) -> None:
    """Raise a ValueError on all ranks for free nodes or facets on the axis; collective.

    A radial displacement there makes u_r / r infinite, or merely large on a mesh.
    """
    V, i = solid.V, solid.kinematics.radius
    if i is None:
        return
    axis = on_axis(solid.kinematics, V.mesh, V.tabulate_dof_coordinates())
    free = axis[: len(supports.owned)] & ~supports.owned[:, i]
    missing = V.mesh.comm.allreduce(int(np.sum(free)), op=MPI.SUM)
    if missing:
        raise ValueError(
            f"bcs: {missing} nodes on the axis r = 0 are not held in r, where u_r / r has no limit "
            f"otherwise; prescribe 0 on V.sub({i}) at the nodes with x[{i}] = 0"
        )
    for side in sides:
        for surface, name in zip(side.surfaces, ("slave", "master"), strict=False):
            flat = axis[surface.nodes[surface.facets]].all(axis=1)
            bad = V.mesh.comm.allreduce(int(np.sum(flat)), op=MPI.SUM)
            if bad:
                raise ValueError(
                    f"{name}={surface.label}: {bad} facets lie on the axis r = 0, which is inside "
                    "the body; leave them out of the tag"
                )
