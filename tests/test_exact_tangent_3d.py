# SPDX-License-Identifier: MIT
"""The exact tangent of moving geometry in 3D: its derivatives, its rate, and when it is used."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem
from dolfinx_mortar.geometry import area
from dolfinx_mortar.geometry.facets import points_of
from dolfinx_mortar.mortar.curvature_correction import find_smooth_sides, point_heights
from dolfinx_mortar.mortar.derivatives import Tractions
from dolfinx_mortar.mortar.facet_derivatives import differentiate_in_space
from dolfinx_mortar.mortar.integrals import (
    default_keep,
    find_segments,
    node_weights,
    weighted_duals,
)
from dolfinx_mortar.mortar.pairing import create_pairing, received_facets
from dolfinx_mortar.mortar.surface import (
    coordinates,
    create_surface,
    facets_at,
    normal_derivatives,
)
from tests import meshes_3d

COMM = MPI.COMM_SELF


class Rough:
    """Two rough, bent sides, with random tractions."""

    def __init__(self, cell, n_lower, n_upper, *, upper, seed, smooth=False):
        """Create them; the slave is the upper side of the lower box."""
        rng = np.random.default_rng(seed)
        mesh, _, facets = meshes_3d.two_boxes(
            COMM, (*n_lower, 1), (*n_upper, 1), upper=upper, cell=cell, jitter=0.2, seed=seed
        )
        V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
        self.u, X = fem.Function(V), V.tabulate_dof_coordinates()
        self.u.x.array[:] = 0.03 * rng.standard_normal(self.u.x.array.size)
        self.u.x.array[2::3] -= 0.2 * (X[:, 0] - 0.4) ** 2 - 0.1 * X[:, 0] * X[:, 1]
        tags = (meshes_3d.TOP_OF_LOWER, "slave"), (meshes_3d.BOTTOM_OF_UPPER, "master")
        self.slave, self.master = (create_surface(V, facets, *tag) for tag in tags)
        self.pairing = create_pairing(V, self.slave, self.master, self.u)
        self.smooth = None
        if smooth:
            found = find_smooth_sides(self.pairing, np.zeros(X.shape, dtype=bool), 40.0)
            a, b = (replace(s, sagitta=rng.uniform(0.02, 0.05, s.sagitta.shape)) for s in found)
            self.smooth = a, b
        self.values = rng.uniform(0.5, 1.0, (2, len(self.slave.nodes)))
        segments, _ = find_segments(self.pairing, self.u)
        self.keep = default_keep(self.pairing, segments, *node_weights(self.pairing, segments))
        self.nodes = np.concatenate([self.slave.nodes, self.pairing.master_nodes])
        self.turn = meshes_3d.rotation((1.0, 2.0, 3.0), 0.7)

    def given(self, n):
        """Return normals and tractions for averaged normals."""
        k, (a, b) = self.keep[:, None], self.values[:, :, None]
        one = np.broadcast_to(np.eye(3), (len(n), 3, 3)) * k[:, None]
        changes = a[..., None] * one + b[..., None] * self.turn @ one
        return Tractions(k * n, one, k * (a * n + b * n @ self.turn.T), changes)

    def forces_and_gaps(self):
        """Return the forces on all nodes and the weighted gaps."""
        segments, n = find_segments(self.pairing, self.u)
        given, own = self.given(n), len(self.slave.nodes)
        Phi = weighted_duals(self.pairing, segments, self.keep)
        sides = (
            (facets_at(self.slave, coordinates(self.slave, self.u)), segments.slave, segments.xi_s),
            (received_facets(self.pairing, self.u), segments.master, segments.xi_m),
        )
        x_s, x_m = (points_of(*side) for side in sides)
        N_s, N_m = (facets.element.shape_functions(xi) for facets, _, xi in sides)
        nodes, others = self.slave.facets[segments.slave], self.pairing.master_facets
        s = np.einsum("qj,qji->qi", Phi, given.tractions[nodes])[:, None]
        F, G = np.zeros((len(self.nodes), 3)), np.zeros(own)
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
        Phi = weighted_duals(self.pairing, segments, self.keep)
        at = self.pairing, self.u, segments, self.keep, Phi
        found = differentiate_in_space(*at, self.given(n), self.smooth)
        blocks, own = normal_derivatives(self.slave, coordinates(self.slave, self.u)), len(n)
        N = np.zeros((own, 3, len(self.nodes), 3))
        for f, nodes in enumerate(self.slave.facets):
            for j, a in enumerate(nodes):
                for k, b in enumerate(nodes):
                    N[a, :, b] += blocks[f, j, :, k]
        N = N.reshape(3 * own, -1)
        return found.F_x + found.F_n @ N, found.G_x + found.G_n @ N

    def differences(self):
        """Return them by central differences, extrapolated."""
        columns = []
        for node in self.nodes:
            for i in range(3):
                columns.append(
                    (4 * self._difference(node, i, 1e-5) - self._difference(node, i, 2e-5)) / 3
                )
        both = np.stack(columns, axis=1)
        return np.split(both, [3 * len(self.nodes)])

    def _difference(self, node, i, h):
        results = []
        for step in (h, -h):
            before = self.u.x.array[3 * node + i]
            self.u.x.array[3 * node + i] += step
            results.append(np.concatenate(self.forces_and_gaps()))
            self.u.x.array[3 * node + i] = before
        return (results[0] - results[1]) / (2 * h)


def errors(rough):
    """Return the errors of the derivatives, over the largest entries."""
    both = zip(rough.derivatives(), rough.differences(), strict=True)
    return [np.abs(found - expected).max() / np.abs(expected).max() for found, expected in both]


UNDER = (-0.5, 1.6, -0.5, 1.5)
PARTLY = (0.2, 1.3, -0.1, 0.7)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("upper", [UNDER, PARTLY])
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_of_one_pair(cell, upper, seed):
    """Of one facet (two triangles) a side, which lies under the master or reaches beyond it."""
    rough = Rough(cell, (1, 1), (1, 1), upper=upper, seed=seed)
    assert max(errors(rough)) < 1e-8


@pytest.mark.parametrize("upper", [UNDER, PARTLY])
def test_derivatives_of_smooth_heights(upper, monkeypatch):
    """Of one pair: between two master facets heights jump. With integrals that are accurate."""
    monkeypatch.setattr(area, "_least_degree", lambda slave, master: 12)
    rough = Rough("hexahedron", (1, 1), (1, 1), upper=upper, seed=3, smooth=True)
    assert max(errors(rough)) < 1e-8


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_derivatives_are_those_of_forces_and_gaps(cell):
    """Of random tractions on sides that cover each other in part; to 1e-8 of the largest entry."""
    rough = Rough(cell, (3, 3), (2, 3), upper=PARTLY, seed=3)
    assert 0 < rough.keep.sum() < len(rough.keep)
    assert max(errors(rough)) < 1e-8
