# SPDX-License-Identifier: MIT
"""Blocks whose whole skins are in contact, and the errors of the exact tangent at their edges."""

from contextlib import contextmanager
from dataclasses import replace

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar import compat
from dolfinx_mortar.geometry import area
from dolfinx_mortar.interfaces import mortar_interface
from dolfinx_mortar.mortar import integrals
from dolfinx_mortar.mortar.edges import find_sharing
from dolfinx_mortar.mortar.surface import accumulate
from tests import meshes


def begin(mesh, cells, facets, degree, slave, master, **options):
    """Return a problem of two blocks in a third step, with friction, and what it begins with."""
    d = mesh.geometry.dim
    V = fem.functionspace(mesh, ("Lagrange", degree, (d,)))
    top, bcs = fem.Constant(mesh, np.zeros(d)), []
    for tag, value in ((meshes.BOTTOM, np.zeros(d)), (meshes.TOP, top)):
        bcs.append(
            fem.dirichletbc(value, fem.locate_dofs_topological(V, d - 1, facets.find(tag)), V)
        )
    tags = meshes.skins(mesh, cells, facets)
    contact = dm.Contact(tags, slave=slave, master=master, friction=0.3, **options)
    solid = dm.Solid(fem.Function(V), dm.Elastic(1000.0, 0.3))
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="updated")
    across = np.array([0.003, 0.002])[: d - 1]
    for push in ((*(0.0 * across), -0.01), (*across, -0.02)):
        top.value[:] = push
        dm.newton(problem)
        problem.commit()
    top.value[:] = (*(3 * across), -0.02)
    return problem, problem.begin_step()


@contextmanager
def linear_normals(problem):
    """Let the normals of contact change as the exact tangent at the present displacement says.

    It leaves out what other parts of M and other spreads change.
    """
    (link,), u = problem.system.unilateral, problem.owned_u
    derivatives, start = link.interface.derivatives(link), u.copy()
    derivatives.differentiate(link, problem.u, np.ones(problem.n), None)  # all facets are loaded
    C, n = derivatives.normals.zero().copy(), link.coupling.common.n

    def changed(*arguments):
        turned = (C * problem.vector(u - start)).array_r.reshape(-1, n.shape[1])
        return replace(found(*arguments), n=n + turned[link.nodes])

    found = mortar_interface.common_normals
    mortar_interface.common_normals = changed
    try:
        yield
    finally:
        mortar_interface.common_normals = found


def integrate_accurately(monkeypatch):
    """Integrate in space with many points: derivatives are those of integrals, by fewer points."""
    monkeypatch.setattr(area, "_least_degree", lambda slave, master: 20)
    monkeypatch.setattr(area, "_degree_of_moments", lambda slave, master, smooth: 20)


def count_all_parts(monkeypatch):
    """Let what stands back count in full: the exact tangent takes its factors as constants."""
    monkeypatch.setattr(integrals, "_near_parts", lambda pairing, segments, *sides: segments)


def wavy(X, phase):
    """Return vectors at points (n, 3), the same on all ranks."""
    parts = [np.sin(X @ np.array(k) + phase + i) for i, k in enumerate([(9, 7, 5), (5, 9, 8)])]
    return np.stack([parts[0], parts[1], parts[0] * parts[1]], axis=1)


def raise_upper(problem, by):
    """Move the upper block up, so that it is open: what is shared out depends on how far."""
    V, d = problem.V, problem.d
    x = V.mesh.geometry.x[compat.cell_nodes(V.mesh)].mean(axis=1)
    nodes = np.unique(V.dofmap.list[x[:, d - 1] > 0.0])
    problem.owned_u.reshape(-1, d)[nodes[nodes < problem.n], d - 1] += by


