# SPDX-License-Identifier: MIT
"""Slave facets on which Dirichlet data leave no multiplier, so that nothing holds the master."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.interfaces.link import Link


@dataclass(frozen=True)
class Unheld:
    """Slave facets whose nodes are all prescribed and that meet several master facets, all ranks.

    Over one master facet both sides are linear, and agree where their nodes do; over several
    nothing asks the nodes of the master between them to follow.
    """

    facets: int
    place: tuple[float, ...]  # centre of one of them

    def __str__(self) -> str:
        return (
            f"{self.facets} slave facets (one around ({', '.join(f'{c:.4g}' for c in self.place)}))"
        )


def find_unheld(link: Link) -> Unheld | None:
    """Return the slave facets without a multiplier that meet several master facets; collective."""
    if not link.pairing:
        return None
    slave, segments = link.sides.slave, link.mortar[1].segments
    bare = link.prescribed_facets()
    met = np.unique(np.column_stack([segments.slave, segments.master]), axis=0)[:, 0]
    bare &= np.bincount(met, minlength=len(bare)) > 1
    places = slave.X[slave.facets[bare]].mean(axis=1)
    found = [tuple(place) for own in link.sides.V.mesh.comm.allgather(places) for place in own]
    return Unheld(len(found), min(found)) if found else None
