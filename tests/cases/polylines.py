# SPDX-License-Identifier: MIT
"""Mortar operators of two polylines as dense matrices, without a mesh."""

from types import SimpleNamespace

import numpy as np
import numpy.typing as npt

from dolfinx_mortar.geometry.facets import LINE2, Facets, facet_normals
from tests.cases import surfaces
from tests.cases.surfaces import Side

Floats = npt.NDArray[np.float64]


def chain(n: int) -> npt.NDArray[np.int32]:
    """Return the facets of a polyline with n nodes."""
    return np.stack([np.arange(n - 1), np.arange(1, n)], axis=1).astype(np.int32)


def nodal_normals(x: Floats, facets: npt.NDArray[np.int32]) -> Floats:
    """Return averaged unit normals by a loop over the facets."""
    normals = np.zeros_like(x)
    for facet, n in zip(facets, facet_normals(Facets(LINE2, x[facets])), strict=True):
        normals[facet] += n
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def assemble(x_s, x_m, *, keep=None, facets_m=None, pairs=None) -> SimpleNamespace:
    """Assemble D and M of two polylines; all slave nodes are kept unless told otherwise."""
    x_s, x_m = np.asarray(x_s, dtype=float), np.asarray(x_m, dtype=float)
    facets_m = chain(len(x_m)) if facets_m is None else np.asarray(facets_m, dtype=np.int32)
    slave, master = Side(x_s, chain(len(x_s))), Side(x_m, facets_m)
    options = {"pairs": pairs, "keep": keep, "normals": nodal_normals(x_s, slave.facets)}
    found = surfaces.assemble(slave, master, **options)
    return SimpleNamespace(**vars(found) | {"x_s": x_s, "x_m": x_m})
