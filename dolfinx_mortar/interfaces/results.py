# SPDX-License-Identifier: MIT
"""Results of a step: resultants, nodal tractions and gaps, merged where slave sides meet."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

from dolfinx import fem, la
from dolfinx_mortar.algebra.parallel import ratio
from dolfinx_mortar.arrays import TINY, Bools, Floats
from dolfinx_mortar.interfaces.coupling import Sides, with_ghosts
from dolfinx_mortar.interfaces.interface import Interface, Resultants
from dolfinx_mortar.interfaces.link import Link
from dolfinx_mortar.mortar.surface import mean_facet_length


def set_results(
    link: Link,
    reaction: Floats,
    known: Floats,
    gap: Floats,
    active: Bools,
    x: Floats,
    growth: Floats,
) -> tuple[float, float]:
    """Set resultants and Functions of an interface; return its `_balances`; collective.

    Args:
        reaction: (n, d) D_jj lambda_j in the frames, at the owned slave nodes; zero in directions
            that are not constrained.
        known: (n, d) friction in directions that are prescribed, as vectors.
        gap: (n,) nodal gaps that may still close; how far a jump opens a tie.
        active: (n,) nodes on which the interface acts.
        x: (owned nodes, d) coordinates at which the forces act.
        growth: (n,) area per D_jj, for what is shown as traction.
    """
    fields = link.interface.fields
    assert fields is not None
    kept: Bools = np.asarray(link.coupling.kept.any(axis=1))
    D = link.coupling.weight
    weight = np.broadcast_to(D, reaction.shape)
    multiplier = np.divide(reaction, weight, out=np.zeros_like(reaction), where=weight > 0)
    forces = np.einsum("nji,nj->ni", link.coupling.rows, reaction)
    link.interface.resultants, balances = _resultants(link, forces, known, multiplier, x)
    traction = np.einsum("nji,nj->ni", link.coupling.rows, multiplier)
    _, choices = D.shape
    if choices > 1:  # components that supports take are those of the nodes around
        traction = np.nan_to_num(_extended(link, traction, link.coupling.kept)[link.nodes])
    normal = np.einsum("ni,ni->n", traction, link.coupling.normals) / np.maximum(growth, TINY)
    _fill(fields.pressure, link, np.where(kept, normal, 0.0), kept)
    fields.pressure.x.array[:] = np.nan_to_num(fields.pressure.x.array)
    _fill(fields.gap, link, gap, kept)
    _fill(fields.active, link, active.astype(np.float64), kept)
    # a node without weight, on the axis, has no multiplier: it carries if its neighbours do
    around = link.coupling.coverage.weightless & (fields.active.x.array[link.nodes] > 0.0)
    fields.active.x.array[:] = 0.0
    fields.active.x.array[link.nodes] = active | around
    fields.active.x.scatter_forward()
    return balances


def set_sliding(
    link: Link, traction: Floats, step_slip: Floats, slip: Floats, status: Floats, energy: Floats
) -> None:
    """Set the results of friction at the owned slave nodes, (n, d) and (n,); collective."""
    interface, nodes = link.interface, link.nodes
    # on the axis, where nothing carries a multiplier, what is closed cannot slide
    on = link.coupling.coverage.weightless & (interface.active.x.array[nodes] > 0.0)
    status = np.where(on, 1.0, status)
    values = traction, step_slip, slip[:, None], status[:, None], energy[:, None]
    for function, at_nodes in zip(interface.functions_of_friction, values, strict=True):
        function.x.array[:] = 0.0
        function.x.array.reshape(-1, at_nodes.shape[1])[nodes] = at_nodes
        function.x.scatter_forward()
    comm = link.sides.V.mesh.comm
    interface.sum_up(comm, nodes)


def _resultants(
    link: Link, forces: Floats, known: Floats, multiplier: Floats, x: Floats
) -> tuple[Resultants, tuple[float, float]]:
    """Return the resultants and balances of what slave nodes exert (n, d) in two parts; collective.

    In the directions that the interface constrains, and the friction in prescribed ones.
    """
    comm, n, d = link.sides.V.mesh.comm, link.sides.n_owned, forces.shape[1]
    f, points = np.zeros((2, n, 3)), np.zeros((n, 3))
    f[:, :, :d], points[:, :d] = link.transpose(forces), x
    if link.interface.rough:
        f[:, :, :d] += link.exert(known)
    if link.sides.master is None:  # what is no part of the mesh takes the same forces
        f[1] = -f[0]
    local = np.array([[-s.sum(axis=0), -np.cross(points, s).sum(axis=0)] for s in f])
    total = comm.allreduce(local, op=MPI.SUM)
    found = Resultants(
        force=total[0, 0, :d],
        moment=total[0, 1],
        master_force=total[1, 0, :d],
        master_moment=total[1, 1],
        multiplier=link.interface.shown(multiplier),
        nodes=link.nodes,
        carries=np.asarray(link.coupling.kept.any(axis=1)),
        place=link.interface.place(),
    )
    return found, _balances(comm, f, points, mean_facet_length(link.sides.slave))


def _balances(comm: MPI.Comm, f: Floats, points: Floats, h: float) -> tuple[float, float]:
    """Return the relative imbalances of forces and of moments of the two sides; collective.

        |sum_j (s_j + t_j)| / S,   |sum_j a_j x (s_j + t_j)| / sum_j |s_j| (|a_j| + h)

    with S = sum_j |s_j|, the middle c = sum_j |s_j| x_j / S and the arms a_j = x_j - c. Sums of
    sizes do not cancel where resultants do, as around a shaft. Arms from the middle are the same
    wherever the origin is, and so is the moment about it, even of forces that do not balance. The
    facet length is for forces at one point.

    Args:
        comm: communicator of the mesh.
        f: (2, n, 3) forces s and t of the slave and the master side at owned nodes.
        points: (n, 3) where they act, x.
        h: mean slave facet length.
    """
    size = np.linalg.norm(f[0], axis=1)
    whole = comm.allreduce(np.append(size @ points, size.sum()), op=MPI.SUM)
    arms, both = points - whole[:3] / np.maximum(whole[3], TINY), f.sum(axis=0)
    scale = size @ np.linalg.norm(arms, axis=1)
    left = [*both.sum(axis=0), *np.cross(arms, both).sum(axis=0), scale]
    total = comm.allreduce(np.array(left), op=MPI.SUM)
    force, moment = (float(np.linalg.norm(v)) for v in (total[:3], total[3:6]))
    return ratio(force, whole[3]), ratio(moment, total[6] + h * whole[3])


def _fill(function: fem.Function, link: Link, values: Floats, kept: Bools) -> None:
    """Set a Function to nodal values on the slave side, zero off it; collective."""
    result = _extended(link, values[:, None], kept[:, None])[:, 0]
    function.x.array[:] = np.where(link.sides.on_slave, result, 0.0)


def _extended(link: Link, values: Floats, kept: Bools) -> Floats:
    """Return nodal values (local nodes, k) of those (n, k) at kept slave nodes (n, k); collective.

    Covered slave nodes without multiplier get the mean of the kept ones on their facets. A kept
    node's value is a traction even if the node is partly covered, because D_jj is its covered
    weight; a removed node has handed its dual function to those neighbours. Nodes beyond the master
    are not-a-number.
    """
    sides, k = link.sides, values.shape[1]
    vector = la.vector(sides.V.dofmap.index_map, 2 * k)
    array = vector.array.reshape(-1, 2, k)
    array[link.nodes] = np.stack([np.where(kept, values, 0.0), kept], axis=1)
    vector.scatter_forward()
    known = array.copy()
    covered = np.zeros(sides.n_owned, dtype=bool)
    covered[link.nodes] = link.coupling.coverage.faces
    facets = sides.slave.nodes[sides.slave.facets]
    array[:] = 0.0
    np.add.at(array, facets, known[facets].sum(axis=1, keepdims=True))
    vector.scatter_reverse(la.InsertMode.add)
    vector.scatter_forward()
    with np.errstate(invalid="ignore"):
        mean = array[:, 0] / array[:, 1]
    extended = np.where(with_ghosts(sides.V, covered)[:, None], mean, np.nan)
    return np.asarray(np.where(known[:, 1] > 0, known[:, 0], extended))


def merge_results(
    sides: Sequence[Sides], interfaces: Sequence[Interface], name: str, function: fem.Function
) -> fem.Function:
    """Fill a Function with results of all interfaces; collective.

    "pressure", "gap", "status", "facing", or of those with friction "traction" and "slip".

    A node on several slave sides has the value of the interface that gave it a multiplier, then of
    the first one in which it faces the master. Off the slave sides, and where a node faces no
    master, the value is 0: "facing" is 1 where a gap of 0 is one, and 0 where there is none.
    """
    n, size = sides[0].n_owned, function.function_space.dofmap.index_map_bs
    merged, best = np.zeros((n, size)), np.full(n, -1)
    for side, interface in zip(sides, interfaces, strict=True):
        nodes = side.nodes
        facing = ~np.isnan(_nodal(interface, "gap", 1)[nodes, 0])
        last = interface.resultants
        claim = np.where(facing, 1 + (np.False_ if last is None else last.carries), 0)
        take = claim > best[nodes]
        best[nodes[take]] = claim[take]
        values = _nodal(interface, name, size)[nodes]
        merged[nodes[take]] = np.where(facing[:, None], values, 0.0)[take]
    function.x.array[: n * size] = merged.ravel()
    function.x.scatter_forward()
    return function


def _nodal(interface: Interface, name: str, size: int) -> Floats:
    """Return nodal values (.., size); "facing" is 1 everywhere once a step has found gaps."""
    assert interface.fields is not None
    gap = interface.fields.gap.x.array
    if name == "facing":
        return np.full((len(gap), 1), float(interface.resultants is not None))
    field = interface.field(name)
    if field is None:
        return np.zeros((len(gap), size))
    return np.asarray(field.x.array.reshape(-1, size))
