# SPDX-License-Identifier: MIT
"""Prediction of a step: transported deformation below a slider, and the gain of the last step.

The deformation below a slider (a dent) moves with it by the sliding path c:

    u(X) <- u(X) + w(X - C) - w(X),   w = u0 - A X,   C = (1 + A)^-1 c,

with the displacement u0 of the last step; prescribed components stay. A X + b is the fit of u0 at
the nodes. The dent is in the body whose motion reduces the overlap.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from dolfinx import fem
from dolfinx_mortar.algebra.parallel import any_rank, largest, maximum
from dolfinx_mortar.common.arrays import TINY, Bools, Floats
from dolfinx_mortar.common.spaces import with_values
from dolfinx_mortar.interfaces.link import nodal_gaps
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.mortar.surface import coordinates, nodal_normals
from dolfinx_mortar.problem.checks import StepData
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.solid.supports import Bodies


def predict(
    problem: ContactProblem, data: StepData, level: float | None, before: Floats
) -> StepData:
    """Predict u at the end of a step; return the data with the motion of tools; collective.

    `before` (n,) is u before the rigid motion with the supports.
    """
    _convect(problem, problem.owned_u - before, before)
    data = replace(data, begun=problem.owned_u.copy())
    if level is None or data.flows:
        return data
    return replace(data, travel=_go_on(problem, level, data.target))


def _convect(problem: ContactProblem, carried: Floats, before: Floats) -> None:
    """Move the deformation of a side by which the overlap halves; collective."""
    if problem.solid.strain == "small" or problem.geometry == "reference":
        return
    closed, sliding = problem.committed.active.copy(), problem.committed.sliding
    for interface, sides in zip(problem.interfaces, problem.system.sides, strict=True):
        if interface.law is not None and sliding is not None:
            closed[sides.nodes] &= sliding[sides.nodes].any(axis=1)
    began = with_values(problem.V, before)
    given = problem.bodies, carried.reshape(problem.X.shape), began
    slides = find_slides(problem.system, closed, *given)
    if not slides:
        return
    elastic, free = elastic_groups(problem.solid, problem.bodies), ~problem.supports.owned
    left = _overlap(problem)
    for dents in slides:
        for dent in dents:
            if not elastic[dent.group]:
                continue
            at = problem.owned_u.copy()
            problem.move(at + (free * convected(began, problem.bodies, dent)).ravel())
            found = _overlap(problem)
            if 2.0 * found < left:
                left = found
                break
            problem.move(at)


def _go_on(problem: ContactProblem, level: float, target: Floats) -> Floats | None:
    """Add the scaled gain of the last step; return the motion (m,) of tools; collective.

    On flowing bodies only.
    """
    gained, tools = problem.committed.gained, [i.driven() for i in problem.interfaces]
    if gained is None or problem.solid.strain == "small":
        return None
    driven = [tool for tool in tools if tool is not None]
    share = (level - problem.committed.level) / gained.duration
    counts = [len(tool.names) for tool in driven]
    if not 0.0 < share <= 2.0 or sum(counts) != len(gained.travel):
        return None
    elastic = elastic_groups(problem.solid, problem.bodies)
    flows = ~elastic[problem.bodies.groups[problem.bodies.label]]
    if not any_rank(problem.comm, flows.any())[0]:
        return None
    travel, held = share * gained.travel, problem.supports.owned.ravel()
    by = np.where(held, target - problem.owned_u, share * gained.by)
    problem.move(problem.owned_u + flows.repeat(problem.d) * by)
    parts = np.split(travel, np.cumsum(counts, dtype=int))[:-1]
    for tool, own in zip(driven, parts, strict=True):
        tool.move(own)
    return travel


def _overlap(problem: ContactProblem) -> float:
    with problem.timings("mortar"):
        links = problem.system.at(problem.configuration).links
        gap = np.minimum(nodal_gaps(links, problem.positions(), problem.n), 0.0)
        return float(np.sqrt(problem.comm.allreduce(float(gap @ gap))))


@dataclass(frozen=True)
class Dent:
    """A group of tied bodies dented by a slider."""

    group: int
    way: Floats  # (d,) path in this step relative to the group


def find_slides(
    system: InterfaceSystem, closed: Bools, bodies: Bodies, carried: Floats, u: fem.Function
) -> list[list[Dent]]:
    """Sides of each sliding contact that may be dented; collective.

    Closed contacts that slide by a facet or more, each side in one group; first the group that
    moves less.

    Args:
        closed: (owned nodes,) closed without stick at the last commit.
        carried: (owned nodes, d) displacement by the supports.
        u: displacement at the start of the step.
    """
    slides, groups, of_nodes = [], bodies.groups, bodies.groups[bodies.label]
    shifts = bodies.mean(carried, np.ones_like(carried, dtype=bool))
    for interface, sides in zip(system.interfaces, system.sides, strict=True):
        comm, touching = sides.V.mesh.comm, closed[sides.nodes]
        number = comm.allreduce(int(touching.sum()))
        if not sides.unilateral or number == 0:
            continue
        found = np.zeros((2, bodies.count))
        for there, on in zip(found, (sides.on_slave, sides.on_master), strict=True):
            there[of_nodes[on[: len(of_nodes)]]] = 1.0
        slave, master = (np.flatnonzero(on) for on in maximum(comm, *found.ravel()).reshape(2, -1))
        if len(slave) != 1 or len(master) > 1 or np.array_equal(slave, master):
            continue
        x = coordinates(sides.slave, u)
        at = x[: len(touching)][touching]
        own = shifts[groups == slave[0]][0]
        if len(master):
            other = shifts[groups == master[0]][0]
        else:
            tool = interface.tool
            ways = np.zeros_like(at) if tool is None else tool.way(at, at)
            other = comm.allreduce(ways.sum(axis=0)) / number
        way = other - own
        normals = nodal_normals(sides.slave, x)[: len(touching)][touching]
        normal = comm.allreduce(normals.sum(axis=0))
        way = way - (way @ normal) * normal / max(normal @ normal, TINY)
        if np.linalg.norm(way) >= system.facet_length:
            dents = [Dent(int(slave[0]), way), *(Dent(int(m), -way) for m in master)]
            slides.append(dents if own @ own <= other @ other else dents[::-1])
    return slides


def elastic_groups(solid: Solid, bodies: Bodies) -> Bools:
    """Groups without internal variables, which would stay at X; collective."""
    inelastic = np.zeros(bodies.count)
    for region in solid.regions:
        if region.law.state:
            owned = region.cells[region.cells < len(bodies.of_cells)]
            inelastic[bodies.groups[bodies.of_cells[owned]]] = 1.0
    return maximum(solid.mesh.comm, *inelastic) == 0.0


def convected(u: fem.Function, bodies: Bodies, dent: Dent) -> Floats:
    """Return w(X - C) - w(X), (owned nodes, d), on the bodies of a group, else 0; collective.

    Between nodes w is interpolated by radial functions, beyond the body extrapolated; ranks send
    the nodes that are near the points X - C of another rank.
    """
    V, n, d = u.function_space, len(bodies.label), u.function_space.dofmap.index_map_bs
    comm, dim, moved = V.mesh.comm, V.mesh.topology.dim, np.zeros((n, d))
    X, values = V.tabulate_dof_coordinates()[:n, :d], u.x.array.reshape(-1, d)[:n]
    cells = np.arange(V.mesh.topology.index_map(dim).size_local, dtype=np.int32)
    cell = largest(comm, V.mesh.h(dim, cells))
    for body in np.flatnonzero(bodies.groups == dent.group):
        on = bodies.label == body
        x, w = X[on], values[on]
        count, middle = comm.allreduce(len(x)), comm.allreduce(x.sum(axis=0))
        G = np.column_stack([x - middle / count, np.ones(len(x))])
        fit = np.linalg.lstsq(*(comm.allreduce(G.T @ v) for v in (G, w)))[0]
        A = fit[:d].T
        w = w - x @ A.T
        way = np.linalg.solve(np.eye(d) + A, dent.way)
        margin = np.linalg.norm(way) + 2.0 * cell
        box = x.min(axis=0, initial=np.inf) - way, x.max(axis=0, initial=-np.inf) - way
        near = [
            ((x > low - margin) & (x < high + margin)).all(axis=1)
            for low, high in comm.allgather(box)
        ]
        there = comm.alltoall([(x[to], w[to]) for to in near])
        if len(x):
            known = (np.concatenate(part) for part in zip(*there, strict=True))
            at = scipy.interpolate.RBFInterpolator(*known, neighbors=3**d, kernel="linear")
            moved[on] = at(x - way) - w
    return moved
