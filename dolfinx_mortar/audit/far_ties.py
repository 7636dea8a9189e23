# SPDX-License-Identifier: MIT
"""Distances of tied points, and slave nodes beyond the reach of a tie."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.interfaces.interface import Interface
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.duals import find_coverage, node_weights
from dolfinx_mortar.mortar.integrals import find_segments, point_distances


@dataclass(frozen=True)
class TieReach:
    """What the audit has found for a tie at X, all ranks."""

    tie: Interface
    farthest: float  # largest distance of two points that are tied, 0 if none is
    share: float  # largest distance in parts of the larger facet there
    beyond: int  # slave nodes that face the master, but farther away than the tie reaches

    def __str__(self) -> str:
        beyond = f", {self.beyond} nodes farther apart are not" if self.beyond else ""
        return f"tied over distances up to {self.farthest:.3g}{beyond}"

    @property
    def hint(self) -> str:
        """Remedy where nothing else holds a body; empty if the tie reaches everywhere."""
        if not self.beyond:
            return ""
        return f"; {self.tie} does not reach {self.beyond} slave nodes: {self._remedy}"

    @property
    def warning(self) -> str:
        """Warning where points at a distance are tied or left out by default; otherwise empty.

        Facets that meet at the feature angle a or less stand off a smooth surface by no more than
        their sagittas, tan(a / 4) / 2 of their length on either side.
        """
        plain = np.tan(np.radians(self.tie.feature_angle / 4))
        if self.tie.within is not None or (self.share <= plain and not self.beyond):
            return ""
        apart = f"what is tied is up to {self.farthest:.3g} apart, {self.share:.2g} of a facet"
        left = (
            f"{self.beyond} slave nodes face the master from more than half a facet farther than "
            "where the sides are nearest, and are not tied"
        )
        told = [apart] * int(self.share > plain) + [left] * int(self.beyond > 0)
        return f"{self.tie}: {', and '.join(told)}; {self._remedy}"

    @property
    def _remedy(self) -> str:
        given = "Tie(..., within=)" if self.tie.within is None else "within="
        return f"say how far it shall reach, {given}, or mark only what belongs together"


def measure_reach(link: Link) -> TieReach | None:
    """Measure a tie; None for what is no tie; collective."""
    tie = link.interface
    if link.unilateral or link.pairing is None:
        return None
    pairing, segments = link.mortar[0], link.mortar[1].segments  # ties are coupled at X
    everything, _ = find_segments(pairing, None)
    distances, larger = point_distances(pairing, segments, None)
    comm = link.sides.V.mesh.comm
    farthest, share = maximum(
        comm, distances.max(initial=0.0), (distances / larger).max(initial=0.0)
    )
    all_around = find_coverage(pairing, everything, *node_weights(pairing, everything)).faces
    beyond = all_around & ~link.coupling.coverage.faces
    count = comm.allreduce(int(beyond.sum()), op=MPI.SUM)
    return TieReach(tie, float(farthest), float(share), int(count))
