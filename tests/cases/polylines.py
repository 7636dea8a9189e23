# SPDX-License-Identifier: MIT
"""Mortar operators of two polylines as dense matrices, without a mesh."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.geometry import segments
from dolfinx_mortar.geometry.elements import LINE2
from dolfinx_mortar.geometry.facets import Facets, facet_normals
from dolfinx_mortar.mortar import duals, integrals

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Operators:
    """Dense operators of a slave and a master polyline."""

    D: Floats  # (n_s, n_s)
    M: Floats  # (n_s, n_m)
    x_s: Floats  # (n_s, 2)
    x_m: Floats  # (n_m, 2)
    covered: Floats  # (n_s - 1,) covered length of each slave facet
    coverage: Floats  # (n_s,) covered part of the tributary weight of each node
    points: segments.Segments


def chain(n: int) -> npt.NDArray[np.int32]:
    """Return the facets of a polyline with n nodes."""
    return np.stack([np.arange(n - 1), np.arange(1, n)], axis=1).astype(np.int32)


def nodal_normals(x: Floats, facets: npt.NDArray[np.int32]) -> Floats:
    """Return averaged unit normals by a loop over the facets."""
    normals = np.zeros_like(x)
    for facet, n in zip(facets, facet_normals(Facets(LINE2, x[facets])), strict=True):
        normals[facet] += n
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def assemble(x_s, x_m, *, keep=None, facets_m=None, pairs=None) -> Operators:
    """Assemble D and M of two polylines; all slave nodes are kept unless told otherwise.

    Args:
        x_s: Slave nodes (n_s, 2), the outward normal on the right of the direction of travel.
        x_m: Master nodes (n_m, 2), likewise, hence in the opposite direction.
        keep: Kept slave nodes.
        facets_m: Master facets if they do not form one polyline.
        pairs: Candidates in place of a search.
    """
    x_s, x_m = np.asarray(x_s, dtype=float), np.asarray(x_m, dtype=float)
    facets_s = chain(len(x_s))
    facets_m = chain(len(x_m)) if facets_m is None else np.asarray(facets_m, dtype=np.int32)
    n_s = nodal_normals(x_s, facets_s)[facets_s]
    f_s, f_m = Facets(LINE2, x_s[facets_s]), Facets(LINE2, x_m[facets_m])
    if pairs is None:
        pairs = segments.find_candidates(f_s, n_s, f_m, np.zeros(len(facets_s)))
    points = segments.create_segments(f_s, n_s, f_m, pairs)
    N_s, N_m = (LINE2.shape_functions(xi) for xi in (points.xi_s, points.xi_m))
    keep = np.ones(len(x_s), dtype=bool) if keep is None else np.asarray(keep)
    Phi = duals.create_duals(N_s, points.weight, points.slave, keep[facets_s]).Phi
    D, M = np.zeros((len(x_s), len(x_s))), np.zeros((len(x_s), len(x_m)))
    rows, columns = facets_s[points.slave], facets_m[points.master]
    for i in range(2):
        for j in range(2):
            values = points.weight * Phi[:, i]
            np.add.at(D, (rows[:, i], rows[:, j]), values * N_s[:, j])
            np.add.at(M, (rows[:, i], columns[:, j]), values * N_m[:, j])
    weights = integrals.covered_weights(N_s, points.weight, points.slave, len(facets_s))
    total, tributary = np.zeros(len(x_s)), np.zeros(len(x_s))
    np.add.at(total, facets_s, weights)
    np.add.at(tributary, facets_s, points.facet_weights)
    return Operators(D, M, x_s, x_m, weights.sum(axis=1), total / tributary, points)
