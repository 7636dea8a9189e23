# SPDX-License-Identifier: MIT
"""Change of basis u = T y of a problem, in which every constraint is a bound.

See theory.md, Constraints become bounds. T = (I - Q)^-1 W, W = blockdiag(R_j), is W + Q without
references to slave nodes, in a stack of bodies the product of the interfaces' matrices in
topological order. Sides of six-node triangles have two matrices, first that of the mid-side nodes.
A slave node of several interfaces has multipliers of only one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from graphlib import TopologicalSorter
from itertools import permutations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx.fem import Function, FunctionSpace
from dolfinx_mortar.algebra.congruence import ProductOfBases
from dolfinx_mortar.algebra.parallel import any_rank, sums_at_nodes
from dolfinx_mortar.common.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.common.spaces import with_ghosts
from dolfinx_mortar.interfaces.coupling import (
    CoupledSides,
    Pattern,
    Sides,
    create_blocks,
)
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.duals import LEAST_COVERAGE, Coverage
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing
from dolfinx_mortar.mortar.surface import nodal_normals, sum_at_nodes


@dataclass(frozen=True)
class Claims:
    """Owners of slave nodes, and order of the interfaces."""

    owner: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int32))  # (owned nodes,)
    banned: Sequence[Bools] = ()  # of each (local nodes,): slave nodes of others
    # i depends on slave nodes of k: T_i is left of T_k
    dependencies: frozenset[tuple[int, int]] = frozenset()
    order: Sequence[int] = ()  # of the transformations
    notes: Sequence[str] = ()


def choose_owners(sides: Sequence[Sides], coverage: Sequence[Coverage]) -> Ints:
    """Owner (n,) of each owned node: first interface that faces or covers it."""
    n = sides[0].n_owned
    owner, best = np.zeros(n, dtype=np.int32), np.full(n, -1)
    for k, (side, found) in enumerate(zip(sides, coverage, strict=True)):
        level = np.full(n, -1)
        level[side.nodes] = 1 * (found.share > 0.0) + found.faces
        owner[level > best] = k
        best = np.maximum(best, level)
    return owner


def find_referenced(sides: Sides, pattern: Pattern, banned: Bools, coverage: Coverage) -> Bools:
    """Nodes to which P may refer: of masters, and removed slave nodes; collective."""
    columns, layout = pattern.column[pattern.split :], sides.V.dofmap.index_map
    counts = sums_at_nodes(sides.V.mesh.comm, layout, columns, np.ones((len(columns), 1)))
    leant_on = counts[:, 0] > 0
    leant_on[sides.nodes[coverage.reached & banned[sides.nodes]]] = True
    return leant_on


def _why_claimed(
    sides: Sequence[Sides], interfaces: Sequence[Interface], owners: Ints, k: int
) -> str:
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
    """Owned nodes on one face with the owner, covered by both masters; collective."""
    d, own = sides[0].V.mesh.geometry.dim, np.arange(len(owner))
    whole = np.zeros((len(sides), len(owner)), dtype=bool)
    of_sides = np.zeros((*whole.shape, d))
    for on, n, side, found in zip(whole, of_sides, sides, coverage, strict=True):
        on[side.nodes] = found.share >= 1.0 - LEAST_COVERAGE
        n[side.nodes] = nodal_normals(side.slave, side.slave.X)[: side.slave.owned]
    angles = np.radians([interface.feature_angle for interface in interfaces])
    one_face = (of_sides * of_sides[owner, own]).sum(axis=2) > np.cos(angles)[:, None]
    return whole & whole[owner, own] & one_face


def _lost(sides: Sides, coverage: Coverage, banned: Bools, common: Bools) -> Bools:
    """Removed owned nodes that lose contact, not at ``common`` ends; collective."""
    slave = sides.slave
    taken = np.asarray(with_ghosts(sides.V, banned)[slave.nodes][slave.facets].all(axis=1))
    alone = np.repeat(taken[:, None, None], slave.facets.shape[1], axis=1)
    lost = np.zeros(sides.n_owned, dtype=bool)
    lost[sides.nodes] = coverage.faces & (
        ~common[sides.nodes] | (sum_at_nodes(slave, alone)[: slave.owned, 0] > 0)
    )
    return lost & banned


def resolve_claims(
    interfaces: Sequence[Interface],
    sides: Sequence[Sides],
    patterns: Sequence[Pattern],
    coverage: Sequence[Coverage],
) -> Claims:
    """Assign every slave node to one interface and order the interfaces; collective.

    The later interface loses nodes that would close a cycle.
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
        return leant_on & slaves[k] & ~banned[k]

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
    before = {k: {i for i, e in dependencies if e == k} for k in range(len(sides))}
    order = list(TopologicalSorter(before).static_order())
    return Claims(owner, shared, frozenset(dependencies), order, notes)


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


