# SPDX-License-Identifier: MIT
"""Segments of a pair at X + u, and integrals over them.

Each slave facet is integrated by its owner; master facets are copied there. The weight of a
pairing, such as 2 pi r, is positive, taken on the slave side at X.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from mpi4py import MPI

import numba
import numpy as np

from dolfinx.common import timed
from dolfinx.fem import Function
from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import (
    Facets,
    facet_normals,
    facet_sizes,
    points_of,
    tributary_weights,
)
from dolfinx_mortar.geometry.segments import Segments, create_segments
from dolfinx_mortar.geometry.tolerances import KERNEL
from dolfinx_mortar.mortar.pairing import Pairing, Weight, received_facets
from dolfinx_mortar.mortar.surface import (
    Surface,
    accumulate,
    coordinates,
    facets_at,
    nodal_normals,
    sum_at_nodes,
)

_FALL = 0.3
"""Least fall of weights, as a share of the size of a facet, see `_near_parts`: a lower step counts
in part, and changes a gap by up to a sixth of it."""

_OF_POINTS = "pair", "slave", "master", "xi_s", "xi_m", "weight"

# loops compile faster than array expressions
SUMS = {**KERNEL, "fastmath": {"reassoc", "contract", "nsz"}}


@numba.njit(**SUMS)
def product(a, b):  # type: ignore[no-untyped-def]
    """Scalar product of a and b (q,)."""
    result = 0.0
    for q in range(len(a)):
        result += a[q] * b[q]
    return result


@numba.njit(**SUMS)
def add(factor, a, b):  # type: ignore[no-untyped-def]
    """Add a factor times a (q,) to b."""
    for q in range(len(a)):
        b[q] += factor * a[q]


@numba.njit(**SUMS)
def _add_products(blocks, Phi, N, where):  # type: ignore[no-untyped-def]
    first = 0
    while first < len(where):
        last = first  # neighbouring points mostly share a block
        while last < len(where) and where[last] == where[first]:
            last += 1
        for i in range(len(Phi)):
            for j in range(len(N)):
                blocks[where[first], i, j] += product(Phi[i, first:last], N[j, first:last])
        first = last


def sums_of_products(Phi: Floats, N: Floats, where: Ints, size: int) -> Floats:
    """Sums (size, k, l) of weighted Phi (q, k) times N (q, l) by places (q,)."""
    blocks = np.zeros((size, Phi.shape[1], N.shape[1]))
    _add_products(blocks, np.ascontiguousarray(Phi.T), np.ascontiguousarray(N.T), where)
    return blocks


def sums_of_values(Phi: Floats, values: Floats, where: Ints, size: int) -> Floats:
    """Sums (size, k) of weighted Phi (q, k) times values (q,) by places (q,)."""
    return sums_of_products(Phi, values[:, None], where, size)[:, :, 0]


class Integrated(Protocol):
    """Data for integrals over a slave side."""

    @property
    def slave(self) -> Surface:
        """The side."""


@timed("~Mortar: segments")
def find_segments(pairing: Pairing, u: Function | None) -> tuple[Segments, Floats]:
    """Find the segments, weighted, and the averaged slave normals (n, d) at X + u (collective)."""
    slave = pairing.slave
    x = coordinates(slave, u)
    normals = nodal_normals(slave, x)
    master = received_facets(pairing, u)
    facets = facets_at(slave, x)
    n_s = normals[slave.facets]
    segments = create_segments(facets, n_s, master, pairing.pairs, pairing.deepest)
    segments = _near_parts(pairing, segments, facets, master)
    return weigh(slave, pairing.weight, segments, facets), normals


def _near_parts(pairing: Pairing, segments: Segments, facets: Facets, master: Facets) -> Segments:
    """Reduce the weights of segments far behind the nearest one (collective).

    See theory.md, Edges and corners: 8 and 3/2 leave rolling discs and sliding cantilevers
    unchanged.
    """
    slave, on, w = pairing.slave, segments.slave, segments.weight
    n, count = facet_normals(facets), len(facets.x)
    gap, least = gaps(facets, master, pairing.pairs, segments, n), np.full(count, np.inf)
    np.minimum.at(least, on, gap)
    cosine = np.einsum(
        "pi,pi->p", n[pairing.pairs[:, 0]], facet_normals(master)[pairing.pairs[:, 1]]
    )
    steep = np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) / np.maximum(np.abs(cosine), EPS)
    columns = np.column_stack([steep[segments.pair], np.ones(len(w))])
    sums = sums_of_values(columns, w, on, count)
    reach = _reaches(slave, least, sums, facet_sizes(facets.x))
    part = 1.0 - reach[on, 1] * (gap - reach[on, 0])
    if part.min(initial=1.0) > 1.0 - HALF_OF_DIGITS:
        return segments
    some = np.bincount(segments.pair, part > 0.0, minlength=len(pairing.pairs)) > 0.0
    # complete segments, with tiny weights at some points
    segments = replace(segments, weight=w * np.clip(part, EPS, 1.0), reach=reach)
    return some_points(segments, some[segments.pair])


def gaps(facets: Facets, master: Facets, pairs: Ints, segments: Segments, n: Floats) -> Floats:
    """Gaps (q,) at points of pairs (p, 2) along normals n (m, d) of the facets."""
    heights = np.einsum("mki,mi->mk", facets.x, n)[segments.slave]
    above = np.einsum("pki,pi->pk", master.x[pairs[:, 1]], n[pairs[:, 0]])[segments.pair]
    N = master.element.shape_functions(segments.xi_m)
    return np.einsum("qk,qk->q", N, above) - np.einsum("qk,qk->q", segments.N, heights)


def _reaches(slave: Surface, least: Floats, sums: Floats, size: Floats) -> Floats:
    """Gap above which weights fall, and the slope; collective."""
    nearest = np.full(len(slave.nodes), -np.inf)
    np.maximum.at(nearest, slave.facets, -least[:, None])
    least = -accumulate(slave, nearest, largest=True)[slave.facets].max(axis=1, initial=-np.inf)
    around = sum_at_nodes(slave, sums[:, None].repeat(slave.facets.shape[1], axis=1))
    rise, length = np.moveaxis(around[slave.facets].sum(axis=1), 1, 0)
    room = np.minimum(1.5, 8.0 * rise / np.maximum(length, TINY))
    return np.stack([least + room * size, 1.0 / (np.maximum(room, _FALL) * size)], axis=1)


def point_distances(
    pairing: Pairing, segments: Segments, u: Function | None
) -> tuple[Floats, Floats]:
    """Distances |x_s - x_m| (q,), and the larger diameter (q,) at X of both facets (collective)."""
    slave = facets_at(pairing.slave, coordinates(pairing.slave, u))
    offsets = points_of(slave, segments.slave, segments.xi_s)
    offsets -= points_of(received_facets(pairing, u), segments.master, segments.xi_m)
    sizes = facet_sizes(pairing.slave.X[pairing.slave.facets])
    of_master = facet_sizes(pairing.master_X[pairing.master_facets])
    larger = np.maximum(sizes[segments.slave], of_master[segments.master])
    return np.linalg.norm(offsets, axis=1), larger


def drop_far(
    pairing: Pairing,
    segments: Segments,
    u: Function | None,
    reach: Callable[[Floats, float], Floats],
) -> Segments:
    """The segments without pairs that are too far apart as a whole (collective).

    `reach`: sizes of facets (q,), least distance -> largest distances (q,).
    """
    distances, larger = point_distances(pairing, segments, u)
    comm = pairing.slave.V.mesh.comm
    nearest = float(comm.allreduce(distances.min(initial=np.inf), op=MPI.MIN))
    far = distances > reach(larger, nearest) + HALF_OF_DIGITS * larger
    near = (np.bincount(segments.pair, far, minlength=len(pairing.pairs)) == 0.0)[segments.pair]
    return some_points(segments, near)


def some_points(segments: Segments, which: Bools) -> Segments:
    """Some points (q,) of the segments."""
    points = {name: getattr(segments, name)[which] for name in _OF_POINTS}
    return replace(segments, **points)


def weigh(slave: Surface, weight: Weight | None, segments: Segments, facets: Facets) -> Segments:
    """The segments with a weight, taken at X, where it is positive."""
    if weight is None:
        return segments
    at_X = facets_at(slave, slave.X)
    points = facets.element.shape_functions(facets.element.rule[0]) @ at_X.x
    whole = weight(points.reshape(-1, points.shape[2])).reshape(points.shape[:2])
    return replace(
        segments,
        weight=segments.weight * weight(points_of(at_X, segments.slave, segments.xi_s)),
        facet_weights=tributary_weights(facets, whole),
    )


def integrate_values(
    pairing: Integrated, segments: Segments, Phi: Floats, values: Floats
) -> Floats:
    """Int Phi_j f (n, c) at the slave nodes for f (q, c) (collective)."""
    slave = pairing.slave
    return sum_at_nodes(slave, sums_of_products(Phi, values, segments.slave, len(slave.facets)))
