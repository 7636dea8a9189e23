# SPDX-License-Identifier: MIT
"""Base class of interfaces: constraints on a side of a body."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from types import NoneType
from typing import Any, ClassVar

from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.parallel import is_defined_here, named, raised_together
from dolfinx_mortar.common.arrays import Bools, Floats, Ints
from dolfinx_mortar.common.tags import label, tag_of
from dolfinx_mortar.interfaces.constraints import (
    Constraints,
    check_constraints,
)
from dolfinx_mortar.interfaces.contact_tangent import LinkDerivatives
from dolfinx_mortar.interfaces.coupling import (
    CoupledSides,
    Coupling,
    Pattern,
    Sides,
    check_coupling,
    create_pattern,
    mark,
)
from dolfinx_mortar.interfaces.results import Results
from dolfinx_mortar.interfaces.tool import RigidBody, Tool
from dolfinx_mortar.mortar.curvature_correction import NodeShape, find_shape
from dolfinx_mortar.mortar.duals import Coverage
from dolfinx_mortar.mortar.mirrors import judge_supports
from dolfinx_mortar.mortar.pairing import Pairing, Weight
from dolfinx_mortar.mortar.surface import check_tags, create_surface, dependent_nodes

# Default least angle of an edge: circles of at least nine facets are smooth, chamfers not.
FEATURE_ANGLE = 40.0


class Collective:
    """Errors of a user's methods on one rank are raised on all ranks, after the call."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not is_defined_here(cls):
            for name in _RETURNS.keys() & vars(cls).keys():
                setattr(cls, name, _raised_together(name, vars(cls)[name]))


class Interface(Collective, Results, ABC):
    """A constraint on the nodes of a tagged slave side: base class of all interfaces.

    A subclass gives nodes, directions and distances in `couple`, and bounds in `constraints`.
    Errors of its methods on one rank are raised on all after the call: collective methods may only
    communicate where all ranks do. Results: ``force``, ``moment``, ``pressure``, ``gap`` and
    ``active``.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag or name (see `Tags`) of the nonmortar side.

    Raises:
        ValueError: for invalid tags and unknown names.

    Attributes:
        unilateral: whether it can open: one-sided bounds.
        stays: whether it is always coupled at X.
        smooth: whether facets approximate smooth surfaces.
        feature_angle: least angle of an edge in degrees.
        within: largest distance of facets that are paired, None for a multiple of their size.
        master: tag of the other side, or None.
        rigid: rigid body that holds or meets the side, or None.
        tool: the same, if it meets the side.
        wear: law of wear of the side, or None.
    """

    unilateral: ClassVar[bool] = False
    stays: bool = False
    smooth: bool = False
    feature_angle: float = FEATURE_ANGLE
    within: float | None = np.inf
    master: int | None = None
    rigid: RigidBody | None = None
    tool: Tool | None = None
    wear: Any = None

    def __init__(self, facet_tags: MeshTags, *, slave: int | str) -> None:
        super().__init__()
        check_tags(facet_tags)
        self.slave = tag_of(facet_tags, slave, "slave")
        self.facet_tags = facet_tags

    def __repr__(self) -> str:
        return f"{type(self).__name__}(slave={label(self.facet_tags, self.slave)})"

    def given(self) -> dict[str, Any]:
        """Arguments that must agree among ranks, by name."""
        own = {"facet_tags": self.facet_tags, "slave": self.slave}
        return own | ({} if self.rigid is None else self.rigid.given())

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError if a problem cannot take it.

        `revolved`: whether it is axisymmetric; `strain`: "small" or "finite".
        """

    def find_sides(self, V: fem.FunctionSpace, fixed: Bools, weight: Weight | None = None) -> Sides:
        """Surfaces in V; collective.

        Args:
            V: vector space of the displacement.
            fixed: (local nodes, d) prescribed directions.
            weight: factor of all integrals, None for 1.
        """
        sides = [create_surface(V, self.facet_tags, self.slave, "slave")]
        if self.master is not None and self.master != self.slave:
            sides.append(create_surface(V, self.facet_tags, self.master, "master"))
        slave, master = sides[0], None if self.master is None else sides[-1]
        mirrors, angle = np.zeros_like(fixed), self.feature_angle
        judged: list[tuple[Bools, Floats]] = []
        shapes: list[NodeShape] = []
        for side in sides:
            judged.append(judge_supports(side, fixed[side.nodes], angle))
            own = judged[-1][0]
            mirrors[side.nodes] |= own
            if master and (self.unilateral or (self.smooth and not side.curved)):
                shapes.append(find_shape(side, fixed, angle, own))
        on_slave = mark(slave)
        on_master = np.zeros_like(on_slave) if master is None else mark(master)
        at = V, slave, master, on_slave, on_master, fixed, mirrors
        rest = dependent_nodes(slave)[: slave.owned], self.unilateral
        both = 2 // len(sides)
        return Sides(*at, *rest, weight=weight, judged=judged, shapes=both * shapes)

    def pair(
        self,
        sides: Sides,
        u: fem.Function | None,
        *,
        again: bool,
        earlier: tuple[Pairing | None, Pattern] | None = None,
    ) -> tuple[Pairing | None, Pattern]:
        """Pair the surfaces at X + u and fix the pattern of Q, empty without a master; collective.

        Args:
            u: displacement, None for X.
            again: a later search, in which no pairs are no error.
            earlier: of an earlier search, returned for the same pairs.
        """
        if earlier is not None:
            return earlier
        none = np.zeros(0, dtype=np.int32)
        return None, create_pattern(sides, none, none.astype(np.int64), 0)

    def measure_coverage(
        self, sides: Sides, pairing: Pairing | None, u: fem.Function | None
    ) -> Coverage:
        """Coverage of slave nodes at X + u; collective."""
        return full_coverage(sides)

    @abstractmethod
    def couple(
        self,
        sides: Sides,
        pairing: Pairing | None,
        pattern: Pattern,
        banned: Bools,
        u: fem.Function | None,
    ) -> Coupling:
        """Frames, weights and Q at X + u (X for None); collective.

        `banned` (local nodes,) are slave nodes without multiplier.
        """

    def apart(self, V: fem.FunctionSpace, nodes: Ints) -> Floats | None:
        """Displacement (n, d) of tied sides, length (n,) added to a gap, at nodes (n,); or None.

        Collective.
        """
        return None

    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Bounds on increments: w_n <= gap if unilateral, else w = 0.

        Args:
            nodes: (n,) owned slave nodes.
            directions: (n, d) constrained directions of the frames.
            slip: (n, d) relative motion in the frames: if unilateral of positions (first component
                minus the gap), else of displacements minus `apart`.
            D: (n, c) weights.
        """
        d = directions.shape[1]
        bounded = directions & (np.arange(d) == 0) if self.unilateral else directions
        node, axis = np.nonzero(bounded)
        dofs, upper = (d * nodes[node] + axis).astype(np.int32), -slip[node, axis]
        lower = np.full_like(upper, -np.inf) if self.unilateral else upper
        return Constraints(dofs, lower, upper, np.broadcast_to(D, directions.shape)[node, axis])

    def derivatives(self, link: CoupledSides) -> LinkDerivatives | None:
        """Derivatives for the pattern of a link, or None; collective."""
        return None

    def driven(self) -> Any:
        """Object with motions driven by given forces, or None if all are prescribed.

        With `holds`, `names`, `loads`, `motions` and `move` of `RigidBody`, and where it holds the
        side also `curve` of `Plate`.
        """
        return self.rigid if self.rigid is not None and self.rigid.load else None

    def warnings(self, link: CoupledSides, x: PETSc.Vec) -> list[str]:
        """Warnings for the audit at positions x (n,), the same on all ranks; collective.

        Raises:
            ValueError: on all ranks, for unsolvable cases.
        """
        return []

    def state(self, ended: bool) -> dict[str, Floats]:
        """Copies of the state except results, finite arrays of fixed names and lengths; collective.

        `ended`: at the start of the next step.
        """
        return {} if self.rigid is None else self.rigid.state(ended)

    def restore(self, state: Mapping[str, Floats]) -> None:
        """Set the result of `state`; without communication."""
        if self.rigid is not None:
            self.rigid.restore(state)


