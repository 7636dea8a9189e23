# SPDX-License-Identifier: MIT
"""Rigid bodies that touch or hold a side: their pose, loads that drive them, and tools."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

import basix.ufl
import ufl
from dolfinx import default_real_type, fem
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import as_numbers, is_number
from dolfinx_mortar.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.geometry.segments import FACING, Segments
from dolfinx_mortar.interfaces.coupling import Pattern
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, side_heights
from dolfinx_mortar.mortar.passing import SeenByTool
from dolfinx_mortar.mortar.surface import coordinates, facets_at
from dolfinx_mortar.mortar.whole_side import WholeSide
from dolfinx_mortar.shapes import Distance, Shape
from dolfinx_mortar.shapes.shape import check_finite, check_returned, unit_vectors
from dolfinx_mortar.shapes.zero_level import find_zero_level


class Driven(Protocol):
    """A rigid tool or side with m unknown motions, each with a given force; the same on all ranks.

    An interface offers it, see `Interface.driven`, and Newton's method finds the motions, see
    `newton_method.driven_tools`.
    """

    @property
    def holds(self) -> bool:
        """Whether nodes follow it in all directions, rather than touch it."""

    @property
    def names(self) -> Sequence[str]:
        """Names in messages of the m motions, and of the forces that drive them."""

    def loads(self) -> Floats:
        """Return the given forces (m,) on the tool.

        Raises:
            ValueError: for values of Constants that are not finite.
        """

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """Return what one unit of each motion (m, n, d) does at points.

        Args:
            x: (n, d) where they are, X if the geometry is frozen.
            X: (n, d) where they were at the start.
            moved: (m,) amounts of the motions by which it is moved from where it is; what that
                changes is found to first order, or neglected.
        """

    def curve(self, X: Floats, amounts: Floats) -> Floats:
        """Return the difference (n, d) of a motion from its tangent, at points that follow it.

        Asked only of what `holds` nodes.

        Args:
            X: (n, d) where they were at the start.
            amounts: (m,) of the motions.
        """

    def move(self, amounts: Floats) -> None:
        """Move the tool by amounts (m,) of its motions."""


@dataclass(frozen=True)
class Pose:
    """Where a tool is: x = position + R (xi - point) of a point xi of the tool as it starts."""

    position: Floats  # (d,) of the tool's point
    rotation: Floats  # (1,) angle in the plane, (3,) rotation vector in space
    point: Floats  # (d,) where that point starts

    @property
    def R(self) -> Floats:
        """The rotation (d, d)."""
        if len(self.position) == 2:
            c, s = np.cos(self.rotation[0]), np.sin(self.rotation[0])
            return np.array([[c, -s], [s, c]])
        return np.asarray(Rotation.from_rotvec(self.rotation).as_matrix())

    def to_tool(self, x: Floats) -> Floats:
        """Return the points of the tool (n, d) that are at x (n, d)."""
        return (x - self.position) @ self.R + self.point

    def to_space(self, xi: Floats) -> Floats:
        """Return where points of the tool (n, d) are."""
        return (xi - self.point) @ self.R.T + self.position

    def distance(self, shape: Shape, x: Floats) -> Distance:
        """Return the distances of points x (n, d) from the surface of a shape."""
        found, R = shape.distance(self.to_tool(x)), self.R
        return Distance(found.value, found.gradient @ R.T, R @ found.hessian @ R.T)


Load = float | fem.Constant
"""A number, or a scalar Constant."""

PLANE = ("x", "y", "moment")
SPACE = ("x", "y", "z", "moment x", "moment y", "moment z")


def motions_in(d: int) -> tuple[str, ...]:
    """Return the names of a tool's motions, and of the forces that drive them."""
    return SPACE if d > 2 else PLANE


