# SPDX-License-Identifier: MIT
"""Slave nodes near the master, which take part in the change of basis.

Far nodes in T would add fill to factorisations, and new pairs where curved sides slide past each
other. Their gaps are watched: only time depends on the choice.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Actives, Bools, Floats, Ints
from dolfinx_mortar.interfaces.link import Link

# Near is this share of the largest prescribed increment plus so many facets: next to a touching
# node the gap is below two facets for surfaces inclined by less than 63 degrees.
INCREMENT_SHARE, FACETS = 0.25, 2.0
# Multiple of the near distance for T. Eight cases of large sliding need 74, 70, 66, 66, 66
# different T with 1, 1.25, 2, 4, 8.
MARGIN = 2.0
# Round bodies that overlap by delta touch where they overlap by half of it (Hertz: a^2 = R delta).
OVERLAP = 0.5


def nodal_gaps(links: Sequence[Link], v: PETSc.Vec, n: int) -> Floats:
    """Return n_j.(P v - v_j) (owned nodes,), the gap for v = X + u, else inf; collective."""
    gap = np.full(n, np.inf)
    for link in links:
        if link.unilateral:
            normal = link.coupling.directions[:, 0]
            gap[link.nodes[normal]] = link.gaps(v)[normal]
    return gap


@dataclass(frozen=True)
class Reach:
    """Gaps of the owned nodes, and the near distance."""

    gap: Floats  # (owned nodes,)
    beyond: Floats  # (owned nodes,) gap minus the least gap
    distance: float  # limit of `beyond` for near nodes

    def missing(self, links: Sequence[Link]) -> bool:
        """Whether a node outside T is near; on this rank."""
        close = (self.beyond <= self.distance) | (self.gap <= 0.0)
        return any(close[link.nodes[~link.near]].any() for link in links)

    def near(self, link: Link) -> Bools:
        """Mask of slave nodes (n,) for T; all if it acts at open nodes."""
        if link.acts_openly:
            return np.ones(len(link.nodes), dtype=bool)
        close = (self.beyond <= MARGIN * self.distance) | (self.gap <= 0.0)
        return np.asarray(close[link.nodes])


def find_reach(
    links: Sequence[Link], x: PETSc.Vec, n: int, increment: float, facet_length: float
) -> Reach:
    """Gaps at positions x and the near distance; collective."""
    comm = links[0].sides.V.mesh.comm
    gap = nodal_gaps(links, x, n)
    opposite = float(maximum(comm, -gap.min(initial=np.inf))[0])
    nearest = max(-opposite, 0.0) if np.isfinite(opposite) else 0.0
    distance = INCREMENT_SHARE * increment + FACETS * facet_length
    return Reach(gap, gap - nearest, float(distance))


def touches_far_nodes(links: Sequence[Link], x: PETSc.Vec, n: int) -> bool:
    """Whether a slave node outside T penetrates the master; collective."""
    gap = nodal_gaps(links, x, n)
    touched = [(gap[link.nodes[~link.near]] <= 0.0).any() for link in links]
    return bool(any_rank(links[0].sides.V.mesh.comm, any(touched))[0])


def predict_active(
    links: Sequence[Link], x: PETSc.Vec, n: int, bounded: Ints, facet_length: float
) -> Actives:
    """Initial active set on the owned nodes ``bounded``; collective.

    Nodes that overlap at x like round bodies in contact, or the nearest.
    """
    comm: MPI.Comm = links[0].sides.V.mesh.comm
    gap = nodal_gaps(links, x, n)
    nearest = -float(maximum(comm, -gap.min(initial=np.inf))[0])
    depth = nearest if nearest > 0.0 else OVERLAP * nearest
    level = HALF_OF_DIGITS * facet_length
    return np.asarray(gap[bounded] <= depth + level).astype(np.int8)
