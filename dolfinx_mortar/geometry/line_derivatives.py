# SPDX-License-Identifier: MIT
r"""Derivatives of the points of segments in 2D, when the nodes and the normals of facets move.

A segment of a pair of facets reaches from one end of its projection on the slave facet to the
other, and its points divide it in fixed shares. With the slave's x(xi), the directions n(xi) of
projection and the master's y(eta), an end of the master at y_l and the point opposite xi satisfy

    (x(xi) - y_l) x n(xi) = 0,            (x(xi) - y(eta)) x n(xi) = 0,

so that, with p = x - y and the cross product a x b = a_1 b_2 - a_2 b_1 of the plane,

    d xi  = -[(dx - dy_l) x n + p x dn] / (x' x n + p x n')
    d eta = [(dx - dy) x n + p x dn + (x' x n + p x n') d xi] / (y' x n)

where dx, dy and dn are the changes at fixed xi and eta. A weight w = |x'| (b - a)/2 w_k f changes
by d w / w = d(b - a)/(b - a) + x'.dx' / |x'|^2 + (ln f)' d xi.
"""

from dataclasses import dataclass

import numpy as np

from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.geometry.elements import FacetElement
from dolfinx_mortar.geometry.facets import Facets
from dolfinx_mortar.geometry.line import gauss_points
from dolfinx_mortar.geometry.segments import Segments


@dataclass(frozen=True, eq=False)
class PointDerivatives:
    """Derivatives of the points (q,) of segments.

    The p columns belong to the coordinates of the slave facet's nodes (k, 2), to the directions of
    projection at them (k, 2), and to the coordinates of the master facet's nodes (m, 2).
    """

    xi_s: Floats  # (q, p)
    xi_m: Floats  # (q, p)
    weight: Floats  # (q, p)


@dataclass(frozen=True, eq=False)
class _Curve:
    """A field with nodal values v (m, k, 2) at points (q,) of facets, with two derivatives."""

    N: Floats  # (q, k)
    dN: Floats  # (q, k)
    value: Floats  # (q, 2)
    slope: Floats  # (q, 2)
    bend: Floats  # (q, 2)


def _curve(element: FacetElement, v: Floats, xi: Floats) -> _Curve:
    """Return the field with values v (q, k, 2) at xi (q,)."""
    N = element.shape_functions(xi[:, None])
    dN = element.derivatives(xi[:, None])[:, :, 0]
    ends = element.derivatives(np.array([[-1.0], [1.0]]))[:, :, 0]
    bend = (ends[1] - ends[0]) / 2
    value, slope = (np.einsum("qk,qki->qi", F, v) for F in (N, dN))
    return _Curve(N, dN, value, slope, np.einsum("k,qki->qi", bend, v))


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _turned(v: Floats) -> Floats:
    """Return r (q, 2) with a x v = a.r."""
    return np.stack([v[:, 1], -v[:, 0]], axis=1)


def _moment_gradient(N: Floats, N_m: Floats, n: Floats, p: Floats) -> Floats:
    """Return d[(x - y) x n] (q, 2k + 2k + 2m) at fixed xi and eta."""
    r = _turned(n)[:, None]
    parts = N[:, :, None] * r, -N[:, :, None] * _turned(p)[:, None], -N_m[:, :, None] * r
    return np.concatenate([part.reshape(len(n), 2 * part.shape[1]) for part in parts], axis=1)


def differentiate_points(
    slave: Facets, n_s: Floats, master: Facets, segments: Segments, log_slope: Floats
) -> PointDerivatives:
    """Return the derivatives of the points of segments.

    Ends that are no ends of the pair's own projection stay where they are: those of slave facets,
    and those where another master facet becomes the nearest one.

    Args:
        slave: Slave facets (ms,).
        n_s: Averaged normals (ms, k, 2) at their nodes.
        master: Master facets (mm,).
        segments: Their segments, of `place_points`.
        log_slope: (ln f)' (q,) of the factor of the weights, by xi_s.
    """
    degree = max(slave.element.degree, master.element.degree)
    t = gauss_points(2 * degree + 1)[0]
    first = slice(None, None, len(t))
    s, m, xi = segments.slave, segments.master, segments.xi_s[:, 0]
    grouped = xi.reshape(-1, len(t))
    half = (grouped[:, -1] - grouped[:, 0]) / (t[-1] - t[0])
    middle = (grouped[:, -1] + grouped[:, 0]) / 2
    # the two sides are passed in opposite directions
    low, high = (
        _end_gradient(
            (slave.element, slave.x[s[first]], n_s[s[first]]),
            (master.x[m[first]], master.element.vertices[vertex]),
            middle + sign * half,
        )
        for sign, vertex in ((-1.0, 1), (1.0, 0))
    )
    share = np.tile((1 + t) / 2, len(half))[:, None]
    d_low, d_high = (np.repeat(end, len(t), axis=0) for end in (low, high))
    d_xi = (1 - share) * d_low + share * d_high

    x, n = _curve(slave.element, slave.x[s], xi), _curve(slave.element, n_s[s], xi)
    y = _curve(master.element, master.x[m], segments.xi_m[:, 0])
    p = x.value - y.value
    moved = _moment_gradient(x.N, y.N, n.value, p)
    along = _cross(x.slope, n.value) + _cross(p, n.slope)
    d_eta = (moved + along[:, None] * d_xi) / _cross(y.slope, n.value)[:, None]

    square = (x.slope**2).sum(axis=1)
    relative = (d_high - d_low) / np.repeat(2 * half, len(t))[:, None]
    relative += ((x.slope * x.bend).sum(axis=1) / square + log_slope)[:, None] * d_xi
    k = x.N.shape[1]
    stretch = x.dN[:, :, None] * (x.slope / square[:, None])[:, None]
    relative[:, : 2 * k] += stretch.reshape(len(s), 2 * k)
    return PointDerivatives(d_xi, d_eta, segments.weight[:, None] * relative)


def _end_gradient(
    slave: tuple[FacetElement, Floats, Floats], master: tuple[Floats, int], xi: Floats
) -> Floats:
    """Return the derivatives (s, p) of the ends (s,) of segments at one node of their masters.

    Args:
        slave: element, coordinates (s, k, 2) and directions (s, k, 2) of the slave facets.
        master: coordinates (s, m, 2) of the master facets, and the number of the node.
        xi: where the segments end.
    """
    element, x_s, n_s = slave
    x_m, vertex = master
    x, n = _curve(element, x_s, xi), _curve(element, n_s, xi)
    p = x.value - x_m[:, vertex]
    N_m = np.zeros(x_m.shape[:2])
    N_m[:, vertex] = 1.0
    slope = _cross(x.slope, n.value) + _cross(p, n.slope)
    off = _cross(p, n.value) / slope
    # of two ends that coincide the clipping shows round-off
    own: Bools = (np.abs(off) < HALF_OF_DIGITS) & (np.abs(xi) < 1.0 - HALF_OF_DIGITS)
    gradient = _moment_gradient(x.N, N_m, n.value, p)
    return np.where(own[:, None], -gradient / slope[:, None], 0.0)
