# SPDX-License-Identifier: MIT
"""A dense model of the Schur complement on the bounded unknowns, and what is learnt with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.qp.tolerances import EPS, ROUND_OFF


@dataclass
class SchurModel:
    """A symmetric positive definite model of the Schur complement on the bounded unknowns."""

    base: Floats  # (k, k) before any pair is known: from A, or what was learnt about an earlier A
    V: Floats  # (k, j) directions, conjugate: V' W = 1
    W: Floats  # (k, j) S V

    def matrix(self) -> Floats:
        """Return base - base V (V' base V)^-1 V' base + W W', which maps V to W.

        Raises:
            LinAlgError: if round-off has made the base indefinite.
        """
        if self.V.shape[1] == 0:
            return self.base
        C = self.base @ self.V
        M = self.base - C @ cho_solve(cho_factor(self.V.T @ C), C.T) + self.W @ self.W.T
        return np.asarray(0.5 * (M + M.T))

    def learn(self, v: Floats, w: Floats) -> None:
        """Add the pair w = S v, made conjugate to the pairs at hand."""
        whole = v @ w
        for _ in range(2):  # twice is enough
            c = self.W.T @ v
            v, w = v - self.V @ c, w - self.W @ c
        energy = v @ w
        least = max(float(whole), float(np.linalg.norm(v) * np.linalg.norm(w)))
        if not energy > np.sqrt(EPS) * least:
            return  # half of the digits are gone: what is left of the pair is mostly its errors
        if self.V.shape[1] == 0:  # the first pair knows the scale
            self.base = self.base * (energy / (v @ self.base @ v))
        scale = 1.0 / np.sqrt(energy)
        self.V = np.column_stack([self.V, scale * v])
        self.W = np.column_stack([self.W, scale * w])

    def forget(self) -> None:
        """Drop all pairs."""
        self.V = self.W = np.zeros((self.base.shape[0], 0))


def half_laplacian(block: Floats) -> Floats:
    """Return diag^(1/2) sqrt(L) diag^(1/2), with L the Laplacian of the graph of A_BB.

    For linear elements on a curve this is the energy of the Dirichlet-to-Neumann map up to a
    factor, whatever the mesh sizes; diag(A) brings in the stiffness. All edges weigh the same: the
    entries of A_BB reflect the angles of the elements, which S hardly feels (measured on a graded
    mesh: condition number of M^-1 S 6 without weights, 17 with |a_ij| as weights).
    """
    diagonal = np.sqrt(np.diag(block))
    edges = (np.abs(block) > ROUND_OFF * EPS * np.outer(diagonal, diagonal)).astype(np.float64)
    np.fill_diagonal(edges, 0.0)
    values, vectors = eigh(np.diag(edges.sum(axis=1)) - edges)
    # the size of the body bounds the softest mode: one wavelength over all bounded unknowns
    shift = max(values.max(initial=0.0), 1.0) / max(1, values.size) ** 2
    root = (vectors * np.sqrt(np.maximum(values, 0.0) + shift)) @ vectors.T
    return np.asarray(root * np.outer(diagonal, diagonal))


@dataclass(frozen=True)
class Learnt:
    """What the QPs of one linear solver have shown, for the next one; its matrix may be another."""

    bounded: Ints | None = None  # this rank's unknowns of the model, ascending
    model: SchurModel | None = None  # on rank 0
    changes: int | None = None  # unknowns in which the last QP changed its first active set
