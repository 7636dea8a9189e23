# SPDX-License-Identifier: MIT
"""Prediction of a step: transported deformation below a slider, and the gain of the last step.

The deformation below a slider (a dent) moves with it by the sliding path c:

    u(X) <- u(X) + w(X - C) - w(X),   w = u0 - A X,   C = (1 + A)^-1 c,

with the displacement u0 of the last step; prescribed components stay. A X + b is the fit of u0 at
the nodes. The dent is in the body whose motion reduces the overlap.
"""

from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from dolfinx import fem, geometry
from dolfinx.mesh import Mesh
from dolfinx_mortar.algebra.parallel import any_rank, maximum
from dolfinx_mortar.arrays import HALF_OF_DIGITS, QUARTER_OF_DIGITS, TINY, Bools, Floats, Ints
from dolfinx_mortar.compat import cell_nodes, scaled_mesh
from dolfinx_mortar.interfaces.link import nodal_gaps
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.mortar.surface import coordinates, nodal_normals
from dolfinx_mortar.problem.problem import ContactProblem
from dolfinx_mortar.problem.step_data import StepData
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.spaces import with_values
from dolfinx_mortar.supports.bodies import Bodies


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
    closed, began = problem.committed.active & ~_stuck(problem), with_values(problem.V, before)
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
            problem.owned_u[:] += (free * convected(began, problem.bodies, dent)).ravel()
            problem.u.x.scatter_forward()
            found = _overlap(problem)
            if 2.0 * found < left:
                left = found
                break
            problem.owned_u[:] = at
            problem.u.x.scatter_forward()


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
    problem.owned_u[:] += flows.repeat(problem.d) * by
    problem.u.x.scatter_forward()
    for tool, end in zip(driven, np.cumsum(counts), strict=True):
        tool.move(travel[end - len(tool.names) : end])
    return travel


def _stuck(problem: ContactProblem) -> Bools:
    stuck, sliding = np.zeros(problem.n, dtype=bool), problem.committed.sliding
    if sliding is not None:
        for interface, sides in zip(problem.interfaces, problem.system.sides, strict=True):
            if interface.law is not None:
                stuck[sides.nodes] = ~sliding[sides.nodes].any(axis=1)
    return stuck


def _overlap(problem: ContactProblem) -> float:
    with problem.timings("mortar"):
        links = problem.system.at(problem.configuration).links
        gap = np.minimum(nodal_gaps(links, problem.positions(), problem.n), 0.0)
        return float(np.sqrt(problem.comm.allreduce(float(gap @ gap), op=MPI.SUM)))


@dataclass(frozen=True)
class Dent:
    """A group of tied bodies dented by a slider."""

    group: int
    way: Floats  # (d,) path in this step relative to the group


def find_slides(
    system: InterfaceSystem, closed: Bools, bodies: Bodies, carried: Floats, u: fem.Function
) -> list[list[Dent]]:
    """Sides of each sliding contact that may be dented; collective.

    Closed contacts that slide by a facet or more, each side in one group that does not rotate;
    first the group that moves less.

    Args:
        closed: (owned nodes,) closed without stick at the last commit.
        carried: (owned nodes, d) displacement by the supports.
        u: displacement at the start of the step.
    """
    slides, groups, of_nodes = [], bodies.groups, bodies.groups[bodies.label]
    shifts = bodies.mean(carried, np.ones_like(carried, dtype=bool))
    off = np.abs(carried - shifts[bodies.label]).max(axis=1, initial=0.0)
    marks = np.zeros(bodies.count)
    marks[of_nodes[off > HALF_OF_DIGITS * system.facet_length]] = 1.0
    turning = maximum(bodies.V.mesh.comm, *marks)
    for interface, sides in zip(system.interfaces, system.sides, strict=True):
        comm, touching = sides.V.mesh.comm, closed[sides.nodes]
        number = comm.allreduce(int(touching.sum()), op=MPI.SUM)
        if not sides.unilateral or number == 0:
            continue
        found = np.zeros((2, bodies.count))
        for there, on in zip(found, (sides.on_slave, sides.on_master), strict=True):
            there[of_nodes[on[: len(of_nodes)]]] = 1.0
        slave, master = (np.flatnonzero(on) for on in maximum(comm, *found.ravel()).reshape(2, -1))
        if len(slave) != 1 or len(master) > 1 or np.array_equal(slave, master):
            continue
        if turning[[*slave, *master]].any():
            continue
        x = coordinates(sides.slave, u)
        at = x[: len(touching)][touching]
        own = shifts[groups == slave[0]][0]
        if len(master):
            other = shifts[groups == master[0]][0]
        else:
            tool = interface.tool
            ways = np.zeros_like(at) if tool is None else tool.way(at, at)
            other = comm.allreduce(ways.sum(axis=0), op=MPI.SUM) / number
        way = other - own
        if np.linalg.norm(way) < system.facet_length:
            continue
        normals = nodal_normals(sides.slave, x)[: len(touching)][touching]
        normal = comm.allreduce(normals.sum(axis=0), op=MPI.SUM)
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
    return np.asarray(maximum(solid.mesh.comm, *inelastic) == 0.0)


