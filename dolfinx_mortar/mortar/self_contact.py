# SPDX-License-Identifier: MIT
"""Self-contact: facets of a surface that can touch, and which of two is the slave.

A node of both kinds has no multiplier. Arguments: own facets (ms,), received `copies` (mm,), global
`nodes` (ms, k) and (mm, k) of both, their coordinates `X`, `pairs` (p, 2) that face each other, and
`deepest`, how far behind a facet its master may lie.
"""

from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.facets import Facets, facet_normals, facet_sizes
from dolfinx_mortar.geometry.flat import facet_distances

REACH = 4.0
"""Largest distance, in diameters, of facets that are divided at a search (cost only); others at
half the distance require a new search, before they touch."""


class Roles(NamedTuple):
    """Slaves and masters at a search."""

    slave: Bools  # (ms,) own facets
    copies: Bools  # (mm,) received ones that are slaves
    nodes: tuple[Longs, Longs]  # (ms, k), (mm, k) global nodes
    deepest: tuple[Floats, Floats]  # (ms,), (mm,)
    seen: Longs  # (q,) near pairs: own facet * mm + received one
    distance: Floats  # (q,) of these


def distances_in_reach(
    facets: Facets,
    copies: Facets,
    pairs: Ints,
    nodes: tuple[Longs, Longs],
    deepest: tuple[Floats, Floats],
) -> Floats:
    """Distances (p,) of pairs, in diameters of the larger facet; inf if not near.

    Facets with a common node, or too deep, are not near.
    """
    found = np.full(len(pairs), np.inf)
    f, g = pairs.T
    size = np.maximum(facet_sizes(facets.x)[f], facet_sizes(copies.x)[g])
    limit = np.minimum(deepest[0][f], deepest[1][g])
    middle, other = facets.x.mean(axis=1)[f], copies.x.mean(axis=1)[g]
    near = np.linalg.norm(middle - other, axis=1) <= (REACH + 1.0) * size
    near &= ~(nodes[0][f][:, :, None] == nodes[1][g][:, None]).any(axis=(1, 2))
    for at, x, n in ((middle, copies.x[g], facets[f]), (other, facets.x[f], copies[g])):
        before = np.einsum("pki,pi->pk", x - at[:, None], facet_normals(n))
        near &= before.max(axis=1, initial=-np.inf) > -limit
    some = np.flatnonzero(near)
    found[some] = facet_distances(facets[f[some]], copies[g[some]]) / size[some]
    found[found > REACH] = np.inf
    return found


def choose_roles(
    comm: MPI.Intracomm,
    pairs: Ints,
    distance: Floats,
    nodes: tuple[Longs, Longs],
    X: tuple[Floats, Floats],
) -> tuple[Bools, Bools]:
    """Which own (ms,) and which received facets (mm,) are slaves; collective.

    Pair by pair, the nearest first (a spanning tree): facets that face each other have opposite
    roles; neighbours, a diameter apart, the same; then the finer one at X is the slave. Undecided
    parts begin with a slave in the order of coordinates, on all ranks.
    """
    rows = np.sort(nodes[0], axis=1), np.sort(nodes[1], axis=1)
    f, g = pairs.T
    sent = rows[0][f], rows[1][g], X[0][f], X[1][g], distance
    parts = list(zip(*comm.allgather(sent), strict=True))
    first, second, X_first, X_second, apart = (np.concatenate(part) for part in parts)
    keys, index, number = np.unique(
        np.concatenate([first, second]), axis=0, return_index=True, return_inverse=True
    )
    x, ends = np.concatenate([X_first, X_second])[index], number.reshape(2, -1)
    slaves = keys[_divide(keys, x, ends[0], ends[1], apart)]
    return _are_among(rows[0], slaves), _are_among(rows[1], slaves)


def _are_among(rows: Longs, keys: Longs) -> Bools:
    _, number = np.unique(np.concatenate([keys, rows]), axis=0, return_inverse=True)
    number = number.ravel()
    return np.isin(number[len(keys) :], number[: len(keys)])


