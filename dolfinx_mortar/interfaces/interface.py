# SPDX-License-Identifier: MIT
"""Interfaces: constraints on a side of a body, as their user describes them, and their results."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import wraps
from types import NoneType
from typing import Any, ClassVar

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem
from dolfinx.mesh import MeshTags
from dolfinx_mortar.algebra.errors import is_defined_here, named, raised_together
from dolfinx_mortar.arrays import Bools, Floats, Ints, Longs
from dolfinx_mortar.interfaces.constraints import (
    Constraints,
    SlipLimits,
    check_constraints,
    check_limits,
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
from dolfinx_mortar.interfaces.slip_partners import Partners
from dolfinx_mortar.interfaces.tool import Driven, Pose
from dolfinx_mortar.mortar.duals import Coverage
from dolfinx_mortar.mortar.mirrors import judge_supports
from dolfinx_mortar.mortar.pairing import Pairing, Weight
from dolfinx_mortar.mortar.passing import SeenByTool
from dolfinx_mortar.mortar.surface import check_tags, create_surface, dependent_nodes
from dolfinx_mortar.shapes import Shape
from dolfinx_mortar.shapes.zero_level import find_zero_level
from dolfinx_mortar.tags import check_tag, label, tag_of


class NoResult(RuntimeError, AttributeError):
    """A result was asked for before the first step; also an AttributeError, for ``hasattr``."""

    def __init__(self, interface: Interface, name: str, why: str = "") -> None:
        why = f": {why}" if why else " yet: solve a step first, newton(problem)"
        super().__init__(f"{interface} has no {name}{why}")


@dataclass(frozen=True)
class Fields:
    """Nodal results as Functions; zero until the first step."""

    pressure: fem.Function
    gap: fem.Function
    active: fem.Function


@dataclass(frozen=True)
class Resultants:
    """Results of a step that are no Functions."""

    force: Floats  # (d,) resultant exerted on the slave side
    moment: Floats  # (3,) its moment about the origin
    master_force: Floats  # (d,) the same for the master side
    master_moment: Floats  # (3,)
    multiplier: Floats  # (n,) or (n, d) lambda_j = reaction_j / D_jj at the owned slave nodes
    nodes: Ints  # (n,) local numbers of these nodes
    carries: Bools  # (n,) which of them have a multiplier
    place: Floats  # (3,) where a tool is; 0 without one


@dataclass(frozen=True)
class Outline:
    """Shape and position of a tool, for pictures and files."""

    shape: Shape
    pose: Pose
    revolved: bool = False  # only the part r >= 0 is shown

    def distance(self, x: Floats) -> Floats:
        """Return the signed distances (n,) of points (n, d)."""
        return self.shape.values(self.pose.to_tool(x))

    @property
    def surface(self) -> tuple[Floats, Longs] | None:
        """Points (n, d) where it is, with lines or triangles; None if it is not made of these."""
        found = self.shape.surface
        return None if found is None else (self.pose.to_space(found[0]), found[1])

    def cut(self, low: Floats, high: Floats) -> tuple[Floats, Longs]:
        """Return points (n, d) of the tool as it starts, and the lines or triangles (m, d) of them.

        All of what it is made of, or else what is in a box (d,).
        """
        if (found := self.shape.surface) is not None:
            return found
        if self.revolved:
            low = np.maximum(low, [0.0, -np.inf])
        return find_zero_level(self.shape, low, high)


# Facets whose normals differ by more degrees meet in an edge, unless the user says otherwise: round
# sides have nine facets to a circle (360 / 9 = 40 degrees) or more, chamfers 45 degrees.
FEATURE_ANGLE = 40.0


class Interface(ABC):
    """A constraint on the nodes of a slave side, marked in facet tags: the base of all kinds.

    `Contact` and `Tie` do so by another side of the mesh. A kind of your own says in `couple` at
    which nodes, along which directions and by how much; in `constraints` which bounds follow.
    What its methods raise on one rank is raised on all when the call is over. So of what is
    collective, a method may only do what all ranks reach.

    Args:
        facet_tags: facet markers on the mesh of the displacement.
        slave: tag, or name if the tags have names (see `Tags`), of the side that carries the
            multipliers and the integration (nonmortar side).

    Raises:
        ValueError: for tags that are none, and unknown names.

    After a step (see the subclasses for signs): ``force``, ``moment``, ``pressure``, ``gap`` and
    ``active``.
    """

    unilateral: ClassVar[bool] = False  # can open: its bounds have one side
    holds_nodes: ClassVar[bool] = False  # in all directions, as supports do
    pressure_name: ClassVar[str] = "normal traction"  # as pictures call it
    # where straight facets of degree 2 spoil pressures, how, and whether only in a close fit
    spoilt: ClassVar[tuple[str, str, bool]] = "", "", False
    smooth: bool = False  # whether facets stand for smooth surfaces
    feature_angle: float = FEATURE_ANGLE
    lasts: ClassVar[bool] = False  # whether couple() at X returns the same while pairs last
    near_only: ClassVar[bool] = False  # partners have to lie within reach
    within: float | None = None  # how far that is, as its user has given it
    tightening: Floats | None = None  # (d,) by which sides are apart beside their jump
    moved_by_loads: ClassVar[bool] = False  # whether what the side meets moves with the load level

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not is_defined_here(cls):
            for name in _RETURNS.keys() & vars(cls).keys():
                setattr(cls, name, _together(name, vars(cls)[name]))

    def __init__(self, facet_tags: MeshTags, *, slave: int | str) -> None:
        check_tags(facet_tags)
        self.slave: int = tag_of(facet_tags, slave, "slave")
        check_tag("slave", self.slave)
        self.facet_tags = facet_tags
        self.owner: object = None  # the problem that has taken the interface
        self.fields: Fields | None = None
        self.resultants: Resultants | None = None

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.sides})"

    @property
    def meets_itself(self) -> bool:
        """Whether both sides are one surface, divided into slaves and masters at each search."""
        return False

    @property
    def sides(self) -> str:
        """Names of the sides in messages."""
        return f"slave={label(self.facet_tags, self.slave)}"

    def given(self) -> dict[str, Any]:
        """Return what all ranks have to give the same, by name; see `agreement`."""
        return {"facet_tags": self.facet_tags, "slave": self.slave}

    @property
    def identity(self) -> Mapping[str, Any]:
        """What results belong to, by name, of what JSON can hold: a checkpoint is refused else."""
        return {}

    def check(self, V: fem.FunctionSpace) -> None:
        """Raise a ValueError unless a problem with the displacement's space can take it."""

    def check_kinematics(self, d: int, revolved: bool, strain: str) -> None:
        """Raise a ValueError unless a problem of a kind can take it.

        Args:
            d: dimension of the mesh.
            revolved: whether it is axisymmetric.
            strain: "small" or "finite".
        """

    def take(self, owner: object, V: fem.FunctionSpace) -> None:
        """Belong to a problem from now on, with fields on V and without results; collective."""
        scalar = V.sub(0).collapse()[0]
        self.owner, self.resultants = owner, None
        self.fields = Fields(
            *(fem.Function(scalar, name=name) for name in ("pressure", "gap", "active"))
        )

    # -- surfaces, pairs, operators --------------------------------------------------------------

    def configuration(self, u: fem.Function | None) -> fem.Function | None:
        """Return the displacement at which the interface is taken, None for X."""
        return u

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
        at = V, slave, None, on_slave, nowhere, fixed, mirrors, dependent
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

    def has_slid(
        self, sides: Sides, pairing: Pairing | None, u: fem.Function | None, near: Bools | None
    ) -> bool:
        """Tell whether the bodies slid out of the margin of the last search; collective.

        Args:
            sides: the surfaces.
            pairing: their candidate pairs.
            u: displacement.
            near: slave nodes (n,) whose facets are looked at; None for all.
        """
        return False

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
        before: Coupling | None = None,
    ) -> Coupling:
        """Return frames, weights and Q at X + u; collective.

        Args:
            sides: the surfaces.
            pairing: their candidate pairs.
            pattern: of Q.
            banned: (local nodes,) slave nodes that may not carry a multiplier.
            u: displacement, None for X.
            before: of the last geometry of the step; in its first one none.
        """

    # -- constraints -----------------------------------------------------------------------------

    @property
    def rough(self) -> bool:
        """Whether the interface has friction."""
        return False

    @property
    def acts_openly(self) -> bool:
        """Whether it acts at slave nodes that are not closed, too."""
        return not self.unilateral

    def measured(self, x: PETSc.Vec, u: PETSc.Vec) -> PETSc.Vec:
        """Return the quantity that is constrained: positions x or displacements u."""
        return x

    @abstractmethod
    def constraints(self, nodes: Ints, directions: Bools, slip: Floats, D: Floats) -> Constraints:
        """Return the bounds on further motion.

        Args:
            nodes: (n,) owned slave nodes.
            directions: (n, d) which directions of the frames are constrained.
            slip: (n, d) relative motion of what is ``measured``, in the frames; the first component
                is minus the gap.
            D: (n, c) weights.
        """

    def limits(self) -> Floats | None:
        """Return the limits of friction at the owned nodes, None without friction; collective."""
        return None

    def slip_limits(
        self, nodes: Ints, directions: Bools, frames: Floats, slip: Floats, D: Floats, limit: Floats
    ) -> SlipLimits:
        """Return the limits of tangential reactions where it is rough, see `Contact`."""
        raise NotImplementedError

    def partners(self, link: CoupledSides, x: PETSc.Vec, *, frozen: bool) -> Partners | None:
        """Return from where slips of a step are measured; None for P of the moment; collective.

        Args:
            link: the interface in a configuration at the start of the step.
            x: (n,) positions at the last commit.
            frozen: whether surfaces stay at X.
        """
        return None

    def derivatives(self, link: CoupledSides) -> LinkDerivatives | None:
        """Return derivatives of forces and gaps by motions of the side, None for none; collective.

        For the pattern of a link.
        """
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

    def depths(self, link: CoupledSides, u: fem.Function) -> tuple[Floats, Floats, Floats] | None:
        """Return how deep points of the side are in a tool at X + u; None without one; collective.

        Depths over the length of their facets (q,), depths (q,) and points (q, d).
        """
        return None

    def heights(self, link: CoupledSides, u: fem.Function | None) -> Floats | None:
        """Return how much nearer a tool would be to smooth surfaces (n,) at the owned slave nodes.

        None where facets are what is meant, or stand for these already; collective.
        """
        return None

    def in_corners(self, link: CoupledSides, x: PETSc.Vec) -> str:
        """Say where corners have no one normal, for steps that fail at x = X + u; collective."""
        return ""

    # -- what steps read and find ----------------------------------------------------------------

    def jump_at(self, V: fem.FunctionSpace, nodes: Ints) -> Floats | None:
        """Return the displacement (n, d) that is no relative motion; None for none; collective."""
        return None

    def apart_at(self, V: fem.FunctionSpace, nodes: Ints) -> Floats | None:
        """Return the same with the tightening."""
        jump, way = self.jump_at(V, nodes), self.tightening
        if way is None or not way.any():
            return jump
        return np.tile(way, (len(nodes), 1)) if jump is None else jump + way

    def ended(self) -> Any:
        """Return what `commit` takes of the end of a step, whatever is set after it."""
        return None

    def commit(self, ended: Any) -> None:
        """Make the end of a step, see `ended`, the state from which the next one starts."""

    def found(self) -> dict[str, list[float]]:
        """Return results of steps that are not nodal, for a checkpoint.

        Finite numbers in lists whose names and lengths do not change.
        """
        return {}

    def take_found(self, found: Mapping[str, list[float]]) -> None:
        """Restore what `found` has returned."""

    def failed(self) -> Exception | None:
        """Return an error on this rank that has waited until all ranks ask, and forget it."""
        return None

    def driven(self) -> Driven | None:
        """Return the motions of a tool that given forces drive; None where none are."""
        return None

    def tool_way(self, before: Floats, after: Floats) -> Floats | None:
        """Return how far a tool has carried points (n, d) since the last commit; None for none."""
        return None

    def seen_by_tool(self) -> SeenByTool | None:
        """Return how a tool has seen points since the last commit; None without one."""
        return None

    def turn(self) -> Floats:
        """Return how a tool has turned since the last commit, (1,) or (3,); 0 without one."""
        return np.zeros(1)

    def outline(self) -> Outline | None:
        """Return where a tool is at present, for pictures; None without one."""
        return None

    # -- results ---------------------------------------------------------------------------------

    @property
    def functions(self) -> list[fem.Function]:
        """All nodal results, of an interface that a problem has taken."""
        assert self.fields is not None
        return [self.fields.pressure, self.fields.gap, self.fields.active]

    @property
    def functions_of_friction(self) -> list[fem.Function]:
        """Traction, slip of the step, slip, status and energy; none without friction."""
        return []

    def keep(self) -> Any:
        """Return copies of the results, and of what `commit` sets, for `put_back`."""
        return self.resultants, [(f, f.x.array.copy()) for f in self.functions]

    def put_back(self, kept: Any) -> None:
        """Restore the results that `keep` has returned; without communication."""
        self.resultants, functions = kept
        for f, values in functions:
            f.x.array[:] = values

    def clear(self) -> None:
        """Remove the results, as before the first step; without communication."""
        self.resultants = None
        for f in self.functions:
            f.x.array[:] = 0.0

    def sum_up(self, comm: MPI.Comm, nodes: Ints) -> None:
        """Add up what is a sum over the nodal results of the owned slave nodes; collective."""

    def place(self) -> Floats:
        """Return where a tool is, (3,); 0 without one."""
        return np.zeros(3)

    def shown(self, multiplier: Floats) -> Floats:
        """Return the multipliers (n, d) in the frames as results show them."""
        return multiplier[:, 0] if self.unilateral else multiplier

    def field(self, name: str) -> fem.Function | None:
        """Return a field by the name under which it is written, None if there is none."""
        names = {"status": "active"}
        return getattr(self.fields, names.get(name, name), None)

    def _result(self, record: Any, name: str) -> Any:
        if record is None:
            raise NoResult(self, name)
        return getattr(record, name)

    @property
    def force(self) -> Floats:
        """Resultant (d,) exerted on the slave side.

        At the end of the step: for impulses in motions see `Ledger.impulses`.

        Of rings, (radial, axial): the sum of what pushes outwards all around, which no force on
        the whole balances, and the force along the axis.
        """
        return self._result(self.resultants, "force")

    @property
    def moment(self) -> Floats:
        """Moment (3,) about the origin of the forces on the slave side.

        Of rings that of these sums in the plane of the section: it tells whether the two sides
        balance, and is no moment on the whole, which is zero.
        """
        return self._result(self.resultants, "moment")

    @property
    def master_force(self) -> Floats:
        """Resultant (d,) exerted on the master side."""
        return self._result(self.resultants, "master_force")

    @property
    def master_moment(self) -> Floats:
        """Moment (3,) about the origin of the forces on the master side."""
        return self._result(self.resultants, "master_moment")

    @property
    def multiplier(self) -> Floats:
        """Multipliers lambda_j at the owned slave nodes."""
        return self._result(self.resultants, "multiplier")

    @property
    def pressure(self) -> fem.Function:
        """Normal traction, positive in compression; zero off the slave side."""
        return self._result(self.fields, "pressure")

    @property
    def gap(self) -> fem.Function:
        """Distance to the master; zero off the slave side."""
        return self._result(self.fields, "gap")

    @property
    def active(self) -> fem.Function:
        """1 where the interface acts, else 0."""
        return self._result(self.fields, "active")

    def gather(self, u: fem.Function) -> Mapping[str, Floats]:
        """Return the slave nodes of all ranks on every rank; collective.

        Returns:
            "X" (n, d) reference and "x" (n, d) current coordinates at u, "pressure", "gap" and
            "active" (n,), ordered by X.

        Raises:
            NoResult: before the first step.
            ValueError: for what is no displacement.
        """
        return self.gather_functions(u, {})

    def gather_functions(
        self, u: fem.Function, more: Mapping[str, fem.Function]
    ) -> Mapping[str, Floats]:
        """Return the same with more Functions; collective."""
        if self.resultants is None or self.fields is None:
            raise NoResult(self, "nodal results")
        mesh = self.fields.pressure.function_space.mesh
        if not isinstance(u, fem.Function) or u.function_space.mesh is not mesh or not u.ufl_shape:
            raise ValueError(f"u is {u!r}: give the displacement, solid.u")
        V, own, d = u.function_space, self.resultants.nodes, len(self.force)
        X = V.tabulate_dof_coordinates()[own, :d]
        functions = {name: getattr(self.fields, name) for name in ("pressure", "gap", "active")}
        functions |= more
        sizes = {name: f.function_space.dofmap.index_map_bs for name, f in functions.items()}
        columns = [X, X + u.x.array.reshape(-1, d)[own]]
        columns += [f.x.array.reshape(-1, sizes[name])[own] for name, f in functions.items()]
        table = np.concatenate(V.mesh.comm.allgather(np.hstack(columns)))
        table = table[np.lexsort(table[:, :d].T[::-1])]
        ends = np.cumsum([d, d, *sizes.values()])[:-1]
        parts = dict(zip(("X", "x", *sizes), np.split(table, ends, axis=1), strict=True))
        return {
            name: part if sizes.get(name, d) > 1 else part[:, 0] for name, part in parts.items()
        }


