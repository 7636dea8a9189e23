# SPDX-License-Identifier: MIT
"""Faces of bodies: exterior facets that join at less than a feature angle, and their edges."""

from dataclasses import dataclass
from itertools import count
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfinx import fem
from dolfinx_mortar.arguments import is_number
from dolfinx_mortar.arrays import TINY, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.curvature import unit
from dolfinx_mortar.geometry.facets import Facets, facet_normals, points_of
from dolfinx_mortar.geometry.segments import Segments
from dolfinx_mortar.mortar.pairing import Pairing, received_facets


def check_angle(feature_angle: Any) -> float:
    """Return the angle from which on facets meet in an edge, if it is one.

    Raises:
        ValueError: unless 0 < feature_angle <= 180.
    """
    if not is_number(feature_angle) or not 0.0 < feature_angle <= 180.0:
        raise ValueError(
            f"feature_angle is {feature_angle!r}: give degrees, 0 < feature_angle <= 180"
        )
    return float(feature_angle)


@dataclass(frozen=True, eq=False)
class Faces:
    """The smooth faces into which edges divide the skins of bodies."""

    of_facets: Longs  # (m,) face of each facet of this rank; numbers of all ranks
    beside: frozenset[tuple[int, int]]  # pairs of faces that meet in an edge, both ways


def find_faces(
    V: fem.FunctionSpace, facets: Facets, nodes: Ints, body: Longs, feature_angle: float
) -> Faces:
    """Divide exterior facets into faces; collective.

    Two facets of one body with a common edge (in the plane: a common vertex) are of one face where
    their normals differ by less than the feature angle.

    Args:
        V: the space, with the numbers of nodes.
        facets: (m,) exterior facets of this rank.
        nodes: (m, k) their local nodes.
        body: (m,) to which they belong.
        feature_angle: in degrees.
    """
    comm = V.mesh.comm
    edges = _edges(V, facets, nodes)
    m, per_facet = edges.shape[:2]
    keys, owner = edges.reshape(-1, edges.shape[2]), np.repeat(np.arange(m), per_facet)
    columns = np.column_stack([keys, body[owner]]), facet_normals(facets)[owner]
    limit = np.cos(np.radians(feature_angle))
    first, second, smooth = _meeting(columns[0], columns[1], limit)
    parts, local = _components(m, owner[first[smooth]], owner[second[smooth]])
    own: Longs = local + (comm.exscan(parts) or 0)

    # Where the other facet at an edge is one of another rank, faces are joined by all.
    single = np.ones(len(keys), dtype=bool)
    single[first], single[second] = False, False
    sent = *(column[single] for column in columns), own[owner[single]]
    everywhere = [np.concatenate(each) for each in zip(*comm.allgather(sent), strict=True)]
    a, b, joined = _meeting(everywhere[0], everywhere[1], limit)
    ends = everywhere[2]
    _, face = _components(comm.allreduce(parts, op=MPI.SUM), ends[a[joined]], ends[b[joined]])
    sharp = own[owner[np.stack([first[~smooth], second[~smooth]], axis=1)]]
    sharp = np.concatenate([sharp, np.stack([ends[a[~joined]], ends[b[~joined]]], axis=1)])
    pairs = np.concatenate(comm.allgather(np.unique(face[sharp], axis=0)))
    both = np.concatenate([pairs, pairs[:, ::-1]])
    return Faces(face[own], frozenset((int(one), int(other)) for one, other in both))


def _edges(V: fem.FunctionSpace, facets: Facets, nodes: Ints) -> Longs:
    """Return the global numbers (m, e, 2 or 1) of the ends of the edges of facets, ascending."""
    local = nodes[:, np.array(facets.element.vertices)]
    numbers = V.dofmap.index_map.local_to_global(local.ravel().astype(np.int32))
    corners: Longs = np.asarray(numbers, dtype=np.int64).reshape(local.shape)
    if facets.x.shape[2] == 2:
        return corners[:, :, None]
    return np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=2), axis=2)


def _meeting(keys: Longs, normals: Floats, limit: float) -> tuple[Longs, Longs, Bools]:
    """Return which rows (q,), (q,) have the same key, and where their normals are close."""
    order = np.lexsort(keys.T)
    sorted_keys = keys[order]
    found: list[Longs] = [np.zeros((0, 2), dtype=np.int64)]
    for step in count(1):
        same = (sorted_keys[step:] == sorted_keys[:-step]).all(axis=1)
        if not same.any():
            break
        where = np.flatnonzero(same)
        found.append(np.stack([order[where], order[where + step]], axis=1))
    first, second = np.concatenate(found).T
    cosine = np.einsum("qi,qi->q", normals[first], normals[second])
    return first, second, cosine > limit


def _components(n: int, a: Longs, b: Longs) -> tuple[int, Longs]:
    """Return the number of connected parts of a graph with n vertices, and that of each."""
    parts, found = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(n, n)), False)
    return int(parts), np.asarray(found, dtype=np.int64)


def facing_edges(pairing: Pairing, segments: Segments, feature_angle: float) -> Bools:
    """Return the slave facets (m,) that convex edges or corners of the master face; collective.

    On more than a twentieth of what such a facet faces, the master's normal is turned from the mean
    there by more than half of the feature angle, and normals point apart. At X.

    Args:
        feature_angle: Degrees between facets from which on they meet in an edge.
    """
    on, count, w = segments.slave, len(pairing.slave.facets), segments.weight
    received = received_facets(pairing, None)
    n = facet_normals(received)[segments.master]
    x = points_of(received, segments.master, segments.xi_m)
    whole = np.maximum(np.bincount(on, w, count), TINY)
    middle, mean = (
        np.stack([np.bincount(on, w * part, count) for part in v.T], axis=1) / whole[:, None]
        for v in (x, n)
    )
    turned = (n * unit(mean)[on]).sum(axis=1) < np.cos(np.radians(feature_angle / 2))
    apart = ((x - middle[on]) * (n - mean[on])).sum(axis=1)
    convex = np.bincount(on, w * apart, count) > 0.0
    return np.asarray(convex & (np.bincount(on, w * turned, count) > 0.05 * whole))
