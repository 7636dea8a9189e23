# SPDX-License-Identifier: MIT
"""Two rough sides with random tractions: forces, weighted gaps, and differences of these."""

from dataclasses import replace

import numpy as np

from dolfinx_mortar.geometry.facets import points_of
from dolfinx_mortar.mortar import edges
from dolfinx_mortar.mortar.curvature_correction import find_smooth_sides, point_heights
from dolfinx_mortar.mortar.duals import default_keep, node_weights, weighted_duals
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    coordinates,
    create_surface,
    facets_at,
    normal_derivatives,
)
from dolfinx_mortar.mortar.tangent import Tractions, differentiate
from tests.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER


def summed(parts, shape):
    """Return the sum of blocks as a dense matrix."""
    total = np.zeros(shape)
    for part in parts:
        _, _, i, _, h = part.values.shape
        rows = i * part.rows[:, :, None] + np.arange(i)
        columns = h * part.columns[:, :, None] + np.arange(h)
        np.add.at(total, (rows[..., None, None], columns[:, None, None]), part.values)
    return total


class RoughSides:
    """Both sides at a displacement, in the plane or in space; the upper side of below is slave."""

    def __init__(self, u, facets, turn, rng, *, sagittas=None, weight=None, shared=True):
        """Find the sides.

        Args:
            u: the displacement, which `differences` changes and puts back.
            facets: tags.
            turn: matrix (d, d) that turns normals into the direction of the other traction.
            rng: of sagittas and tractions.
            sagittas: range of those of smooth surfaces, None for facets.
            weight: of the integrals.
            shared: whether functions of nodes without multiplier are shared out, or in part, as
                beside open edges: by the opening, which a wide `edges.SUNK` lets be anywhere
                between.
        """
        V, self.u, self.turn, self.d = u.function_space, u, turn, len(turn)
        self.shared = shared
        tags = (TOP_OF_LOWER, "slave"), (BOTTOM_OF_UPPER, "master")
        self.slave, self.master = (create_surface(V, facets, *tag) for tag in tags)
        self.pairing = create_pairing(V, self.slave, self.master, u, weight=weight)
        self.smooth = None
        if sagittas is not None:
            free = np.zeros((len(u.x.array) // self.d, self.d), dtype=bool)
            found = find_smooth_sides(self.pairing, free, 40.0)
            a, b = (replace(s, sagitta=rng.uniform(*sagittas, s.sagitta.shape)) for s in found)
            self.smooth = a, b
        self.values = rng.uniform(0.5, 1.0, (2, len(self.slave.nodes)))
        segments, _ = find_segments(self.pairing, u)
        self.keep = default_keep(self.pairing, segments, *node_weights(self.pairing, segments))
        self.nodes = np.concatenate([self.slave.nodes, self.pairing.master_nodes])

    def sharing(self, segments):
        """Return what is shared out at the present displacement."""
        closed = np.ones(len(self.slave.facets))
        if not self.shared:
            closed = edges._closed(self.pairing, segments, self.u, ~self.keep)
        return edges.Sharing(~self.keep, closed)

    def duals(self, segments):
        """Return the weighted dual functions."""
        Phi = weighted_duals(self.pairing, segments, self.keep)
        return edges.open_duals(self.pairing, segments, Phi, self.keep, self.sharing(segments))

    def given(self, n):
        """Return normals and tractions for averaged normals."""
        k, (a, b) = self.keep[:, None], self.values[:, :, None]
        one = np.broadcast_to(np.eye(self.d), (len(n), self.d, self.d)) * k[:, None]
        changes = a[..., None] * one + b[..., None] * self.turn @ one
        return Tractions(k * n, one, k * (a * n + b * n @ self.turn.T), changes)

    def forces_and_gaps(self):
        """Return the forces on all nodes and the weighted gaps."""
        segments, n = find_segments(self.pairing, self.u)
        given, own = self.given(n), len(self.slave.nodes)
        Phi = self.duals(segments)
        sides = (
            (facets_at(self.slave, coordinates(self.slave, self.u)), segments.slave, segments.xi_s),
            (received_facets(self.pairing, self.u), segments.master, segments.xi_m),
        )
        x_s, x_m = (points_of(*side) for side in sides)
        N_s, N_m = (facets.element.shape_functions(xi) for facets, _, xi in sides)
        nodes, others = self.slave.facets[segments.slave], self.pairing.master_facets
        s = np.einsum("qj,qji->qi", Phi, given.tractions[nodes])[:, None]
        F, G = np.zeros((len(self.nodes), self.d)), np.zeros(own)
        np.add.at(F, nodes, N_s[:, :, None] * s)
        np.add.at(F, own + others[segments.master], -N_m[:, :, None] * s)
        gap = np.einsum("qji,qi->qj", given.normals[nodes], x_m - x_s)
        if self.smooth is not None:
            gap -= point_heights(self.pairing, segments, self.u, self.smooth)[:, None]
        np.add.at(G, nodes, Phi * gap)
        return F.ravel(), G

    def derivatives(self):
        """Return those of the forces and the weighted gaps by the coordinates of both sides."""
        segments, n = find_segments(self.pairing, self.u)
        at = self.pairing, self.u, segments, self.keep, self.given(n), self.smooth
        at = *at, self.sharing(segments)
        found, N = differentiate(*at), self.normals_by_nodes()
        F, G = self.d * len(self.nodes), len(n)
        return tuple(
            summed(by_x, (i, N.shape[1])) + summed([*by_n, *by_p], (i, len(N))) @ N
            for i, by_x, by_n, by_p in (
                (F, found.F_x, found.F_n, found.F_p),
                (G, found.G_x, found.G_n, found.G_p),
            )
        )

    def normals_by_nodes(self):
        """Return the derivatives (d own nodes, d nodes) of the averaged normals."""
        blocks, own = normal_derivatives(self.slave, coordinates(self.slave, self.u)), self.slave
        N = np.zeros((len(own.nodes), self.d, len(self.nodes), self.d))
        for f, nodes in enumerate(own.facets):
            for j, a in enumerate(nodes):
                for k, b in enumerate(nodes):
                    N[a, :, b] += blocks[f, j, :, k]
        return N.reshape(self.d * len(own.nodes), -1)

    def differences(self, directions=None):
        """Return the derivatives of forces and gaps by central differences, extrapolated.

        By the coordinates of all nodes, or along directions (.., nodes, d).
        """
        every = np.eye(self.d * len(self.nodes)).reshape(-1, len(self.nodes), self.d)
        columns = [
            (4 * self._difference(1e-5 * v) - self._difference(2e-5 * v) / 2) / 3e-5
            for v in (every if directions is None else directions)
        ]
        both = np.stack(columns, axis=1)
        return np.split(both, [self.d * len(self.nodes)])

    def _difference(self, moved):
        results, before = [], self.u.x.array.copy()
        for step in (moved, -moved):
            self.u.x.array.reshape(-1, self.d)[self.nodes] += step
            results.append(np.concatenate(self.forces_and_gaps()))
            self.u.x.array[:] = before
        return (results[0] - results[1]) / 2
