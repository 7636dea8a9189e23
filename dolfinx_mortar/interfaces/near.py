# SPDX-License-Identifier: MIT
"""Slave nodes that take part in the change of basis: those that the master may reach.

Far from the contact T would couple the bodies where they cannot meet, which costs fill in every
factorisation, and new pairs wherever curved sides slide past each other at a distance. So T holds
the near nodes only, and the gaps of the others are watched: the choice costs time, never accuracy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Actives, Bools, Floats, Ints
from dolfinx_mortar.interfaces.link import Link

# What counts as near: this share of the largest prescribed increment, plus so many facet lengths.
# Beside a node that touches, the next one is a facet away, and its gap below two facet lengths if
# the surfaces are inclined to each other by less than 63 degrees; at right angles none faces.
INCREMENT_SHARE, FACETS = 0.25, 2.0
# T holds nodes up to so many times that distance, so that it need not change in every step. Eight
# cases of large sliding need 74, 70, 66, 66, 66 of them with 1, 1.25, 2, 4, 8, in the same time.
MARGIN = 2.0
# Two round bodies that overlap by delta touch where they would overlap by half of it (Hertz: a^2 =
# R delta, while the overlap ends at 2 R delta).
OVERLAP = 0.5


def nodal_gaps(links: Sequence[Link], v: PETSc.Vec, n: int) -> Floats:
    """Return (owned nodes,) n_j.(P v - v_j), inf at nodes that no contact constrains; collective.

    For v = X + u this is the gap, how far w_n may still grow.
    """
    gap = np.full(n, np.inf)
    for link in links:
        if link.unilateral:
            normal = link.coupling.directions[:, 0]
            gap[link.nodes[normal]] = link.gaps(v)[normal]
    return gap


@dataclass(frozen=True)
class Reach:
    """Gaps of the owned nodes, and which of them count as near."""

    gap: Floats  # (owned nodes,)
    beyond: Floats  # (owned nodes,) gap beyond the nearest
    distance: float  # what counts as near, of `beyond`

    def missing(self, links: Sequence[Link]) -> bool:
        """Tell whether a node outside T is near; on this rank."""
        close = (self.beyond <= self.distance) | (self.gap <= 0.0)
        return any(close[link.nodes[~link.near]].any() for link in links)

    def near(self, link: Link) -> Bools:
        """Return which slave nodes (n,) of an interface T shall hold; all where it acts openly."""
        if link.acts_openly:
            return np.ones(len(link.nodes), dtype=bool)
        close = (self.beyond <= MARGIN * self.distance) | (self.gap <= 0.0)
        return np.asarray(close[link.nodes])


def find_reach(
    links: Sequence[Link], x: PETSc.Vec, n: int, increment: float, facet_length: float
) -> Reach:
    """Measure the gaps at positions x against what counts as near; collective."""
    comm = links[0].sides.V.mesh.comm
    gap = nodal_gaps(links, x, n)
    opposite = float(maximum(comm, -gap.min(initial=np.inf))[0])
    nearest = max(-opposite, 0.0) if np.isfinite(opposite) else 0.0
    distance = INCREMENT_SHARE * increment + FACETS * facet_length
    return Reach(gap, gap - nearest, float(distance))


def touches_far_nodes(links: Sequence[Link], x: PETSc.Vec, n: int) -> bool:
    """Tell whether a slave node that T does not hold lies in the master; collective."""
    gap = nodal_gaps(links, x, n)
    touched = [(gap[link.nodes[~link.near]] <= 0.0).any() for link in links]
    return bool(any_rank(links[0].sides.V.mesh.comm, any(touched))[0])


def predict_active(
    links: Sequence[Link], x: PETSc.Vec, n: int, bounded: Ints, facet_length: float
) -> Actives:
    """Return a first guess of the contact set on the owned nodes ``bounded``; collective.

    Nodes that overlap at positions x, to which the supports have moved every body as a whole, as
    deeply as where round bodies touch in the end; where none does, the nodes nearest.
    """
    comm: MPI.Comm = links[0].sides.V.mesh.comm
    gap = nodal_gaps(links, x, n)
    nearest = -float(maximum(comm, -gap.min(initial=np.inf))[0])
    depth = nearest if nearest > 0.0 else OVERLAP * nearest
    level = HALF_OF_DIGITS * facet_length  # differences of coordinates: these are equally near
    return np.asarray(gap[bounded] <= depth + level).astype(np.int8)
