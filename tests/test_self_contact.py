# SPDX-License-Identifier: MIT
"""A surface that meets itself: roles, what is paired, folds that close, balances, ranks."""

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dolfinx
import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.interfaces.coupling import relative_motions
from dolfinx_mortar.mortar import self_contact
from dolfinx_mortar.mortar.pairing import create_pairing, outside_margin
from dolfinx_mortar.mortar.self_contact import REACH, _divide
from dolfinx_mortar.mortar.surface import (
    create_surface,
)
from dolfinx_mortar.report.penetration import find_overlaps, notes_on_crossings
from dolfinx_mortar.steps.failures import describe_passing
from tests.cases.block_piles import create_blocks
from tests.cases.folds import (
    SKIN,
    closed_ring,
    create_fold,
    create_hairpin,
    create_ring,
    create_sheet,
    hairpin,
    ring,
)

COMM = MPI.COMM_WORLD


# -- a fold that closes ----------------------------------------------------------------------------


@pytest.mark.mpi
def test_a_ring_closes_on_itself():
    """Nothing is near at first; then it is found before it touches, and forces balance."""
    found = closed_ring(COMM)
    alone = COMM.bcast(closed_ring(MPI.COMM_SELF) if COMM.rank == 0 else None)
    np.testing.assert_allclose(found, alone, rtol=1e-8, atol=1e-12)


# -- roles -----------------------------------------------------------------------------------------


def layers(rng, counts):
    """Return nodes, coordinates and near pairs of facets in layers above each other."""
    keys, x = [], []
    for k, count in enumerate(counts):
        at = np.sort(rng.uniform(0.0, 1.0, count + 1))
        at[0], at[-1] = 0.0, 1.0
        points = np.stack([at, np.full(count + 1, 0.1 * k)], axis=1)
        first = sum(counts[:k]) + k
        keys += [(first + i, first + i + 1) for i in range(count)]
        x += [points[i : i + 2] for i in range(count)]
    x, layer = np.array(x), np.repeat(np.arange(len(counts)), counts)
    low, high = x[:, 0, 0], x[:, 1, 0]
    over = (low[:, None] < high) & (high[:, None] > low)
    a, b = np.nonzero(over & (layer[:, None] < layer))
    return np.array(keys), x, a, b, 0.1 * (layer[b] - layer[a]), layer


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(1, 6), min_size=2, max_size=4))
@settings(max_examples=40, deadline=None)
def test_of_nearest_facets_one_is_the_slave_whatever_their_numbers(seed, counts):
    rng = np.random.default_rng(seed)
    keys, x, a, b, distance, layer = layers(rng, counts)
    slave = _divide(keys, x, a, b, distance)
    nearest = distance < 0.15
    assert (slave[a[nearest]] != slave[b[nearest]]).all()
    for k in range(len(counts)):  # a layer is of one kind
        assert len(set(slave[layer == k].tolist())) == 1
    if len(counts) == 2 and not 1 / 4 < counts[0] / counts[1] < 4:  # the finer one
        assert slave[layer == int(counts[1] > counts[0])].all()
    order, nodes = rng.permutation(len(keys)), rng.permutation(keys.max() + 1)
    place = np.argsort(order)
    shuffled = rng.permutation(len(a))
    again = _divide(
        nodes[keys][order], x[order], place[b[shuffled]], place[a[shuffled]], distance[shuffled]
    )
    assert np.array_equal(again, slave[order])


def test_a_notch_is_paired_but_for_the_facets_that_share_its_tip():
    """Of a hairpin that is nearly closed, facets with a common node have no pair."""
    fold = create_hairpin()
    V = fold.problem.V
    skin = create_surface(V, fold.contact.facet_tags, SKIN, "skin")
    u = fem.Function(V)
    u.interpolate(lambda x: np.stack([0.0 * x[0], -0.6 * x[1]]))
    pairing = create_pairing(skin, skin, u)
    assert len(pairing.pairs) > 5
    nodes = pairing.master_nodes[pairing.master_facets[pairing.pairs[:, 1]]]
    own = skin.nodes[skin.facets[pairing.pairs[:, 0]]]
    assert not (nodes[:, :, None] == own[:, None]).any()
    # no node is both: slaves are on one side of the middle, masters on the other
    assert not set(nodes.ravel()) & set(own.ravel())


