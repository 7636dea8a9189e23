# SPDX-License-Identifier: MIT
"""Rigid bodies that touch or hold a side: pose, driving loads, and tools."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import scipy

import basix.ufl
import ufl
from dolfinx import default_real_type, fem
from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common.arguments import FINITE, array, check, check_optional, instance
from dolfinx_mortar.common.arrays import HALF_OF_DIGITS, Bools, Floats, Longs
from dolfinx_mortar.geometry.facets import facet_normals
from dolfinx_mortar.geometry.segments import FACING, Segments
from dolfinx_mortar.interfaces.constraints import FORCE, Force, present_force
from dolfinx_mortar.interfaces.coupling import Pattern
from dolfinx_mortar.mortar.curvature_correction import SmoothSide, side_heights
from dolfinx_mortar.mortar.operators import WholeSide
from dolfinx_mortar.mortar.passing import SeenByTool
from dolfinx_mortar.mortar.surface import coordinates, facets_at
from dolfinx_mortar.shapes import Distance, Shape
from dolfinx_mortar.shapes.shape import check_returned, unit_vectors
from dolfinx_mortar.shapes.zero_level import find_zero_level


@dataclass(frozen=True)
class Pose:
    """Pose of a tool: x = position + R (xi - point) of a point with initial position xi.

    With `linear` rotations R = 1 + theta x.
    """

    position: Floats  # (d,)
    rotation: Floats  # (1,) or (3,) rotation vector
    point: Floats  # (d,) initial position
    linear: bool = False

    @property
    def R(self) -> Floats:
        """Rotation matrix (d, d)."""
        d = len(self.position)
        if self.linear:
            return np.eye(d) + spun(np.eye(d), self.rotation).T
        return _turn(in_space(self.rotation)).as_matrix()[:d, :d]

    def to_tool(self, x: Floats) -> Floats:
        """Initial positions (n, d) of the tool's points at x (n, d)."""
        return (x - self.position) @ self.R + self.point

    def to_space(self, xi: Floats) -> Floats:
        """Present positions of the tool's points (n, d)."""
        return (xi - self.point) @ self.R.T + self.position

    def distance(self, shape: Shape, x: Floats) -> Distance:
        """Checked distances of points (n, d) from a shape."""
        at, R = self.to_tool(x), self.R
        found = check_returned(shape, shape.distance(at), at)
        return Distance(found.value, found.gradient @ R.T, R @ found.hessian @ R.T)


PLANE = ("x", "y", "moment")
SPACE = ("x", "y", "z", "moment x", "moment y", "moment z")


def motions_in(d: int) -> tuple[str, ...]:
    """Names of a tool's motions and their forces."""
    return SPACE if d > 2 else PLANE