def convected(u: fem.Function, bodies: Bodies, dent: Dent) -> Floats:
    """Return w(X - C) - w(X), (owned nodes, d), on the bodies of a group, else 0; collective."""
    V, d = u.function_space, u.function_space.dofmap.index_map_bs
    n, X, w = len(bodies.label), V.tabulate_dof_coordinates(), fem.Function(V)
    values = np.zeros((n, d))
    for body in np.flatnonzero(bodies.groups == dent.group):
        on = bodies.label == body
        A = mean_gradient(X[:n][on, :d], u.x.array.reshape(-1, d)[:n][on], V.mesh.comm)
        w.x.array[:] = u.x.array - (X[:, :d] @ A.T).ravel()
        way = np.linalg.solve(np.eye(d) + A, dent.way)
        x = X[:n][on]
        x[:, :d] -= way
        cells = np.flatnonzero(bodies.of_cells == body).astype(np.int32)
        moved = values_near(w, cells, x, float(np.linalg.norm(way)))
        values[on] = moved - w.x.array.reshape(-1, d)[:n][on]
    return values


def mean_gradient(X: Floats, u: Floats, comm: MPI.Comm) -> Floats:
    """Gradient A (d, d) of the fit A X + b to displacements u (n, d); collective."""
    d, ones = X.shape[1], np.ones((len(X), 1))
    rows = np.hstack([X, ones, u])
    n, *total = comm.allreduce(np.array([len(X), *rows.sum(axis=0)]), op=MPI.SUM)
    rows = rows - np.array(total) / n
    moments = comm.allreduce(rows.T @ rows, op=MPI.SUM)
    return np.asarray(np.linalg.solve(moments[:d, :d], moments[:d, d + 1 :]).T)


def values_near(u: fem.Function, cells: Ints, points: Floats, reach: float) -> Floats:
    """Values u (p, d) at points (p, 3), or at nearest points within reach; collective."""
    V, comm = u.function_space, u.function_space.mesh.comm
    x = V.mesh.geometry.x[cell_nodes(V.mesh)[cells].ravel()]
    margin = (1.0 + QUARTER_OF_DIGITS) * reach
    ends = x.min(axis=0, initial=np.inf) - margin, x.max(axis=0, initial=-np.inf) + margin
    near = [((points >= a) & (points <= b)).all(axis=1) for a, b in comm.allgather(ends)]
    asked = comm.alltoall([points[on] for on in near])
    found = comm.alltoall([_nearest_values(u, cells, p) for p in asked])
    least, result = np.full(len(points), np.inf), np.zeros((len(points), V.dofmap.index_map_bs))
    for on, (distances, values) in zip(near, found, strict=True):
        nearer = distances < least[on]
        where = np.flatnonzero(on)[nearer]
        least[where], result[where] = distances[nearer], values[nearer]
    return result


def _nearest_values(u: fem.Function, cells: Ints, points: Floats) -> tuple[Floats, Floats]:
    """Distances (p,) of points from this rank's cells, and u (p, d) there."""
    mesh, d = u.function_space.mesh, u.function_space.dofmap.index_map_bs
    if not len(cells) or not len(points):
        return np.full(len(points), np.inf), np.zeros((len(points), d))
    # dolfinx has an absolute tolerance of 1e-6: scale cells to size one
    size = np.ptp(mesh.geometry.x[cell_nodes(mesh)[cells]], axis=1).max()
    scale = float(2.0 ** -np.round(np.log2(size)))
    distances, nearest, at = _nearest_points(scaled_mesh(mesh, scale), cells, scale * points)
    values = u.eval(at / scale, nearest).reshape(-1, d)
    return np.asarray(distances / scale), np.asarray(values)


def _nearest_points(mesh: Mesh, cells: Ints, points: Floats) -> tuple[Floats, Ints, Floats]:
    """Distances (p,) from this rank's cells, these, and points in them."""
    tdim, corners = mesh.topology.dim, cell_nodes(mesh)
    tree = geometry.bb_tree(mesh, tdim, entities=cells)
    inside = geometry.compute_collisions_points(tree, points)
    inside = geometry.compute_colliding_cells(mesh, inside, points)
    some = np.diff(inside.offsets) > 0
    nearest = np.zeros(len(points), dtype=np.int32)
    nearest[some] = inside.array[inside.offsets[:-1][some]]
    middles = geometry.create_midpoint_tree(mesh, tdim, cells)
    nearest[~some] = geometry.compute_closest_entity(tree, middles, mesh, points[~some])
    squared = geometry.squared_distance(mesh, tdim, nearest, points)  # type: ignore[arg-type]
    distances: Floats = np.sqrt(squared)
    at = points.copy()
    for k in np.flatnonzero(distances > 0.0):
        at[k] += geometry.compute_distance_gjk(mesh.geometry.x[corners[nearest[k]]], points[k])
    return distances, nearest, at
