# SPDX-License-Identifier: MIT
"""Which exterior facets of a body face another body, and their distances; over all ranks.

Facets are projected along their normals; the nearest facet hides those behind it, also of its own
body. An overlap is a negative distance.
"""

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.common.arguments import check, number
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Ints, Longs
from dolfinx_mortar.geometry.facets import (
    Facets,
    are_inside,
    facet_normals,
    facet_sizes,
)
from dolfinx_mortar.geometry.flat import bounds, facet_distances
from dolfinx_mortar.geometry.segments import create_segments, find_candidates
from dolfinx_mortar.geometry.tolerances import ROUND_OFF
from dolfinx_mortar.mortar.integrals import gaps
from dolfinx_mortar.mortar.pairing import THROUGH
from dolfinx_mortar.mortar.self_contact import neighbours
from dolfinx_mortar.mortar.surface import seen_facets, thickness_of_bodies


class Skin(NamedTuple):
    """Exterior facets of this rank."""

    facets: Facets  # (m,)
    part: Longs  # (m,) connected part of the mesh
    label: Longs


@dataclass(frozen=True, eq=False)
class Facing:
    """Pairs of facets of different parts that face each other, the first of this rank."""

    facet: Longs  # (p,) index into the skin
    part: Longs  # (p, 2)
    label: Longs
    size: Floats  # (p, 2) their diameters
    area: Floats  # (p,) of the first that faces the second
    distance: Floats  # (p,) negative: penetration
    place: Floats  # (p, d) centre of the first

    def __getitem__(self, which: Bools | Longs) -> "Facing":
        return Facing(*(getattr(self, field.name)[which] for field in fields(self)))


def find_facing(comm: MPI.Intracomm, skin: Skin) -> Facing:
    """Return the facets of other parts that facets of a skin face, at any distance; collective.

    Not those deeper in another body than half of the thinner body (`pairing.THROUGH`).
    """
    facets = skin.facets
    depth = THROUGH * thickness_of_bodies(comm, facets, skin.part, facets, skin.part)
    seen = seen_facets(comm, facets, facets, skin.part, skin.label, depth)
    others, part, label, behind = seen
    n = np.repeat(facet_normals(facets)[:, None], facets.element.nodes, axis=1)
    pairs = find_candidates(facets, n, others, np.zeros(len(depth)))
    deepest = np.minimum(depth[pairs[:, 0]], behind[pairs[:, 1]])
    segments = create_segments(facets, n, others, pairs, deepest)
    area = np.bincount(segments.pair, segments.weight, minlength=len(pairs)).astype(np.float64)
    least = np.full(len(pairs), np.inf)
    np.minimum.at(least, segments.pair, gaps(facets, others, pairs, segments, n[:, 0]))
    a, b = pairs.T
    size = np.stack([facet_sizes(facets.x)[a], facet_sizes(others.x)[b]], axis=1)
    # neighbours overlap by round-off
    over = area > HALF_OF_DIGITS * size[:, 0] ** (facets.x.shape[2] - 1)
    found = np.flatnonzero(over & (part[b] != skin.part[a]))
    distance = _distances(facets[a[found]], others[b[found]], least[found])
    some = np.isfinite(distance)
    found, distance = found[some], distance[some]
    a, b, size = a[found], b[found], size[found]
    return Facing(
        facet=a,
        part=np.stack([skin.part[a], part[b]], axis=1),
        label=np.stack([skin.label[a], label[b]], axis=1),
        size=size,
        area=area[found],
        distance=distance,
        place=facets.x[a].mean(axis=1),
    )


def _distances(facets: Facets, others: Facets, least: Floats) -> Floats:
    """Distances (p,) of pairs, inf for a flank seen past the edge of a body.

    Facets that cross at less than 45 degrees touch, as on fitting curved sides.
    """
    size, vertices = facet_sizes(facets.x), others.x[:, others.element.vertices]
    n, other = facet_normals(facets), facet_normals(others)
    middle = facets.x[:, facets.element.vertices].mean(axis=1)
    along = np.einsum("pi,pi->p", vertices.mean(axis=1) - middle, other)
    along /= np.einsum("pi,pi->p", n, other)
    inside = are_inside(vertices, other, middle + along[:, None] * n)
    distance = facet_distances(facets, others)
    distance[distance < ROUND_OFF * np.maximum(size, facet_sizes(others.x))] = 0.0
    across = (distance == 0.0) & ((n * other).sum(axis=1) < -np.sqrt(0.5))
    otherwise = np.where(across, 0.0, np.inf)
    return np.where(
        least < -HALF_OF_DIGITS * size, np.where(inside & (along < 0.0), along, otherwise), distance
    )


def are_near(facing: Facing, within: float | None) -> Bools:
    """Pairs `within` a distance, default the larger diameter."""
    reach = facing.size.max(axis=1, initial=0.0) if within is None else within
    return facing.distance <= reach


def boxes_of(comm: MPI.Comm, x: Floats, body: Longs, count: int) -> Floats:
    """Boxes (count, 2, d) of bodies from facets of bodies (m,); collective."""
    boxes = np.full((count, 2, x.shape[2]), np.inf)
    low, high = bounds(x)
    np.minimum.at(boxes[:, 0], body, low)
    np.minimum.at(boxes[:, 1], body, -high)
    comm.Allreduce(MPI.IN_PLACE, boxes, op=MPI.MIN)
    boxes[:, 1] *= -1.0
    return boxes


def check_angle(feature_angle: Any) -> float:
    """Return the least angle of an edge, in degrees; ValueError unless in (0, 180]."""
    return check("feature_angle", feature_angle, number("degrees", above=0.0, most=180.0))


def find_faces(
    V: fem.FunctionSpace, facets: Facets, nodes: Ints, body: Longs, feature_angle: float
) -> Longs:
    """Smooth face (m,) of each exterior facet of this rank, numbered over all ranks; collective.

    Neighbours of one body are of one face where their normals differ by less than the angle, in
    degrees.
    """
    comm = V.mesh.comm
    ends = nodes[:, facets.element.vertices]
    numbers = V.dofmap.index_map.local_to_global(ends.ravel().astype(np.int32))
    keys: Longs = np.asarray(numbers, dtype=np.int64).reshape(ends.shape)
    sent = comm.allgather((keys, body, facet_normals(facets)))
    keys, body, normals = (np.concatenate(each) for each in zip(*sent, strict=True))
    first, second = neighbours(keys, facets.x.shape[2] - 1)
    smooth = (normals[first] * normals[second]).sum(axis=1) > np.cos(np.radians(feature_angle))
    smooth &= body[first] == body[second]
    first, second, m = first[smooth], second[smooth], len(keys)
    graph = scipy.sparse.coo_array((np.ones(len(first)), (first, second)), shape=(m, m))
    _, face = scipy.sparse.csgraph.connected_components(graph, directed=False)
    before = comm.exscan(len(nodes)) or 0
    return np.asarray(face[before : before + len(nodes)], dtype=np.int64)
