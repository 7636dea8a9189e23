# SPDX-License-Identifier: MIT
"""Near bodies, for proposals of contacts and warnings about missing ones."""

from mpi4py import MPI

import numpy as np

from dolfinx import fem
from dolfinx_mortar.arrays import Bools, Floats, Longs
from dolfinx_mortar.geometry.facets import facet_sizes
from dolfinx_mortar.geometry.flat import bounds, near_others
from dolfinx_mortar.interfaces.system import InterfaceSystem
from dolfinx_mortar.mortar.facing_bodies import Facing, Skin, find_facing
from dolfinx_mortar.supports.bodies import Bodies, name_of


def are_near(facing: Facing, within: float | None) -> Bools:
    """Mask (p,) of pairs of facets `within` a distance, default the diameter of the larger."""
    reach = facing.size.max(axis=1, initial=0.0) if within is None else within
    return np.asarray(facing.distance <= reach)


def boxes_of(comm: MPI.Comm, x: Floats, body: Longs, count: int) -> Floats:
    """Boxes (count, 2, d) of bodies from facets x (m, k, d) of bodies (m,); collective."""
    boxes = np.full((count, 2, x.shape[2]), np.inf)
    low, high = bounds(x)
    np.minimum.at(boxes[:, 0], body, low)
    np.minimum.at(boxes[:, 1], body, -high)
    comm.Allreduce(MPI.IN_PLACE, boxes, op=MPI.MIN)
    boxes[:, 1] *= -1.0
    return boxes


def warnings_on_neighbours(
    bodies: Bodies, system: InterfaceSystem, at: fem.Function | None
) -> list[str]:
    """Warning for each pair of near bodies (`find_pairs`) without an interface; collective."""
    coupled = _coupled(bodies, system)
    if (coupled | np.eye(bodies.count, dtype=bool)).all():
        return []
    comm = bodies.V.mesh.comm
    facets = system.boundary.at(at)
    part = bodies.of_cells[system.boundary.cells].astype(np.int64)
    largest = comm.allreduce(float(facet_sizes(facets.x).max(initial=0.0)), op=MPI.MAX)
    boxes = boxes_of(comm, facets.x, part, bodies.count)
    boxes += np.array([-largest, largest])[:, None]
    skin = Skin(facets, part, np.zeros((len(part), 0), dtype=np.int64))
    found = find_facing(comm, skin, near_others(facets.x, part, boxes))
    found = found[are_near(found, None)]
    pairs = np.sort(found.part, axis=1)
    rows: Floats = np.column_stack([pairs, found.distance, found.place])
    rows = rows[~coupled[pairs[:, 0], pairs[:, 1]]]
    nearest = _nearest(np.concatenate(comm.allgather(_nearest(rows))))
    return [_warning(bodies, *map(int, row[:2]), *row[2:].tolist()) for row in nearest]


def _nearest(rows: Floats) -> Floats:
    rows = rows[np.lexsort(rows.T[::-1])]
    return rows[np.unique(rows[:, :2], axis=0, return_index=True)[1]]


def _coupled(bodies: Bodies, system: InterfaceSystem) -> Bools:
    """Mask (bodies, bodies) of coupled bodies; collective."""
    found = np.zeros((bodies.count, bodies.count))
    n = len(bodies.label)
    for sides in system.sides:
        if sides.master is not None:
            on = [np.unique(bodies.label[mark[:n]]) for mark in (sides.on_slave, sides.on_master)]
            both = [
                np.unique(np.concatenate(each))
                for each in zip(*bodies.V.mesh.comm.allgather(on), strict=True)
            ]
            found[np.ix_(*both)] = 1.0
    return np.asarray((found + found.T) > 0.0)


def _warning(bodies: Bodies, one: int, other: int, distance: float, *place: float) -> str:
    who = " and ".join(name_of(bodies, [k]) for k in (one, other))
    where = f"({', '.join(f'{x:.4g}' for x in place)})"
    how = f"are {distance:.3g} apart" if distance >= 0.0 else f"overlap by {-distance:.3g}"
    return (
        f"{who} {how} around {where}, and no interface couples them: give them a Contact if they "
        "can touch (dm.find_pairs proposes one)"
    )
