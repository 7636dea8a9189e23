# SPDX-License-Identifier: MIT
"""Interfaces: constraints on a side of a body, as their user describes them."""

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
from dolfinx_mortar.algebra.errors import is_defined_here, named, raised_together
from dolfinx_mortar.arrays import Bools, Floats, Ints
from dolfinx_mortar.interfaces.constraints import (
    Constraints,
    check_constraints,
    equalities,
    upper_bounds,
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
from dolfinx_mortar.interfaces.tool import Driven, RigidBody, Tool
from dolfinx_mortar.mortar.duals import Coverage
from dolfinx_mortar.mortar.mirrors import judge_supports
from dolfinx_mortar.mortar.pairing import Pairing, Weight
from dolfinx_mortar.mortar.surface import check_tags, create_surface, dependent_nodes
from dolfinx_mortar.tags import check_tag, label, tag_of

# Facets whose normals differ by more degrees meet in an edge, unless the user says otherwise: round
# sides have nine facets to a circle (360 / 9 = 40 degrees) or more, chamfers 45 degrees.
FEATURE_ANGLE = 40.0


class Collective:
    """What methods of a user's kind raise on one rank is raised on all; the package's pay nothing.

    When the call is over: of what is collective, a method may only do what all ranks reach.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not is_defined_here(cls):
            for name in _RETURNS.keys() & vars(cls).keys():
                setattr(cls, name, _raised_together(name, vars(cls)[name]))


class Interface(Collective, Results, ABC):
    """A constraint on the nodes of a slave side, marked in facet tags: the base of all kinds.

    `Contact` and `Tie` do so by another side of the mesh. A kind of your own says in `couple` at
    which nodes, along which directions and by how much; perhaps in `constraints` which bounds
    follow. What its methods raise on one rank is raised on all when the call is over, see
    `Collective`.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag, or name if the tags have names (see `Tags`), of the side that carries the
            multipliers and the integration (nonmortar side).

    Raises:
        ValueError: for tags that are none, and unknown names.

    Attributes:
        unilateral: whether it can open: its bounds have one side.
        stays: whether it is coupled at X, not at X + u, whatever the geometry of the problem.
        smooth: whether facets stand for smooth surfaces.
        feature_angle: degrees between facets from which on they meet in an edge.
        within: how far apart partners may be, None where facets say so.
        rigid: what holds the side or meets it as a rigid body, None for none.
        tool: the same, if it meets the side.

    After a step (see the subclasses for signs): ``force``, ``moment``, ``pressure``, ``gap`` and
    ``active``.
    """

    unilateral: ClassVar[bool] = False
    stays: bool = False
    smooth: bool = False
    feature_angle: float = FEATURE_ANGLE
    within: float | None = np.inf
    rigid: RigidBody | None = None
    tool: Tool | None = None

    def __init__(self, facet_tags: MeshTags, *, slave: int | str) -> None:
        super().__init__()
        check_tags(facet_tags)
        self.slave: int = tag_of(facet_tags, slave, "slave")
        check_tag("slave", self.slave)
        self.facet_tags = facet_tags

    def __repr__(self) -> str:
        return f"{type(self).__name__}(slave={label(self.facet_tags, self.slave)})"

    def given(self) -> dict[str, Any]:
        """Return what all ranks have to give the same, by name; see `agreement`."""
        return {"facet_tags": self.facet_tags, "slave": self.slave}

    def check(self, V: fem.FunctionSpace, revolved: bool, strain: str) -> None:
        """Raise a ValueError unless a problem can take it.

        Args:
            V: the space of the displacement.
            revolved: whether the problem is axisymmetric.
            strain: "small" or "finite".
        """

    # -- surfaces, pairs, operators --------------------------------------------------------------

    def find_sides(self, V: fem.FunctionSpace, fixed: Bools, weight: Weight | None = None) -> Sides:
        """Return the surfaces in V: the slave's; collective.

        Args:
            V: the vector space of the displacement.
            fixed: (local nodes, d) True where a direction of a node is prescribed.
            weight: factor of all integrals over the interface, 1 if not given.
        """
        slave = create_surface(V, self.facet_tags, self.slave, "slave")
        on_slave, dependent = mark(slave), dependent_nodes(slave)[: slave.owned]
        nowhere = np.zeros_like(on_slave)
        mirrors = np.zeros_like(fixed)
        judged = [judge_supports(slave, fixed[slave.nodes], self.feature_angle)]
        mirrors[slave.nodes] = judged[0][0]
        at = V, slave, None, on_slave, nowhere, fixed, mirrors, dependent, self.unilateral
        return Sides(*at, weight=weight, judged=judged)

    def pair(
        self,
        sides: Sides,
        u: fem.Function | None,
        *,
        again: bool,
        earlier: tuple[Pairing | None, Pattern] | None = None,
    ) -> tuple[Pairing | None, Pattern]:
        """Pair the surfaces at X + u and fix the pattern of Q: empty without a master; collective.

        Args:
            sides: the surfaces.
            u: displacement, None for X.
            again: sides that have faced each other once may turn away; at first that is an error.
            earlier: of an earlier search, which serves once more where the pairs are the same.
        """
        if earlier is not None:
            return earlier
        none = np.zeros(0, dtype=np.int32)
        return None, create_pattern(sides, none, none.astype(np.int64), 0)

    def measure_coverage(
        self, sides: Sides, pairing: Pairing | None, u: fem.Function | None
    ) -> Coverage:
        """Return how far the slave nodes face the master at X + u: all without one; collective."""
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
        """Return frames, weights and Q at X + u; collective.

        Args:
            sides: the surfaces.
            pairing: their candidate pairs.
            pattern: of Q.
            banned: (local nodes,) slave nodes that may not carry a multiplier.
            u: displacement, None for X.
        """

    # -- what acts -------------------------------------------------------------------------------

    def apart(self, V: fem.FunctionSpace, nodes: Ints) -> Floats | None:
        """Return the displacement (n, d) of the side that is no relative motion; collective.

        At slave nodes (n,), for what cannot open; None for none.
        """
        return None

    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Return the bounds on further motion: w_n <= gap of what can open, else w = 0.

        Args:
            nodes: (n,) owned slave nodes.
            directions: (n, d) which directions of the frames are constrained.
            slip: (n, d) relative motion in the frames: of positions where it can open, so that the
                first component is minus the gap, else of displacements, less what is `apart`.
            D: (n, c) weights.
        """
        if self.unilateral:
            return upper_bounds(nodes, directions, slip, D)
        node, axis = np.nonzero(directions)
        dofs = (directions.shape[1] * nodes[node] + axis).astype(np.int32)
        weight = np.broadcast_to(D, directions.shape)[node, axis]
        return equalities(dofs, -slip[node, axis], weight)

    def derivatives(self, link: CoupledSides) -> LinkDerivatives | None:
        """Return derivatives of forces and gaps by motions of the side, None for none; collective.

        For the pattern of a link.
        """
        return None

    def driven(self) -> Driven | None:
        """Return the motions of a tool that given forces drive; None where none are."""
        return None

    def warnings(self, link: CoupledSides, x: PETSc.Vec) -> list[str]:
        """Return warnings for the audit, the same on all ranks; collective.

        Args:
            link: the interface, coupled.
            x: (n,) present positions.

        Raises:
            ValueError: on all ranks, for what cannot be solved.
        """
        return []

    # -- what steps change -----------------------------------------------------------------------

    def state(self, ended: bool) -> dict[str, Floats]:
        """Return copies of what steps change, beside results; collective.

        Finite numbers by names that do not change, in arrays of lengths that do not change.

        Args:
            ended: whether the state is that with which the next step begins.
        """
        return {}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """Take over what `state` has returned; without communication."""


def full_coverage(sides: Sides) -> Coverage:
    """Return the coverage of slave nodes that all face the master."""
    n = len(sides.nodes)
    faces = np.ones(n, dtype=bool)
    return Coverage(np.ones(n), faces, ~faces)


# What users may write, and what it may return.
_RETURNS: Mapping[str, tuple[type, ...]] = {
    "find_sides": (Sides,),
    "pair": (tuple,),
    "measure_coverage": (Coverage,),
    "couple": (Coupling,),
    "may_carry": (np.ndarray,),
    "frame": (object,),
    "blocks": (np.ndarray,),
    "apart": (np.ndarray, NoneType),
    "constraints": (Constraints,),
    "derivatives": (object,),
    "warnings": (list,),
    "state": (dict,),
}


def _raised_together(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method, of a name, whose errors on one rank are raised on all; collective."""

    @wraps(method)
    def asked(self: Interface, *args: Any, **options: Any) -> Any:
        with raised_together(self.facet_tags.topology.comm), named(f"{self!r}: {name}()"):
            found = method(self, *args, **options)
            _check_returned(f"{self!r}: {name}() returns", found, _RETURNS[name], args)
        return found

    return asked


def _check_returned(
    name: str, found: object, kinds: tuple[type, ...], args: tuple[Any, ...]
) -> None:
    """Raise a ValueError unless a method of an interface may return this."""
    if not isinstance(found, kinds):
        wanted = " or ".join("None" if k is NoneType else k.__name__ for k in kinds)
        raise ValueError(f"{name} a {type(found).__name__}: return a {wanted}")
    if isinstance(found, Coupling):
        check_coupling(name, found, args[0], args[2])
    if isinstance(found, Constraints):
        check_constraints(name, found, *args[:2])


def check_owned(interfaces: Iterable[Interface], owner: object) -> None:
    """Raise a ValueError if a problem made later has taken over an interface.

    Args:
        interfaces: those of the problem.
        owner: what the problem has taken them for.
    """
    for interface in interfaces:
        if interface.owner is not owner:
            raise ValueError(
                f"interfaces: {interface} is also in a problem that was made later, and has the "
                f"results of that one; make a {type(interface).__name__} for each problem"
            )
