# SPDX-License-Identifier: MIT
"""A side of a body glued to a rigid plate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.common.arguments import array, check
from dolfinx_mortar.common.arrays import TINY, Bools, Floats, Ints
from dolfinx_mortar.geometry.facets import tributary_weights
from dolfinx_mortar.interfaces.constraints import Force
from dolfinx_mortar.interfaces.coupling import Coupling, Pattern, Sides, create_coupling
from dolfinx_mortar.interfaces.interface import Interface, full_coverage
from dolfinx_mortar.interfaces.tool import Movable, RigidBody, spun
from dolfinx_mortar.mortar.pairing import Pairing, Weight
from dolfinx_mortar.mortar.surface import coordinates, facets_at, nodal_normals, sum_at_nodes


class Plate(RigidBody):
    """Rigid body glued to a side."""

    holds = True

    def curve(self, X: Floats, amounts: Floats) -> Floats:
        """Motion by amounts (m,) minus its linearisation (n, d) at X."""
        if self.linear:  # exactly: the first steps in time are as small as round-off
            return np.zeros_like(X)
        way = np.tensordot(amounts, self.motions(X, X, np.zeros_like(amounts)), 1)
        return self.pose(self.ahead(amounts)).to_space(X) - self.pose().to_space(X) - way

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """See `RigidBody`."""
        arm = X - self.point
        if not self.linear:
            arm = arm @ self.pose().R.T
            arm = arm + spun(arm, self.steps(moved)[len(self.point) :])
        return self.along(arm)


class RigidSide(Movable, Interface):
    """A side that moves as a rigid body: prescribed, or driven by force and moment.

    Its point c = ``reference`` is at ``position`` = c + t, turned by ``rotation`` about it (an
    angle in the plane, a rotation vector in space; radians): Constants, read in every step. With
    the rotation matrix R or vector theta

        u_j = t + R (X_j - c) - (X_j - c)      at finite strain,
        u_j = t + theta x (X_j - c)            at small strain.

    Results: ``force`` on the side, ``reference_moment`` about the present point, ``pressure``
    (normal traction), ``travel`` (motion by loads). Its nodes may have no Dirichlet conditions and
    belong to no other slave side, but may to a master.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        side: tag or name (see `Tags`) of the side.
        reference: d initial coordinates of its point.
        load: given forces and moments by name, as of `Obstacle`; 0 leaves a motion free. Other
            motions are prescribed.

    Raises:
        ValueError: for an invalid argument; from the problem, for such nodes or no facets.
    """

    rigid: Plate

    def __init__(
        self,
        facet_tags: MeshTags,
        side: int | str,
        *,
        reference: Any,
        load: Mapping[str, Force] | None = None,
    ) -> None:
        super().__init__(facet_tags, slave=side)
        d = facet_tags.topology.dim
        self.rigid = Plate(check("reference", reference, array((d,))))
        self.load = load or {}

    def __repr__(self) -> str:
        return super().__repr__().replace("slave=", "", 1)

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Set the kinematics: forces act at X at small strain."""
        self.rigid.revolved = revolved
        self.rigid.linear = self.stays = strain == "small"

    def find_sides(self, V: fem.FunctionSpace, fixed: Bools, weight: Weight | None = None) -> Sides:
        """Surface in V; a ValueError for nodes with Dirichlet conditions; collective."""
        sides = super().find_sides(V, fixed, weight)
        free = 1 if self.rigid.revolved else 0  # on the axis u_r = 0
        held = np.asarray(fixed[sides.nodes][:, free:].any(axis=1))
        self._refuse(sides, held, "Dirichlet conditions hold")
        return sides

    def couple(
        self,
        sides: Sides,
        pairing: Pairing | None,
        pattern: Pattern,
        banned: Bools,
        u: fem.Function | None,
    ) -> Coupling:
        """See `Interface.couple`: all directions are constrained; collective."""
        self._refuse(sides, banned[sides.nodes], "an earlier interface has")
        slave, n, d = sides.slave, len(sides.nodes), sides.fixed.shape[1]
        x = coordinates(slave, u)
        areas = tributary_weights(facets_at(slave, x)).mean(axis=1)  # none is zero
        if sides.weight is not None:
            areas = areas * sides.weight(slave.X[slave.facets].mean(axis=1))
        areas = np.repeat(areas[:, None, None], slave.facets.shape[1], axis=1)
        areas = sum_at_nodes(slave, areas)[: slave.owned]
        return create_coupling(
            pattern,
            np.zeros((0, d)),
            nodal_normals(slave, x)[: slave.owned],
            sides.fixed[sides.nodes],
            np.ones((n, d), dtype=bool),
            tangential=True,
            weight=np.tile(np.maximum(areas, TINY), d),
            heights=np.zeros(n),
            coverage=full_coverage(sides),
        )

    def _refuse(self, sides: Sides, wrong: Bools, who: str) -> None:
        count = int(sides.V.mesh.comm.allreduce(int(wrong.sum()), op=MPI.SUM))
        if count:
            raise ValueError(
                f"{self!r}: {who} {count} of its nodes, but all nodes of a RigidSide move with it: "
                "remove one of the two there"
            )

    def apart(self, V: fem.FunctionSpace, nodes: Ints) -> Floats:
        """Displacement of the plate (n, d) at the nodes."""
        X = V.tabulate_dof_coordinates()[nodes, : len(self.reference)]
        return self.rigid.pose().to_space(X) - X

    @property
    def reference_moment(self) -> Floats:
        """Moment (3,) on the side about its point; in the plane the last component."""
        return self._about_place(self.moment, self.force)
