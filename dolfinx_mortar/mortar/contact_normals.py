# SPDX-License-Identifier: MIT
"""Directions in which contact nodes may be met."""

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.arrays import TINY, Bools, Floats
from dolfinx_mortar.geometry.facets import normals_at_nodes
from dolfinx_mortar.mortar.surface import Boundary


def contact_normals(
    V: fem.FunctionSpace, boundary: Boundary, contact: Bools, degrees: float
) -> Floats:
    """Return the mean normals at X of the facets between contact nodes; collective.

    (owned nodes, d), zero at other nodes, and at those where one of these facets is turned from the
    mean by more than an angle, as at edges.

    Args:
        V: of the displacement.
        boundary: all exterior facets.
        contact: (owned nodes,) those of sides that can open.
        degrees: the angle.
    """
    d = V.dofmap.index_map_bs
    on, mean, turned = fem.Function(V), fem.Function(V), fem.Function(V)
    on.x.array.reshape(-1, d)[: len(contact)] = contact[:, None]
    on.x.scatter_forward()
    touching = np.flatnonzero(on.x.array.reshape(-1, d)[boundary.nodes, 0].all(axis=1))
    nodes, normals = boundary.nodes[touching], normals_at_nodes(boundary.facets[touching])
    n = mean.x.array.reshape(-1, d)
    np.add.at(n, nodes, normals)
    _share(mean)
    n /= np.maximum(np.linalg.norm(n, axis=1), TINY)[:, None]
    edge = (normals * n[nodes]).sum(axis=2) < np.cos(np.radians(degrees))
    np.add.at(turned.x.array.reshape(-1, d), nodes, edge[:, :, None].astype(float))
    _share(turned)
    found = n[: len(contact)].copy()
    found[turned.x.array.reshape(-1, d)[: len(contact), 0] > 0.0] = 0.0
    return found


def _share(sums: fem.Function) -> None:
    """Add up what the ranks have at nodes they share; collective."""
    sums.x.scatter_reverse(la.InsertMode.add)
    sums.x.scatter_forward()
