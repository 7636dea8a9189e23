# SPDX-License-Identifier: MIT
"""Slip in a step, relative to the master points (partners) at the last commit.

The tangential distance of a node and its partner must not slip in rigid rotations: in the plane it
turns with the normal; in space, where it may spin, the slave side carries it.
On a moving rigid tool slips are along arcs of its surface. The nearest point of the tool at the
last commit moves with it to y, its normal (into the tool) to n_0; the nearest point is now z, with
the normal n. With d = z - y, c = n_0.n, h = |n_0 + n|, the angle b between n_0 and n, f = (b/2) /
sin(b/2), and tangents t at z, the slip is

    t.(d - B n_0),   B = d.(n + n_0) / h^2 + K d.(n - n_0),
    K = (f - 1) / (2 - 2 c) + f / (h (2 + h)),

exact on planes, cylinders and spheres up to half a turn, and zero in common motions. With frozen
geometry the tool's motion at X is s + theta x (X - p), with rotation theta, translation s of its
point, and p the middle of its path.
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.csr import Triplets
from dolfinx_mortar.common.arrays import EPS, HALF_OF_DIGITS, Bools, Floats
from dolfinx_mortar.interfaces.coupling import CoupledSides, node_motions
from dolfinx_mortar.interfaces.tool import Pose, Tool, spun, turn_between
from dolfinx_mortar.mortar.surface import accumulate
from dolfinx_mortar.mortar.tangent import carrying


@dataclass(frozen=True)
class Partners:
    """P of a contact and its distances at the start of a step."""

    P: PETSc.Mat  # (nodes, nodes) between nodes, scalar
    known: Bools  # (n,) that face the master
    normals: Floats  # (n, d) unit normals at the start
    apart: Floats  # (n,) n.(x_j - P x)
    along: Floats  # (n, d) tangential part of x_j - P x, in the plane

    def completed(self, link: CoupledSides, other: Partners) -> Partners:
        """These, with the others at nodes without a partner; collective."""
        P, only = self.P.copy(), other.P.copy()
        for matrix, nodes in ((P, ~self.known), (only, self.known)):
            keep = matrix.createVecLeft()
            keep.array[:] = 1.0
            keep.array[link.nodes[nodes]] = 0.0
            matrix.diagonalScale(keep)
        P.axpy(1.0, only, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        here = self.known[:, None]
        return Partners(
            P,
            self.known | other.known,
            np.where(here, self.normals, other.normals),
            np.where(self.known, self.apart, other.apart),
            np.where(here, self.along, other.along),
        )

    def motion(self, link: CoupledSides, moved: PETSc.Vec) -> Floats:
        """Return x_j - P x minus its tangential part at the commit, turned with n; collective."""
        both = self.normals + link.coupling.normals
        cosine = (self.normals * link.coupling.normals).sum(axis=1)
        tilt = (self.along * link.coupling.normals).sum(axis=1) / np.maximum(1.0 + cosine, EPS)
        whole = node_motions(link, self.P, moved) + self.apart[:, None] * self.normals
        return whole + tilt[:, None] * both

    def derivatives(self, link: CoupledSides, moved: PETSc.Vec) -> tuple[Floats, Floats]:
        """Derivatives (n, d, d) of the motion by that of x_j - P x and by n, along tangents."""
        n, d = self.normals.shape
        one = np.tile(np.eye(d), (n, 1, 1))
        return one, 0.0 * one

    def slip(self, link: CoupledSides, moved: PETSc.Vec) -> Floats:
        """Motion (n, d) by ``moved``, in present frames; collective."""
        in_frames = np.einsum("nij,nj->ni", link.coupling.rows, self.motion(link, moved))
        return np.where(self.known[:, None], in_frames, link.relative(moved))


def partners_on_master(link: CoupledSides, x: PETSc.Vec) -> Partners:
    """Partners in the present configuration, x (n,) at the last commit; collective."""
    scalars, coupling = link.pattern.scalars, link.coupling
    scalars.fill(coupling.P[:, 0, None, None])
    P = scalars.matrix.copy()
    apart, along = _distances(link, P, x)
    if along.shape[1] > 2:
        P.axpy(1.0, _carried(link, x, along), PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        apart, along = _distances(link, P, x)[0], np.zeros_like(along)
    return Partners(P, coupling.kept[:, 0], coupling.normals, apart, along)


def _distances(link: CoupledSides, P: PETSc.Mat, x: PETSc.Vec) -> tuple[Floats, Floats]:
    distance, normals = node_motions(link, P, x), link.coupling.normals
    apart = np.einsum("ni,ni->n", distance, normals)
    return apart, distance - apart[:, None] * normals


def _carried(link: CoupledSides, x: PETSc.Vec, along: Floats) -> PETSc.Mat:
    """Slave matrix W, W x = ``along`` (n, d) up to normal parts; collective."""
    slave, index_map = link.sides.slave, link.sides.V.dofmap.index_map
    d, kept = along.shape[1], link.coupling.kept[:, :1]
    columns = np.zeros((len(slave.nodes), 3 * d))
    columns[: slave.owned, :d] = x.array_r.reshape(-1, d)[link.nodes]
    columns[: slave.owned, d:] = np.hstack([link.coupling.normals, along]) * kept
    W = carrying(slave, *np.split(accumulate(slave, columns), 3, axis=1))
    nodes = index_map.local_to_global(slave.nodes).astype(np.int64)[slave.facets]
    rows, others = (np.broadcast_to(v, W.shape) for v in (nodes[:, :, None], nodes[:, None]))
    return Triplets(slave.V.mesh.comm, index_map, rows, others).fill(W)


@dataclass(frozen=True)
class ToolPartners(Partners):
    """Partners on a tool, with P = 0."""

    at: Floats  # (n, d) positions at the last commit, X if frozen
    place: Floats  # (n, d) nearest, in the tool's initial position
    into: Floats  # (n, d) normals there, into the tool
    tool: Tool
    began: Pose
    frozen: bool

    @classmethod
    def create(cls, link: CoupledSides, x: PETSc.Vec, tool: Tool, *, frozen: bool) -> ToolPartners:
        """Partners of a link, x (n,) at the last commit; collective."""
        n, scalars = link.coupling.normals, link.pattern.scalars
        scalars.fill(np.zeros((len(link.coupling.P), 1, 1)))
        at = x.array_r.reshape(-1, n.shape[1])[link.nodes]
        if frozen:
            at = link.sides.slave.X[: link.sides.slave.owned]
        began, found = tool.began, tool.distance(at, tool.began)
        known = np.ones(len(n), dtype=bool)
        whole = scalars.matrix.copy(), known, n, np.zeros(len(n)), 0.0 * n
        return cls(
            *whole,
            at=at,
            place=began.to_tool(at - found.value[:, None] * found.gradient),
            into=-found.gradient @ began.R,
            tool=tool,
            began=began,
            frozen=frozen,
        )

    def completed(self, link: CoupledSides, other: Partners) -> Partners:
        """See `Partners`: none is missing."""
        return self

    def motion(self, link: CoupledSides, moved: PETSc.Vec) -> Floats:
        """Motion (n, d) for the displacement since the last commit."""
        moved = moved.array_r.reshape(-1, self.at.shape[1])[link.nodes]
        now = self.tool.pose()
        if self.frozen:
            middle = (now.position + self.began.position) / 2
            way = spun(self.at - middle, turn_between(self.began, now))
            return moved - way - (now.position - self.began.position)
        chord, start, end = self._arcs(link, self.at + moved)
        motion = chord - _rise(chord, start, end)[:, None] * start
        return motion - (motion * end).sum(axis=1)[:, None] * end

    def derivatives(self, link: CoupledSides, moved: PETSc.Vec) -> tuple[Floats, Floats]:
        """See `Partners`."""
        n, d = self.at.shape
        x = self.at + moved.array_r.reshape(-1, d)[link.nodes]
        (chord, start, end), found = self._arcs(link, x), self.tool.distance(x)
        g, step = found.gradient, 1e-30
        across = np.eye(d) - g[:, :, None] * g[:, None]
        across -= found.value[:, None, None] * found.hessian
        by_chord, by_end = np.zeros((2, n, d))
        for i, way in enumerate(step * 1j * np.eye(d)):
            by_chord[:, i] = _rise(chord + way, start, end).imag / step
            by_end[:, i] = _rise(chord, start, end + way).imag / step
        lift = ((chord - _rise(chord, start, end)[:, None] * start) * end).sum(axis=1)
        by_n = -start[:, :, None] * by_end[:, None] - lift[:, None, None] * np.eye(d)
        return (np.eye(d) - start[:, :, None] * by_chord[:, None]) @ across, by_n

    def _arcs(self, link: CoupledSides, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Chords d and normals n_0 and n of the surface below nodes at x; collective."""
        now, found = self.tool.pose(), self.tool.distance(x)
        foot = x - found.value[:, None] * found.gradient
        return foot - now.to_space(self.place), self.into @ now.R.T, link.coupling.normals


def _rise(chord: Floats, start: Floats, end: Floats) -> Floats:
    """B (n,), also of complex numbers for derivatives along unit normals."""
    both, apart = end + start, end - start
    z, h = (apart**2).sum(axis=1), np.sqrt((both**2).sum(axis=1))
    h = np.maximum(h, HALF_OF_DIGITS)  # undefined at half a turn
    straight = np.abs(z) <= HALF_OF_DIGITS
    w = np.sqrt(np.where(straight, 1.0, z))
    f = np.where(straight, 1 + z / 24, 2 * np.arctan(w / h) / w)
    K = np.where(straight, 1 / 24 + 3 / 640 * z, (f - 1) / w**2) + f / (h * (2 + h))
    return (chord * both).sum(axis=1) / h**2 + K * (chord * apart).sum(axis=1)
