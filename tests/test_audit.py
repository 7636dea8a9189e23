# SPDX-License-Identifier: MIT
"""The audit before the first step: it reports errors of the set-up, and nothing else."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx.mesh import meshtags
from tests.cases.block_piles import ABOVE, PILE, WEST, Blocks
from tests.cases.close_fits import create_ring, nested
from tests.cases.two_bodies import create_problem, held

COMM = MPI.COMM_WORLD
PAIR = [(0.0, 1.0, -1.0, 0.0, 4, 3), (0.0, 1.0, 0.0, 1.0, 3, 3)]


HELD = (11, None), (23, None)


def create(boxes=PAIR, joins=((13, 21),), supports=HELD, kind=dm.Contact, tags=None, push=None):
    """Return a problem of blocks: joins are (slave, master), supports (tag, component)."""
    b = Blocks(boxes)
    if tags is not None:
        b.facets = tags(b.mesh, b.facets)
    interfaces = [kind(b.facets, slave=s, master=m) for s, m in joins]
    bcs = [b.fix(*divmod(tag, 10), component=i) for tag, i in supports]
    loads = None if push is None else b.traction(2, ABOVE, push)
    return b.problem(interfaces, bcs, loads=loads)


def warned(*words, **options):
    """Expect the audit to warn of something in such words; return it."""
    audit = create(**options).audit()
    assert any(all(word in w for word in words) for w in audit.warnings), audit
    return audit


@pytest.mark.mpi
def test_nothing_to_complain():
    audit = create().audit()
    assert audit.warnings == [] and not audit.held_by_contact
    assert audit.bodies == 2
    (found,) = audit.interfaces
    assert (found.slave_facets, found.master_facets) == (4, 3)
    assert (found.slave_nodes, found.kept_nodes) == (5, 5)
    assert found.uncovered_nodes == found.removed_nodes == found.dirichlet_nodes == 0
    assert found.facing_away == 0
    assert found.size_ratio == pytest.approx(0.75)


@pytest.mark.mpi
def test_supports_that_hold_nothing():
    """As with a tag that no facet has; also where that is why a body is loose."""
    held = ((11, None), (22, None))
    assert create(supports=held).audit().warnings == []
    (warning,) = create(supports=(*held, (99, 1))).audit().warnings
    assert "bcs[2], on V.sub(1), has no dofs" in warning and "check the tag" in warning
    with pytest.raises(ValueError, match=r"(?s)nothing holds.*bcs\[1\], on V, has no dofs"):
        create(supports=((11, None), (99, None))).audit()


@pytest.mark.parametrize(
    ("supports", "kind", "nodes", "kept"),
    [
        ((*HELD, (14, 0)), dm.Contact, 0, 5),  # normal free: nothing is lost
        ((*HELD, (14, 1)), dm.Contact, 1, 4),  # normal taken
        ((*HELD, (14, None), (12, None)), dm.Contact, 2, 3),
        ((*HELD, (14, None)), dm.Tie, 1, 4),
    ],
)
def test_slave_nodes_with_dirichlet_data(supports, kind, nodes, kept):
    """Nodes that lose their constraint are counted and told of; the others still work."""
    problem = create(supports=supports, kind=kind)
    audit = problem.audit()
    assert audit.interfaces[0].dirichlet_nodes == nodes
    assert audit.interfaces[0].kept_nodes == kept
    assert audit.interfaces[0].removed_nodes == 5 - kept
    told = [w for w in audit.warnings if "Dirichlet" in w]
    assert len(told) == (nodes > 0) and all(f"at {nodes} slave nodes" in w for w in told)
    assert dm.newton(problem).converged


def test_slave_side_that_is_prescribed_altogether():
    audit = warned("no slave node carries a multiplier", supports=(*HELD, (13, None)))
    assert audit.interfaces[0].kept_nodes == 0


def test_coarse_slave():
    boxes = [(0.0, 1.0, -1.0, 0.0, 2, 2), (0.0, 1.0, 0.0, 1.0, 9, 2)]
    warned("4.5 times as long", "finer", boxes=boxes)
    assert create(boxes, joins=((21, 13),)).audit().warnings == []


def retagged(tags, tag):
    """Return what gives facets of some tags another one."""

    def change(domain, facets):
        values = np.where(np.isin(facets.values, tags), tag, facets.values).astype(np.int32)
        return meshtags(domain, 1, facets.indices, values)

    return change


@pytest.mark.mpi
def test_facets_that_turn_their_back():
    """A slave side marked around the corner is fine; one with its back to the master is not."""
    assert create(tags=retagged((12, 14), 13)).audit().interfaces[0].facing_away == 0
    # a thin upper block, of which the top is marked, too: its facets turn away from the slave
    thin = [PAIR[0], (0.0, 1.0, -0.1, 0.0, 4, 1)]
    options = {"boxes": thin, "tags": retagged((23,), 21), "supports": ((11, None), (22, None))}
    assert warned("4 slave facets face away", **options).interfaces[0].facing_away == 4


@pytest.mark.mpi
@pytest.mark.parametrize("beyond", [0.0, 0.005])
def test_uncovered_nodes(beyond):
    """As many as have no gap in the results, also where a trace of their weight is covered."""
    boxes = [(0.0, 1.0, -1.0, 0.0, 4, 3), (0.5 - beyond, 1.0, 0.0, 1.0, 3, 3)]
    problem = create(boxes)
    (found,) = problem.audit().interfaces
    assert found.uncovered_nodes == 2 and found.kept_nodes == 3 and found.removed_nodes == 0
    dm.newton(problem)
    gap = problem.contacts[0].gap.x.array[: problem.n]
    assert COMM.allreduce(int(np.isnan(gap).sum())) == found.uncovered_nodes


@pytest.mark.mpi
def test_double_claims():
    """A node belongs to the interface whose master it faces; one that faces both, to the first."""
    boxes = [(0.0, 1.0, -1.0, 0.0, 4, 2), (0.0, 0.4, 0.0, 1.0, 2, 2), (0.6, 1.0, 0.0, 1.0, 2, 2)]
    supports = (*HELD, (33, None))
    audit = create(boxes, joins=((13, 21), (13, 31)), supports=supports).audit()
    said = [w for w in audit.warnings if "slave=13, master=31" in w]
    assert len(said) == 1 and "1 slave nodes removed" in said[0] and "one tag" in said[0]
    assert [i.kept_nodes for i in audit.interfaces] == [3, 2]
    swapped = create(boxes, joins=((21, 13), (31, 13)), supports=supports).audit()
    (beside,) = swapped.warnings  # the blocks are nearer than their facets are long
    assert "0.2 apart" in beside and swapped.interfaces[1].kept_nodes == 3


def test_body_held_by_contact_alone():
    """A warning, and it works under a load that presses it on; the load must be balanced."""
    problem = create(supports=((11, None), (22, 0)), push=(0.0, -5.0))
    audit = problem.audit()
    (name,) = audit.held_by_contact
    assert name.startswith("the body around [")
    assert audit.warnings == [
        f"contact alone holds {name}: the loads must press the sides together"
    ]
    dm.newton(problem)
    # the interface bends a little, so the force may lean, but no more than that
    assert problem.contacts[0].force == pytest.approx([0.0, -5.0], abs=5e-3)
    assert problem.contacts[0].force[1] == pytest.approx(-5.0, rel=1e-6)


@pytest.mark.mpi
def test_body_that_nothing_holds():
    with pytest.raises(ValueError, match=r"nothing holds.*translation x.*Prescribe"):
        create(supports=((11, None),)).audit()
    # a tie holds it altogether
    assert create(supports=((11, None),), kind=dm.Tie).audit().warnings == []


ALL = "[0.5, 0.5], [0.5, 1.5], [0.5, 2.5]"


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("joins", "kind", "supports", "expected"),
    [
        ((), dm.Contact, ((11, None), (21, None)), "xyz of the body around [0.5, 2.5]"),
        (((13, 21), (23, 31)), dm.Tie, (), f"xyz of the bodies around {ALL} together"),
        (((13, 21), (23, 31)), dm.Tie, ((11, 1),), f"x of the bodies around {ALL} together"),
        (((13, 21),), dm.Tie, ((31, None),), f"xyz of the bodies around {ALL[:22]} together"),
        (
            ((13, 21), (23, 31)),
            dm.Contact,
            (),
            "x of the body around [0.5, 0.5]; x of the body around [0.5, 1.5]; "
            f"x of the body around [0.5, 2.5]; yz of the bodies around {ALL} together",
        ),
    ],
)
def test_free_motions_by_simple_names(joins, kind, supports, expected):
    """Every motion of single bodies or several together is named as one, and once."""
    kinds = {"x": "translation x", "y": "translation y", "z": "rotation about z"}
    whole = []
    for part in expected.split("; "):
        letters, _, who = part.partition(" of ")
        whole += [f"{kinds[letter]} of {who}" for letter in letters]
    with pytest.raises(ValueError) as caught:
        create(PILE, joins, supports, kind).audit()
    found = str(caught.value).partition("against ")[2].partition(". Prescribe")[0]
    assert sorted(found.split("; ")) == sorted(whole)


@pytest.mark.mpi
@pytest.mark.parametrize("gap", [0.02, -0.01])
def test_range_of_gaps(gap):
    """The audit shows the smallest and the largest gap, and names an overlap."""
    boxes = [(0.0, 1.0, -1.0, 0.0, 4, 2), (0.0, 1.0, gap, 1.0, 3, 2)]
    problem = create(boxes)
    audit = problem.audit()
    assert audit.interfaces[0].least_gap == pytest.approx(gap)
    assert audit.interfaces[0].largest_gap == pytest.approx(gap)
    assert ("overlap 0.01" in str(audit)) == (gap < 0)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("facets", "oblique", "bent"),
    [(3, 5.0, True), (2, -5.0, True), (3, 0.0, False), (12, 5.0, False)],
)
def test_a_support_that_may_be_a_mirror(facets, oblique, bent):
    """An arc of 57 degrees that ends 5 degrees off the right angle, like one that is no circle."""
    start = np.radians(oblique)

    def rounded(domain, tags):
        x, y, _ = domain.geometry.x.T.copy()
        domain.geometry.x[:, 0] = np.sin(start + x) - np.sin(start)
        domain.geometry.x[:, 1] = y + np.cos(start + x)
        return tags

    boxes = [(0.0, 1.0, -1.0, 0.0, facets, 3), (0.0, 1.0, 0.0, 1.0, facets, 3)]
    rollers = (*HELD, (10 + WEST, 0), (20 + WEST, 0))
    warnings = create(boxes, supports=rollers, tags=rounded).audit().warnings
    told = [w for w in warnings if "plane of symmetry" in w]
    assert len(told) == 2 * bent
    for side, warning in zip(("slave", "master"), told, strict=False):
        assert f"at 1 nodes of its {side} side" in warning
        assert "an angle 5 degrees off the right" in warning


def uneven_angles(rng, n):
    """Return n angles around the circle, up to a quarter of a step off even ones."""
    return 2 * np.pi * (np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n


@pytest.mark.mpi
def test_a_pin_that_may_spin(rng):
    """Uneven facets resist the spin of a pin in its hole a little; still nothing holds it."""
    rings = (
        create_ring(0.4, 0.98, uneven_angles(rng, 31)),
        create_ring(1.0, 2.0, uneven_angles(rng, 24)),
    )
    domain, tags = nested(COMM, rings)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    for slave, master in ((2, 3), (3, 2)):
        contact = dm.Contact(tags, slave=slave, master=master)
        with pytest.raises(ValueError, match=r"nothing holds.*rotation about z") as caught:
            create_problem(V, [contact], [held(V, tags, 4)]).audit()
        assert "translation" not in str(caught.value)
