# SPDX-License-Identifier: MIT
"""Contacts that the program proposes, and warnings about bodies that come near without one."""

from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, create_blocks
from tests.cases.meshes import create_distributed
from tests.cases.meshes_3d import rotation, two_boxes
from tests.cases.pressed_blocks import rejected
from tests.cases.two_bodies import create_problem, held

COMM = MPI.COMM_WORLD
# a base, two blocks of different facets on it, and a lid a little above both
PILE = [(0, 4, -1, 0, 8, 2), (0, 1.9, 0, 1, 5, 3), (2, 4, 0, 1, 3, 3), (0.5, 3.5, 1.05, 2, 7, 3)]


def create(boxes, partition="graph", **options):
    """Return what is found between blocks, with their names."""
    domain, cells, facets = create_blocks(COMM, boxes, partition=partition)
    named = dm.Tags(cells, {f"block {k + 1}": k + 1 for k in range(len(boxes))})
    return dm.find_pairs(domain, named, **options), domain, facets


def count(tags, name):
    owned = tags.topology.index_map(tags.dim).size_local
    return COMM.allreduce(int((tags.find(name) < owned).sum()))


def ends(pairs):
    return [(p.slave.split(" to ")[0], p.master.split(" to ")[0]) for p in pairs.found]


@pytest.mark.mpi
def test_disc_on_block_has_the_sides_that_its_author_has_tagged(capsys):
    domain, cells, sides = dm.meshing.hertz(COMM, kind="graded", h=0.4)
    tags, contacts = dm.find_pairs(domain, cells)
    assert list(tags.names) == ["block to disc", "disc to block"]
    for name, side in (("disc to block", "arc"), ("block to disc", "top")):
        assert set(tags.find(name).tolist()) == set(sides.find(side).tolist())
    (contact,) = contacts
    assert (contact.slave, contact.master) == (tags.tag("disc to block"), tags.tag("block to disc"))
    shown = capsys.readouterr().out.splitlines()
    if COMM.rank == 0:
        assert len(shown) == 2 and shown[0].startswith("slave (facets, size), master")
        assert shown[1].startswith("disc to block (") and shown[1].split()[-1] == "0"
    else:
        assert not shown


@pytest.mark.mpi
@pytest.mark.parametrize("partition", ["graph", "bodies", "empty"])
def test_pile_has_the_same_pairs_on_any_ranks(partition):
    pairs, *_ = create(PILE, partition, show=False)
    found = [(p.slave, p.facets[0], p.master, p.facets[1]) for p in pairs.found]
    assert found == [
        ("block 2 to block 1", 5, "block 1 to block 2, block 3", 8),
        ("block 1 to block 2, block 3", 8, "block 3 to block 1", 3),
        ("block 2 to block 3", 3, "block 3 to block 2", 3),
        ("block 2 to block 4", 5, "block 4 to block 2, block 3", 7),
        ("block 4 to block 2, block 3", 7, "block 3 to block 4", 3),
    ]
    distances = [p.distance for p in pairs.found]
    assert np.allclose(distances, [0.0, 0.0, 0.1, 0.05, 0.05], rtol=0, atol=1e-12)
    # over 1.9 and 2 of the base, the heights of 1, 1.4 and 1.5 of the lid
    assert np.allclose([p.area for p in pairs.found], [1.9, 2.0, 1.0, 1.4, 1.5])
    counts = [c for p in pairs.found for c in zip((p.slave, p.master), p.facets, strict=True)]
    assert {name: count(pairs.tags, name) for name in pairs.tags.names} == dict(counts)
    assert len(pairs.contacts) == 5
    # block 2 is the slave of all three others, so its upper and lower corner are slaves twice
    assert [text.partition(",")[0] for text in pairs.lost] == [
        "'block 2' as slave of 'block 3' loses 1 node to its contact with 'block 1'",
        "'block 2' as slave of 'block 4' loses 1 node to its contact with 'block 3'",
    ]
    assert str(pairs).splitlines()[-2:] == pairs.lost
    # bodies without tags are numbered by their places
    one = dm.find_pairs(create_blocks(COMM, PILE[::-1], partition=partition)[0], show=False).found[
        0
    ]
    assert (one.slave, one.master) == ("body 2 to body 1", "body 1 to body 2, body 4")


