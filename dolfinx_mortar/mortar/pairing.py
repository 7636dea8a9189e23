# SPDX-License-Identifier: MIT
"""Candidate pairs of slave and master facets over all ranks, reused while the bodies slide.

Each slave facet is integrated by its owner, which receives the master facets it may face.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx.common import timed
from dolfinx.fem import Function, FunctionSpace
from dolfinx_mortar.algebra.csr import Triplets
from dolfinx_mortar.algebra.parallel import any_rank, values_at
from dolfinx_mortar.common.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.geometry.segments import (
    are_facing,
    bounding_directions,
    find_candidates,
    projection_directions,
    sliding_margins,
)
from dolfinx_mortar.mortar.self_contact import Roles, divide, has_changed
from dolfinx_mortar.mortar.surface import (
    Surface,
    coordinates,
    facets_at,
    find_receivers,
    nodal_normals,
    send,
    thickness_stretches,
)

Weight = Callable[[Floats], Floats]
"""Points (q, d) at X -> factor (q,) of integrals over a surface, such as 2 pi r; positive."""
THROUGH = 0.5
"""A facet further behind the slave than this part of the thinner body is on its far side.

Overlaps where contact begins are far smaller. From 0.25 to 0.9 stacks, edges and corners have the
same iterations and forces.
"""


@dataclass(frozen=True, eq=False)
class Pairing:
    """Candidate pairs of facets at one configuration, with a margin.

    Matrices have a row for each owned slave node; columns of P = D^-1 (M - D_other) are those of D
    off its diagonal, then of M.
    """

    slave: Surface
    master: Surface
    pairs: Ints  # (p, 2) own slave facet, received master facet; ordered
    master_nodes: Longs  # (nm,) global
    master_facets: Ints  # (mm, k) indices into these
    master_X: Floats  # (nm, d)
    deepest: Floats  # (p,) largest depth of a master, or inf
    sent: Bools  # (own master facets, ranks)
    D: Triplets  # int Phi_j N_l^s
    M: Triplets  # int Phi_j N_l^m
    row: Ints  # (e,) owned slave node
    column: Longs  # (e,) global node
    off_diagonal: Ints  # positions in D of those of P
    diagonal: tuple[Ints, Ints]  # positions of D_jj in D, and nodes j
    weight: Weight | None = None  # of all integrals over the slave side; None for 1
    roles: Roles | None = None  # of a surface in self-contact


def _slave_facets(slave: Surface, u: Function | None) -> tuple[Facets, Floats]:
    x = coordinates(slave, u)
    facets = facets_at(slave, x)
    return facets, projection_directions(facets, nodal_normals(slave, x)[slave.facets])


def _send_facets(
    master: Surface, receivers: Bools, deepest: Floats
) -> tuple[Longs, Ints, Floats, Floats]:
    """Send master facets; return global nodes, facets, X, deepest (collective)."""
    V = master.V
    numbers = V.dofmap.index_map.local_to_global(master.nodes)[master.facets]
    X = master.X[master.facets]
    numbers, X, deepest = send(V.mesh.comm, receivers, numbers, X, deepest)
    nodes, first, facets = np.unique(numbers, return_index=True, return_inverse=True)
    facets = facets.reshape(numbers.shape).astype(np.int32)
    return nodes.astype(np.int64), facets, X.reshape(-1, X.shape[2])[first], deepest


def _deepest(surface: Surface, u: Function | None, itself: bool) -> Floats:
    if u is None or not itself:
        return THROUGH * surface.thickness
    stretch = thickness_stretches(surface, u)[surface.facets].min(axis=1, initial=np.inf)
    return THROUGH * surface.thickness * stretch


def create_triplets(slave: Surface, rows: Longs, columns: Longs) -> Triplets:
    """Sums of blocks between global nodes (b, k) and (b, l); collective."""
    block = (*rows.shape, columns.shape[1])
    places = (np.broadcast_to(v, block) for v in (rows[:, :, None], columns[:, None]))
    return Triplets(slave.V.mesh.comm, slave.V.dofmap.index_map, *places)


def pattern_of_P(slave: Surface, D: Triplets, *M: Triplets) -> dict[str, Any]:
    """Rows and columns of P, and places in D."""
    index_map = slave.V.dofmap.index_map
    nodes = slave.nodes[: slave.owned]
    position = np.full(index_map.size_local, -1, dtype=np.int32)
    position[nodes] = np.arange(len(nodes), dtype=np.int32)
    on = D.rows + index_map.local_range[0] == D.columns
    off, diagonal = np.flatnonzero(~on), np.flatnonzero(on)
    return {
        "row": position[np.concatenate([D.rows[off], *(A.rows for A in M)])],
        "column": np.concatenate([D.columns[off], *(A.columns for A in M)]),
        "off_diagonal": off.astype(np.int32),
        "diagonal": (diagonal.astype(np.int32), position[D.rows[diagonal]]),
    }


def _check_facing(pairs: Ints, slave: Surface, master: Surface, n_s: Floats, n_m: Floats) -> None:
    comm = slave.V.mesh.comm
    if comm.allreduce(len(pairs)):
        return
    n_m = np.concatenate(comm.allgather(n_m))
    facing = any(are_facing(np.broadcast_to(n, (len(n_m), *n.shape)), n_m).any() for n in n_s)
    if not comm.allreduce(int(facing)):
        raise ValueError(
            f"slave={slave.label} and master={master.label} can never meet: no two of their facets "
            "face each other; check the tags."
        )


@timed("~Mortar: search")
def create_pairing(
    slave: Surface,
    master: Surface,
    u: Function | None,
    *,
    moving: bool = True,
    again: bool = False,
    weight: Weight | None = None,
    earlier: Pairing | None = None,
) -> Pairing:
    """Find the candidate pairs at X + u and fix the patterns of D and M (collective).

    Pairs of moving surfaces allow a sliding by half an edge. In self-contact slave facets are
    chosen anew.

    Args:
        again: a later search, in which no pairs are no error.
        weight: factor of all integrals over the slave side; None for 1.
        earlier: of the same surfaces; its patterns are reused if the pairs are the same.

    Raises:
        ValueError: On all ranks, if the sides share facets, u is not finite there, or at the first
            search no facets face each other.
    """
    V, comm = slave.V, slave.V.mesh.comm
    common = comm.allreduce(len(np.intersect1d(slave.entities, master.entities)))
    if common and slave is not master:
        raise ValueError(
            f"slave={slave.label} and master={master.label} share {common} facets; "
            "mark each side of the interface with a tag of its own."
        )
    slaves, n_s = _slave_facets(slave, u)
    masters = facets_at(master, coordinates(master, u))
    if any_rank(comm, not (np.isfinite(slaves.x).all() and np.isfinite(masters.x).all()))[0]:
        raise ValueError(
            "u holds NaN or infinity at nodes of slave or master; check the displacement."
        )
    margin = sliding_margins(slaves.x) * moving
    receivers: Bools = np.ones((len(masters.x), 1), dtype=bool)
    if comm.size > 1:
        along = bounding_directions(slaves, n_s)
        receivers = find_receivers(comm, slaves.x, along, margin, masters)
    own = _deepest(slave, u, slave is master)
    others = own if slave is master else _deepest(master, u, False)
    nodes, facets, X, deepest = _send_facets(master, receivers, others)
    copies = Facets(master.element, _coordinates_of(V, nodes, X, u)[facets])
    pairs = find_candidates(slaves, n_s, copies, margin)
    roles = None
    if slave is master:
        numbers = V.dofmap.index_map.local_to_global(slave.nodes)[slave.facets], nodes[facets]
        places, limits = (slave.X[slave.facets], X[facets]), (own, deepest)
        pairs, roles = divide(comm, slaves, copies, pairs, numbers, places, limits)
    elif not again:
        _check_facing(pairs, slave, master, n_s, facet_normals(masters))
    deepest = np.minimum(own[pairs[:, 0]], deepest[pairs[:, 1]])
    if earlier is not None:
        same = np.array_equal(earlier.pairs, pairs)
        same &= np.array_equal(earlier.master_nodes, nodes)
        same &= np.array_equal(earlier.master_facets, facets)
        if not any_rank(comm, not same)[0]:
            return replace(earlier, sent=receivers, deepest=deepest, roles=roles)
    rows = V.dofmap.index_map.local_to_global(slave.nodes)[slave.facets]
    paired = rows[np.unique(pairs[:, 0])]
    D = create_triplets(slave, paired, paired)
    M = create_triplets(slave, rows[pairs[:, 0]], nodes[facets][pairs[:, 1]])
    return Pairing(
        slave=slave,
        master=master,
        pairs=pairs,
        master_nodes=nodes,
        master_facets=facets,
        master_X=X,
        deepest=deepest,
        sent=receivers,
        D=D,
        M=M,
        **pattern_of_P(slave, D, M),
        weight=weight,
        roles=roles,
    )


def _coordinates_of(V: FunctionSpace, nodes: Longs, X: Floats, u: Function | None) -> Floats:
    """Coordinates X + u (n, d) of global nodes; collective."""
    if u is None:
        return X
    own = u.x.array[: V.dofmap.index_map.size_local * X.shape[1]].reshape(-1, X.shape[1])
    return X + values_at(V.mesh.comm, own, nodes)


def receive(pairing: Pairing, values: npt.NDArray[Any]) -> Floats:
    """Owners' values (n, c) at the received master nodes (nm, c); collective."""
    master, index_map = pairing.master, pairing.master.V.dofmap.index_map
    at = np.zeros((index_map.size_local, values.shape[1]))
    at[master.nodes[: master.owned]] = values[: master.owned]
    return values_at(master.V.mesh.comm, at, pairing.master_nodes)


