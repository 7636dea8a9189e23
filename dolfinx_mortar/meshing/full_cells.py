# SPDX-License-Identifier: MIT
"""Nodes that 8-node quadrilaterals and 20-node hexahedra lack, in any order of a file."""

from typing import Any

import numpy as np

import basix
from dolfinx_mortar.common.arrays import Floats, Longs

# Gmsh's numbers of these cells, and of the full ones.
INCOMPLETE = {16: ("quadrilateral", 10), 17: ("hexahedron", 12)}


def missing_nodes(cell: str, points: Floats, count: int) -> Floats:
    """Weights (m, count) of the first nodes for each of the other m.

    The shape functions are those of the serendipity space of degree 2: all polynomials of
    superlinear degree at most 2. Source: D. N. Arnold, G. Awanou, Found. Comput. Math. 11 (2011)
    337-344.

    Args:
        cell: name of the reference cell.
        points: (count + m, d) nodes of the full cell on it.
        count: number of nodes that are given.
    """
    if count == len(points):
        return np.empty((0, count))
    variants = basix.LagrangeVariant.legendre, basix.DPCVariant.legendre
    family, kind = basix.ElementFamily.serendipity, basix.CellType[cell]
    space = basix.create_element(family, kind, 2, *variants)
    values = np.asarray(space.tabulate(0, points), dtype=float)[0, :, :, 0]
    weights = values[count:] @ np.linalg.inv(values[:count])
    return np.asarray(np.round(4.0 * weights) / 4.0)  # they are quarters


def full_cells(x: Floats, *blocks: tuple[Floats, Longs]) -> tuple[Floats, list[Longs]]:
    """Append the nodes that cells lack, those that cells share once.

    Args:
        x: (n, d) positions of all nodes.
        blocks: weights (m, k) of `missing_nodes` and rows (cells, k) of nodes.

    Returns:
        Positions (N, d), and rows (cells, k + m) of each block.
    """
    # a node is where its corners are, those with negative weights
    keys = [np.where(w < 0.0, cells[:, None], -1) for w, cells in blocks]
    rows = [np.sort(key)[..., -8:].reshape(-1, 8) for key in keys]
    places = [np.einsum("mk,ckd->cmd", w, x[cells]).reshape(-1, x.shape[1]) for w, cells in blocks]
    _, first, number = np.unique(
        np.concatenate(rows), axis=0, return_index=True, return_inverse=True
    )
    ends = np.cumsum([len(row) for row in rows])[:-1]
    new = np.split(len(x) + number.ravel(), ends)
    full = [
        np.hstack([cells, own.reshape(len(cells), len(w))])
        for (w, cells), own in zip(blocks, new, strict=True)
    ]
    return np.concatenate([x, np.concatenate(places)[first]]), full


def fill_cells(model: Any) -> None:
    """Replace such cells of a model of Gmsh by full ones."""
    mesh = model.mesh
    found = [
        (dim, entity, kind, numbers, nodes.reshape(len(numbers), -1))
        for dim, entity in model.getEntities()
        for kind, numbers, nodes in zip(*mesh.getElements(dim, entity), strict=True)
        if kind in INCOMPLETE
    ]
    if not found:
        return
    tags, x, _ = mesh.getNodes()
    order = np.argsort(tags)
    blocks = []
    for _, _, kind, _, nodes in found:
        cell, full = INCOMPLETE[kind]
        _, dim, _, _, points, _ = mesh.getElementProperties(full)
        weights = missing_nodes(cell, (points.reshape(-1, dim) + 1.0) / 2.0, nodes.shape[1])
        blocks.append((weights, np.searchsorted(tags[order], nodes)))
    every, cells = full_cells(x.reshape(-1, 3)[order], *blocks)
    new = np.arange(len(tags), len(every)) - len(tags) + tags.max() + 1
    tags = np.append(tags[order], new)
    mesh.addNodes(*found[0][:2], new, every[len(x) // 3 :].ravel())
    for (dim, entity, kind, numbers, _), rows in zip(found, cells, strict=True):
        mesh.removeElements(dim, entity, numbers)
        mesh.addElementsByType(entity, INCOMPLETE[kind][1], numbers, tags[rows].ravel())
