# SPDX-License-Identifier: MIT
"""Which ranks can need which facets of a surface.

Each rank sends the others a few cones that contain the projections of its own facets.
"""

from dataclasses import fields

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, bounding_balls
from dolfinx_mortar.geometry.segments import Cones, create_cones, find_meeting, sort_in_space


def create_groups(x: Floats) -> list[Ints]:
    """Divide facets x (m, k, d) into groups of neighbours, at most sqrt(m) rounded up.

    Few groups make short messages, small ones send few facets that are not needed.
    """
    order = sort_in_space(x.mean(axis=1)).astype(np.int32)
    size = 1
    while size**2 < len(x):  # powers of 2: those blocks are compact
        size *= 2
    return [order[first : first + size] for first in range(0, len(x), size)]


def group_cones(x: Floats, directions: Floats, groups: list[Ints], margin: Floats) -> Cones:
    """Bound the projections of groups of facets.

    Args:
        x: Nodes (m, k, d) of the facets.
        directions: Unit vectors (m, k', d) whose cone holds the directions of each facet.
        groups: Facets of each group.
        margin: Lateral margin (m,) of the facets.
    """
    cones = [create_cones(x[:0], directions[:0], margin[:0])]  # there may be no group
    for group in groups:
        nodes, normals = (v[group].reshape(1, -1, x.shape[2]) for v in (x, directions))
        cones.append(create_cones(nodes, normals, margin[group].max(keepdims=True)))
    names = (field.name for field in fields(Cones))
    return Cones(*(np.concatenate([getattr(cone, name) for cone in cones]) for name in names))


def find_receivers(comm: MPI.Intracomm, cones: Cones, facets: Facets) -> Bools:
    """Return which of the own facets (m, ranks) ranks can need, by their cones (collective)."""
    needed = np.zeros((len(facets.x), comm.size), dtype=bool)
    balls = bounding_balls(facets.x)
    for rank, others in enumerate(comm.allgather(cones)):
        needed[find_meeting(others, *balls)[:, 1], rank] = True
    return needed