def notes_on_splits(
    interfaces: Sequence[Interface],
    sides: Sequence[Sides],
    coverage: Sequence[Coverage],
    displacements: Sequence[Function | None],
) -> list[str]:
    """Notes on facets of two slave sides below one master; collective."""
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
        count = comm.allreduce(_beside(sides[k], sides[i], displacements[k]), op=MPI.SUM)
        if count:
            notes.append(
                f"{interfaces[k]}: {count} slave facets face the master of {interfaces[i]}, to "
                "which they are not coupled, beside the nodes of both slave sides; divide slave "
                "and master at the same place, or give both masters one tag"
            )
    return notes


def _beside(side: Sides, other: Sides, u: Function | None) -> int:
    """Number of facets at the other slave side that only its master covers; collective."""
    facets = side.slave.nodes[side.slave.facets]
    beside, shared = other.on_slave[facets], other.on_master[facets].all(axis=1).any()
    if other.master is None or side.master is None or any_rank(side.V.mesh.comm, shared)[0]:
        return 0
    parts = []
    for master in (side.master, other.master):
        pairing = create_pairing(side.slave, master, u, moving=False, again=True)
        segments, _ = find_segments(pairing, u)
        covered = np.bincount(segments.slave, segments.weight, minlength=len(facets))
        parts.append(covered / segments.facet_weights.sum(axis=1))
    uncoupled = np.minimum(parts[1], 1.0 - parts[0]) > LEAST_COVERAGE
    return int((uncoupled & beside.any(axis=1) & ~beside.all(axis=1)).sum())