class RigidBody:
    """Position and rotation of a rigid body as Constants, and the loads that drive it instead.

    Attributes:
        point: (d,) about which it turns, where it starts.
        position: Constant (d,), where that point is.
        rotation: Constant, an angle in the plane, a rotation vector (3,) in space.
        revolved: whether the problem is axisymmetric, so that it stays on the axis.
        load: forces and moments about its point that are given, by name, see `motions_in`.
        travel: (3,) or (6,) how far these have moved it, beyond position and rotation.
    """

    holds = False

    def __init__(self, point: Floats) -> None:
        d = len(point)
        self.point, self.revolved = point, False
        cell = "tetrahedron" if d > 2 else "triangle"  # of no mesh
        domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(d,)))
        turn = np.zeros(3) if d > 2 else 0.0
        self.position = fem.Constant(domain, self.point.astype(default_real_type))
        self.rotation = fem.Constant(domain, np.asarray(turn, dtype=default_real_type))
        self.load: Mapping[str, Load] = {}
        self.travel: Floats = np.zeros(len(motions_in(d)))

    def pose(self, travel: Floats | None = None) -> Pose:
        """Return where it is at present, or would be with another travel.

        Raises:
            ValueError: for NaN and infinity, and in an axisymmetric problem off the axis.
        """
        position: Floats = np.array(self.position.value, dtype=np.float64)
        rotation: Floats = np.array(self.rotation.value, dtype=np.float64).reshape(-1)
        for name, value in (("position", position), ("rotation", rotation)):
            if not np.isfinite(value).all():
                raise ValueError(f"{name} is {value.tolist()}: set the Constant to finite numbers")
        if self.revolved and (rotation.any() or position[0] != self.point[0]):
            raise ValueError(
                f"position is {position.tolist()} and rotation {rotation.tolist()}: in an "
                f"axisymmetric problem a tool moves along the axis only, from {self.point.tolist()}"
            )
        d = len(position)
        travel = self.travel if travel is None else travel
        position = position + travel[:d]
        if travel[d:].any():
            rotation = after(rotation, travel[d:])
        return Pose(position, rotation, self.point)

    def check_load(self, load: Any) -> Mapping[str, Load]:
        """Return the given forces by name, in the order of `motions_in`.

        Raises:
            ValueError: for unknown names, and what is no finite number or scalar Constant.
        """
        known = motions_in(len(self.point))
        if load is None:
            return {}
        if not isinstance(load, Mapping) or not load.keys() <= set(known):
            raise ValueError(
                f"load is {load!r}: give a dictionary of forces on the tool by name, of "
                f"{', '.join(map(repr, known))}"
            )
        for name, value in load.items():
            scalar = isinstance(value, fem.Constant) and value.value.shape == ()
            if not (is_number(value) or scalar):
                raise ValueError(
                    f"load[{name!r}] is {value!r}: give a finite number or a scalar Constant, and "
                    "leave out what position and rotation prescribe"
                )
        return {name: load[name] for name in known if name in load}

    def loads(self) -> Floats:
        """Return the present values (m,).

        Raises:
            ValueError: for NaN and infinity, and in an axisymmetric problem other than "y".
        """
        if self.revolved and self.load.keys() - {"y"}:
            raise ValueError(
                f"load is {dict(self.load)!r}: in an axisymmetric problem a tool is driven along "
                "the axis only, {'y': ..}, by the force on all of it"
            )
        values = [float(getattr(value, "value", value)) for value in self.load.values()]
        for name, value in zip(self.load, values, strict=True):
            if not np.isfinite(value):
                raise ValueError(f"load[{name!r}] is {value}: set the Constant to a finite number")
        return np.array(values)

    @property
    def identity(self) -> dict[str, Any]:
        """The point, by which position and rotation say where it is; for checkpoints."""
        return {"reference": self.point.tolist()}

    def given(self) -> dict[str, Any]:
        """Return what all ranks have to give the same, by name."""
        return {name: getattr(self, name) for name in ("point", "position", "rotation", "load")}

    def place(self) -> Floats:
        """Return where its point is (d,), about which moments are given."""
        return self.pose().position

    def state(self, ended: bool) -> dict[str, Floats]:
        """Return what steps change, see `Interface.state`."""
        return {"travel": self.travel}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """Take over what `state` has returned."""
        self.travel = state["travel"]

    @property
    def names(self) -> Sequence[str]:
        """The motions that loads drive, as in `motions_in`."""
        return tuple(self.load)

    @property
    def _driven(self) -> list[int]:
        return [motions_in(len(self.point)).index(name) for name in self.names]

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """Return what one unit of each driven motion (m, n, d) does, see `Driven`."""
        return self.along(x - self.pose().position)

    def curve(self, X: Floats, amounts: Floats) -> Floats:
        """Return 0: nothing follows a tool, see `Driven`."""
        return np.zeros_like(X)

    def along(self, arm: Floats) -> Floats:
        """Return what one unit of each driven motion (m, n, d) does at arms (n, d)."""
        n, d = arm.shape
        every = np.zeros((len(motions_in(d)), n, d))
        every[np.arange(d), :, np.arange(d)] = 1.0
        if d == 2:
            every[2] = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        else:
            every[3:] = np.cross(np.eye(3)[:, None], arm[None])
        return every[self._driven]

    def steps(self, amounts: Floats) -> Floats:
        """Return amounts (m,) of the driven motions as those of all, (3,) or (6,)."""
        step = np.zeros(len(self.travel))
        step[self._driven] = amounts
        return step

    def ahead(self, amounts: Floats) -> Floats:
        """Return the travel (3,) or (6,) with amounts (m,) of the driven motions added."""
        step, d = self.steps(amounts), len(self.point)
        return np.concatenate([self.travel[:d] + step[:d], after(self.travel[d:], step[d:])])

    def move(self, amounts: Floats) -> None:
        """Add amounts (m,) of the driven motions to the travel."""
        self.travel = self.ahead(amounts)


