# SPDX-License-Identifier: MIT
"""Change of basis u = T y of a problem, in which every constraint is a bound.

T contains P = D^-1 M: row j of B_I T = N^T (D - M) T is D_jj times a unit vector (theory.md,
Constraints become bounds). T = (I - Q)^-1 W, W = blockdiag(R_j), is W + Q without references to
slave nodes, in a stack of bodies the product of the interfaces' matrices in topological order.
Sides of six-node triangles have two matrices, first that of the mid-side nodes.
"""

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.congruence import Congruence
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.interfaces.claims import Claims
from dolfinx_mortar.interfaces.coupling import create_blocks
from dolfinx_mortar.interfaces.link import Link


class Transformation:
    """T and T^T K T on patterns that are fixed as long as the pairings."""

    def __init__(self, V: fem.FunctionSpace, links: Sequence[Link], claims: Claims) -> None:
        # without chains one matrix saves products
        self.claims = claims
        groups = [[i] for i in claims.order] if self.chained else [claims.order]
        self.links = links
        dependent = any_rank(V.mesh.comm, any(link.sides.dependent.any() for link in links))[0]
        levels = (True, False) if dependent else (None,)
        parts = [(group, level) for group in groups for level in levels]
        self.factors = [_Factor(V, links, *part) for part in parts]
        self._congruences: list[Congruence] = []

    @property
    def chained(self) -> bool:
        """Whether interfaces may depend on each other's slave nodes."""
        return bool(self.claims.dependencies)

    def serves(self, claims: Claims) -> bool:
        """Whether its factors fit other claims."""
        mine = self.claims
        return claims.order == mine.order and claims.dependencies == mine.dependencies

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
        """C of T = I + C, a copy; collective."""
        C = _product([factor.C for factor in self.factors])
        return C.copy() if len(self.factors) == 1 else C

    # -- multigrid basis v, y = (I - E) v: at open nodes v_n = n_j.u_j, uncoupled from the master;
    # for chains v = y

    def uncouple(self, held: Ints) -> tuple[PETSc.Mat, PETSc.Mat | None]:
        """Return C of u = (I + C) v, without stored zeros, and E or None; collective.

        Args:
            held: owned fixed unknowns of y.
        """
        if self.chained:
            return self.change, None
        Cs, Es = zip(*(factor.uncouple(self.links, held) for factor in self.factors), strict=True)
        C, E = _product(Cs), Es[0]
        for other in Es[1:]:
            E.axpy(1.0, other, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        if len(Es) > 1:  # v of vertices with mid-side nodes is not their u
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

    @property
    def formed(self) -> bool:
        """Whether T^T K T exists."""
        return bool(self._congruences)

    def transform(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return T^T K T, refilled in place; collective."""
        fresh = not self.formed
        for k, factor in enumerate(self.factors):
            if fresh:
                self._congruences.append(Congruence(K, factor.C))
                self._congruences[k].product.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            else:
                self._congruences[k].update(K, factor.C)
            K = self._congruences[k].product
        return K


class _Factor:
    """T = I + C of independent interfaces, of all or some of their slave nodes."""

    def __init__(
        self,
        V: fem.FunctionSpace,
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
        """Refill the matrix; collective."""
        values = []
        for k, mine, here in self.parts:
            link = links[k]
            turn = link.coupling.R[mine] - np.eye(link.coupling.R.shape[1])
            values += [turn, link.coupling.blocks[here[link.pattern.row]]]
        self._blocks.fill(np.concatenate(values))

    def uncouple(self, links: Sequence[Link], held: Ints) -> tuple[PETSc.Mat, PETSc.Mat]:
        """Return C of constraints at held unknowns, without stored zeros, and E; collective."""
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
            dofs = d * link.nodes[:, None] + np.arange(d)
            free_now = link.constrained & ~is_held[dofs]
            used = blocks.any(axis=(1, 2)) & here[p.row]
            off = used & free_now[p.row].any(axis=1)
            at, free = p.row[off], free_now[p.row[off]]
            in_frame = np.where(free[:, :, None], link.coupling.rows[at] @ blocks[off], 0.0)
            kept = blocks.copy()
            kept[off] -= link.coupling.R[at] @ in_frame
            kept[off & (link.constrained == free_now)[p.row].all(axis=1)] = 0.0
            on = used & kept.any(axis=(1, 2))
            C.append((link.nodes[p.row[on]], p.column[on], kept[on]))
            E.append((link.nodes[p.row[off]], p.column[off], in_frame))
        return _create(V, C), _create(V, E)

    def inverse(self, links: Sequence[Link], u: PETSc.Vec) -> PETSc.Vec:
        """Return y with T y = u: w_j = R_j^-1 (u_j - sum_l Q_jl u_l); collective."""
        difference, d = u.copy(), self.V.dofmap.index_map_bs
        for k, _, here in self.parts:
            moved = (links[k].Q * u).array_r.reshape(-1, d)
            nodes = links[k].nodes[here]  # others have no row in T
            difference.array.reshape(-1, d)[nodes] -= moved[nodes]
        y = u.copy()
        for k, mine, _ in self.parts:
            nodes, rows = links[k].nodes[mine], links[k].coupling.rows[mine]
            slip = difference.array_r.reshape(-1, d)[nodes]
            y.array.reshape(-1, d)[nodes] = np.einsum("nij,nj->ni", rows, slip)
        return y


def _product(Cs: Sequence[PETSc.Mat]) -> PETSc.Mat:
    """C of the product of I + C_k; collective."""
    total = Cs[0]
    for C in Cs[1:]:
        both = total.matMult(C)
        for part in (total, C):
            both.axpy(1.0, part, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        total = both
    return total


def _create(V: fem.FunctionSpace, parts: Sequence[tuple[Ints, Longs, Floats]]) -> PETSc.Mat:
    rows, columns, values = (np.concatenate([part[k] for part in parts]) for k in range(3))
    blocks = create_blocks(V, rows, columns)
    blocks.fill(values)
    return blocks.matrix


def _kept_by(links: Sequence[Link], nodes: Ints) -> Bools:
    found = np.zeros(len(nodes), dtype=bool)
    for link in links:
        found |= link.sides.on_slave[nodes] & ~link.banned[nodes]
    return found
