# SPDX-License-Identifier: MIT
"""Solve one plastic contact step on any number of ranks and write its numbers; see test_ranks."""

import json
import sys

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from tests.cases import friction as friction_case
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.pressed_blocks import PressedBlocks

STEEL = dm.VonMises(E=206_900.0, nu=0.29, Y=450 * np.sqrt(2 / 3), a=10_000.0)


def gather(problem):
    """Return the displacements (n, 2 d) of all nodes with their coordinates, ordered."""
    V = problem.V
    n = V.dofmap.index_map.size_local
    d = V.mesh.geometry.dim
    X = V.tabulate_dof_coordinates()[:n, :d]
    u = problem.u.x.array[: d * n].reshape(-1, d)
    # nodes of the two bodies may lie at one place: the displacement tells them apart
    table = np.concatenate(V.mesh.comm.allgather(np.hstack([X, u])))
    return table[np.lexsort(np.round(table, 9).T[::-1])].tolist()


def blocks(partition, kind=dm.Contact):
    """Press two blocks with oblique load on each other, or pull them, on a given partition."""
    case = PressedBlocks(
        n_lower=(8, 6), n_upper=(9, 7), x_upper=(0.1, 0.8), jitter=0.4, partition=partition
    )
    case.top.value[0] = 0.001
    contact = kind(case.facets, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    problem = case.problem([contact], law=STEEL)
    judged = dm.newton(problem, rtol=1e-11).certificate
    surface = contact.gather(problem.u)
    return {
        "force": contact.force.tolist(),
        "moment": [float(contact.moment[2])],
        "pressure": surface["pressure"].tolist(),
        "displacement": gather(problem),
        **{name: getattr(judged, name) for name in LEFT_OUT},
    }


def friction(cell, partition):
    """Press a block and push it, until some of it slips, with updated geometry."""
    case = friction_case.create(
        cell, friction=0.3, geometry="updated", mesh_options={"partition": partition}
    )
    rest = (0.002,) if cell == "hexahedron" else ()
    for way in (0.0, 0.02, 0.003):
        case.solve(way, *rest, -0.01, rtol=1e-11)
    nodes = case.contact.gather(case.problem.u)
    # tabulated coordinates differ by round-off, which must not change the order
    order = np.lexsort(np.round(nodes["X"], 9).T[::-1])
    return {
        "force": case.contact.force.tolist(),
        "moment": case.contact.moment.tolist(),
        "displacement": gather(case.problem),
        "dissipation": case.contact.dissipation,
        **{name: nodes[name][order].tolist() for name in FRICTION},
    }


LEFT_OUT = ("left_out_strain", "left_out_work", "left_out_lengths", "rotation")
FRICTION = ("pressure", "traction", "step_slip", "slip", "status")

if __name__ == "__main__":
    # on one rank all partitions are the same
    results = {name: blocks(name) for name in ("graph", "shared_facet", "stripes", "bodies")}
    results |= {"tie": blocks("empty", dm.Tie)}
    for cell, names in (("triangle", ("graph", "empty")), ("hexahedron", ("empty",))):
        results |= {f"{cell} {name} friction": friction(cell, name) for name in names}
    if MPI.COMM_WORLD.rank == 0:
        with open(sys.argv[1], "w") as file:
            json.dump(results, file)
