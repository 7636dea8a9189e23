# SPDX-License-Identifier: MIT
"""Which ranks can need which facets of a surface: each tells the others where its own look to."""

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, bounding_balls
from dolfinx_mortar.geometry.search import Cones, create_cones, find_meeting

_GROUPS = 16
"""Cones by which a rank tells the others where it needs facets: message against copies."""


def create_groups(x: Floats) -> list[Ints]:
    """Divide facets x (m, k, d) into groups of neighbours, by halving along the longest side."""
    groups: list[Ints] = [np.arange(len(x), dtype=np.int32)]
    centre = x.mean(axis=1)
    while len(groups) < _GROUPS and max(map(len, groups)) > 1:
        halves: list[Ints] = []
        for group in groups:
            points = centre[group]
            axis = np.argmax(np.ptp(points, axis=0)) if len(group) else 0
            halves += np.array_split(group[np.argsort(points[:, axis], kind="stable")], 2)
        groups = halves
    return [group for group in groups if len(group)]


def group_cones(x: Floats, directions: Floats, groups: list[Ints], margin: Floats) -> Cones:
    """Bound the projections of groups of facets.

    Args:
        x: Nodes (m, k, d) of the facets.
        directions: Unit vectors (m, k', d) whose cone holds the directions of each facet.
        groups: Facets of each group.
        margin: Lateral margin (m,) of the facets.
    """
    d = x.shape[2]
    cones = [
        create_cones(
            x[group].reshape(1, -1, d),
            directions[group].reshape(1, -1, d),
            margin[group].max(keepdims=True),
        )
        for group in groups
    ]
    if not cones:
        return Cones(np.empty((0, d)), np.empty((0, d)), np.empty(0), np.empty(0))
    return Cones(
        np.concatenate([cone.centre for cone in cones]),
        np.concatenate([cone.axis for cone in cones]),
        np.concatenate([cone.radius for cone in cones]),
        np.concatenate([cone.slope for cone in cones]),
    )


def find_receivers(comm: MPI.Intracomm, cones: Cones, facets: Facets) -> Bools:
    """Return (own facets, ranks): which ranks, each with its cones, can need them (collective)."""
    needed = np.zeros((len(facets.x), comm.size), dtype=bool)
    balls = bounding_balls(facets.x)
    for rank, others in enumerate(comm.allgather(cones)):
        needed[find_meeting(others, *balls)[:, 1], rank] = True
    return needed
