# SPDX-License-Identifier: MIT
"""Three bodies: stacks, nodes that are slave and master, second claims and cycles, all exact."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices, locate_entities_boundary, meshtags
from tests.cases.meshes import _block, create_distributed
from tests.cases.mortar import largest
from tests.cases.two_bodies import create_problem, held

E, NU, P = 1000.0, 0.3, 10.0
EXACT = 1e-10
COMM = MPI.COMM_WORLD


def create_blocks(blocks):
    """Return a mesh of rectangles given as (x lines, y lines), and the block of each cell."""
    parts = [_block(np.asarray(x, float), np.asarray(y, float), "triangle") for x, y in blocks]
    offsets, counts = (np.cumsum([0] + [len(p[k]) for p in parts]) for k in (0, 1))
    cells = np.concatenate([c + o for (_, c), o in zip(parts, offsets, strict=False)])
    points = np.concatenate([points for points, _ in parts])
    mesh = create_distributed(COMM, points, cells, "triangle")
    block = np.searchsorted(counts, mesh.topology.original_cell_index, side="right") - 1
    return mesh, block


def tag_facets(mesh, block, marks):
    """Tag facets given as tag: (block or None, function of x)."""
    mesh.topology.create_connectivity(1, 2)
    cell = mesh.topology.connectivity(1, 2)
    exterior = exterior_facet_indices(mesh.topology)
    owner = np.full(exterior.max(initial=-1) + 1, -1)
    owner[exterior] = [block[cell.links(f)[0]] for f in exterior]
    found, values = [], []
    for tag, (number, where) in marks.items():
        facets = np.intersect1d(locate_entities_boundary(mesh, 1, where), exterior)
        facets = facets if number is None else facets[owner[facets] == number]
        found.append(facets)
        values.append(np.full(len(facets), tag, dtype=np.int32))
    found, values = np.concatenate(found).astype(np.int32), np.concatenate(values)
    order = np.argsort(found)
    return meshtags(mesh, 1, found[order], values[order])


def at(y, low=-1.0, high=9.0):
    return lambda x: np.isclose(x[1], y) & (x[0] > low - 1e-9) & (x[0] < high + 1e-9)


def press(mesh, tags, interfaces):
    """Press on tag 2 with P; check the uniaxial stress state and return problem and report."""
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    exact, u = fem.Function(V), fem.Function(V)
    strain = P / E * np.array([NU * (1 + NU), NU**2 - 1])[:, None]
    exact.interpolate(lambda x: strain * x[:2])
    bcs = []
    for component, tag in ((1, 1), (0, 5)):
        spaces = V.sub(component), V.sub(component).collapse()[0]
        dofs = fem.locate_dofs_topological(spaces, 1, tags.find(tag))
        value = exact.sub(component).collapse()
        bcs.append(fem.dirichletbc(value, dofs, spaces[0]))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    loads = -fem.Constant(mesh, P) * ufl.TestFunction(V)[1] * ds(2)
    options = {"loads": loads, "geometry": "reference"}
    problem = create_problem(u, interfaces(tags), bcs, dm.Elastic(E, NU), **options)
    report = dm.newton(problem, rtol=1e-11)
    assert largest(u.x.array - exact.x.array) < EXACT * largest(exact.x.array)
    for link in problem.system.links:
        on = link.coupling.kept.any(axis=1)
        pressure = link.interface.pressure.x.array[link.nodes[on]]
        assert np.abs(pressure - P).max(initial=0.0) < 1e-9 * P
    return problem, report


COLUMNS = [np.linspace(0, 1, n) for n in (4, 6, 5)]


def stack(kinds, slaves):

    def create(tags):
        sides = [(20, 11), (21, 12)]
        return [
            kind(tags, slave=pair[s == "upper"], master=pair[s == "lower"])
            for kind, pair, s in zip(kinds, sides, slaves, strict=True)
        ]

    return create


@pytest.mark.parametrize("below", ["lower", "upper"])
@pytest.mark.parametrize("above", ["lower", "upper"])
@pytest.mark.parametrize("kinds", [(dm.Contact, dm.Contact), (dm.Contact, dm.Tie)])
def test_stack(kinds, below, above):
    """Three blocks in a stack, the middle one slave above and master below, and all others."""
    mesh, block = create_blocks([(x, np.linspace(k, k + 1, 4)) for k, x in enumerate(COLUMNS)])
    marks = {1: (0, at(0.0)), 2: (2, at(3.0)), 5: (None, lambda x: np.isclose(x[0], 0))}
    marks |= {20: (0, at(1.0)), 11: (1, at(1.0)), 21: (1, at(2.0)), 12: (2, at(2.0))}
    tags = tag_facets(mesh, block, marks)
    problem, _ = press(mesh, tags, stack(kinds, (below, above)))
    for interface in problem.interfaces:
        assert np.isclose(abs(interface.force[1]), P, rtol=1e-9)


def beside(left, right):
    """Return a lower block of length 2, two blocks beside each other on it, and the tags."""
    lines = [np.linspace(0, 2, 6), left, right]
    lines[0] = np.sort(np.append(lines[0], 1.0))
    heights = [np.linspace(0, 1, 4), np.linspace(1, 2, 3), np.linspace(1, 2, 4)]
    mesh, block = create_blocks(zip(lines, heights, strict=True))
    # upper blocks slide along the line between them, too
    marks = {1: (0, at(0.0)), 2: (None, at(2.0)), 11: (1, at(1.0)), 12: (2, at(1.0))}
    marks |= {20: (0, at(1.0, 0, 1)), 21: (0, at(1.0, 1, 2))}
    marks[5] = (None, lambda x: np.isclose(x[0], 0) | np.isclose(x[0], 1) & (x[1] > 1 - 1e-9))
    return mesh, tag_facets(mesh, block, marks)


BESIDE = {
    # which side is slave left and right: the node at x = 1 is ...
    "slave and master": ((20, 11), (12, 21)),
    "master and slave": ((11, 20), (21, 12)),
    "slave twice": ((20, 11), (21, 12)),
    "master twice": ((11, 20), (12, 21)),
}


@pytest.mark.mpi
@pytest.mark.parametrize("case", BESIDE)
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_two_blocks_on_one(case, kind):
    """A node of the lower block belongs to both interfaces, as slave, master or both."""
    mesh, tags = beside(np.linspace(0, 1, 5), np.linspace(1, 2, 4))

    def create(tags):
        return [kind(tags, slave=s, master=m) for s, m in BESIDE[case]]

    problem, _ = press(mesh, tags, create)
    assert not problem.system.present.claims.notes  # nothing is lost
    for interface in problem.interfaces:
        assert np.isclose(abs(interface.force[1]), P, rtol=0.35)
    total = sum(abs(i.force[1]) for i in problem.interfaces)
    assert np.isclose(total, 2 * P, rtol=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
@pytest.mark.parametrize(
    ("end", "between"), [(1.0, None), (1.05, 21), (1.1, 21), (1.3, 21), (0.95, 20), (0.9, 20)]
)
def test_slave_and_master_divided_at_different_places(kind, end, between):
    """At 1 and at other places: facets that face the other interface's master are told of."""
    lines, heights = (np.linspace(0, 2, n) for n in (21, 41)), ([0, 0.5, 1], [1, 1.5, 2])
    mesh, block = create_blocks(zip(lines, heights, strict=True))
    marks = {1: (0, at(0.0)), 2: (1, at(2.0))}
    marks |= {20: (0, at(1.0, 0, 1)), 21: (0, at(1.0, 1, 2))}
    marks |= {11: (1, at(1.0, 0, end)), 12: (1, at(1.0, end, 2))}
    tags = tag_facets(mesh, block, marks)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    both = [kind(tags, slave=20, master=11), kind(tags, slave=21, master=12)]
    bcs = [held(V, tags, 1), held(V, tags, 2)]
    said = create_problem(V, both, bcs).audit().warnings
    said = [note for note in said if "divide slave and master at the same place" in note]
    assert len(said) == (between is not None)
    assert all(note.startswith(repr(both[between - 20])) for note in said)
    assert all(repr(one) in note for note in said for one in both)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_cycle(kind):
    """Slave on the left and master on the right: each depends on the nodes of the other one."""
    lines = np.linspace(0, 2, 7)[[0, 1, 2, 4, 5, 6]], np.linspace(0, 2, 9)[[0, 1, 2, 3, 5, 6, 7, 8]]
    lines = [np.sort(np.append(x, 1.0)) for x in lines]
    heights = [np.linspace(0, 1, 4), np.linspace(1, 2, 4)]
    mesh, block = create_blocks(zip(lines, heights, strict=True))
    marks = {1: (0, at(0.0)), 2: (1, at(2.0)), 5: (None, lambda x: np.isclose(x[0], 0))}
    marks |= {20: (0, at(1.0, 0, 1)), 21: (0, at(1.0, 1, 2))}
    marks |= {11: (1, at(1.0, 0, 1)), 12: (1, at(1.0, 1, 2))}
    tags = tag_facets(mesh, block, marks)

    def create(tags):
        return [kind(tags, slave=20, master=11), kind(tags, slave=12, master=21)]

    problem, _ = press(mesh, tags, create)
    assert any("cycle" in note for note in problem.system.present.claims.notes)


@pytest.mark.mpi
@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_one_slave_side_against_two_masters(kind):
    """Each slave node belongs to the interface whose master it faces; the pressure stays exact."""
    mesh, tags = beside(np.linspace(0, 1, 5), np.linspace(1, 2, 4))
    values = np.where(tags.values == 21, 20, tags.values)  # the whole lower side
    tags = meshtags(mesh, 1, tags.indices, values)

    def create(tags):
        return [kind(tags, slave=20, master=master) for master in (11, 12)]

    problem, _ = press(mesh, tags, create)
    for interface in problem.interfaces:
        assert np.isclose(abs(interface.force[1]), P, rtol=0.35)
    assert np.isclose(sum(abs(i.force[1]) for i in problem.interfaces), 2 * P, rtol=1e-9)
    kept = sum(int(link.coupling.kept.any(axis=1).sum()) for link in problem.system.links)
    assert COMM.allreduce(kept) == 7  # every node of the lower side once