def create_squares(bodies, n=2):
    """Create bodies of unit squares, by the numbers of their lowest corners, with n x n cells."""
    points, cells = [], []
    for squares in bodies:
        at = {}
        for i, j in squares:
            for a, b in np.ndindex(n, n):
                corners = [(n * i + a + p, n * j + b + q) for q in (0, 1) for p in (0, 1)]
                cells.append([at.setdefault(c, len(points) + len(at)) for c in corners])
        points += list(at)
    x, e = np.array(points) / n, np.array(cells)
    return create_distributed(COMM, x, e, "quadrilateral")


@pytest.mark.mpi
def test_a_body_whose_sides_to_two_others_share_a_face():
    """A block in a channel of two angles: walls and floor are one side, of all three faces."""
    channel = [[(0, 0), (1, 0), (0, 1)], [(2, 0), (3, 0), (3, 1)], [(1, 1), (2, 1)]]
    pairs = dm.find_pairs(create_squares(channel), show=False)
    (name,) = (name for name in pairs.tags.names if ", " in name)
    assert count(pairs.tags, name) == 8  # of 2 + 1 + 1 unit lengths
    assert [sorted(p.facets) for p in pairs.found if name in f"{p.slave}{p.master}"] == [[4, 8]] * 2


# Walls of blocks. Chosen pair by pair, contacts lose all slave nodes to cycles: bodies pass.
WALLS = [
    [(0, 4, 0, 1, 8, 1), (0, 2.5, 1, 2, 7, 3), (2.5, 3, 1, 2, 1, 3), (3, 4, 1, 2, 2, 1),
     (0, 4, 2, 3, 4, 2)],
    [(0, 2, 0, 1, 4, 1), (2, 3, 0, 1, 3, 1), (3, 4, 0, 1, 1, 1), (0, 4, 1, 3, 4, 2)],
]  # fmt: skip


@pytest.mark.mpi
@pytest.mark.parametrize("boxes", WALLS)
def test_walls_pass_the_patch_test_with_proposed_contacts(boxes):
    """Pressed between flat walls, all blocks are strained alike: u_y = -e y, u_x = 0."""
    domain, cells, facets = create_blocks(COMM, boxes)
    pairs = dm.find_pairs(domain, cells, show=False)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    tops = [10 * (k + 1) + ABOVE for k, box in enumerate(boxes) if box[3] == 3]
    sides = [10 * (k + 1) + WEST for k, box in enumerate(boxes) if box[0] == 0]
    sides += [10 * (k + 1) + EAST for k, box in enumerate(boxes) if box[1] == 4]
    bottoms = [10 * (k + 1) + BELOW for k, box in enumerate(boxes) if box[2] == 0]
    bcs = [
        held(V, facets, tag, value, i)
        for tags, i, value in ((tops, 1, -0.03), (sides, 0, 0.0), (bottoms, 1, 0.0))
        for tag in tags
    ]
    problem = create_problem(V, pairs.contacts, bcs, cells=cells)
    u = problem.u
    dm.newton(problem, rtol=1e-10)
    exact = fem.Function(V)
    exact.interpolate(lambda x: np.stack([0.0 * x[0], -0.01 * x[1]]))
    assert np.abs(u.x.array - exact.x.array).max(initial=0.0) < 1e-8
    assert not any("cycle" in text for text in pairs.lost)
    assert min(i.kept_nodes for i in problem.audit().interfaces) > 0


@pytest.mark.serial
def test_slaves_of_many_blocks():
    """A wall of 32 blocks has more pairs than are compared in all ways: hardly any cycles."""
    rng, boxes = np.random.default_rng(2), []
    for row in range(5):
        cuts = [0.0, *np.arange(0.5 * (row % 2) or 1.0, 6.0), 6.0]
        for a, b in pairwise(cuts):
            boxes.append((a, b, float(row), row + 1.0, *map(int, rng.integers(1, 4, 2))))
    pairs, *_ = create(boxes, show=False)
    assert len(boxes) == 32 and len(pairs.found) == 75
    assert len([text for text in pairs.lost if "cycle" in text]) <= 3


def test_blocks_that_touch_in_an_edge_are_no_pair_in_any_direction():
    """Their projections overlap by what coordinates in a file are rounded to."""
    for angle in (0.1, 0.8, 1.5):
        domain, *_ = create_blocks(MPI.COMM_SELF, [(0, 1, 0, 1, 3, 3), (1 - 1e-10, 2, 1, 2, 2, 2)])
        c, s = np.cos(angle), np.sin(angle)
        domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ np.array([[c, s], [-s, c]])
        with pytest.raises(ValueError, match="face each other"):
            dm.find_pairs(domain, show=False)