class Transformation:
    """T and T^T K T on the patterns of the pairings."""

    def __init__(self, V: FunctionSpace, links: Sequence[Link], claims: Claims) -> None:
        # without chains one matrix saves products
        self.claims = claims
        groups = [[i] for i in claims.order] if self.chained else [list(claims.order)]
        self.links = links
        dependent = any_rank(V.mesh.comm, any(link.sides.dependent.any() for link in links))[0]
        levels = (True, False) if dependent else (None,)
        parts = [(group, level) for group in groups for level in levels]
        self.factors = [_Factor(V, links, *part) for part in parts]
        self._product = ProductOfBases()
        self.formed = False  # whether T^T K T exists

    @property
    def chained(self) -> bool:
        """Whether interfaces may depend on others' slave nodes."""
        return bool(self.claims.dependencies)

    def serves(self, links: Sequence[Link], claims: Claims) -> bool:
        """Whether its factors fit other links and claims, on this rank."""
        mine = self.claims
        same = claims.order == mine.order and claims.dependencies == mine.dependencies
        return same and all(
            np.array_equal(a, b)
            for one, other in zip(self.links, links, strict=True)
            for a, b in (
                (one.pattern.row, other.pattern.row),
                (one.pattern.column, other.pattern.column),
                (one.banned, other.banned),
            )
        )

    def update(self, links: Sequence[Link]) -> None:
        """Refill T; collective."""
        self.links = links
        for factor in self.factors:
            factor.update(links)

    def apply(self, y: PETSc.Vec, u: PETSc.Vec) -> None:
        """Set u = T y; collective."""
        y.copy(u)
        for factor in reversed(self.factors):
            u.axpy(1.0, factor.C * u)

    def apply_transposed(self, f: PETSc.Vec, g: PETSc.Vec) -> None:
        """Set g = T^T f; collective."""
        f.copy(g)
        change = f.duplicate()
        for factor in self.factors:
            factor.C.multTranspose(g, change)
            g.axpy(1.0, change)

    @property
    def change(self) -> PETSc.Mat:
        """Copy of C, T = I + C; collective."""
        C = _product([factor.C for factor in self.factors])
        return C.copy() if len(self.factors) == 1 else C

    # multigrid basis v, y = (I - E) v: at open nodes v_n = n_j.u_j; for chains v = y

    def uncouple(self, held: Ints) -> tuple[PETSc.Mat, PETSc.Mat | None]:
        """C of u = (I + C) v, and E or None, for owned fixed unknowns of y; collective."""
        if self.chained:
            return self.change, None
        Cs, Es = zip(*(factor.uncouple(self.links, held) for factor in self.factors), strict=True)
        C, E = _product(Cs), Es[0]
        for other in Es[1:]:
            E.axpy(1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        if len(Es) > 1:  # vertices with mid-side nodes: v is not their u
            E.axpy(1.0, E.matMult(C), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        return C, E

    def uncoupled(self, u: PETSc.Vec, E: PETSc.Mat | None) -> PETSc.Vec:
        """Return v with T (I - E) v = u; collective."""
        y = self.inverse(u)
        if E is None:
            return y
        once, v = y.duplicate(), y.duplicate()
        E.multAdd(y, y, once)
        E.multAdd(once, y, v)  # (I - E)^-1 = I + E + E^2: vertices may be open
        return v

    def inverse(self, u: PETSc.Vec) -> PETSc.Vec:
        """Return y with T y = u; collective."""
        for factor in self.factors:
            u = factor.inverse(self.links, u)
        return u

    def transform(self, K: PETSc.Mat) -> PETSc.Mat:
        """T^T K T, refilled in place; collective."""
        self.formed = True
        return self._product.fill([K], [(factor.C, factor.C) for factor in self.factors])


class _Factor:
    """T = I + C of independent interfaces, of all or some of their slave nodes."""

    def __init__(
        self,
        V: FunctionSpace,
        links: Sequence[Link],
        members: list[int],
        dependent: bool | None = None,
    ) -> None:
        first, n = V.dofmap.index_map.local_range[0], V.dofmap.index_map.size_local
        taken = np.zeros(n, dtype=bool)
        rows, columns = [], []
        self.parts: list[tuple[int, Bools, Bools]] = []  # link, nodes with frames, rows of Q
        # shared slave nodes have the frame of their owner
        for k in members:
            link, p = links[k], links[k].pattern
            others = [links[i] for i in members if i != k]
            mine = ~taken[link.nodes] & ~(link.banned[link.nodes] & _kept_by(others, link.nodes))
            taken[link.nodes[mine]] = True
            here = np.ones_like(mine) if dependent is None else link.sides.dependent == dependent
            mine &= here
            self.parts.append((k, mine, here))
            on = here[p.row]
            rows += [link.nodes[mine], link.nodes[p.row[on]]]
            columns += [link.nodes[mine].astype(np.int64) + first, p.column[on]]
        self.V = V
        self._blocks = create_blocks(V, np.concatenate(rows), np.concatenate(columns))
        self.C = self._blocks.matrix

    def update(self, links: Sequence[Link]) -> None:
        values = []
        for k, mine, here in self.parts:
            link = links[k]
            turn = link.coupling.R[mine] - np.eye(link.coupling.R.shape[1])
            values += [turn, link.coupling.blocks[here[link.pattern.row]]]
        self._blocks.fill(np.concatenate(values))

    def uncouple(self, links: Sequence[Link], held: Ints) -> tuple[PETSc.Mat, PETSc.Mat]:
        """See `Transformation.uncouple`; collective."""
        V, d = self.V, self.V.dofmap.index_map_bs
        first, n = V.dofmap.index_map.local_range[0], V.dofmap.index_map.size_local
        is_held = np.zeros(d * n, dtype=bool)
        is_held[held] = True
        C: list[tuple[Ints, Longs, Floats]] = []
        E: list[tuple[Ints, Longs, Floats]] = []
        for k, mine, here in self.parts:
            link, p, blocks = links[k], links[k].pattern, links[k].coupling.blocks
            nodes = link.nodes[mine]
            C.append((nodes, nodes.astype(np.int64) + first, link.coupling.R[mine] - np.eye(d)))
            free = link.constrained & ~is_held[d * link.nodes[:, None] + np.arange(d)]
            all_free = free.any(axis=1) & (free == link.constrained).all(axis=1)
            in_frame = np.where(free[p.row][:, :, None], link.coupling.rows[p.row] @ blocks, 0.0)
            kept = blocks - link.coupling.R[p.row] @ in_frame
            kept[all_free[p.row]] = 0.0  # without round-off
            for found, values in ((C, kept), (E, in_frame)):
                on = here[p.row] & values.any(axis=(1, 2))
                found.append((link.nodes[p.row[on]], p.column[on], values[on]))
        return _create(V, C), _create(V, E)

    def inverse(self, links: Sequence[Link], u: PETSc.Vec) -> PETSc.Vec:
        """Return w_j = R_j^-1 (u_j - sum_l Q_jl u_l) = u_j - R_j^-1 (C u)_j; collective."""
        y, d = u.copy(), self.V.dofmap.index_map_bs
        change = (self.C * u).array_r.reshape(-1, d)
        for k, mine, _ in self.parts:
            nodes, rows = links[k].nodes[mine], links[k].coupling.rows[mine]
            y.array.reshape(-1, d)[nodes] -= np.einsum("nij,nj->ni", rows, change[nodes])
        return y


def _product(Cs: Sequence[PETSc.Mat]) -> PETSc.Mat:
    total = Cs[0]
    for C in Cs[1:]:
        both = total.matMult(C)
        for part in (total, C):
            both.axpy(1.0, part, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        total = both
    return total


def _create(V: FunctionSpace, parts: Sequence[tuple[Ints, Longs, Floats]]) -> PETSc.Mat:
    rows, columns, values = (np.concatenate([part[k] for part in parts]) for k in range(3))
    blocks = create_blocks(V, rows, columns)
    blocks.fill(values)
    return blocks.matrix


def _kept_by(links: Sequence[Link], nodes: Ints) -> Bools:
    found = np.zeros(len(nodes), dtype=bool)
    for link in links:
        found |= link.sides.on_slave[nodes] & ~link.banned[nodes]
    return found