class Tangent:
    """The tangent at a displacement far from balance, beside differences."""

    def __init__(self, problem, data, noise=1e-4):
        """Compare forces, weighted gaps and slips along a direction; all terms count."""
        self.problem, self.data, self.X = problem, data, problem.V.tabulate_dof_coordinates()
        self.d, u = problem.d, problem.owned_u
        u += noise * self._field(0.0).reshape(u.shape)
        self.start, du = u.copy(), self._field(2.0).reshape(u.shape)
        self.multipliers, self.tangential = 0.75 + 0.25 * self._field(1.0)[:, 0], self._field(3.0)
        link, *_ = self._at(0.0 * du)
        self.tangential[link.nodes] = self._across(link)
        with linear_normals(problem):
            steps = [self._difference(h, du) for h in (1e-5, 2e-5)]
        forces, gaps, slips = ((4 * a - b) / 3 for a, b in zip(*steps, strict=True))
        self.link, since, *_ = self._at(0.0 * du)
        coupling, known = self.link.coupling, data.partners[0].known
        slips = np.einsum("nij,ni->nj", coupling.R[:, :, 1:], slips)
        given, du = (self.multipliers, self.tangential, (since, data.partners)), problem.vector(du)
        tangent = problem.system.linearise_geometry(problem.u, *given)
        kept, closing = coupling.kept[:, 0] & self.link.near, tangent.closing(du)
        closing = closing.reshape(-1, self.d)[self.link.nodes]
        found = (tangent.forces[0] * du).array_r.reshape(-1, self.d)
        self.errors = [
            self._error(found, forces),
            self._error(closing[kept, 0] * coupling.weight[kept, 0], -gaps[kept]),
            self._error(closing[kept & known, 1:], slips[kept & known]),
        ]
        self.on_edges = problem.comm.allreduce(
            int((kept & self.link.sides.edges[: len(kept)]).sum())
        )

    def _field(self, phase):
        return wavy(self.X[: self.problem.n], phase)[:, : self.d]

    def _across(self, link):
        n, v = link.coupling.normals, self.tangential[link.nodes]
        return v - (v * n).sum(axis=1)[:, None] * n

    def _at(self, step):
        problem = self.problem
        u = problem.owned_u
        u[:] = self.start + step
        problem.u.x.scatter_forward()
        problem.follow_geometry()
        (link,) = problem.system.unilateral
        weight, lam = link.coupling.weight[:, :1], self.multipliers[link.nodes, None]
        along = lam * link.coupling.normals + self._across(link)
        since = problem.vector(u - problem.committed.displacement)
        slip = self.data.partners[0].slip(link, since)[:, 1:]
        slip = np.einsum("nij,nj->ni", link.coupling.R[:, :, 1:], slip)  # as a vector
        forces = np.add(*link.transpose(weight * along))
        return link, since, forces, weight[:, 0] * link.gaps(problem.positions()), slip

    def _difference(self, h, du):
        above, below = self._at(h * du)[2:], self._at(-h * du)[2:]
        return [(a - b) / (2 * h) for a, b in zip(above, below, strict=True)]

    def _error(self, found, expected):
        """Return the largest error over the largest entry, of all ranks."""
        most = [np.abs(v).max(initial=0.0) for v in (found - expected, expected)]
        error, size = (self.problem.comm.allreduce(v, op=MPI.MAX) for v in most)
        return error / size

    def open_in_part(self):
        """Return how many facets share out functions in part; collective."""
        slave, coupling = self.link.sides.slave, self.link.coupling
        kept = np.zeros((len(slave.nodes), 1))
        kept[: slave.owned, 0] = coupling.kept[:, 0]
        keep = accumulate(slave, kept)[:, 0] > 0.0
        at = self.link.pairing, coupling.operators.segments, self.problem.u, keep
        sharing = find_sharing(*at, self.link.sides.edges, self.link.banned[slave.nodes])
        assert sharing is not None
        return self.problem.comm.allreduce(
            int(((sharing.closed > 0.0) & (sharing.closed < 1.0)).sum())
        )
