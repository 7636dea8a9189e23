# SPDX-License-Identifier: MIT
"""Contacts side by side whose slave sides and master sides are divided at different places."""

from collections.abc import Sequence
from itertools import permutations

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.interfaces.coupling import Sides
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.mortar.duals import LEAST_COVERAGE, Coverage
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing


def notes_on_splits(
    interfaces: Sequence[Interface],
    sides: Sequence[Sides],
    coverage: Sequence[Coverage],
    displacements: Sequence[fem.Function | None],
) -> list[str]:
    """Return a note for each interface of which facets face another one's master; collective.

    Where two slave sides meet, their masters have to end, too: what lies between faces the master
    of the neighbour, to which it is not coupled, as on blocks whose slave is divided at 1 and whose
    master at 1.1. Facets are told of with nodes of both sides and more than `LEAST_COVERAGE` of
    them in between.

    Args:
        interfaces: the descriptions.
        sides: their sides.
        coverage: how far their slave nodes face their masters.
        displacements: where they are, None for X.
    """
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
    """Return the part of slave facets (m,) that faces the other's master only; collective.

    Zero for those without a node of both slave sides, or that are the other's, too.
    """
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