def full_coverage(sides: Sides) -> Coverage:
    """Return the coverage of slave nodes that all face the master."""
    n = len(sides.nodes)
    faces = np.ones(n, dtype=bool)
    return Coverage(np.ones(n), faces, ~faces)


def _together(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method of a user's kind whose errors on one rank are raised on all; collective.

    When it has returned or failed: where it is collective itself, all ranks have to get to its end.
    """

    @wraps(method)
    def asked(self: Interface, *args: Any, **options: Any) -> Any:
        with raised_together(self.facet_tags.topology.comm), named(f"{self!r}: {name}()"):
            found = method(self, *args, **options)
            _check_returned(f"{self!r}: {name}() returns", name, found, args)
        return found

    return asked


# What kinds of users may write, and what it may return.
_RETURNS: Mapping[str, tuple[type, ...]] = {
    "configuration": (fem.Function, NoneType),
    "find_sides": (Sides,),
    "pair": (tuple,),
    "has_slid": (object,),
    "measure_coverage": (Coverage,),
    "couple": (Coupling,),
    "measured": (PETSc.Vec,),
    "constraints": (Constraints,),
    "limits": (np.ndarray, NoneType),
    "slip_limits": (SlipLimits,),
    "apart_at": (np.ndarray, NoneType),
    "jump_at": (np.ndarray, NoneType),
    "found": (dict,),
    "shown": (np.ndarray,),
    "may_carry": (np.ndarray,),
    "frame": (object,),
    "blocks": (np.ndarray,),
    "keep": (object,),
    "commit": (object,),
    "ended": (object,),
    "take": (object,),
    "warnings": (list,),
    "place": (np.ndarray,),
    "sum_up": (object,),
    "field": (object,),
}


def _check_returned(name: str, method: str, found: object, args: tuple[Any, ...]) -> None:
    """Raise a ValueError unless a method of an interface may return this."""
    kinds = _RETURNS[method]
    if not isinstance(found, kinds):
        wanted = " or ".join("None" if k is NoneType else k.__name__ for k in kinds)
        raise ValueError(f"{name} a {type(found).__name__}: return a {wanted}")
    if isinstance(found, Coupling):
        check_coupling(name, found, args[0], args[2])
    if isinstance(found, Constraints):
        check_constraints(name, found, *args[:2])
    if isinstance(found, SlipLimits):
        check_limits(name, found, args[1].shape[1])


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