FLOOR, WALL, ONES = (
    (0, 1, -1, 0, 2, 2),
    (1, 2, 0.1, 1, 2, 2),
    [(0, 2, 0, 1, 2, 2), (2, 4, 0, 1, 2, 2)],
)
TWICE = "'block 2' as slave of 'block 3' loses 1 node to its contact with 'block 1'"
ROLES = {  # blocks, slaves and masters of the first pairs, what is lost
    "finer than twice: claimed twice": ([(0, 4, -1, 0, 16, 2), *ONES], "12 13", None),
    "a little finer": ([(0, 4, -1, 0, 6, 2), *ONES], "12 13", None),
    "in a corner": ([FLOOR, (0, 1, 0, 1, 3, 3), WALL], "21 32", []),
    "beside a wall that is too coarse": ([FLOOR, (0, 1, 0, 1, 7, 7), WALL], "21 23", [TWICE]),
    "as much is lost: the finer ones": (
        [(0, 2, -1, 0, 6, 2), (0, 1, 0, 1, 3, 2), (1, 2, 0, 1, 2, 2)],
        "12 13",
        None,
    ),
}


@pytest.mark.mpi
@pytest.mark.parametrize("case", ROLES)
def test_who_is_the_slave(case):
    boxes, expected, lost = ROLES[case]
    pairs, *_ = create(boxes, show=False)
    assert ends(pairs)[:2] == [tuple(f"block {k}" for k in pair) for pair in expected.split()]
    assert lost is None or [text.partition(",")[0] for text in pairs.lost] == lost


@pytest.mark.mpi
def test_what_is_beside_behind_or_looks_away_is_no_pair():
    two = [(0, 1, 0, 1, 2, 2), (0, 1, 1.01, 2, 2, 2)]
    shim = (-0.1, 1.1, 1.002, 1.008, 4, 1)  # thinner than a facet, so that all is near
    pairs, *_ = create([*two, shim], show=False)
    assert sorted(map(sorted, ends(pairs))) == [["block 1", "block 3"], ["block 2", "block 3"]]
    beside = (1.5, 2.5, 1.3, 2.3, 2, 2)  # flanks look past each other, as do lid and base
    pairs, *_ = create([*two, beside], within=10.0, show=False)
    assert sorted(map(sorted, ends(pairs))) == [["block 1", "block 2"], ["block 2", "block 3"]]
    corner = (1.0, 2.0, 1.0, 2.0, 2, 2)  # touches the first one in a corner only
    with pytest.raises(ValueError, match="face each other"):
        create([two[0], corner], show=False)
    # strips back to back: upper and lower one are thinner than they are near
    strips = [(0, 1, 0, 0.02, 8, 1), (0, 1, -0.02, -0.001, 8, 1)]
    pairs, *_ = create(strips, show=False)
    assert len(pairs.found) == 1 and abs(pairs.found[0].distance - 0.001) < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_near_is_a_facet_unless_it_is_said(unit):
    """The larger one of the two, of length 0.5: in any unit of length."""

    def boxes(gap):
        low, high = np.array([0, 1, -1, 0]) * unit, np.array([0, 1, gap, gap + 1]) * unit
        return [(*low, 2, 2), (*high, 5, 2)]

    pairs, *_ = create(boxes(0.49), show=False)
    assert np.isclose(pairs.found[0].distance, 0.49 * unit, rtol=1e-9)
    assert pairs.found[0].slave == "block 2 to block 1"  # the finer side
    nearest = f"'block 1' and 'block 2', are {0.51 * unit:.4g} apart"
    with pytest.raises(ValueError, match=nearest):
        create(boxes(0.51), show=False)
    assert len(create(boxes(0.51), within=0.52 * unit, show=False)[0].found) == 1
    with pytest.raises(ValueError, match=f"within={0.4 * unit:g}"):
        create(boxes(0.49), within=0.4 * unit, show=False)