def full_coverage(sides: Sides) -> Coverage:
    """Full coverage."""
    n = len(sides.nodes)
    faces = np.ones(n, dtype=bool)
    return Coverage(np.ones(n), faces, ~faces)


# methods of users, and their results
_RETURNS: Mapping[str, tuple[type, ...]] = {
    "find_sides": (Sides,),
    "pair": (tuple,),
    "measure_coverage": (Coverage,),
    "couple": (Coupling,),
    "may_carry": (np.ndarray,),
    "apart": (np.ndarray, NoneType),
    "constraints": (Constraints,),
    "derivatives": (object,),
    "warnings": (list,),
    "state": (dict,),
}


def _raised_together(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """Method with errors of one rank raised on all; collective."""

    @wraps(method)
    def asked(self: Interface, *args: Any, **options: Any) -> Any:
        with raised_together(self.facet_tags.topology.comm), named(f"{self!r}: {name}()"):
            found = method(self, *args, **options)
            kinds, who = _RETURNS[name], f"{self!r}: {name}() returns"
            if not isinstance(found, kinds):
                wanted = " or ".join("None" if k is NoneType else k.__name__ for k in kinds)
                raise ValueError(f"{who} a {type(found).__name__}: return a {wanted}")
            if isinstance(found, Coupling):
                check_coupling(who, found, args[0], args[2])
            if isinstance(found, Constraints):
                check_constraints(who, found, *args[:2])
        return found

    return asked


def check_owned(interfaces: Iterable[Interface], owner: object) -> None:
    """Raise a ValueError if another problem has taken over an interface."""
    for interface in interfaces:
        if interface.owner is not owner:
            raise ValueError(
                f"interfaces: {interface} is also in a problem that was made later, and has the "
                f"results of that one; make a {type(interface).__name__} for each problem"
            )
