# SPDX-License-Identifier: MIT
r"""A side of a body that moves as a rigid body, as if a rigid plate were glued to it.

At its nodes u is that of the plate, with its point c at the start, the displacement t of that
point and the rotation R,

    u_j = t + R (X_j - c) - (X_j - c);    where strains are small  u_j = t + theta x (X_j - c).

t and R are prescribed, or unknown where the force or moment along them is given: then the forces
f_j with which the plate holds the nodes are in balance with it, sum_j f_j = F and
sum_j R (X_j - c) x f_j = M, see `newton_method.driven_tools`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.arrays import TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import tributary_weights
from dolfinx_mortar.interfaces.coupling import Coupling, Pattern, Sides
from dolfinx_mortar.interfaces.interface import Interface, full_coverage
from dolfinx_mortar.interfaces.tool import Load, Movable, Pose, RigidBody, check_point, spun
from dolfinx_mortar.mortar.pairing import Pairing, Weight
from dolfinx_mortar.mortar.surface import coordinates, facets_at, nodal_normals, sum_at_nodes


class Plate(RigidBody):
    """What is glued to a side.

    Attributes:
        small: whether rotations are those of a small strain, which add up.
    """

    holds = True

    def __init__(self, point: Floats) -> None:
        super().__init__(point)
        self.small = True

    def ahead(self, amounts: Floats) -> Floats:
        """Return the travel (3,) or (6,) with amounts (m,) of the driven motions added."""
        return self.travel + self.steps(amounts) if self.small else super().ahead(amounts)

    def turned(self, arm: Floats, rotation: Floats) -> Floats:
        """Return arms (n, d) turned by a rotation, in the first order where strains are small."""
        if not self.small:
            origin = np.zeros(len(self.point))
            return Pose(origin, rotation, origin).to_space(arm)
        return arm + spun(arm, rotation)

    def place(self) -> Floats:
        """Return where its point is (d,): at the start where strains are small."""
        return self.point if self.small else super().place()

    def moved(self, X: Floats, travel: Floats | None = None) -> Floats:
        """Return where points (n, d) of the plate are that started at X, at present or ahead."""
        travel = self.travel if travel is None else travel
        pose, d = self.pose(travel), len(self.point)
        rotation: Floats = np.array(self.rotation.value, dtype=np.float64).reshape(-1)
        rotation = rotation + travel[d:] if self.small else pose.rotation
        return np.asarray(self.turned(X - self.point, rotation) + pose.position)

    def curve(self, X: Floats, amounts: Floats) -> Floats:
        """Return by how much a motion ends beside its tangent (n, d), see `Driven`."""
        if self.small:
            return np.zeros_like(X)
        way = np.tensordot(amounts, self.motions(X, X, np.zeros_like(amounts)), 1)
        return self.moved(X, self.ahead(amounts)) - self.moved(X) - way

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """Return what one unit of each driven motion (m, n, d) does, see `Driven`."""
        arm = X - self.point
        if not self.small:
            arm = self.turned(arm, self.pose().rotation)
            arm = arm + spun(arm, self.steps(moved)[len(self.point) :])
        return self.along(arm)


class RigidSide(Movable, Interface):
    """A side that moves as a rigid body: clamped, moved and turned, or driven by force and moment.

    Its point c = ``reference`` is at ``position`` = c + t, and it is turned by ``rotation`` about
    it (an angle in the plane, a rotation vector in space; radians): both are Constants, whose
    values ``ramp`` and ``on_time`` of `load_steps` may set, and which are read in every step. At
    its nodes, with the rotation matrix R or the rotation vector theta,

        u_j = t + R (X_j - c) - (X_j - c)      at finite strain,
        u_j = t + theta x (X_j - c)            at small strain.

    After a step ``force`` is the force with which the side is held, ``reference_moment`` the moment
    of that about the point where it is now, ``pressure`` its normal traction, and ``travel`` how
    far loads have moved it. Nodes belong to it alone: it shares none with Dirichlet conditions, nor
    with the slave side of another interface, but may be the master of one.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        side: tag of the side, or its name, see `Tags`.
        reference: d coordinates of the point about which it turns, at the start.
        load: forces and moments that are given instead of its motion, by name: "x", "y" and
            "moment" about its point in the plane, "x", "y", "z", "moment x" to "moment z" in space,
            "y" in axisymmetric problems, each a number or a scalar Constant, read at every step; 0
            leaves a motion free. Other motions are prescribed by position and rotation.

    Raises:
        ValueError: for tags that are none, unknown names, a point or loads that are none. When a
            problem takes it, for a side without facets, and one that shares nodes with Dirichlet
            conditions or with an interface that is named before it.
    """

    rigid: Plate

    def __init__(
        self,
        facet_tags: MeshTags,
        side: int | str,
        *,
        reference: Any,
        load: Mapping[str, Load] | None = None,
    ) -> None:
        super().__init__(facet_tags, slave=side)
        self.rigid = Plate(check_point(reference, facet_tags.topology.dim))
        self.load = load or {}

    def __repr__(self) -> str:
        return super().__repr__().replace("slave=", "", 1)

    def given(self) -> dict[str, Any]:
        """Return what all ranks have to give the same, by name; see `agreement`."""
        return super().given() | self.rigid.given()

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Take note of the kinematics: forces act at X where strains are small."""
        self.rigid.revolved, self.rigid.small = revolved, strain == "small"
        self.stays = self.rigid.small

    # -- nodes -----------------------------------------------------------------------------------

    def find_sides(self, V: fem.FunctionSpace, fixed: Bools, weight: Weight | None = None) -> Sides:
        """Return the surface in V; collective.

        Raises:
            ValueError: on all ranks, if Dirichlet conditions hold some of its nodes.
        """
        sides = super().find_sides(V, fixed, weight)
        free = 1 if self.rigid.revolved else 0  # on the axis u_r = 0, as on the side
        held = np.asarray(fixed[sides.nodes][:, free:].any(axis=1))
        self._refuse(sides, held, "Dirichlet conditions hold", "of the two")
        return sides

    def couple(
        self,
        sides: Sides,
        pairing: Pairing | None,
        pattern: Pattern,
        banned: Bools,
        u: fem.Function | None,
    ) -> Coupling:
        """Return that all nodes are held in all directions, see `Interface.couple`; collective."""
        self._refuse(sides, banned[sides.nodes], "an earlier interface has", "of the two")
        slave, n, d = sides.slave, len(sides.nodes), sides.fixed.shape[1]
        x = coordinates(slave, u)
        areas = tributary_weights(facets_at(slave, x)).mean(axis=1)  # equal parts, none is zero
        if sides.weight is not None:
            areas = areas * sides.weight(slave.X[slave.facets].mean(axis=1))
        areas = np.repeat(areas[:, None, None], slave.facets.shape[1], axis=1)
        areas = sum_at_nodes(slave, areas)[: slave.owned]
        fixed = sides.fixed[sides.nodes]
        return Coupling(
            blocks=np.zeros((0, d, d)),
            P=np.zeros((0, 1)),
            R=np.broadcast_to(np.eye(d), (n, d, d)),
            slot=np.where(fixed, np.arange(d, dtype=np.int32), -1).astype(np.int32),
            directions=~fixed,
            kept=np.ones((n, 1), dtype=bool),
            weight=np.maximum(areas, TINY),
            normals=nodal_normals(slave, x)[: slave.owned],
            heights=np.zeros(n),
            coverage=full_coverage(sides),
        )

    def _refuse(self, sides: Sides, wrong: Bools, who: str, whose: str) -> None:
        """Raise a ValueError if some owned nodes (n,) are another's; collective."""
        count = int(sides.V.mesh.comm.allreduce(int(wrong.sum()), op=MPI.SUM))
        if count:
            raise ValueError(
                f"{self!r}: {who} {count} of its nodes, but all nodes of a RigidSide move with it: "
                f"remove one {whose} there"
            )

    def apart(self, V: fem.FunctionSpace, nodes: Ints) -> Floats:
        """Return the displacement of the plate (n, d) at the nodes."""
        X = V.tabulate_dof_coordinates()[nodes, : len(self.reference)]
        return self.rigid.moved(X) - X

    @property
    def reference_moment(self) -> Floats:
        """Moment (3,) about its point of the forces that hold it; the last component in a plane."""
        return self._about_place(self.moment, self.force)