@pytest.mark.mpi
def test_overlaps_are_pairs():
    for depth, found in ((0.3, True), (0.49, True), (0.6, False)):
        boxes = [(0, 2, -3, 0, 4, 12), (0.5, 1.5, -depth, 1 - depth, 3, 4)]
        if found:
            pairs, *_ = create(boxes, show=False)
            assert np.isclose(pairs.found[0].distance, -depth, atol=1e-12)
            continue
        with pytest.raises(ValueError, match="overlap by more than half"):
            create(boxes, show=False)
    pairs, *_ = create([(0, 1, 0, 1, 2, 2), (0, 1, 1, 2, 3, 2)], friction=0.25, show=False)
    assert [c.friction for c in pairs.contacts] == [0.25]


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
@pytest.mark.parametrize("partition", ["graph", "empty"])
def test_boxes_in_space_without_any_tag(cell, partition):
    domain, _, facets = two_boxes(
        COMM, (3, 3, 2), (2, 3, 2), cell=cell, gap=0.1, turn=rotation((1, 2, 3), 0.7),
        partition=partition,
    )  # fmt: skip
    pairs = dm.find_pairs(domain, show=False)
    (pair,) = pairs.found
    triangles = 2 if cell == "tetrahedron" else 1
    assert sorted(pair.facets) == [6 * triangles, 9 * triangles]
    assert pair.facets[0] > pair.facets[1]
    assert np.isclose(pair.distance, 0.1) and np.isclose(pair.area, 1.0)
    on_top = set(facets.find(3).tolist()) | set(facets.find(4).tolist())
    assert set(pairs.tags.indices.tolist()) == on_top


@pytest.mark.mpi
def test_audit_names_bodies_that_come_near_without_a_contact():
    domain, cells, facets = create_blocks(COMM, PILE)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    bcs = [held(V, facets, tag) for tag in (10 + BELOW, 20 + EAST, 30 + EAST, 40 + ABOVE)]
    u = fem.Function(V)
    joins = [(21, 13), (31, 13), (43, 41)]

    def warnings(interfaces):
        audit = create_problem(u, interfaces, bcs).audit()
        return [w for w in audit.warnings if "no interface couples them" in w]

    told = warnings([dm.Contact(facets, slave=s, master=m) for s, m in joins[:1]])
    assert len(told) == 4
    assert all(word in told[0] for word in ("the body around", "apart, and", "find_pairs"))
    assert sum("are 0.05 apart" in w for w in told) == 2
    assert sum("are 0.1 apart" in w for w in told) == 1
    _, contacts = dm.find_pairs(domain, cells, show=False)
    assert not warnings(contacts)
    # where they are at the moment: the lid further up, and pressed in
    lid = fem.locate_dofs_geometrical(V, lambda x: x[1] > 1.01)
    for move, count, word in ((3.0, 2, "0.1 apart"), (-0.1, 4, "overlap by 0.05")):
        u.x.array.reshape(-1, 2)[lid, 1] = move
        told = warnings([dm.Contact(facets, slave=s, master=m) for s, m in joins[:1]])
        assert len(told) == count and any(word in w for w in told)


@pytest.mark.mpi
def test_errors_name_the_argument_and_the_remedy():
    boxes = [(0, 1, 0, 1, 2, 2), (0, 1, 1, 2, 3, 2)]
    domain, cells, facets = create_blocks(COMM, boxes)
    if COMM.size > 1:  # before a rank leaves the others alone
        with rejected("within differs between the ranks"):
            dm.find_pairs(domain, within=-1.0 if COMM.rank else None)
    own = cells.find(1)
    some = mesh.meshtags(domain, 2, own, np.ones(len(own), dtype=np.int32))
    one = mesh.create_unit_square(COMM, 4, 4)
    halves = mesh.locate_entities(one, 2, lambda x: x[0] > -1)
    values = (mesh.compute_midpoints(one, 2, halves)[:, 0] > 0.5).astype(np.int32)
    tags = mesh.meshtags(one, 2, halves, values)
    for given, options, *words in (
        *(((domain,), {"within": w}, "within is ", "positive distance") for w in (0.0, "far")),
        ((domain, create_blocks(COMM, boxes)[1]), {}, "cell_tags is ", "of the same mesh"),
        ((domain, facets), {}, "cell_tags is ", "MeshTags of the cells"),
        ((domain, some), {}, "leave out ", " cells"),
        ((3,), {}, "mesh is 3"),
        ((one,), {}, "one connected body", "its own nodes"),
        ((one, tags), {}, "'body 0' and 'body 1' share 5 nodes", "do not fragment"),
        ((mesh.create_unit_cube(COMM, 2, 2, 2, mesh.CellType.prism),), {}, "cells of type prism"),
        ((domain, cells), {"friction": -1.0}, "friction"),
    ):
        with rejected(*words):
            dm.find_pairs(*given, **options)
