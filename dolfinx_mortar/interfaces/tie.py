# SPDX-License-Identifier: MIT
"""Mesh tying, and bolts: ties with an unknown overlap s of given conjugate force F.

A bolt constrains w_j = jump_j + e_j s, e_j being n without directions with Dirichlet data and
shares of nodes without multiplier; sum_j e_j . r_j = F for its reactions (theory.md, Pretension).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arguments import array, check, check_optional, number
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.spaces import check_mesh, check_nodal, check_real
from dolfinx_mortar.geometry.facets import area_vectors, tributary_weights
from dolfinx_mortar.interfaces.constraints import FORCE, Force, present_force
from dolfinx_mortar.interfaces.contact import MortarInterface
from dolfinx_mortar.interfaces.coupling import CoupledSides, Sides
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.mortar.pairing import Weight
from dolfinx_mortar.mortar.surface import Surface, facets_at
from dolfinx_mortar.shapes.shape import check_unit
from ufl.core.expr import Expr

Direction = Sequence[float] | Floats | None
"""Components of a vector of any length."""

# Least cosine with the outward normal: below is shear, or inward if negative.
ALONG = 0.45
# Least mean unit normal of a side that is not around a shank, sin(a) / a for an arc of angle 2 a.
AROUND = 0.1


@dataclass(frozen=True)
class Bolt:
    """Overlap s of a tie along n as an unknown with given conjugate force F."""

    axis: Floats  # (d,) n
    force: Callable[[], float]
    tighten: Callable[[Floats], None]
    overlap: Floats  # (d,)
    name: str

    holds = True
    names = ("pretension",)
    remedy = (
        "supports, ties or contacts have to hold both ends of the bolt along tie.direction, which "
        "points out of the slave side for tension, or the force is too large for the stiffness of "
        "the bolt (check units of both); pretension=None holds the jump"
    )

    def loads(self) -> Floats:
        """The force F (1,)."""
        return np.array([self.force()])

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """See `RigidBody`: n at each node (1, n, d)."""
        return np.tile(self.axis, (1, len(X), 1))

    def curve(self, X: Floats, amounts: Floats) -> Floats:
        """Zero: n is fixed."""
        return np.zeros_like(X)

    def move(self, amounts: Floats) -> None:
        """Add s (1,)."""
        self.tighten(amounts[0] * self.axis)

    def check(self, sides: Sides, largest: float) -> None:
        """Raise a ValueError where the sides cannot overlap; collective."""
        common = (sides.on_slave & sides.on_master)[: sides.n_owned]
        count = sides.V.mesh.comm.allreduce(int(common.sum()), op=MPI.SUM)
        if count:
            raise ValueError(
                f"pretension: both sides of {self.name} have {count} nodes in common, where they "
                "cannot overlap: cut the bolt all through its section"
            )
        if largest == 0.0:
            raise ValueError(
                f"pretension: no slave node of {self.name} carries a multiplier along the "
                f"direction {self.axis.tolist()}: check the tags, the Dirichlet data at its nodes, "
                "and other interfaces that claim them"
            )


def find_axis(normal: Floats, direction: Direction, who: str) -> Floats:
    """Unit vector (d,) of a pretension, the mean normal for None.

    Raises:
        ValueError: if the direction points into the slave side, or is missing.
    """
    length = float(np.linalg.norm(normal))
    around = length <= AROUND
    if direction is None:
        if around:
            raise ValueError(
                f"direction is None, but the slave side of {who} has no mean normal, as its "
                "normals point all around: give the axis of the bolt"
            )
        return np.asarray(normal / length)
    axis = np.array(direction, dtype=float)
    if not around and float(axis @ normal) < -ALONG * length:
        raise ValueError(
            f"direction is {axis.tolist()}, which points from the master side into the slave side: "
            "turn it round (out of the slave side) for tension; to push the sides apart, give a "
            "negative force then"
        )
    return axis


def describe_shear(normal: Floats, axis: Floats, who: str) -> str:
    """Warning if n runs along the cut, or ""."""
    length, along = float(np.linalg.norm(normal)), float(axis @ normal)
    if length <= AROUND or along >= ALONG * length:
        return ""
    return (
        f"direction is {axis.tolist()}, whose cosine with the mean normal out of the slave side of "
        f"{who} is {round(along / length, 3) + 0.0:g}: the sides slip along each other rather than "
        "overlap, and the force is shear. For tension give the axis of the bolt, out of the slave "
        "side"
    )


def mean_normal(slave: Surface) -> Floats:
    """Mean outward unit normal (d,) of a side at X; collective."""
    found = facets_at(slave, slave.X)
    own = np.append(area_vectors(found).sum(axis=0), tributary_weights(found).sum())
    total = slave.V.mesh.comm.allreduce(own, op=MPI.SUM)
    return np.asarray(total[:-1] / total[-1])


Jump = Sequence[float] | Floats | fem.Constant | fem.Function | Callable[[Floats], Floats] | None
"""A vector in Cartesian components, the same everywhere or one at each point."""

# Default reach beyond the least distance, in larger facets: above the sagittas of both sides.
WITHIN = 0.5

REACH = number("the largest distance over which to tie, a length", above=0.0)
BOLT = f"{FORCE.remedy}, the resultant of the bolt; None to hold the jump"


class Tie(MortarInterface):
    """Mesh tying ("glue"): both sides move together in all directions, or a given jump apart.

    The constraint is u_slave - P u_master = jump + s n, P = D^-1 M at X. With a pretension the
    overlap s along the unit vector n is unknown, with the equation ``force @ n == pretension``.
    Prescribed displacement components are not tied. Jumps, tightenings and directions do not rotate
    with the bodies: where these rotate by R, multiply them by R in each step, or a bolt loses
    force. The offset between separated sides rotates (linearised) with ``surface="smooth"`` only.
    ``pressure`` is the normal traction per area at X, positive in compression; ``gap`` the normal
    part of the jump, negative where the sides overlap.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag or name (see `Tags`) of the side with the multipliers.
        master: tag or name of the other side.
        jump: displacement of the slave side relative to the master side: d components, a Constant,
            a Function on this mesh, or a function of points x (3, n) that returns (d, n), read in
            every step. A vector from the slave side into the master side makes them overlap, the
            opposite opens a slit.
        pretension: resultant on the slave side along ``direction``, a force, positive in tension: a
            number or a scalar Constant, read in every step; half of it for half a bolt on a plane
            of symmetry. None keeps jump and tightening: later loads change the force.
        direction: d numbers of any length, out of the slave side: the axis of the bolt; default the
            mean normal of the slave side.
        surface: "facets" ties points of facets, u_s = P u_m; "smooth" the smooth surfaces through
            their nodes: where facets are apart by r, u_s = P u_m + (motion of r).
        feature_angle: least angle of an edge between facets in degrees, for smooth surfaces.
        within: largest distance between tied facets at X; default the least one plus half of the
            larger facet (the audit warns where that may be wrong).
    Source: the paper, section 4, eq. 16 with equality.

    Raises:
        ValueError: for an invalid argument.

    Attributes:
        jump, pretension, direction: as given, the direction as a unit vector; may be set.
        tightening: s n (d,), added to the jump, set by every step with a pretension.
    """

    stays = True

    def __init__(
        self,
        facet_tags: MeshTags,
        *,
        slave: int | str,
        master: int | str,
        jump: Jump = None,
        pretension: Force | None = None,
        direction: Direction = None,
        surface: str = "smooth",
        feature_angle: float = FEATURE_ANGLE,
        within: float | None = None,
    ) -> None:
        tags = {"slave": slave, "master": master}
        super().__init__(facet_tags, **tags, surface=surface, feature_angle=feature_angle)
        everything = isinstance(within, float) and within == np.inf
        self.within = within if everything else check_optional("within", within, REACH)
        self.jump = jump
        self.pretension, self.direction = pretension, direction
        self.tightening: Floats = np.zeros(facet_tags.topology.dim)
        self.normal: Floats = np.zeros(facet_tags.topology.dim)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; a ValueError for an invalid one of a jump or pretension."""
        if name in ("jump", "tightening"):
            value = _check_jump(value, self.facet_tags.topology.dim)
        elif name == "pretension":
            value = check_optional(name, value, FORCE, BOLT)
        elif name == "direction" and value is not None:
            value = check_unit(name, value, self.facet_tags.topology.dim)
        super().__setattr__(name, value)

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        return super().given() | {
            "jump": self.jump,
            "tightening": self.tightening,
            "pretension": self.pretension,
            "direction": self.direction,
            "within": self.within,
        }

    def __repr__(self) -> str:
        name = super().__repr__()
        return name if self.within is None else f"{name[:-1]}, within={self.within!r})"

    def find_sides(self, V: fem.FunctionSpace, fixed: Bools, weight: Weight | None = None) -> Sides:
        """Both surfaces in V, see `Interface.find_sides`; collective."""
        sides = super().find_sides(V, fixed, weight)
        self.normal = mean_normal(sides.slave)
        return sides

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError for a jump on another mesh than V's."""
        check_mesh("jump", self.jump, V)

    def reach(self, sizes: Floats, nearest: float) -> Floats:
        """Largest distances (q,) of paired points by facet sizes (q,)."""
        if self.within is not None:
            return np.full(len(sizes), self.within)
        return nearest + WITHIN * sizes

    def may_carry(self, left: Floats, fixed: Bools) -> Bools:
        """Directions (n, d) without Dirichlet data."""
        return ~fixed

    def apart(self, V: fem.FunctionSpace, nodes: Ints) -> Floats | None:
        """Jump plus tightening (n, d) at slave nodes, or None; collective."""
        if self.jump is None and not self.tightening.any():
            return None
        with raised_together(V.mesh.comm):
            check_mesh("jump", self.jump, V)
        given: Any = self.jump
        if isinstance(given, fem.Function) and given.function_space != V:
            given.x.scatter_forward()
            nodal = fem.Function(V)
            nodal.interpolate(given)
            given = nodal
        with raised_together(V.mesh.comm):
            return _values_at(given, V, nodes) + self.tightening

    def driven(self) -> Bolt | None:
        """Overlap driven by a pretension, if any; a ValueError for an unusable direction."""
        if self.pretension is None:
            return None
        axis = find_axis(self.normal, self.direction, str(self))
        force = partial(present_force, f"pretension of {self}", self.pretension)
        return Bolt(axis, force, self.tighten, self.tightening, str(self))

    def warnings(self, link: CoupledSides, x: PETSc.Vec) -> list[str]:
        """Warning about a pretension with a shear component; collective."""
        bolt = self.driven()
        shear = "" if bolt is None else describe_shear(self.normal, bolt.axis, str(self))
        return [*super().warnings(link, x), *([shear] if shear else [])]

    def tighten(self, way: Floats) -> None:
        """Add an overlap (d,) to the tightening."""
        self.tightening = self.tightening + way

    def state(self, ended: bool) -> dict[str, Floats]:
        """See `Interface.state`."""
        return {"tightening": self.tightening}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """See `Interface.restore`."""
        self.tightening = state["tightening"]