class Movable:
    """The part of an interface with a rigid body that users set and read."""

    rigid: RigidBody

    @property
    def reference(self) -> Floats:
        """Position of its point at the start (d,)."""
        return self.rigid.point

    @property
    def position(self) -> fem.Constant:
        """Position of its point (d,); set its value."""
        return self.rigid.position

    @property
    def rotation(self) -> fem.Constant:
        """Rotation since the start, in radians; set its value.

        An angle in the plane, in space a rotation vector (3,): axis times angle, in radians.
        """
        return self.rigid.rotation

    @property
    def load(self) -> Mapping[str, Load]:
        """Forces and moments on it that are given, by name; may be set anew between steps."""
        return self.rigid.load

    @load.setter
    def load(self, value: Mapping[str, Load] | None) -> None:
        self.rigid.load = self.rigid.check_load(value)

    def state(self, ended: bool) -> dict[str, Floats]:
        """Return how far loads have moved it; of tools, where they were at the last commit, too."""
        return self.rigid.state(ended)

    def restore(self, state: Mapping[str, Floats]) -> None:
        """Take that over."""
        self.rigid.restore(state)

    def driven(self) -> Driven | None:
        """Return the motions that given forces drive; None where all of them are prescribed."""
        return self.rigid if self.load else None

    @property
    def travel(self) -> Floats:
        """Motion by loads in addition to position and rotation, (3,) or (6,).

        Displacement and angle in the plane, displacement and rotation vector in space.
        """
        return self.rigid.travel.copy()


class Asked(Shape):
    """A shape whose distances are checked, and whose errors are those of all ranks.

    It may be the user's, and points differ among ranks: what fails on one of several ranks has to
    wait until all of them ask for `failed`. Until then points there are far from the tool.
    """

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self.alone = True  # on one rank errors need not wait
        self._error: Exception | None = None

    @property
    def point(self) -> Floats:
        """That of the shape."""
        return self.shape.point

    def given(self) -> Mapping[str, Any]:
        """Return the arguments by name."""
        return self.shape.given()

    def distance(self, x: Floats) -> Distance:
        """Return the distances of points x (n, d)."""
        try:
            return check_returned(self.shape, self.shape.distance(x), x)
        except Exception as error:
            self._wait(error)
        n, d = x.shape
        ahead = np.tile(np.eye(d)[0], (n, 1))
        return Distance(np.full(n, self._far(x)), ahead, np.zeros((n, d, d)))

    def values(self, x: Floats) -> Floats:
        """Return phi (n,) alone, at points x (n, d)."""
        try:
            found = self.shape.values(x)
            check_finite(f"{type(self.shape).__name__}: the distance", found, x)
            return found
        except Exception as error:
            self._wait(error)
        return np.full(len(x), self._far(x))

    def failed(self) -> Exception | None:
        """Return the first error on this rank since this was last asked, if any."""
        error, self._error = self._error, None
        return error

    def _wait(self, error: Exception) -> None:
        if self.alone:
            raise error
        self._error = self._error or error

    def _far(self, x: Floats) -> float:
        return 1.0 + float(np.abs(x - self.point).max(initial=0.0))


