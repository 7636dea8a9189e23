# SPDX-License-Identifier: MIT
"""Three bodies: stacks, nodes that are slave and master, second claims and cycles, all exact."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints, meshtags
from tests.cases.block_piles import create_blocks
from tests.cases.mortar import largest
from tests.cases.two_bodies import create_problem, held

E, NU, P = 1000.0, 0.3, 10.0
EXACT = 1e-10
COMM = MPI.COMM_WORLD
KINDS = pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])


def divide(mesh, tags, *cuts):
    """Return tags that are larger by 100 on the facets of some tags beyond some x."""
    x, values = compute_midpoints(mesh, 1, tags.indices)[:, 0], tags.values.copy()
    for tag, end in cuts:
        values[(tags.values == tag) & (x > end)] += 100
    return meshtags(mesh, 1, tags.indices, values)


def press(mesh, tags, interfaces, top=(23,), sides=(14, 24), bottom=11):
    """Press on the top with P; check the uniaxial stress state and return the problem."""
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    exact, u = fem.Function(V), fem.Function(V)
    strain = P / E * np.array([NU * (1 + NU), NU**2 - 1])[:, None]
    exact.interpolate(lambda x: strain * x[:2])
    bcs = []
    for component, held_by in ((1, (bottom,)), (0, sides)):
        spaces = V.sub(component), V.sub(component).collapse()[0]
        facets = np.sort(np.concatenate([tags.find(tag) for tag in held_by]))
        dofs = fem.locate_dofs_topological(spaces, 1, facets)
        bcs.append(fem.dirichletbc(exact.sub(component).collapse(), dofs, spaces[0]))
    ds = ufl.Measure("ds", mesh, subdomain_data=tags)
    loads = -fem.Constant(mesh, P) * ufl.TestFunction(V)[1] * ds(top)
    options = {"loads": loads, "geometry": "reference"}
    problem = create_problem(u, interfaces(tags), bcs, dm.Elastic(E, NU), **options)
    dm.newton(problem, rtol=1e-11)
    assert largest(u.x.array - exact.x.array) < EXACT * largest(exact.x.array)
    for link in problem.system.links:
        on = link.coupling.kept.any(axis=1)
        pressure = link.interface.pressure.x.array[link.nodes[on]]
        assert np.abs(pressure - P).max(initial=0.0) < 1e-9 * P
    return problem


@pytest.mark.parametrize("below", [1, -1])
@pytest.mark.parametrize("above", [1, -1])
@pytest.mark.parametrize("kinds", [(dm.Contact, dm.Contact), (dm.Contact, dm.Tie)])
def test_stack(kinds, below, above):
    """Three blocks in a stack, the middle one slave above and master below, and all others."""
    boxes = [(0, 1, k, k + 1, n, 3) for k, n in enumerate((3, 5, 4))]
    mesh, _, tags = create_blocks(COMM, boxes)
    sides = (13, 21)[::below], (23, 31)[::above]

    def create(tags):
        return [k(tags, slave=s, master=m) for k, (s, m) in zip(kinds, sides, strict=True)]

    for interface in press(mesh, tags, create, (33,), (14, 24, 34)).interfaces:
        assert np.isclose(abs(interface.force[1]), P, rtol=1e-9)


def press_beside(kind, sides, *cuts):
    """Press two blocks beside each other on one of twice the length; check the sum of forces."""
    boxes = [(0, 2, 0, 1, 6, 3), (0, 1, 1, 2, 4, 2), (1, 2, 1, 2, 4, 3)]
    mesh, _, tags = create_blocks(COMM, boxes)

    def create(tags):
        return [kind(tags, slave=s, master=m) for s, m in sides]

    # upper blocks slide along the line between them, too
    tags = divide(mesh, tags, *cuts)
    problem = press(mesh, tags, create, (23, 33), (14, 24, 22, 34))
    forces = [abs(interface.force[1]) for interface in problem.interfaces]
    assert np.allclose(forces, P, rtol=0.35) and np.isclose(sum(forces), 2 * P, rtol=1e-9)
    return problem


BESIDE = {
    # which side is slave left and right: the node at x = 1 is ...
    "slave and master": ((13, 21), (31, 113)),
    "master and slave": ((21, 13), (113, 31)),
    "slave twice": ((13, 21), (113, 31)),
    "master twice": ((21, 13), (31, 113)),
}


@pytest.mark.mpi
@pytest.mark.parametrize("case", BESIDE)
@KINDS
def test_two_blocks_on_one(case, kind):
    """A node of the lower block belongs to both interfaces, as slave, master or both."""
    problem = press_beside(kind, BESIDE[case], (13, 1.0))
    assert not problem.system.present.claims.notes  # nothing is lost


@pytest.mark.mpi
@KINDS
def test_one_slave_side_against_two_masters(kind):
    """Each slave node belongs to the interface whose master it faces; the pressure stays exact."""
    problem = press_beside(kind, ((13, 21), (13, 31)))
    kept = sum(int(link.coupling.kept.any(axis=1).sum()) for link in problem.system.links)
    assert COMM.allreduce(kept) == 7  # every node of the lower side once


@pytest.mark.mpi
@KINDS
@pytest.mark.parametrize(
    ("end", "between"), [(1.0, None), (1.05, 1), (1.1, 1), (1.3, 1), (0.95, 0), (0.9, 0)]
)
def test_slave_and_master_divided_at_different_places(kind, end, between):
    """At 1 and at other places: facets that face the other interface's master are told of."""
    mesh, _, tags = create_blocks(COMM, [(0, 2, 0, 1, 20, 2), (0, 2, 1, 2, 40, 2)])
    tags = divide(mesh, tags, (13, 1.0), (21, end))
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    both = [kind(tags, slave=13, master=21), kind(tags, slave=113, master=121)]
    said = create_problem(V, both, [held(V, tags, 11), held(V, tags, 23)]).audit().warnings
    said = [note for note in said if "divide slave and master at the same place" in note]
    assert len(said) == (between is not None)
    assert all(note.startswith(repr(both[between])) for note in said)
    assert all(repr(one) in note for note in said for one in both)


@pytest.mark.mpi
@KINDS
def test_cycle(kind):
    """Slave on the left and master on the right: each depends on the nodes of the other one."""
    mesh, _, tags = create_blocks(COMM, [(0, 2, 0, 1, 6, 3), (0, 2, 1, 2, 8, 3)])
    tags = divide(mesh, tags, (13, 1.0), (21, 1.0))

    def create(tags):
        return [kind(tags, slave=13, master=21), kind(tags, slave=121, master=113)]

    problem = press(mesh, tags, create)
    assert any("cycle" in note for note in problem.system.present.claims.notes)