def two_blocks():
    """Return one surface around two blocks, and displacements to a gap in parts of the reach."""
    boxes = [(0, 2, -1, 0, 8, 2), (0, 2, 1, 2, 8, 2)]  # facets of .25 and, at the flanks, .5
    domain, *_ = create_blocks(MPI.COMM_SELF, boxes)
    domain.topology.create_connectivity(1, 2)
    facets = np.sort(dolfinx.mesh.exterior_facet_indices(domain.topology))
    tags = dolfinx.mesh.meshtags(domain, 1, facets, np.full(len(facets), SKIN, dtype=np.int32))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))

    def at(share, aside=0.0):
        down = share * REACH * 0.25 - 1
        u = fem.Function(V)
        u.interpolate(lambda x: np.outer([aside, down], x[1] > 0.5))
        return u

    return V, create_surface(V, tags, SKIN, "skin"), at


def test_parts_that_come_near_ask_for_a_search():
    """Within half of the reach, and not before; not those whose roles are settled."""
    _, skin, at = two_blocks()
    far = create_pairing(skin, skin, at(1.05))
    assert len(far.roles.seen) == 0
    assert not outside_margin(far, at(0.55))
    assert outside_margin(far, at(0.45))
    near = create_pairing(skin, skin, at(0.95))
    assert len(near.pairs) >= 8
    assert not outside_margin(near, at(0.1))
    # masters beyond the next one have not been seen by a slave
    assert not outside_margin(near, at(0.1, aside=0.1))
    assert outside_margin(near, at(0.1, aside=0.6))


def test_facets_of_one_role_that_come_nearer_ask_for_a_search(monkeypatch):
    _, skin, at = two_blocks()
    every = lambda keys, *_: np.ones(len(keys), dtype=bool)  # noqa: E731
    with monkeypatch.context() as patch:
        patch.setattr(self_contact, "_divide", every)
        pairing = create_pairing(skin, skin, at(0.9))
    assert len(pairing.pairs) == 0 and len(pairing.roles.seen) >= 16
    assert not outside_margin(pairing, at(0.48))
    assert outside_margin(pairing, at(0.42))


def test_moments_lack_what_turns_the_normals_and_nothing_else():
    """Forces lambda_j D_jj v_j.dn_j/du of the exact derivative of the gap have the moment left."""
    sheet = create_sheet(COMM, (32, 2), ring(), closed=True)
    fold = create_fold(sheet, lambda x: (x[1] > 0.9) & (x[0] > -0.05), lambda x: x[1] < -0.9)
    for way in np.linspace(0.0, 1.55, 17)[8:]:
        report = fold.close(way, rtol=1e-9)
    problem, own, (link,) = fold.problem, fold.contact, fold.problem.system.links
    left_out = relative_motions(link, problem.positions())[0]
    left_out *= (own.multiplier * link.coupling.weight[:, 0])[:, None]
    turned = np.cross(np.array([0.0, 0.0, 1.0]), np.pad(link.coupling.normals, ((0, 0), (0, 1))))
    moment = COMM.allreduce((left_out * turned[:, :2]).sum(), op=MPI.SUM)
    left = own.moment + own.master_moment
    size = np.linalg.norm(left)
    assert fold.active > 0 and report.certificate.force_balance < 1e-12
    assert size > 1e-7 * np.linalg.norm(own.moment)
    assert np.abs(left - [0.0, 0.0, moment]).max() < 1e-6 * size


# -- what is said ----------------------------------------------------------------------------------