class Tool(RigidBody):
    """A tool: a shape and its pose.

    Attributes:
        shape: as given.
        asked: its distances.
        began: where it was at the last commit.
        probes: (q, d) points at which distances tell functions from others.
    """

    def __init__(self, shape: Any, reference: Any, d: int) -> None:
        """Check the shape, in d dimensions.

        Raises:
            ValueError: for what is no shape, one of another dimension, and a point that has not d
                finite coordinates.
        """
        if not isinstance(shape, Shape):
            raise ValueError(
                f"shape is {shape!r}: give one of dolfinx_mortar.shapes, such as Plane(point, "
                "normal), or SignedDistance(phi, point)"
            )
        if len(shape.point) != d:
            raise ValueError(
                f"shape is {shape!r}, of {len(shape.point)} coordinates, but the mesh has {d}"
            )
        super().__init__(shape.point.copy() if reference is None else check_point(reference, d))
        self.shape, self.asked = shape, Asked(shape)
        self.began, self.probes = self.pose(), np.zeros((0, d))

    def check(self, d: int, revolved: bool) -> None:
        """Take note of the kinematics.

        Raises:
            ValueError: for a shape that is none in d dimensions, or none of revolution.
        """
        if misfit := self.shape.misfit(d, revolved):
            raise ValueError(f"shape: {misfit}")
        self.revolved = revolved

    def probed(self) -> list[float] | str:
        """Return distances from the shape, or how they fail.

        Before them the largest coordinate, of whose round-off they are.
        """
        try:
            found = [*map(float, self.shape.values(self.probes))]
        except Exception as error:  # which steps will raise where it is of consequence
            return type(error).__name__
        size = float(np.abs(self.probes).max(initial=0.0))
        return [size, *found] if np.isfinite(found).all() else "NaN or infinity"

    def given(self) -> dict[str, Any]:
        """Return the same with the shape, and distances from it."""
        return super().given() | {"shape": self.shape, "distances": self.probed()}

    @property
    def identity(self) -> dict[str, Any]:
        """The point, and distances from the shape where it starts."""
        return super().identity | {"distances": self.probed()}

    def state(self, ended: bool) -> dict[str, Floats]:
        """Return the travel, and where it was at the last commit, or is now for the next one."""
        began = self.pose() if ended else self.began
        return super().state(ended) | {"position": began.position, "rotation": began.rotation}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """Take over what `state` has returned."""
        super().restore(state)
        self.began = Pose(state["position"], state["rotation"], self.point)

    def way(self, before: Floats, after: Floats) -> Floats:
        """Return how far it carries points (n, d) since the last commit.

        The mean of what it does to a point that is there before, and to one that is there after.
        """
        began, now = self.began, self.pose()
        forth = now.to_space(began.to_tool(before)) - before
        back = after - began.to_space(now.to_tool(after))
        return np.asarray(0.5 * (forth + back))

    def turn(self) -> Floats:
        """Return how it has turned since the last commit, see `turn_between`."""
        return turn_between(self.began, self.pose())

    def seen(self) -> SeenByTool:
        """Return how it has seen points since the last commit."""
        began, now, shape = self.began, self.pose(), self.shape
        turn = fewer_turns(self.turn())
        return SeenByTool(
            lambda t, x: on_the_way(began, now, turn, t).to_tool(x), turn, shape.values, shape.point
        )

    def outline(self) -> Outline:
        """Return where it is at present, for pictures and files."""
        return Outline(self.shape, self.pose(), self.revolved)


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


def spun(arm: Floats, rotation: Floats) -> Floats:
    """Return theta x r of arms r (n, d)."""
    if len(rotation) == 1:
        return np.asarray(rotation[0] * np.stack([-arm[:, 1], arm[:, 0]], axis=1))
    return np.asarray(np.cross(rotation, arm))


def turn_between(before: Pose, now: Pose) -> Floats:
    """Return the rotation, an angle (1,) or a vector (3,), from one pose to another one.

    In the plane with whole turns, in space about an axis that does not change, too.
    """
    change = now.rotation - before.rotation
    if len(change) > 1 and np.cross(before.rotation, now.rotation).any():
        return _vector_near(Rotation.from_matrix(now.R @ before.R.T), change)
    return change


