# SPDX-License-Identifier: MIT
"""Audit of the mesh: NaN coordinates; collapsed, inverted or folded cells.

dolfinx orders nodes freely, so that only the signs of the Jacobian within a cell are compared, and
the sides of a facet on which two simplices lie.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
from dolfinx import la
from dolfinx.mesh import Mesh
from dolfinx_mortar import compat
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.spaces import HIGHEST

SIMPLICES = ("triangle", "tetrahedron")
CELLS = (*SIMPLICES, "quadrilateral", "hexahedron")


@dataclass(frozen=True)
class _Cells:
    mesh: Mesh
    kind: str
    nodes: Longs  # (k, n) global numbers
    x: Floats  # (k, d, n) coordinates


def check_mesh(mesh: Mesh) -> None:
    """Raise a ValueError on all ranks for invalid cells; collective.

    Invalid: unsupported degree of the geometry, NaN or infinite coordinates, no volume, Jacobians
    that change sign, overlaps with neighbours. Unsupported kinds of cells are ignored.
    """
    kind, d = mesh.topology.cell_name(), mesh.topology.dim
    if kind not in CELLS or mesh.geometry.dim != d:
        return
    degree = compat.cell_degree(mesh)
    if degree > HIGHEST:
        raise ValueError(
            f"mesh: the geometry has degree {degree}; make the mesh with degree 1 or {HIGHEST}"
        )
    cells = _own_cells(mesh, kind)
    bad = ~np.isfinite(cells.x).all(axis=(0, 1))
    _reject(cells, bad, "have coordinates that are NaN or infinite", "check the mesh")
    # two points per edge of tensor cells, three for degree 2
    exact = 3 * degree - 2 if kind in SIMPLICES else 2 * degree + 1
    points, _ = map(np.asarray, basix.make_quadrature(basix.CellType[kind], exact))
    with np.errstate(under="ignore"):
        noise, J = _round_off(cells.x), jacobians(cells.x, kind, points, degree)
    collapsed = (np.abs(J) <= noise).all(axis=0)
    _reject(cells, collapsed, "have collapsed, without volume", "remesh there")
    order = "the nodes of a cell are in dolfinx's order (a tensor product, not around it)"
    remedy = f"check that no node was moved too far, and that {order}"
    mixed = (J > noise).any(axis=0) & (J < -noise).any(axis=0)
    _reject(cells, mixed, "are inverted: the Jacobian changes sign inside", remedy)
    if kind in SIMPLICES:
        what = "lie on the same side of a facet as a neighbour: one of the two is inverted or"
        remedy = "check that no node was moved through a cell"
        _reject(cells, _beside_neighbour(cells), f"{what} folded", remedy)


def jacobians(x: Floats, kind: str, points: Floats, degree: int = 1) -> Floats:
    """Jacobians (q, n) of cells x (k, d, n) at reference points (q, d).

    >>> square = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 1.0], [2.0, 1.0]])[:, :, None]
    >>> jacobians(square, "quadrilateral", np.array([[0.25, 0.5]])).round(12).tolist()
    [[2.0]]
    """
    cell, variant = basix.CellType[kind], basix.LagrangeVariant.equispaced
    element = basix.create_element(basix.ElementFamily.P, cell, degree, variant)
    slopes = np.asarray(element.tabulate(1, points))[1:, :, :, 0]  # (d, q, k)
    return np.asarray(np.linalg.det(np.einsum("dqk,kin->qndi", slopes, x)))


def _round_off(x: Floats) -> Floats:
    """Error of the Jacobian of cells x (k, d, n), EPS |x| h^(d-1)."""
    most, least = x.max(axis=0), x.min(axis=0)
    largest, extent = np.maximum(most, -least).max(axis=0), (most - least).max(axis=0)
    return np.asarray(ROUND_OFF * largest * extent ** (x.shape[1] - 1))


def _own_cells(mesh: Mesh, kind: str) -> _Cells:
    d, geometry = mesh.topology.dim, mesh.geometry
    dofs = compat.cell_nodes(mesh)[: mesh.topology.index_map(d).size_local]
    dofs = np.ascontiguousarray(dofs.T)
    nodes = geometry.index_map().local_to_global(dofs.ravel().astype(np.int32))
    x = np.stack([np.asarray(geometry.x[:, i], dtype=np.float64)[dofs] for i in range(d)], axis=1)
    return _Cells(mesh, kind, np.asarray(nodes, dtype=np.int64).reshape(dofs.shape), x)


def _beside_neighbour(cells: _Cells) -> Bools:
    """Mask (n,) of simplices on the same side of a facet as their neighbour; collective."""
    topology, d = cells.mesh.topology, cells.x.shape[1]
    topology.create_entities(d - 1)
    topology.create_connectivity(d, d - 1)
    x, nodes = cells.x[: d + 1], cells.nodes[: d + 1]
    # facet i lacks vertex i, which moves to the end
    sides = np.tile(np.sign(np.linalg.det((x[1:] - x[0]).transpose(2, 0, 1))), (d + 1, 1))
    for i, j in combinations(range(d + 1), 2):
        ordered = np.where(nodes[i] < nodes[j], 1.0, -1.0)
        sides *= ordered
        sides[i] *= -ordered
        sides[j] *= ordered
    facets = topology.connectivity(d, d - 1).array[: sides.size].reshape(-1, d + 1).T
    total = la.vector(topology.index_map(d - 1))
    total.array[:] = np.bincount(facets.ravel(), sides.ravel(), minlength=len(total.array))
    total.scatter_reverse(la.InsertMode.add)
    total.scatter_forward()
    return np.asarray((np.abs(total.array) == 2.0)[facets].any(axis=0))


def _reject(cells: _Cells, bad: Any, what: str, remedy: str) -> None:
    count, total = cells.mesh.comm.allreduce(np.array([bad.sum(), len(bad)]), op=MPI.SUM)
    if count == 0:
        return
    x = np.moveaxis(cells.x[:, :, bad], 2, 0)
    finite = np.isfinite(x)
    centres = np.where(finite, x, 0.0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1)
    every = np.concatenate(cells.mesh.comm.allgather(centres))
    first, *others = sorted(tuple(float(f"{v:.4g}") + 0.0 for v in centre) for centre in every)
    more = " and elsewhere" if others else ""
    raise ValueError(f"mesh: {count} of {total} cells {what}, around {first}{more}; {remedy}")
