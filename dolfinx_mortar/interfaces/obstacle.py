# SPDX-License-Identifier: MIT
"""Unilateral contact of a side with a rigid tool without a mesh.

Multipliers exert the forces -D_jl lambda_j n_j, n_j = -grad phi(x_j), on the nodes l of the side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import any_rank, raised_together
from dolfinx_mortar.common.arguments import check_optional
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, TINY, Bools, Floats, place
from dolfinx_mortar.interfaces.constraints import Force, Limit, create_law
from dolfinx_mortar.interfaces.contact import SURFACES, Unilateral
from dolfinx_mortar.interfaces.coupling import (
    CoupledSides,
    Coupling,
    Pattern,
    Sides,
    create_coupling,
    create_pattern,
    free_directions,
    on_facets,
)
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.interfaces.tool import (
    Movable,
    SidePattern,
    Tool,
    find_facing,
    point_gaps,
)
from dolfinx_mortar.interfaces.wear import Archard
from dolfinx_mortar.mortar.curvature_correction import find_smooth_side
from dolfinx_mortar.mortar.duals import Coverage
from dolfinx_mortar.mortar.operators import create_whole_side, integrate_side, mean_values
from dolfinx_mortar.mortar.pairing import Pairing
from dolfinx_mortar.mortar.surface import (
    coordinates,
    mean_facet_length,
)
from dolfinx_mortar.shapes import Distance, Shape

# Largest | |grad phi| - 1 | within a facet of the surface, the error of forces and gaps.
NO_DISTANCE = 0.1
# Reach of a tool in facets: next to a touching node the gap is below it up to 63 degrees.
FACETS = 2.0


class Obstacle(Movable, Unilateral):
    """Contact of a side with a rigid tool, perhaps with friction.

    With the shape's signed distance phi, positive outside, and the dual functions Phi_j of the
    side, the weighted gaps are

        g_j = int Phi_j phi(X + u) >= 0,

    with geometry="reference" int Phi_j phi(X) - D_jj n_j.u_j, n_j = -grad phi. Contact forces act
    along grad phi on the side.
    The tool's point ``reference`` is at ``position``, and ``rotation`` turns it about this point
    (an angle in the plane, a rotation vector in space; radians): Constants, read in every step.
    Results are those of a `Contact` with the tool as master; slip is relative to the moving tool.
    ``tool_force`` and ``tool_moment`` (about its point) act on the tool. A node faces a tool within
    two facet lengths. Facets inclined by 78 degrees or more to the tool's surface, and untagged
    ones, are not in contact: tag flanks that fold onto the tool, too.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag or name (see `Tags`) of the side that meets the tool.
        shape: the tool in its initial position, see `dolfinx_mortar.shapes`.
        reference: d initial coordinates of the tool's point; default ``shape.point``.
        load: given forces on the tool by name: "x", "y" and "moment" about its point in the plane,
            "x", "y", "z", "moment x" to "moment z" in space, "y" in axisymmetry, numbers or scalar
            Constants, read at every step. Other motions are prescribed. The tool moves by
            ``travel`` until ``tool_force + load = 0``.
        surface: as in `Contact`, for straight cells. "smooth" with displacements of first order
            takes distances at the nodes and does not see a tip between them; default "smooth", for
            flat sides of first order "facets".
        friction, tresca, offset, wear: as in `Contact`.

    Raises:
        ValueError: for an invalid argument; from the problem, for shapes not of revolution in
            axisymmetry.

    Attributes:
        tool: shape, position and rotation.
    """

    rigid: Tool
    tool: Tool

    def __init__(
        self,
        facet_tags: MeshTags,
        *,
        slave: int | str,
        shape: Shape,
        reference: Any = None,
        load: Mapping[str, Force] | None = None,
        surface: str | None = None,
        friction: Limit | None = None,
        tresca: Limit | None = None,
        offset: Limit | None = None,
        wear: Archard | None = None,
    ) -> None:
        super().__init__(facet_tags, slave=slave)
        named = check_optional("surface", surface, SURFACES)
        self.meant = None if named is None else named == "smooth"  # None: by the order
        self.rigid = self.tool = Tool(
            facet_tags.topology.comm, shape, reference, facet_tags.topology.dim
        )
        self.load = load or {}
        self.law = create_law(friction, tresca)
        self.set_offset(offset, wear)

    def __repr__(self) -> str:
        said = f", shape={type(self.tool.shape).__name__}"
        said += {None: "", True: ", surface='smooth'", False: ", surface='facets'"}[self.meant]
        return f"{super().__repr__()[:-1]}{said})"

    @property
    def shape(self) -> Shape:
        """Shape as given."""
        return self.tool.shape

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        return super().given() | {"surface": self.meant}

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError for shapes of another dimension, or not of revolution."""
        super().check(V, revolved, strain)
        self.tool.check(V.mesh.geometry.dim, revolved)

    def take(self, owner: object, V: fem.FunctionSpace) -> None:
        """Assign to a problem; slips count from here; collective."""
        super().take(owner, V)
        self.tool.began = self.tool.pose()

    def pair(
        self,
        sides: Sides,
        u: fem.Function | None,
        *,
        again: bool,
        earlier: tuple[Pairing | None, Pattern] | None = None,
    ) -> tuple[None, Pattern]:
        """Fix the pattern of D between nodes of the side; collective."""
        if earlier is not None:
            return None, earlier[1]
        side = create_whole_side(sides.slave, sides.weight)
        plain = create_pattern(sides, side.row, side.column, len(side.row))
        slave, own = sides.slave, None
        faceted: Bools | None = None
        second, smooth = slave.element.degree > 1, self.meant is not False
        if smooth if second else not self.meant:
            own = find_smooth_side(slave, sides.fixed, FEATURE_ANGLE)
        if not second and own is not None:
            # only facets of flat sides see a tip between the nodes
            bent = np.abs(own.sagitta) > HALF_OF_DIGITS * mean_facet_length(slave)
            on = on_facets(slave, bent.any(axis=1))[: slave.owned]
            is_round = any_rank(sides.V.mesh.comm, on.any())[0]
            faceted = on if is_round and not smooth else None
            own, smooth = None, smooth and is_round
        nodal = smooth and not second
        return None, SidePattern(**vars(plain), side=side, own=own, nodal=nodal, faceted=faceted)

    def measure_coverage(
        self, sides: Sides, pairing: Pairing | None, u: fem.Function | None
    ) -> Coverage:
        """See `Interface.measure_coverage`; collective."""
        slave, own = sides.slave, slice(None, sides.slave.owned)
        length = mean_facet_length(slave)
        near = np.asarray(self.tool.distance(coordinates(slave, u)).value <= FACETS * length)
        reached = on_facets(slave, near[slave.facets].any(axis=1))[own]
        return Coverage(reached.astype(np.float64), reached, np.zeros_like(reached), near[own])

    def couple(
        self,
        sides: Sides,
        pairing: Pairing | None,
        pattern: Pattern,
        banned: Bools,
        u: fem.Function | None,
    ) -> Coupling:
        """See `Interface.couple`; collective."""
        assert isinstance(pattern, SidePattern) and pattern.side is not None
        side, slave, own = pattern.side, sides.slave, slice(None, sides.slave.owned)
        comm, x = sides.V.mesh.comm, coordinates(slave, u)
        at_nodes, facing = self.tool.distance(x), find_facing(side, self.tool, x)
        with raised_together(comm):
            self._check_distance(at_nodes, x, side.facet_length)
        size = np.maximum(np.linalg.norm(at_nodes.gradient, axis=1), TINY)
        into = -at_nodes.gradient / size[:, None]
        _, left = free_directions(into, sides.fixed[slave.nodes])
        allowed = self.may_carry(left, sides.fixed[slave.nodes])[:, 0] & ~banned[slave.nodes]
        near = at_nodes.value <= FACETS * side.facet_length
        if any_rank(comm, banned[slave.nodes].any())[0]:
            facing &= near[slave.facets].any(axis=1)
        found = integrate_side(side, x, facing, allowed)
        gaps, _ = point_gaps(pattern, self.tool, u, found.segments, found.x)
        columns = np.column_stack([found.x, gaps])
        at = mean_values(side, found.segments, found.Phi, found.weight, columns)
        # the gap n.(P x - x_j) - h_j is the mean of phi
        heights = -(into[own] * at[:, :-1]).sum(axis=1) - at[:, -1]
        kept = found.kept
        return create_coupling(
            pattern,
            found.P,
            into[own],
            sides.fixed[sides.nodes],
            kept,
            tangential=self.law is not None,
            weight=found.weight,
            heights=np.where(kept[:, 0], heights, 0.0),
            coverage=replace(found.coverage, near=near[own]),
        )

    def _check_distance(self, at_nodes: Distance, x: Floats, length: float) -> None:
        size = np.linalg.norm(at_nodes.gradient, axis=1)
        off = np.where(np.abs(at_nodes.value) <= length * size, np.abs(size - 1.0), 0.0)
        if off.max(initial=0.0) > NO_DISTANCE:
            worst = int(np.argmax(off))
            at = place(x[worst])
            raise ValueError(
                f"shape: phi is no distance, as abs(grad phi) is {size[worst]:.3g} at {at}; "
                "give phi / abs(grad phi), or the distance itself"
            )

    def warnings(self, link: CoupledSides, x: PETSc.Vec) -> list[str]:
        """Warn of a tool that no facet faces or that starts in the body; collective."""
        sides, comm = link.sides, link.sides.V.mesh.comm
        d = sides.fixed.shape[1]
        at = x.array_r.reshape(-1, d)[link.nodes]
        kept = link.coupling.kept[:, 0]
        if not any_rank(comm, kept.any())[0]:
            return [
                f"{self!r}: no facet of the side faces the tool where it is; its normal points out "
                "of the tool, towards the body: turn it round if it does not"
            ]
        depth = -self.tool.distance(at, self.tool.began).value[kept]
        deepest = depth.max(initial=-np.inf)
        mine = at[kept][int(np.argmax(depth))].tolist() if len(depth) else []
        most, place = max(comm.allgather((float(deepest), mine)))
        if most <= mean_facet_length(sides.slave):
            return []
        where = f"{most:.3g} deep, around ({', '.join(f'{c:.4g}' for c in place)})"
        if not any_rank(comm, (depth <= 0.0).any())[0]:
            raise ValueError(
                f"{self!r}: at its start the tool contains the whole side, up to {where}; the "
                "normal of a tool has to point out of the tool, towards the body: reverse it, or "
                "let the tool start beside the body"
            )
        return [
            f"{self!r}: at its start the tool lies in the body, up to {where}, more than a facet, "
            "which the first step has to remove: let it start beside the body"
        ]

    @property
    def tool_force(self) -> Floats:
        """Resultant (d,) exerted on the tool."""
        return self.master_force

    @property
    def tool_moment(self) -> Floats:
        """Moment (3,) of the forces on the tool about its point; in the plane the last one."""
        return self._about_place(self.master_moment, self.master_force)