def after(rotation: Floats, step: Floats) -> Floats:
    """Return a rotation, an angle (1,) or a vector (3,), followed by another one.

    Whole turns are kept, so that what is turned on and on has no jump.
    """
    if len(rotation) == 1:
        return rotation + step
    turned = Rotation.from_rotvec(step) * Rotation.from_rotvec(rotation)
    return _vector_near(turned, rotation + step)


def _vector_near(turned: Rotation, guess: Floats) -> Floats:
    """Return the vector (3,) of a rotation with those whole turns that are nearest to a guess."""
    found = np.asarray(turned.as_rotvec())
    angle = float(np.linalg.norm(found))
    axis = found / angle if angle > HALF_OF_DIGITS else unit_vectors(guess[None])[1][0]
    turns = np.round((guess @ axis - angle) / (2.0 * np.pi))
    return found if turns == 0.0 else np.asarray(found + 2.0 * np.pi * turns * axis)


def fewer_turns(turn: Floats) -> Floats:
    """Return a rotation with one whole turn at most, in which a tool has been all around."""
    angle, once = float(np.linalg.norm(turn)), 2.0 * np.pi
    return turn if angle < 2.0 * once else turn * ((once + angle % once) / angle)


def on_the_way(before: Pose, now: Pose, turn: Floats, t: float) -> Pose:
    """Return where a tool is at a time from 0 to 1: it turns while its point goes straight ahead.

    Args:
        before: where it is at 0.
        now: where it is at 1.
        turn: between both, as of `turn_between`.
        t: the time.
    """
    if t in (0.0, 1.0):
        return now if t else before
    position = (1.0 - t) * before.position + t * now.position
    return Pose(position, after(before.rotation, t * turn), before.point)


def check_point(given: Any, d: int) -> Floats:
    """Return d finite coordinates; raise a ValueError for anything else."""
    found = as_numbers(given)
    if found is None or found.shape != (d,) or not np.isfinite(found).all():
        raise ValueError(f"reference is {given!r}: give {d} finite coordinates")
    return found


def find_facing(side: WholeSide, pose: Pose, shape: Shape, x: Floats) -> Bools:
    """Return which facets (m,) of this rank face the tool, for nodes at x (n, d).

    Those whose mean normal meets that of the tool at their centre at less than 78 degrees.
    """
    facets = facets_at(side.slave, x)
    tool = pose.distance(shape, facets.x.mean(axis=1)).gradient
    return np.asarray(-(facet_normals(facets) * tool).sum(axis=1) > FACING)


@dataclass(frozen=True)
class SidePattern(Pattern):
    """The pattern of a side alone."""

    side: WholeSide | None = None
    own: SmoothSide | None = None  # for which its facets stand, where they are of second order
    nodal: bool = False  # whether distances are those of nodes, for facets of first order
    faceted: Bools | None = None  # (owned nodes,) where facets are meant that stand for a round one


def point_gaps(
    pattern: SidePattern,
    pose: Pose,
    shape: Shape,
    u: fem.Function | None,
    segments: Segments,
    points: Floats,
) -> tuple[Floats, Distance]:
    """Return the gaps (q,) between a tool and the surface for which facets stand; collective.

    And the distances behind them: of all nodes where they are `nodal`, else of the points.

    Of smooth surfaces of first order they are the distances of the nodes, interpolated: facets
    between nodes on the tool then have none, as the smooth surfaces through the nodes of both.
    Facets of second order bend with u, but those of a mesh with straight cells are straight at X,
    and a side that is round there would meet a round tool with its mid-side or its end nodes alone:
    the smooth surface is nearer by its height.

    Args:
        pose: where the tool is.
        u: displacement, None for X.
        segments: whole facets.
        points: (q, d) their points at X + u.
    """
    assert pattern.side is not None
    slave = pattern.side.slave
    with raised_together(slave.V.mesh.comm):  # what a user's function raises
        if pattern.nodal:
            found = pose.distance(shape, coordinates(slave, u))
            of_nodes = found.value[slave.facets[segments.slave]]
            return np.asarray((segments.N * of_nodes).sum(axis=1)), found
        found = pose.distance(shape, points)
    if pattern.own is None:
        return found.value, found
    heights = side_heights(slave, pattern.own, u, segments.slave, segments.xi_s)
    return found.value - heights, found
