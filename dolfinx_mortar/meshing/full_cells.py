# SPDX-License-Identifier: MIT
"""Nodes that 8-node quadrilaterals and 20-node hexahedra lack, in any order of a file."""

import numpy as np

import basix
from dolfinx_mortar.common.arrays import Floats, Longs


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