class RigidBody:
    """Pose of a rigid body as Constants, and loads that drive m of its motions instead.

    Attributes:
        holds: whether nodes follow it in all directions, as on a rigid side.
        linear: whether rotations are linearised.
        point: (d,) initial position of the reference point.
        position: Constant (d,), position of this point without ``travel``.
        rotation: Constant, an angle in the plane, a rotation vector (3,) in space.
        load: given forces and moments by name.
        travel: (3,) or (6,) additional motion by the loads.
    """

    holds, linear = False, False

    def __init__(self, point: Floats) -> None:
        d = len(point)
        self.point, self.revolved = point, False
        cell = "tetrahedron" if d > 2 else "triangle"
        domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(d,)))
        turn = np.zeros(3) if d > 2 else 0.0
        self.position = fem.Constant(domain, self.point.astype(default_real_type))
        self.rotation = fem.Constant(domain, np.asarray(turn, dtype=default_real_type))
        self.load: Mapping[str, Force] = {}
        self.travel: Floats = np.zeros(len(motions_in(d)))

    def pose(self, travel: Floats | None = None) -> Pose:
        """Present pose, or with another travel; a ValueError for NaN, and off an axis."""
        remedy = "set the Constant to finite numbers"
        position = check("position", self.position.value, FINITE, remedy)
        rotation = check("rotation", self.rotation.value.reshape(-1), FINITE, remedy)
        if self.revolved and (rotation.any() or position[0] != self.point[0]):
            raise ValueError(
                f"position is {position.tolist()} and rotation {rotation.tolist()}: in an "
                f"axisymmetric problem a tool moves along the axis only, from {self.point.tolist()}"
            )
        d = len(position)
        travel = self.travel if travel is None else travel
        turned = self._after(rotation, travel[d:]) if travel[d:].any() else rotation
        return Pose(position + travel[:d], turned, self.point, self.linear)

    def _after(self, rotation: Floats, step: Floats) -> Floats:
        return rotation + step if self.linear else after(rotation, step)

    def check_load(self, load: Any) -> Mapping[str, Force]:
        """Checked forces by name, in the order of `motions_in`."""
        known = motions_in(len(self.point))
        if not isinstance(load, Mapping) or not load.keys() <= set(known):
            raise ValueError(
                f"load is {load!r}: give a dictionary of forces on the tool by name, of "
                f"{', '.join(map(repr, known))}"
            )
        return {k: check(f"load[{k!r}]", load[k], FORCE) for k in known if k in load}

    def loads(self) -> Floats:
        """Present values (m,).

        Raises:
            ValueError: for NaN and infinity, and other than "y" in axisymmetry.
        """
        if self.revolved and self.load.keys() - {"y"}:
            raise ValueError(
                f"load is {dict(self.load)!r}: in an axisymmetric problem a tool is driven along "
                "the axis only, {'y': ..}, by the force on all of it"
            )
        return np.array([present_force(f"load[{name!r}]", v) for name, v in self.load.items()])

    @property
    def identity(self) -> dict[str, Any]:
        """Reference point, for checkpoints."""
        return {"reference": self.point.tolist()}

    def given(self) -> dict[str, Any]:
        """See `Interface.given`."""
        return {name: getattr(self, name) for name in ("point", "position", "rotation", "load")}

    def place(self) -> Floats:
        """Position (d,) of the reference point of moments; the initial one if `linear`."""
        return self.point if self.linear else self.pose().position

    def state(self, ended: bool) -> dict[str, Floats]:
        """See `Interface.state`."""
        return {"travel": self.travel}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """See `Interface.restore`."""
        self.travel = state["travel"]

    @property
    def names(self) -> Sequence[str]:
        """Names (m) of the motions and their forces."""
        return tuple(self.load)

    @property
    def _driven(self) -> list[int]:
        return [motions_in(len(self.point)).index(name) for name in self.names]

    def motions(self, x: Floats, X: Floats, moved: Floats) -> Floats:
        """Displacements (m, n, d) of points by one unit of each motion.

        Points are at x (X if frozen), initially at X (n, d); ``moved`` (m,) is where to linearise.
        """
        return self.along(x - self.pose().position)

    def along(self, arm: Floats) -> Floats:
        """Displacements (m, n, d) by one unit of each motion at arms (n, d)."""
        n, d = arm.shape
        every = np.zeros((len(motions_in(d)), n, d))
        every[np.arange(d), :, np.arange(d)] = 1.0
        every[d:] = [spun(arm, axis) for axis in np.eye(len(every) - d)]
        return every[self._driven]

    def steps(self, amounts: Floats) -> Floats:
        """Amounts (m,) among all motions, (3,) or (6,)."""
        step = np.zeros(len(self.travel))
        step[self._driven] = amounts
        return step

    def ahead(self, amounts: Floats) -> Floats:
        """Travel (3,) or (6,) plus amounts (m,)."""
        (travel, step), d = (self.travel, self.steps(amounts)), len(self.point)
        return np.concatenate([travel[:d] + step[:d], self._after(travel[d:], step[d:])])

    def move(self, amounts: Floats) -> None:
        """Move the body by amounts (m,) of its motions."""
        self.travel = self.ahead(amounts)


class Movable:
    """Interface with a rigid body."""

    rigid: RigidBody

    @property
    def reference(self) -> Floats:
        """Initial position (d,) of the reference point."""
        return self.rigid.point

    @property
    def position(self) -> fem.Constant:
        """Position (d,) of the reference point; set its value."""
        return self.rigid.position

    @property
    def rotation(self) -> fem.Constant:
        """Rotation in radians, an angle or a vector (3,); set its value."""
        return self.rigid.rotation

    @property
    def load(self) -> Mapping[str, Force]:
        """Given forces and moments by name; may be set between steps."""
        return self.rigid.load

    @load.setter
    def load(self, value: Mapping[str, Force] | None) -> None:
        self.rigid.load = self.rigid.check_load({} if value is None else value)

    @property
    def travel(self) -> Floats:
        """Motion by loads, (3,) or (6,)."""
        return self.rigid.travel.copy()