def _divide(keys: Longs, X: Floats, a: Longs, b: Longs, distance: Floats) -> Bools:
    n = len(keys)
    if n == 0:
        return np.zeros(0, dtype=bool)
    size = facet_sizes(X)
    grain = HALF_OF_DIGITS * size.max()
    place = np.column_stack([np.sort(X, axis=1).mean(axis=1), X.max(axis=1) - X.min(axis=1)])
    order = np.lexsort(np.round(place / grain).T[::-1])
    rank = np.empty(n, dtype=np.int64)
    rank[order] = np.arange(n)
    a, b = np.sort(np.stack([rank[a], rank[b]]), axis=0)
    beside, slaves = neighbours(keys[order], X.shape[2] - 1), n
    powers = np.rint(np.log2(size[order][a] / size[order][b]))
    unequal = powers != 0.0
    finer = np.stack([a[unequal], np.full(int(unequal.sum()), slaves)])
    first, second = np.concatenate([np.stack([a, b]), beside, finer], axis=1)
    apart = np.concatenate([distance, np.ones(beside.shape[1]), 1.0 + distance[unequal]])
    different = np.concatenate(
        [np.ones(len(a)), np.zeros(beside.shape[1]), powers[unequal] > 0.0]
    ).astype(bool)
    nearest = np.lexsort((different, second, first, np.round(apart / HALF_OF_DIGITS)))
    # at last each part begins with a slave, its first facet
    first, second = (
        np.append(first[nearest], np.arange(n)),
        np.append(second[nearest], [slaves] * n),
    )
    different = np.append(different[nearest], np.zeros(n, dtype=bool))
    _, place = np.unique(first * (n + 1) + second, return_index=True)
    ends = first[place].astype(np.int32), second[place].astype(np.int32)
    graph = scipy.sparse.csr_array((place + 1.0, ends), shape=(n + 1, n + 1))
    tree = scipy.sparse.csgraph.minimum_spanning_tree(graph).tocoo()
    # two copies of each facet, of either role: the tree connects equal or opposite ones
    turn = (n + 1) * different[tree.data.astype(np.int64) - 1]
    ends = (
        np.append(tree.row, tree.row + n + 1),
        np.append(tree.col + turn, tree.col + n + 1 - turn),
    )
    both = scipy.sparse.coo_array((np.ones(2 * len(turn)), ends), shape=(2 * n + 2, 2 * n + 2))
    _, role = scipy.sparse.csgraph.connected_components(both, directed=False)
    return role[rank] == role[slaves]


def neighbours(keys: Longs, least: int) -> Longs:
    """Pairs (2, p) of rows (n, k) with at least so many common nodes."""
    n, k = keys.shape
    nodes, column = np.unique(keys, return_inverse=True)
    shape = (n, len(nodes))
    on = scipy.sparse.csr_array(
        (np.ones(keys.size), (np.repeat(np.arange(n), k), column.ravel())), shape=shape
    )
    common = scipy.sparse.triu(on @ on.T, 1).tocoo()
    edge = common.data >= least
    return np.stack([common.row[edge], common.col[edge]]).astype(np.int64)


def divide(
    comm: MPI.Intracomm,
    facets: Facets,
    copies: Facets,
    pairs: Ints,
    nodes: tuple[Longs, Longs],
    X: tuple[Floats, Floats],
    deepest: tuple[Floats, Floats],
) -> tuple[Ints, Roles]:
    """Candidates (p, 2) from slaves to masters, and roles; collective."""
    distance = distances_in_reach(facets, copies, pairs, nodes, deepest)
    near = np.flatnonzero(distance < np.inf)
    pairs, distance = pairs[near], distance[near]
    slave, other = choose_roles(comm, pairs, distance, nodes, X)
    seen = pairs[:, 0].astype(np.int64) * len(other) + pairs[:, 1]
    roles = Roles(slave, other, nodes, deepest, seen, distance)
    return pairs[slave[pairs[:, 0]] & ~other[pairs[:, 1]]], roles


def has_changed(roles: Roles, facets: Facets, copies: Facets, pairs: Ints) -> bool:
    """Whether pairs within half of the reach are new, or of equal roles and at half their distance.

    On this rank, since the roles were chosen.
    """
    distance = distances_in_reach(facets, copies, pairs, roles.nodes, roles.deepest)
    near = np.flatnonzero(distance <= REACH / 2)
    pairs, distance = pairs[near], distance[near]
    keys = pairs[:, 0].astype(np.int64) * len(roles.copies) + pairs[:, 1]
    then: Floats = np.full(len(keys), np.inf)
    _, again, before = np.intersect1d(keys, roles.seen, return_indices=True)
    then[again] = roles.distance[before]
    known = then < np.inf
    own, other = roles.slave[pairs[:, 0]], roles.copies[pairs[:, 1]]
    settled = ~own & other  # the slave's rank tests it
    settled |= own & ~other & known
    settled |= (own == other) & known & (distance > then / 2)
    return bool((~settled).any())
