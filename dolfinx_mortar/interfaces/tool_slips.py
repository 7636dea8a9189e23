# SPDX-License-Identifier: MIT
r"""Slip along a rigid tool that moves, along arcs of its surface.

A node is on the tool at the point nearest to it at the last commit, with the normal n_0 into the
tool. That point moves with the tool, to y, and n_0 with it; now the node is nearest to the point z,
with the normal n. Of the chord d = z - y the part along which n differs from n_0 is that of an arc
that turns by their angle b, longer by f = (b/2) / sin(b/2), and ends at z. With c = n_0.n,
h = |n_0 + n| and tangents t at z, the slip is

    t.(d - B n_0),   B = d.(n + n_0) / h^2 + K d.(n - n_0),
    K = (f - 1) / (2 - 2 c) + f / (h (2 + h)).

It is exact on cylinders and spheres up to half a turn, along and about them, on planes the chord
itself; where node and tool move alike there is none, whatever the motion. About the normal a tool
may turn, too: there the chord is taken.

On frozen surfaces it is the displacement since, less the way of the tool past X: by its turn theta
and the way s of its point, which is at p in the middle, s + theta x (X - p).
"""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import HALF_OF_DIGITS, TINY, Floats
from dolfinx_mortar.interfaces.coupling import CoupledSides
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import Pose, Tool, spun, turn_between


@dataclass(frozen=True)
class ToolPartners(Partners):
    """Partners on a tool: P is zero, and the motion that of the node less that of its place."""

    at: Floats  # (n, d) where the nodes were, X on frozen surfaces
    place: Floats  # (n, d) the points of the tool on which they were, as it starts
    into: Floats  # (n, d) the normals there, into the tool as it starts
    tool: Tool
    began: Pose
    frozen: bool

    @classmethod
    def create(
        cls, link: CoupledSides, x: PETSc.Vec, tool: Tool, began: Pose, *, frozen: bool
    ) -> ToolPartners:
        """Return the partners of a link; collective.

        Args:
            x: (n,) positions at the last commit.
            tool: which may move in the step.
            began: where it was at the last commit.
            frozen: whether the surfaces stay at X.
        """
        n, scalars = link.coupling.normals, link.pattern.scalars
        scalars.fill(np.zeros((len(link.coupling.P), 1, 1)))
        at = x.array_r.reshape(-1, n.shape[1])[link.nodes]
        if frozen:
            at = link.sides.slave.X[: link.sides.slave.owned]
        place = began.to_tool(at)
        with raised_together(link.sides.V.mesh.comm):
            found = tool.asked.distance(place)
        known = np.ones(len(n), dtype=bool)
        whole = scalars.matrix.copy(), known, n, np.zeros(len(n)), 0.0 * n
        return cls(
            *whole,
            at=at,
            place=place - found.value[:, None] * found.gradient,
            into=-found.gradient,
            tool=tool,
            began=began,
            frozen=frozen,
        )

    def completed(self, link: CoupledSides, other: Partners) -> Partners:
        """Return these: all nodes have a place on the tool."""
        return self

    def motion(self, link: CoupledSides, moved: PETSc.Vec) -> Floats:
        """Return the motion (n, d) for the displacement since the last commit."""
        moved = moved.array_r.reshape(-1, self.at.shape[1])[link.nodes]
        now = self.tool.pose()
        if self.frozen:
            middle = (now.position + self.began.position) / 2
            way = spun(self.at - middle, turn_between(self.began, now))
            return np.asarray(moved - way - (now.position - self.began.position))
        arcs = self._arcs(link, self.at + moved)
        return np.asarray(arcs.motion - arcs.lift[:, None] * arcs.end)

    def derivatives(self, link: CoupledSides, moved: PETSc.Vec) -> tuple[Floats, Floats]:
        """Return those (n, d, d) of the motion by x_j, and by n, but for parts along n."""
        x = self.at + moved.array_r.reshape(-1, self.at.shape[1])[link.nodes]
        arcs, found = self._arcs(link, x), self.tool.pose().distance(self.tool.asked, x)
        g = found.gradient
        across = np.eye(x.shape[1]) - g[:, :, None] * g[:, None]
        across -= found.value[:, None, None] * found.hessian
        by_chord = np.eye(x.shape[1]) - arcs.start[:, :, None] * arcs.B_by_chord[:, None]
        by_n = -arcs.start[:, :, None] * arcs.B_by_end[:, None]
        by_n -= arcs.lift[:, None, None] * np.eye(x.shape[1])
        return by_chord @ across, by_n

    def _arcs(self, link: CoupledSides, x: Floats) -> _Arcs:
        """Return the arcs to nodes that are at x (n, d)."""
        now = self.tool.pose()
        found, end = now.distance(self.tool.asked, x), link.coupling.normals
        foot = x - found.value[:, None] * found.gradient
        return _Arcs(foot - now.to_space(self.place), self.into @ now.R.T, end)


class _Arcs:
    """Arcs of a surface from their chords and the normals at their ends."""

    def __init__(self, chord: Floats, start: Floats, end: Floats) -> None:
        """Take the chords d (n, d) and the unit normals n_0 and n (n, d)."""
        self.chord, self.start, self.end = chord, start, end
        both, apart = end + start, end - start
        h, w = np.linalg.norm(both, axis=1), np.linalg.norm(apart, axis=1)
        h = np.maximum(h, HALF_OF_DIGITS)  # of half a turn the way is not known
        half = np.arctan2(w, h)
        straight = w**2 <= HALF_OF_DIGITS  # the limits of what follows
        z = np.where(straight, 1.0, w**2)
        f = np.where(straight, 1.0, half / np.maximum(w / 2, TINY))
        f_c = np.where(straight, -1 / 12, (f - 2 / h) / z)
        G = np.where(straight, 1 / 24, (f - 1) / z)
        G_c = np.where(straight, -3 / 320, (f_c + 2 * G) / z)
        K = G + f / (h * (2 + h))
        K_c = G_c + f_c / (h * (2 + h)) - f * (2 + 2 * h) / h / (h * (2 + h)) ** 2
        e, q = (chord * both).sum(axis=1), (chord * apart).sum(axis=1)
        self.motion = chord - (e / h**2 + K * q)[:, None] * start
        self.lift = (self.motion * end).sum(axis=1)  # of it along n
        self.B_by_chord = both / h[:, None] ** 2 + K[:, None] * apart
        by_c = q * K_c - 2 * e / h**4
        self.B_by_end = (1 / h**2 + K)[:, None] * chord + by_c[:, None] * start