class Tool(RigidBody):
    """A shape and its pose; `began` is the pose at the last commit."""

    def __init__(self, comm: MPI.Comm, shape: Any, reference: Any, d: int) -> None:
        remedy = (
            "give one of dolfinx_mortar.shapes, such as Plane(point, normal), or "
            "SignedDistance(phi, point)"
        )
        check("shape", shape, instance(Shape, remedy))
        if len(shape.point) != d:
            raise ValueError(
                f"shape is {shape!r}, of {len(shape.point)} coordinates, but the mesh has {d}"
            )
        given = check_optional("reference", reference, array((d,)))
        super().__init__(shape.point.copy() if given is None else given)
        self.comm, self.shape = comm, shape
        self.began = self.pose()

    def check(self, d: int, revolved: bool) -> None:
        """Set the kinematics; a ValueError for another kind of shape."""
        if misfit := self.shape.misfit(d, revolved):
            raise ValueError(f"shape: {misfit}")
        self.revolved = revolved

    def distance(self, x: Floats, pose: Pose | None = None) -> Distance:
        """Distances of points (n, d) at present or in another pose; collective."""
        with raised_together(self.comm):
            return (pose or self.pose()).distance(self.shape, x)

    def probed(self) -> list[float] | str:
        """Coordinate of points around the shape's, and distances of these, or how they fail."""
        point, d = self.shape.point, len(self.point)
        size = max(1.0, float(np.abs(point).max()))
        around = point + size * np.vstack([np.eye(d), -np.eye(d)])
        try:
            found = [*map(float, self.shape.values(around))]
        except Exception as error:
            return type(error).__name__
        return [size, *found] if np.isfinite(found).all() else "NaN or infinity"

    def given(self) -> dict[str, Any]:
        """Arguments with the shape and its distances."""
        return super().given() | {"shape": self.shape, "distances": self.probed()}

    @property
    def identity(self) -> dict[str, Any]:
        """Reference point and some distances."""
        return super().identity | {"distances": self.probed()}

    def state(self, ended: bool) -> dict[str, Floats]:
        """See `Interface.state`: also the pose `began`."""
        began = self.pose() if ended else self.began
        return super().state(ended) | {"position": began.position, "rotation": began.rotation}

    def restore(self, state: Mapping[str, Floats]) -> None:
        """See `Interface.restore`."""
        super().restore(state)
        self.began = Pose(state["position"], state["rotation"], self.point)

    def way(self, before: Floats, after: Floats) -> Floats:
        """Motion with the tool since the last commit, mean for points before and after (n, d)."""
        began, now = self.began, self.pose()
        forth = now.to_space(began.to_tool(before)) - before
        back = after - began.to_space(now.to_tool(after))
        return 0.5 * (forth + back)

    def turn(self) -> Floats:
        """Rotation since the last commit, see `turn_between`."""
        return turn_between(self.began, self.pose())

    def seen(self) -> SeenByTool:
        """Motion since the last commit relative to the tool, which moves uniformly."""
        began, now, turn, shape = self.began, self.pose(), self.turn(), self.shape

        def at(t: float, x: Floats) -> Floats:
            position = (1.0 - t) * began.position + t * now.position
            return Pose(position, after(began.rotation, t * turn), began.point).to_tool(x)

        return SeenByTool(at, turn, shape.values, shape.point)

    def cut(self, low: Floats, high: Floats) -> tuple[Floats, Longs]:
        """Points in initial position, and their lines or triangles (m, d), in a box."""
        if (found := self.shape.surface) is not None:
            return found
        if self.revolved:
            low = np.maximum(low, [0.0, -np.inf])
        return find_zero_level(self.shape, low, high)


def _turn(rotation: Floats) -> Any:
    return scipy.spatial.transform.Rotation.from_rotvec(rotation)


def in_space(rotation: Floats) -> Floats:
    """Rotation vector (3,) of an angle (1,) or a vector (3,)."""
    return np.append(np.zeros(3 - len(rotation)), rotation)


def spun(arm: Floats, rotation: Floats) -> Floats:
    """Return theta x r of arms r (n, d)."""
    d = arm.shape[1]
    whole = np.pad(arm, [(0, 0), (0, 3 - d)])
    return np.asarray(np.cross(in_space(rotation), whole)[:, :d], dtype=np.float64)


def turn_between(before: Pose, now: Pose) -> Floats:
    """Rotation (1,) or (3,) between two poses, with whole turns."""
    return after(-before.rotation, now.rotation)


def after(rotation: Floats, step: Floats) -> Floats:
    """Rotation (1,) or (3,) followed by ``step``, with whole turns."""
    near = rotation + step
    if len(near) == 1:
        return near
    found = np.asarray((_turn(step) * _turn(rotation)).as_rotvec())
    angle = float(np.linalg.norm(found))
    axis = found / angle if angle > HALF_OF_DIGITS else unit_vectors(near[None])[1][0]
    turns = np.round((near @ axis - angle) / (2.0 * np.pi))
    return found + 2.0 * np.pi * turns * axis


def find_facing(side: WholeSide, tool: Tool, x: Floats) -> Bools:
    """Facets (m,) that face the tool within 78 degrees, for nodes at x; collective."""
    facets = facets_at(side.slave, x)
    out = tool.distance(facets.x.mean(axis=1)).gradient
    return np.asarray(-(facet_normals(facets) * out).sum(axis=1) > FACING)


@dataclass(frozen=True)
class SidePattern(Pattern):
    """Pattern of a side without a master."""

    side: WholeSide | None = None
    own: SmoothSide | None = None  # for facets of second order
    nodal: bool = False  # distances at nodes, for first order
    faceted: Bools | None = None  # (owned nodes,)


def point_gaps(
    pattern: SidePattern,
    tool: Tool,
    u: fem.Function | None,
    segments: Segments,
    points: Floats,
) -> tuple[Floats, Distance]:
    """Gaps (q,) between a tool and the smooth slave surface, and the distances; collective.

    First order interpolates the distances of nodes; second order subtracts the heights. `points`
    (q, d) are of whole facets at X + u (X for None).
    """
    assert pattern.side is not None
    slave = pattern.side.slave
    found = tool.distance(coordinates(slave, u) if pattern.nodal else points)
    if pattern.nodal:
        of_nodes = found.value[slave.facets[segments.slave]]
        return np.asarray((segments.N * of_nodes).sum(axis=1)), found
    if pattern.own is None:
        return found.value, found
    heights = side_heights(slave, pattern.own, u, segments.slave, segments.xi_s)
    return found.value - heights, found