def received_facets(pairing: Pairing, u: Function | None) -> Facets:
    """Received master facets at X + u (collective)."""
    x = _coordinates_of(pairing.master.V, pairing.master_nodes, pairing.master_X, u)
    return Facets(pairing.master.element, x[pairing.master_facets])


@timed("~Mortar: margin")
def outside_margin(pairing: Pairing, u: Function | None) -> bool:
    """Whether a segment at X + u can belong to a pair that is not a candidate (collective).

    By the relative motion only; False is certain. True where u is not finite.
    """
    comm = pairing.slave.V.mesh.comm
    slave, n_s = _slave_facets(pairing.slave, u)
    master = received_facets(pairing, u)
    none, count = np.zeros(len(slave.x)), len(master.x)
    pairs = find_candidates(slave, n_s, master, none)
    if pairing.roles is not None:
        missing = has_changed(pairing.roles, slave, master, pairs)
    else:
        fresh, known = (p[:, 0].astype(np.int64) * count + p[:, 1] for p in (pairs, pairing.pairs))
        missing = not np.isin(fresh, known, assume_unique=True).all()
    missing = missing or not (np.isfinite(slave.x).all() and np.isfinite(master.x).all())
    if comm.size > 1:
        own = facets_at(pairing.master, coordinates(pairing.master, u))
        along = bounding_directions(slave, n_s)
        receivers = find_receivers(comm, slave.x, along, none, own)
        missing = missing or bool((receivers & ~pairing.sent).any())
    return bool(comm.allreduce(int(missing)))
