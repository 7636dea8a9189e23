# SPDX-License-Identifier: MIT
"""Rubber bodies that slide far, on structured quadrilaterals.

The meshes are those of an independent program of its own (plane strain, neo-Hooke, the same mortar
method without smooth surfaces), whose forces and numbers of iterations are quoted by the tests.
"""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem, mesh
from dolfinx_mortar.meshing.two_bodies import distribute
from dolfinx_mortar.mortar import common_normals
from tests.cases.meshes import _block
from tests.cases.two_bodies import create_problem, held

COMM = MPI.COMM_WORLD
BLOCK, TOOL = 1, 2
BASE, TOP, ARC, HELD = 1, 2, 3, 4


def averaged(pairing, segments, M, u, *options):
    """Return the averaged normals of the slave, which are those of the independent program."""
    n = common_normals.common_normals(pairing, segments, 0.0 * M, u, *options)
    assert not n.differentiate()[1].any()
    return n


def grid(nx, ny, place):
    """Return nodes and quadrilaterals of the unit square, mapped by place(s, t)."""
    x, cells = _block(np.linspace(0, 1, nx + 1), np.linspace(0, 1, ny + 1), "quadrilateral")
    return np.stack(place(*x.T), axis=1), cells.astype(np.int64)


def half_ring(nt, nr, outer, inner, centre):
    """Return the lower half of a ring."""

    def place(s, t):
        angle, r = np.pi * (1 + s), outer + (inner - outer) * t
        return centre[0] + r * np.cos(angle), centre[1] + r * np.sin(angle)

    return grid(nt, nr, place)


@dataclass
class Bodies:
    """Two bodies and the tags of their cells and facets."""

    mesh: mesh.Mesh
    cells: mesh.MeshTags
    facets: mesh.MeshTags

    @staticmethod
    def of(parts, tag):
        """Create the mesh of two parts (nodes, cells); `tag` is asked (body, x) for each facet."""
        domain, size = distribute(COMM, lambda: parts, "quadrilateral", 1)
        domain.topology.create_connectivity(1, 2)
        own = domain.topology.index_map(2).size_local
        body = np.where(domain.topology.original_cell_index < size, BLOCK, TOOL).astype(np.int32)
        cells = mesh.meshtags(domain, 2, np.arange(own, dtype=np.int32), body[:own])
        facets, to_cell = (
            mesh.exterior_facet_indices(domain.topology),
            domain.topology.connectivity(1, 2),
        )
        of = body[to_cell.array[to_cell.offsets[facets]]]
        values = tag(of, mesh.compute_midpoints(domain, 1, facets)).astype(np.int32)
        on = values > 0
        return Bodies(domain, cells, mesh.meshtags(domain, 1, facets[on], values[on]))


@dataclass
class Indentation:
    """A half ring over a block; its hub and its cut ends follow `held`, the base `base`."""

    problem: dm.ContactProblem
    contact: dm.Contact
    held: fem.Constant
    base: fem.Constant


def indentation(
    *,
    n,
    moduli=(1.0, 10.0),
    slave="tool",
    radius=1.5,
    length=12.0,
    height=4.0,
    start=3.0,
    blocks=(0.0,),
    apart=False,
    strain="finite",
    surface="facets",
    **options,
):
    """Create the case of n cells (along, deep) of the block and of the half ring.

    Blocks start at `blocks`, and belong to one side or are `apart`, with a contact each; the middle
    of the half ring is at x = start. The options are those of the contact.
    """
    parts = [grid(*n[0], lambda s, t, x=x: (x + length * s, height * (t - 1))) for x in blocks]
    count = len(parts[0][0])
    lower = tuple(
        np.concatenate(v)
        for v in zip(*((x, e + k * count) for k, (x, e) in enumerate(parts)), strict=True)
    )
    upper = half_ring(*n[1], radius, 0.4 * radius, (start, radius))

    def tag(body, x):
        away = np.hypot(x[:, 0] - start, x[:, 1] - radius)
        tool = np.where(away > 0.9 * radius, ARC, HELD)
        tool[(x[:, 1] > radius - 1e-9) | (away < 0.45 * radius)] = HELD
        top = TOP + apart * 10 * np.searchsorted(blocks[1:], x[:, 0])
        block = np.select([x[:, 1] > -1e-9, x[:, 1] < 1e-9 - height], [top, BASE], 0)
        return np.where(body == TOOL, tool, block)

    bodies = Bodies.of((lower, upper), tag)
    V = fem.functionspace(bodies.mesh, ("Lagrange", 1, (2,)))
    top, base = (fem.Constant(bodies.mesh, default_scalar_type((0.0, 0.0))) for _ in range(2))
    bcs = [held(V, bodies.facets, BASE, base), held(V, bodies.facets, HELD, top)]
    make = dm.NeoHooke if strain == "finite" else dm.Elastic
    laws = {BLOCK: make(moduli[0], 0.3), TOOL: make(moduli[1], 0.3)}
    tops = [TOP + 10 * k for k in range(len(blocks))] if apart else [TOP]
    sides = [(ARC, top) if slave == "tool" else (top, ARC) for top in tops]
    contacts = [
        dm.Contact(bodies.facets, slave=s, master=m, surface=surface, **options) for s, m in sides
    ]
    problem = create_problem(V, contacts, bcs, laws, bodies.cells, strain=strain)
    return Indentation(problem, contacts[0], top, base)


def walk(case, path, times, **options):
    """Move along path(t); return the time, force on the master and report of each step."""

    def follow(t):
        case.held.value[:] = path(t)

    steps = []
    for step in dm.load_steps(case.problem, times, on_time=follow, **options):
        steps.append((step.time, case.contact.force.copy(), step.report))
    return steps
