# SPDX-License-Identifier: MIT
"""Whether one side has passed through the other in a step, so that nothing of it is in reach.

Partners that lie deeper than a part of the thinner body are none (`THROUGH`), so a side that moves
far enough in one step sees nothing on its way. What tells is the middle of a body, as far behind
each of its facets: it never lies in the other body, unless that has passed through.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.arrays import Floats
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.geometry.sweep import find_passing, flat_parts
from dolfinx_mortar.mortar.pairing import THROUGH
from dolfinx_mortar.mortar.surface import Surface, coordinates, facets_at


@dataclass(frozen=True)
class Passing:
    """What has passed through a surface, over all ranks."""

    surface: Surface  # through which
    count: int  # facets of the other side whose middle of the body has passed
    place: tuple[float, ...]  # of one of these facets, at the start
    depth: float  # how deep the middle lies behind that facet


def is_far(slave: Surface, master: Surface, before: Floats, now: Floats) -> bool:
    """Tell whether two sides have moved so far towards each other that one may be through.

    By more than the middle of the thinnest body lies deep: steps begin where sides touch at most.
    No facets are looked at; collective.

    Args:
        slave: one side.
        master: the other side.
        before: displacements (owned nodes, d) at the start of the step.
        now: those at its end.
    """
    nodes = np.concatenate([side.nodes[: side.owned] for side in (slave, master)])
    thinnest = min(side.thickness.min(initial=np.inf) for side in (slave, master))
    moved = now[nodes] - before[nodes]
    most, least = moved.max(axis=0, initial=-np.inf), moved.min(axis=0, initial=np.inf)
    found = maximum(slave.V.mesh.comm, -thinnest, *most, *-least)
    extent = found[1:].reshape(2, -1).sum(axis=0)
    return bool(np.linalg.norm(extent) >= -THROUGH * found[0])


def find_passed(
    slave: Surface, master: Surface, before: fem.Function, now: fem.Function
) -> Passing | None:
    """Return through which side the other one has passed, None if neither; collective.

    All ranks get all facets of a side: ask `is_far` first.

    Args:
        slave: one side.
        master: the other side.
        before: displacement at the start of the step.
        now: displacement at its end.
    """
    for own, other in ((slave, master), (master, slave)):
        found = _passed(own, other, before, now)
        if found is not None:
            return found
    return None


def _passed(
    own: Surface, other: Surface, before: fem.Function, now: fem.Function
) -> Passing | None:
    """Return what of a surface has passed through the other one; collective."""
    comm = own.V.mesh.comm
    thick = np.isfinite(own.thickness)
    facets = [facets_at(own, coordinates(own, u))[thick] for u in (before, now)]
    depth = THROUGH * own.thickness[thick]
    corners = np.array(own.element.vertices)
    faces = [f.x[:, corners].mean(axis=1) for f in facets]
    middles = [x - depth[:, None] * facet_normals(f) for x, f in zip(faces, facets, strict=True)]
    parts = [flat_parts(facets_at(other, coordinates(other, u))) for u in (before, now)]
    start, end = (np.concatenate(comm.allgather(part)) for part in parts)
    passed = find_passing((middles[0], middles[1]), (start, end))
    count = comm.allreduce(len(passed), op=MPI.SUM)
    if not count:
        return None
    places = comm.allgather([(*faces[0][k].tolist(), float(depth[k])) for k in passed[:1]])
    *place, deep = min(found[0] for found in places if found)
    return Passing(other, count, tuple(place), deep)
