# SPDX-License-Identifier: MIT
"""Supports that are taken for planes of symmetry, though facets tell of an angle that is none."""

import numpy as np

from dolfinx_mortar.audit.stand_off import SPOILT
from dolfinx_mortar.interfaces.link import Link


def warnings_on_mirrors(link: Link) -> list[str]:
    """Return a warning for each side of which normals at mirrors are bent by much; collective.

    An arc that ends askew by less than half of its first facet cannot be told from a symmetric side
    of changing curvature. Forces of nodes there are askew by the angle: up to 5 % is not told, as
    of corners.
    """
    warnings = []
    names = ("slave",) if link.sides.meet_themselves else ("slave", "master")
    judged = link.sides.judged
    for name, side, (mirrors, tilt) in zip(names, link.sides.surfaces, judged, strict=False):
        sines = np.where(mirrors, np.abs(tilt), 0.0).max(axis=1)[: side.owned]
        own = np.flatnonzero(sines > 0.25 * SPOILT)
        places = [(float(sines[j]), *map(float, side.X[j])) for j in own]
        found = [place for part in link.sides.V.mesh.comm.allgather(places) for place in part]
        if found:
            sine, *place = max(found)
            where = ", ".join(f"{x:.4g}" for x in place)
            warnings.append(
                f"{link.interface}: at {len(found)} nodes of its {name} side, such as the one at "
                f"({where}), a support is taken for a plane of symmetry, although facets there "
                f"tell of an angle {np.degrees(np.arcsin(min(sine, 1.0))):.2g} degrees off the "
                "right one: refine there, the more so if it is none"
            )
    return warnings