def _check_jump(jump: Any, d: int) -> Any:
    if jump is None:
        return None
    example = ", ".join(["0"] * (d - 1) + ["0.1"])
    wanted = (
        f"give {d} Cartesian components of a finite length, [{example}], or a Constant, a Function "
        "or a function of points x (3, n) that has them"
    )
    if isinstance(jump, fem.Constant | fem.Function):
        check_real("jump", jump)
        if isinstance(jump, fem.Function):
            check_nodal("jump", jump, (d,), wanted)
        elif jump.value.shape != (d,):
            raise ValueError(f"jump is a Constant of shape {jump.value.shape}: {wanted}")
        return jump
    if isinstance(jump, Expr):  # UFL expressions are callable, too
        raise ValueError(
            f"jump is an expression of UFL, {type(jump).__name__}: interpolate it into a Function "
            "of the displacement's space, and that again where it changes between steps"
        )
    if callable(jump):
        return jump
    return check("jump", jump, array((d,), remedy=wanted))


def _values_at(jump: Any, V: fem.FunctionSpace, nodes: Ints) -> Floats:
    d = V.dofmap.index_map_bs
    if jump is None:
        return np.zeros((len(nodes), d))
    if isinstance(jump, fem.Function):
        return np.array(jump.x.array.reshape(-1, d)[nodes])
    if isinstance(jump, fem.Constant | np.ndarray):
        return np.tile(getattr(jump, "value", jump), (len(nodes), 1))
    if not len(nodes):  # no points
        return np.zeros((0, d))
    x, n = np.ascontiguousarray(V.tabulate_dof_coordinates()[nodes].T), len(nodes)
    wanted = f"return {d, n} real numbers, a vector for each of {n} points x (3, n)"
    return check("jump(x)", jump(x), array((d, n), finite=False, remedy=wanted)).T
