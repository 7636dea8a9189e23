# SPDX-License-Identifier: MIT
"""Flat parts of exterior facets with what belongs to them, and their exchange between ranks."""

from dataclasses import dataclass, fields
from typing import Self

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Longs


@dataclass(frozen=True)
class FacetParts:
    """Arrays of m facets, which subclasses add to."""

    body: Longs  # (m,)
    sides: Bools  # (m, 2, interfaces) whether they belong to its slave and its master side

    def vertices(self) -> Floats:
        """Return the points (m, k, d) whose box holds what is looked at."""
        raise TypeError(f"{type(self).__name__} has no vertices")

    def part(self, which: Bools | Longs) -> Self:
        """Return some of the facets."""
        return type(self)(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def received(self, comm: MPI.Comm) -> Self:
        """Return the own facets, and those of other ranks that their box meets; collective."""
        if comm.size == 1:
            return self
        low, high = self.vertices().min(axis=1), self.vertices().max(axis=1)
        box = low.min(axis=0, initial=np.inf), high.max(axis=0, initial=-np.inf)
        sent = [
            self.part(((low <= most) & (high >= least)).all(axis=1) & (rank != comm.rank))
            for rank, (least, most) in enumerate(comm.allgather(box))
        ]
        parts = [self, *comm.alltoall(sent)]
        joined = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(self)}
        return type(self)(**joined)


def point(x: Floats) -> str:
    """Write a point for a note.

    >>> point(np.array([0.5, -2.0]))
    '(0.5, -2)'
    """
    return f"({', '.join(f'{c:.4g}' for c in x)})"
