# SPDX-License-Identifier: MIT
r"""Change of the offset vector between two tied points with the displacement of the master.

The facets of two sides that approximate one surface do not touch: the points x_s and x_m of a
segment differ by the offset vector r = x_s - x_m, which moves with the bodies. The constraint
u_s = u_m resists a rotation by strains of the size of r, and its forces at the ends of r have a
moment. To first order the constraint is

    u_s = u_m + (grad u) r_t - (r.n) (grad u)^T n + n (H : E),      r_t = r - (r.n) n

with the surface gradient grad u = sum_l u_l grad N_l^T of the master's displacement at x_m and its
normal n. The first two terms are the displacement at the foot of x_s on the tangent plane; the
third is the rotation of the normal part of r, delta n = -(grad u)^T n. A rigid motion u = a + W x
gives W r, exactly, for all surfaces and distances. The transpose applies the force at x_s to the
master with its moment, so moments balance.

The last term is the change of the height of the smooth surfaces over the facets (`curvature`):
H = 1/2 sum_{a<b} N_a N_b C_ab of both sides, of trace h, and the strain E of the surface, the
symmetric tangential part of grad u. A dilatation u = c x of spheres changes h by c h; rigid motions
have no E, and plane sides no H.
"""

import numba
import numpy as np

from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.geometry.facets import Facets, surface_gradients


def offset_motions(facets: Facets, which: Ints, xi: Floats, offsets: Floats, H: Floats) -> Floats:
    """Return A_l (q, k, d, d): offset vectors change by sum_l A_l u_l.

    A_l = (r.g_l) I - (r.n) g_l n^T + n (H_t g_l)^T with g_l = grad N_l and the tangential part H_t
    of H.

    Args:
        facets: the facets (m,) from which the offsets start.
        which: (q,) facet of each point.
        xi: (q, d-1) its reference coordinates there.
        offsets: r (q, d).
        H: symmetric tensors (q, d, d) of the heights.
    """
    g, n = surface_gradients(facets, which, xi)
    A = np.empty((*g.shape, g.shape[2]))
    _fill(A, g, n, np.ascontiguousarray(offsets), np.ascontiguousarray(H))
    return A


# The kernel spells out its sums: array expressions take five times as long.


@numba.njit(cache=True)
def _fill(A, g, n, offsets, H):  # type: ignore[no-untyped-def]
    """Write A_l (q, k, d, d) for gradients g (q, k, d) and normals n (q, d)."""
    d = n.shape[1]
    stretch = np.empty(d)  # H_t g_l
    for q in range(A.shape[0]):
        along = 0.0
        for i in range(d):
            along += offsets[q, i] * n[q, i]
        for k in range(A.shape[1]):
            over, out = 0.0, 0.0
            for i in range(d):
                over += offsets[q, i] * g[q, k, i]
                stretch[i] = 0.0
                for j in range(d):
                    stretch[i] += H[q, i, j] * g[q, k, j]
                out += stretch[i] * n[q, i]
            for i in range(d):
                for j in range(d):
                    tangential = stretch[j] - out * n[q, j]
                    A[q, k, i, j] = n[q, i] * tangential - along * g[q, k, i] * n[q, j]
                A[q, k, i, i] += over
