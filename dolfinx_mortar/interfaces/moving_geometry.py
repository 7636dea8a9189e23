# SPDX-License-Identifier: MIT
"""Exact linearisation of contact on moving surfaces (theory.md, The exact tangent).

    (K + H) du + B^T lambda+ = r,    G_j + dG_j.du >= 0,    H = d(B^T lambda)/du at fixed lambda,

with weighted gaps G. Test functions are those of T; du = T_g y with y_n = -dG_j.du / D_jj makes
gaps bounds: K^ = T^T (K + H) T_g. In T_g the parts of neighbouring slave nodes are lumped on node
j; the neglected part corrects the bounds once du is known.
With friction y_t is the change of the slip t.m, t.(du_j - P du) + m.dt, with the partners' P
(`slip_partners`) and the motion m; dt = -r (t.dn), r the first column of R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.congruence import OperatorOfBases, ProductOfBases
from dolfinx_mortar.algebra.csr import owned_rows
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.interfaces.basis import Claims, Transformation
from dolfinx_mortar.interfaces.contact_tangent import SlipRows
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.slip_partners import Partners


@dataclass(frozen=True)
class GeometryTangent:
    """Contribution of moving surfaces; valid until the next one."""

    forces: Sequence[PETSc.Mat]  # (n, n) H = d(B^T lambda)/du of each contact
    trial: Transformation  # T_g
    gaps: Sequence[PETSc.Mat]  # (n, n) rows w_n of each: -dG_j.du / D_jj
    slips: Sequence[SlipRows]  # of contacts with friction
    product: ProductOfBases
    operator: OperatorOfBases

    def closing(self, du: PETSc.Vec) -> Floats:
        """Closing of gaps and added slips (n,) by du; collective."""
        total = np.zeros(du.local_size)
        for rows in self.gaps:
            total += (rows * du).array_r
        for slip in self.slips:
            total.reshape(-1, slip.d)[slip.link.nodes, 1:] = slip.of(du)
        return total

    def _bases(self, T: Transformation) -> list[tuple[PETSc.Mat, PETSc.Mat]]:
        return [(a.C, b.C) for a, b in zip(T.factors, self.trial.factors, strict=True)]

    def transform(self, K: PETSc.Mat, T: Transformation) -> PETSc.Mat:
        """Return T^T (K + H) T_g, refilled in place; collective."""
        return self.product.fill([K, *self.forces], self._bases(T))

    def follow(
        self, K: PETSc.Mat, T: Transformation, decoupled: Ints, diagonal: PETSc.Vec
    ) -> OperatorOfBases:
        """Same as an operator, decoupled at owned unknowns, always the same; collective.

        `diagonal` (n,) is that of T^T K T.
        """
        self.operator.follow_bases([K, *self.forces], self._bases(T), decoupled, diagonal)
        return self.operator


class MovingGeometry:
    """Derivatives of contacts, on the patterns of their pairs; collective."""

    def __init__(self, V: fem.FunctionSpace, links: Sequence[Link], claims: Claims) -> None:
        found = {k: link.interface.derivatives(link) for k, link in enumerate(links)}
        self._contacts = {k: one for k, one in found.items() if one is not None}
        self._trial = Transformation(V, links, claims)
        products = ProductOfBases(), OperatorOfBases(self._trial.factors[0].C)
        self._products = products

    def serves(self, links: Sequence[Link]) -> bool:
        """Whether the patterns fit other links."""
        return all(contact.serves(links[k]) for k, contact in self._contacts.items())

    def linearise(
        self,
        links: Sequence[Link],
        u: fem.Function,
        multipliers: Floats,
        tangential: Floats | None,
        slips: tuple[PETSc.Vec, Sequence[Partners | None]],
    ) -> GeometryTangent:
        """See `InterfaceSystem.linearise_geometry`; collective."""
        moved, H, gaps, sliding = list(links), [], [], []
        since, partners = slips
        for k, contact in self._contacts.items():
            forces, rows, known = contact.differentiate(links[k], u, multipliers, tangential)
            slip = None
            if partners and (partner := partners[k]) is not None:
                slip = contact.slips(links[k], u, partner, since)
                sliding.append(slip)
            moved[k] = _trial(links[k], rows, known, slip)
            H.append(forces)
            gaps.append(rows)
        self._trial.update(moved)
        return GeometryTangent(H, self._trial, gaps, sliding, *self._products)


def _trial(link: Link, weighted: PETSc.Mat, known: Bools, slips: SlipRows | None) -> Link:
    """Scale rows dG_j to w_n, and return the link of T_g; collective.

    Rows of T replace unknown or dependent rows, and those with a small part along n_j.
    """
    coupling, nodes, row = link.coupling, link.nodes, link.pattern.row
    kept, R, across = coupling.kept[:, 0], coupling.R, coupling.rows
    d = R.shape[1]
    scale = weighted.createVecLeft()
    on = kept & known
    scale.array[d * nodes[on]] = -1.0 / coupling.weight[on, 0]
    weighted.diagonalScale(scale)
    rows, moved = across.copy(), coupling.P[:, :1, None] * across[row]
    rows[:, 0], moved[:, 0] = _lumped(link, scipy.sparse.csr_array(owned_rows(weighted)[d * nodes]))
    if slips is not None:
        slid, q = rows.copy(), moved.copy()
        for t in range(1, d):
            slid[:, t], q[:, t] = _lumped(link, slips.rows(t - 1))
        slid[:, 1:] = np.where(coupling.directions[:, 1:, None], slid[:, 1:], across[:, 1:])
        # lumped partners outside of the sparsity pattern may make a block singular
        regular = np.linalg.det(slid) * np.linalg.det(R) > 0.5
        faced = (slips.partners.known & regular)[:, None, None]
        rows, moved = np.where(faced, slid, rows), np.where(faced[row], q, moved)
    moved[:, 1:] *= coupling.directions[row, 1:, None]
    moves = kept & ((rows[:, 0] * coupling.normals).sum(axis=1) > 0.5)
    inverted = np.linalg.inv(np.where(moves[:, None, None], rows, across))
    blocks = np.where(moves[row][:, None, None], inverted[row] @ moved, coupling.blocks)
    frames = np.where(moves[:, None, None], inverted, R)
    return replace(link, coupling=replace(coupling, R=frames, blocks=blocks))


def _lumped(link: Link, rows: scipy.sparse.csr_array) -> tuple[Floats, Floats]:
    """Rows' parts (n, d) with others lumped on them, and minus the others (e, d)."""
    coupling, pattern = link.coupling, link.pattern
    used = np.arange(len(pattern.row)) >= pattern.split
    used |= coupling.P[:, 0] != 0.0
    (n, N), d = rows.shape, coupling.R.shape[1]
    rows.sort_indices()
    row = np.repeat(np.arange(n), np.diff(rows.indptr))
    parts = np.bincount(d * row + rows.indices % d, rows.data, minlength=d * n)
    own = np.asarray(parts, dtype=np.float64).reshape(n, d)
    keys = row * N + rows.indices.astype(np.int64)
    p = np.zeros((len(used), d))
    first = pattern.row[used] * np.int64(N) + d * pattern.column[used]
    for i in range(d):
        p[used, i] = -_values_at(keys, rows.data, first + i)
        own[:, i] += np.bincount(pattern.row, p[:, i], minlength=n)
    return own, p


def _values_at(keys: Longs, values: Floats, asked: Longs) -> Floats:
    if not len(keys):
        return np.zeros(len(asked))
    place = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
    return np.where(keys[place] == asked, values[place], 0.0)
