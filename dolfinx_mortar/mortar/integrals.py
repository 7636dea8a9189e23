# SPDX-License-Identifier: MIT
r"""Segments of a pair at X + u, and integrals over them.

Each slave facet is integrated by the rank that owns it; copies of the master facets travel to it.
The weight of a pairing, such as 2 pi r, is a factor of all these integrals. It is taken at the
points of the slave side where they are at X: there it stays what it was, and positive.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from mpi4py import MPI

import numba
import numpy as np

import dolfinx
from dolfinx.common import timed
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, facet_sizes, points_of, tributary_weights
from dolfinx_mortar.geometry.segments import Segments, create_segments
from dolfinx_mortar.mortar.pairing import Pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    Surface,
    coordinates,
    facets_at,
    nodal_normals,
    sum_at_nodes,
)

_OF_POINTS = "pair", "slave", "master", "xi_s", "xi_m", "weight"  # what segments say of each point

# The kernels spell out their sums: array expressions would take three times as long to compile.
# Values of one function at all points lie side by side, and sums may be taken in any order, so that
# the compiler adds up several points at once.
SUMS = {"cache": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz"}}


@numba.njit(**SUMS)
def product(a, b):  # type: ignore[no-untyped-def]
    """Return the scalar product of a and b (q,)."""
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
    """Add Phi (k, q) times N (l, q) of all points to blocks (size, k, l)."""
    first = 0
    while first < len(where):
        last = first  # points of the same block mostly follow each other
        while last < len(where) and where[last] == where[first]:
            last += 1
        for i in range(len(Phi)):
            for j in range(len(N)):
                blocks[where[first], i, j] += product(Phi[i, first:last], N[j, first:last])
        first = last


def sums_of_products(Phi: Floats, N: Floats, where: Ints, size: int) -> Floats:
    """Return the sums (size, k, l) of Phi (q, k) times N (q, l) over the points of each place.

    Args:
        Phi: Values of functions, times the weights of the points.
        N: Values of others.
        where: Place (q,) of each point.
    """
    blocks = np.zeros((size, Phi.shape[1], N.shape[1]))
    _add_products(blocks, np.ascontiguousarray(Phi.T), np.ascontiguousarray(N.T), where)
    return blocks


def sums_of_values(Phi: Floats, values: Floats, where: Ints, size: int) -> Floats:
    """Return the sums (size, k) of Phi (q, k) times values (q,) over the points of each place.

    In the order of the points, as `np.bincount` of each function, in a tenth of the time.

    Args:
        Phi: Values of functions, times the weights of the points.
        values: Values at the points.
        where: Place (q,) of each point.
    """
    sums = np.zeros((size, Phi.shape[1]))
    _add_values(sums, np.ascontiguousarray(Phi.T), np.ascontiguousarray(values), where)
    return sums


@numba.njit(cache=True)
def _add_values(sums, Phi, values, where):  # type: ignore[no-untyped-def]
    """Add Phi (k, q) times values (q,) to sums (size, k)."""
    for i in range(len(Phi)):
        for q in range(len(where)):
            sums[where[q], i] += Phi[i, q] * values[q]


def covered_weights(N_s: Floats, weight: Floats, slave: Ints, m: int) -> Floats:
    """Return the integrals (m, k) of N_j over the covered part of every slave facet (eq. 19).

    Args:
        N_s: Values (q, k) of the slave shape functions.
        weight: Weights (q,) of the quadrature points.
        slave: Slave facet (q,) of each point.
        m: Number of slave facets.

    Example:
        >>> covered_weights(np.array([[0.75, 0.25]]), np.array([1.0]), np.array([1]), 2)
        array([[0.  , 0.  ],
               [0.75, 0.25]])
    """
    return sums_of_products(weight[:, None], N_s, slave, m)[:, 0]


class Integrated(Protocol):
    """Data for integrals over a slave side: a `Pairing`, or a side alone."""

    @property
    def slave(self) -> Surface:
        """The side."""


@timed("~Mortar: segments")
def find_segments(pairing: Pairing, u: dolfinx.fem.Function | None) -> tuple[Segments, Floats]:
    """Find the segments and the averaged slave normals (n, d) at X + u (collective).

    Their weights contain that of the pairing.
    """
    slave = pairing.slave
    x = coordinates(slave, u)
    normals = nodal_normals(slave, x)
    master = received_facets(pairing, u)
    facets = facets_at(slave, x)
    n_s = normals[slave.facets]
    segments = create_segments(facets, n_s, master, pairing.pairs, pairing.deepest)
    return _weigh(pairing, segments, facets), normals


def point_distances(
    pairing: Pairing, segments: Segments, u: dolfinx.fem.Function | None
) -> tuple[Floats, Floats]:
    """Return |x_s - x_m| at the points (q,), and the larger of their two facets (q,) (collective).

    The size of a facet is its diameter at X.
    """
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
    u: dolfinx.fem.Function | None,
    reach: Callable[[Floats, float], Floats],
) -> Segments:
    """Return the segments without the pairs that are too far apart (collective).

    A pair stays if all its points do, so that what stays is whole: functions of the nodes are
    independent on it.

    Args:
        u: Displacement, None for X.
        reach: Largest distances (q,) for sizes of facets (q,), see `point_distances`, and the least
            distance of all.
    """
    distances, larger = point_distances(pairing, segments, u)
    comm = pairing.slave.V.mesh.comm
    nearest = float(comm.allreduce(distances.min(initial=np.inf), op=MPI.MIN))
    far = distances > reach(larger, nearest) + HALF_OF_DIGITS * larger
    near = (np.bincount(segments.pair, far, minlength=len(pairing.pairs)) == 0.0)[segments.pair]
    return some_points(segments, near)


def some_points(segments: Segments, which: Bools) -> Segments:
    """Return the segments with some of their points (q,) only."""
    points = {name: getattr(segments, name)[which] for name in _OF_POINTS}
    return replace(segments, **points)


def _weigh(pairing: Pairing, segments: Segments, facets: Facets) -> Segments:
    """Return segments on the slave facets (m,) at X + u with the weight of the pairing."""
    if pairing.weight is None:
        return segments
    at_X, xi = facets_at(pairing.slave, pairing.slave.X), facets.element.rule[0]
    which = np.repeat(np.arange(len(facets.x), dtype=np.int32), len(xi))
    points = points_of(at_X, which, np.tile(xi, (len(facets.x), 1)))
    whole = pairing.weight(points).reshape(len(facets.x), len(xi))
    at_points = pairing.weight(points_of(at_X, segments.slave, segments.xi_s))
    return replace(
        segments,
        weight=segments.weight * at_points,
        facet_weights=tributary_weights(facets, whole),
    )


def integrate_values(
    pairing: Integrated, segments: Segments, Phi: Floats, values: Floats
) -> Floats:
    """Return int Phi_j f (n,) at the slave nodes for values f (q,) at the points (collective).

    Args:
        Phi: Weighted dual functions (q, k) of `weighted_duals`.
        values: f.
    """
    slave = pairing.slave
    parts = sums_of_values(Phi, values, segments.slave, len(slave.facets))
    return sum_at_nodes(slave, parts[:, :, None])[:, 0]
