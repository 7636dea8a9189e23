# SPDX-License-Identifier: MIT
"""Claims on slave nodes by several interfaces, and the order of their transformations."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, sums_at_nodes
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.coupling import CoupledSides, Pattern, Sides, with_ghosts
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.mortar.duals import LEAST_COVERAGE, Coverage
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import nodal_normals, sum_at_nodes


@dataclass(frozen=True)
class Claims:
    """Owners of slave nodes, and order of the interfaces."""

    owner: Ints  # (owned nodes,) interface
    banned: list[Bools]  # of each interface (local nodes,): slave nodes of others
    dependencies: frozenset[
        tuple[int, int]
    ]  # (i, k): i depends on slave nodes of k, T_i is left of T_k
    order: list[int]  # of the transformations
    notes: list[str]


def referenced(sides: Sides, pattern: Pattern) -> Bools:
    """Mask of owned nodes on which candidate pairs depend; collective."""
    columns, layout = pattern.column[pattern.split :], sides.V.dofmap.index_map
    counts = sums_at_nodes(sides.V.mesh.comm, layout, columns, np.ones((len(columns), 1)))
    return np.asarray(counts[:, 0] > 0)


def choose_owners(sides: Sequence[Sides], coverage: Sequence[Coverage]) -> Ints:
    """Owner (n,) of each owned node: first interface that faces or covers it; no communication."""
    n = sides[0].n_owned
    owner, best = np.zeros(n, dtype=np.int32), np.full(n, -1)
    for k, (side, found) in enumerate(zip(sides, coverage, strict=True)):
        level = np.full(n, -1)
        level[side.nodes] = 1 * (found.share > 0.0) + found.faces
        owner[level > best] = k
        best = np.maximum(best, level)
    return owner


def find_referenced(sides: Sides, pattern: Pattern, banned: Bools, coverage: Coverage) -> Bools:
    """Mask of owned master nodes and removed slave nodes to which P may refer; collective."""
    leant_on = referenced(sides, pattern)
    leant_on[sides.nodes[coverage.reached & banned[sides.nodes]]] = True
    return leant_on


def _why_claimed(
    sides: Sequence[Sides], interfaces: Sequence[Interface], owners: Ints, k: int
) -> str:
    """Reason and remedy for nodes of interface k with other owners; collective."""
    first = int(owners.min(initial=k))
    pair = sides[k].V.mesh.comm.allreduce(first, op=MPI.MIN), k
    why = "claimed by an earlier interface that they face as well; "
    if all(sides[i].master is None for i in pair):
        return why + (
            "where the body may slide from one tool onto the other, give one Obstacle the Union of "
            "their shapes"
        )
    opens = [interfaces[i] for i in pair if sides[i].unilateral]
    if len(opens) == 1:
        return why + f"let the other side of {opens[0]} be the slave"
    return why + "give both masters one tag"


def _common(
    interfaces: Sequence[Interface],
    sides: Sequence[Sides],
    coverage: Sequence[Coverage],
    owner: Ints,
) -> Bools:
    """Masks (n,) of owned nodes on one face with the owner, covered by both masters; collective."""
    d, own = sides[0].V.mesh.geometry.dim, np.arange(len(owner))
    whole = np.zeros((len(sides), len(owner)), dtype=bool)
    of_sides = np.zeros((*whole.shape, d))
    for on, n, side, found in zip(whole, of_sides, sides, coverage, strict=True):
        on[side.nodes] = found.share >= 1.0 - LEAST_COVERAGE
        n[side.nodes] = nodal_normals(side.slave, side.slave.X)[: side.slave.owned]
    angles = np.radians([interface.feature_angle for interface in interfaces])
    one_face = (of_sides * of_sides[owner, own]).sum(axis=2) > np.cos(angles)[:, None]
    return np.asarray(whole & whole[owner, own] & one_face)


def _lost(sides: Sides, coverage: Coverage, banned: Bools, common: Bools) -> Bools:
    """Mask (n,) of removed owned nodes that lose contact, not at ``common`` ends; collective."""
    slave = sides.slave
    taken = np.asarray(with_ghosts(sides.V, banned)[slave.nodes][slave.facets].all(axis=1))
    alone = np.repeat(taken[:, None, None], slave.facets.shape[1], axis=1)
    lost = np.zeros(sides.n_owned, dtype=bool)
    lost[sides.nodes] = coverage.faces & (
        ~common[sides.nodes] | (sum_at_nodes(slave, alone)[: slave.owned, 0] > 0)
    )
    return np.asarray(lost & banned)


def resolve_claims(
    interfaces: Sequence[Interface],
    sides: Sequence[Sides],
    patterns: Sequence[Pattern],
    coverage: Sequence[Coverage],
) -> Claims:
    """Assign every slave node to one interface and order the interfaces; collective.

    The later interface loses claims that would close a cycle.
    """
    comm, n = sides[0].V.mesh.comm, sides[0].n_owned
    owner = choose_owners(sides, coverage)
    slaves = [s.on_slave[:n] for s in sides]
    banned = [slave & (owner != k) for k, slave in enumerate(slaves)]
    notes: list[str] = []
    dependencies: set[tuple[int, int]] = set()

    def note(k: int, nodes: Bools, why: str) -> None:
        count = comm.allreduce(int(nodes.sum()), op=MPI.SUM)
        if count:
            notes.append(f"{interfaces[k]}: {count} slave nodes removed, {why}")

    def dependent(i: int, k: int) -> Bools:
        leant_on = find_referenced(sides[i], patterns[i], banned[i], coverage[i])
        return np.asarray(leant_on & slaves[k] & ~banned[k])

    def remove(k: int, nodes: Bools, why: str) -> None:
        note(k, nodes, why)
        banned[k] |= nodes

    common = _common(interfaces, sides, coverage, owner)
    for k in range(len(sides)):
        lost = _lost(sides[k], coverage[k], banned[k], common[k])
        note(k, lost, _why_claimed(sides, interfaces, owner[lost], k))
        both = dependent(k, k)  # in self-contact the ends of the slave side
        if sides[k].meet_themselves:
            banned[k] |= both
        else:
            remove(k, both, "they are master nodes of the same interface")
        dependencies |= {(k, i) for i in range(k) if any_rank(comm, dependent(k, i).any())[0]}
        for i in range(k):
            hit = dependent(i, k)
            if not any_rank(comm, hit.any())[0]:
                continue
            if _reaches(dependencies, k, i):
                remove(k, hit, f"they would close a cycle with {interfaces[i]}")
            else:
                dependencies.add((i, k))
    shared = [with_ghosts(s.V, b) for s, b in zip(sides, banned, strict=True)]
    return Claims(
        owner, shared, frozenset(dependencies), _topological(len(sides), dependencies), notes
    )


def are_outdated(claims: Claims, links: Sequence[CoupledSides]) -> bool:
    """Whether claims must be resolved again after slides; collective."""
    sides = [link.sides for link in links]
    coverage = [link.coupling.coverage for link in links]
    if len(sides) < 2:
        return False
    n = sides[0].n_owned
    best = choose_owners(sides, coverage)
    faces = np.zeros((len(sides), n), dtype=bool)
    for k, (side, found) in enumerate(zip(sides, coverage, strict=True)):
        faces[k, side.nodes] = found.faces
    own = np.arange(n)
    outdated = [bool((~faces[claims.owner, own] & faces[best, own]).any())]
    for i, link in enumerate(links):
        leant_on = find_referenced(link.sides, link.pattern, claims.banned[i][:n], coverage[i])
        for k, other in enumerate(sides):
            hit = leant_on & other.on_slave[:n] & ~claims.banned[k][:n]
            outdated.append(bool(hit.any()) and i != k and (i, k) not in claims.dependencies)
    return bool(any_rank(sides[0].V.mesh.comm, any(outdated))[0])


def _reaches(edges: set[tuple[int, int]], a: int, b: int) -> bool:
    return any(c == a and (e == b or _reaches(edges, e, b)) for c, e in edges)


def _topological(n: int, edges: set[tuple[int, int]]) -> list[int]:
    order: list[int] = []
    while len(order) < n:
        order.append(
            next(
                k
                for k in range(n)
                if k not in order and all(i in order for i, e in edges if e == k)
            )
        )
    return order


def notes_on_splits(
    interfaces: Sequence[Interface],
    sides: Sequence[Sides],
    coverage: Sequence[Coverage],
    displacements: Sequence[fem.Function | None],
) -> list[str]:
    """Notes on facets at two slave sides that face another interface's master; collective."""
    comm, n = sides[0].V.mesh.comm, sides[0].n_owned
    numbers = [k for k, side in enumerate(sides) if side.master not in (None, side.slave)]
    shares = np.full((len(sides), n), np.nan)
    for share, side, found in zip(shares, sides, coverage, strict=True):
        share[side.nodes] = found.share
    notes = []
    for k, i in permutations(numbers, 2):
        open_ = (shares[k] < 1.0 - LEAST_COVERAGE) & (shares[i] > LEAST_COVERAGE)
        if not any_rank(comm, open_.any())[0]:
            continue
        between = _between(sides[k], sides[i], displacements[k])
        count = comm.allreduce(int((between > LEAST_COVERAGE).sum()), op=MPI.SUM)
        if count:
            notes.append(
                f"{interfaces[k]}: {count} slave facets face the master of {interfaces[i]}, to "
                "which they are not coupled, beside the nodes of both slave sides; divide slave "
                "and master at the same place, or give both masters one tag"
            )
    return notes


def _between(side: Sides, other: Sides, u: fem.Function | None) -> Floats:
    """Part (m,) of facets beside the other slave side that only its master covers; collective."""
    facets = side.slave.nodes[side.slave.facets]
    beside, shared = other.on_slave[facets], other.on_master[facets].all(axis=1).any()
    if other.master is None or side.master is None or any_rank(side.V.mesh.comm, shared)[0]:
        return np.zeros(len(facets))
    parts = []
    for master in (side.master, other.master):
        pairing = create_pairing(side.V, side.slave, master, u, moving=False, again=True)
        segments, _ = find_segments(pairing, u)
        covered = np.bincount(segments.slave, segments.weight, minlength=len(facets))
        parts.append(covered / segments.facet_weights.sum(axis=1))
    uncoupled = np.minimum(parts[1], 1.0 - parts[0])
    return np.asarray(uncoupled * (beside.any(axis=1) & ~beside.all(axis=1)))
