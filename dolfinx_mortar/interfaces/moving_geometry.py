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
from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.congruence import OperatorOfBases, ProductOfBases
from dolfinx_mortar.algebra.csr import matrix_of, owned_rows
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.basis import Claims, Transformation
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.interfaces.slip_partners import Partners


class GeometryTangent:
    """Contribution of moving surfaces, on the patterns of their pairs, at the last iterate.

    Attributes:
        forces: matrices (n, n) H = d(B^T lambda)/du, of each contact.
        rows: matrices (n, n) of w by du: -dG_j.du / D_jj, and added slips.
        trial: T_g.
    """

    def __init__(self, V: fem.FunctionSpace, links: Sequence[Link], claims: Claims) -> None:
        """Find the patterns; collective."""
        found = {k: link.interface.derivatives(link) for k, link in enumerate(links)}
        self._contacts = {k: one for k, one in found.items() if one is not None}
        self.trial = Transformation(V, links, claims)
        self.forces: list[PETSc.Mat] = []
        self.rows: list[PETSc.Mat] = []
        self._product = ProductOfBases()
        self._operator = OperatorOfBases(self.trial.factors[0].C)

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
    ) -> None:
        """See `InterfaceSystem.linearise_geometry`; collective."""
        moved, (since, partners) = list(links), slips
        self.forces, self.rows = [], []
        for k, contact in self._contacts.items():
            link = links[k]
            forces, gaps, known = contact.differentiate(link, u, multipliers, tangential)
            self.forces.append(forces)
            self.rows.append(gaps)
            slid = None
            if partners and (partner := partners[k]) is not None:
                slid = contact.slips(link, partner, since), partner.known
                self.rows.append(_matrix(link, slid[0], gaps))
            moved[k] = _trial(link, gaps, known, slid)
        self.trial.update(moved)

    def closing(self, du: PETSc.Vec) -> Floats:
        """Closing of gaps and added slips (n,) by du; collective."""
        total = np.zeros(du.local_size)
        for rows in self.rows:
            total += (rows * du).array_r
        return total

    def _bases(self, T: Transformation) -> list[tuple[PETSc.Mat, PETSc.Mat]]:
        return [(a.C, b.C) for a, b in zip(T.factors, self.trial.factors, strict=True)]

    def transform(self, K: PETSc.Mat, T: Transformation) -> PETSc.Mat:
        """Return T^T (K + H) T_g, refilled in place; collective."""
        return self._product.fill([K, *self.forces], self._bases(T))

    def follow(
        self, K: PETSc.Mat, T: Transformation, decoupled: Ints, diagonal: PETSc.Vec
    ) -> OperatorOfBases:
        """Same as an operator, decoupled at owned unknowns, always the same; collective.

        `diagonal` (n,) is that of T^T K T.
        """
        self._operator.follow_bases([K, *self.forces], self._bases(T), decoupled, diagonal)
        return self._operator


def _matrix(link: Link, rows: scipy.sparse.csr_array, like: PETSc.Mat) -> PETSc.Mat:
    """Matrix with the rows (d n, unknowns) of slave nodes; collective."""
    found, sizes, d = rows.tocoo(), like.getSizes(), link.coupling.R.shape[1]
    dofs = (d * link.nodes[:, None] + np.arange(d)).ravel()
    at, shape = (dofs[found.row], found.col), (sizes[0][0], sizes[1][1])
    return matrix_of(like.comm, scipy.sparse.coo_array((found.data, at), shape), sizes[1][0])


def _trial(
    link: Link,
    weighted: PETSc.Mat,
    known: Bools,
    slips: tuple[scipy.sparse.csr_array, Bools] | None,
) -> Link:
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
            slid[:, t], q[:, t] = _lumped(link, slips[0][t::d])
        slid[:, 1:] = np.where(coupling.directions[:, 1:, None], slid[:, 1:], across[:, 1:])
        # lumped partners outside of the sparsity pattern may make a block singular
        regular = np.linalg.det(slid) * np.linalg.det(R) > 0.5
        faced = (slips[1] & regular)[:, None, None]
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
    n, d = coupling.R.shape[:2]
    own, p = np.zeros((n, d)), np.zeros((len(used), d))
    np.add.at(own, (np.repeat(np.arange(n), np.diff(rows.indptr)), rows.indices % d), rows.data)
    at = d * pattern.column[used, None] + np.arange(d)
    p[used] = -rows[pattern.row[used, None], at].toarray()
    np.add.at(own, pattern.row, p)
    return own, p