@pytest.mark.mpi
def test_a_surface_that_lies_in_itself_is_told():
    """Whatever has been paired: legs are put through each other by hand."""
    fold = create_hairpin()
    problem = fold.problem
    fold.close(0.1)
    assert not find_overlaps(problem)
    problem.u.interpolate(lambda x: np.stack([0.0 * x[0], -0.3 * np.maximum(x[1], 0) * (x[0] < 0)]))
    assert not find_overlaps(problem)
    problem.u.interpolate(
        lambda x: np.stack([0.0 * x[0], (x[0] - 0.2) * (x[1] > 0.0) * (x[0] < 0.2)])
    )
    found = find_overlaps(problem)
    assert found[-1].share > 0.05
    (note,) = notes_on_crossings(problem, found)
    assert "parts of the body" in note and "a tag for each" in note.why


def test_a_step_in_which_a_surface_passes_through_itself_is_told():
    """Not one that turns it by a radian, or opens it."""
    fold = create_hairpin()
    fold.close(0.05)
    u = fold.problem.u
    u.interpolate(lambda x: np.stack([0.0 * x[0], -1.8 * (x[1] > 0) * np.clip(0.2 - x[0], 0, 0.5)]))
    assert "has passed through" in describe_passing(fold.problem)
    c, s = np.cos(1.0), np.sin(1.0)
    u.interpolate(lambda x: np.stack([(c - 1.0) * x[0] - s * x[1], s * x[0] + (c - 1.0) * x[1]]))
    assert not describe_passing(fold.problem)
    u.interpolate(lambda x: np.stack([0.0 * x[0], np.sign(x[1]) * np.clip(0.2 - x[0], 0, 9)]))
    assert not describe_passing(fold.problem)


def test_only_contacts_may_meet_themselves():
    _, tags = create_sheet(MPI.COMM_SELF, (4, 1), hairpin())
    with pytest.raises(ValueError, match="slave and master are both tag 1"):
        dm.Tie(tags, slave=SKIN, master=SKIN)
    contact = dm.Contact(tags, slave=SKIN, master=SKIN)
    assert contact.meets_itself and repr(contact) == "Contact(slave=1, master=1)"
    assert not dm.Contact(tags, slave=1, master=2).meets_itself


# -- folds at finite strain: with friction, in space

BAR = 1e-6


def close(fold, ways, **options):
    return [fold.close(way, **options) for way in ways]


@pytest.mark.slow
@pytest.mark.mpi
def test_friction_of_a_surface_on_itself():
    """Coulomb's law holds in a hairpin that is closed and then sheared."""
    fold = create_hairpin(friction=0.3)
    reports = close(fold, (0.3, 0.42, 0.44, 0.46), rtol=1e-9)
    values = fold.contact.gather(fold.problem.u)
    on = values["pressure"] > 0.0
    traction = np.linalg.norm(values["traction"], axis=1)
    assert on.sum() >= 5 and (traction[on] > 0.0).any()
    limit = 0.3 * values["pressure"][on]
    assert (traction[on] <= limit + 1e-6 * limit.max()).all()
    assert reports[-1].certificate.force_balance < BAR
    above, below = fold.reactions
    assert np.abs(above + below).max() < BAR * np.abs(above).max()


def ring_in_space(comm):
    """Close a ring in space; return its force, what a pole carries, and nodes in contact."""
    fold = create_ring(comm, cells=(20, 1, 2))
    reports = close(fold, (0.8, 1.3, 1.45, 1.6), rtol=1e-9)
    assert max(r.certificate.crossing for r in reports) == 0.0
    above, below = fold.reactions
    assert np.abs(above + below)[:2].max() < BAR * abs(above[1])
    assert reports[-1].certificate.force_balance < BAR
    assert reports[-1].certificate.moment_balance < 5 * BAR  # sides that are not parallel
    force = fold.contact.force
    assert fold.active > 3 and abs(force[0]) < BAR * abs(force[1])
    return np.array([force[1], above[1], fold.active])


@pytest.mark.slow
@pytest.mark.mpi
def test_a_ring_in_space():
    found = ring_in_space(COMM)
    alone = COMM.bcast(ring_in_space(MPI.COMM_SELF) if COMM.rank == 0 else None)
    np.testing.assert_allclose(found, alone, rtol=1e-7)
