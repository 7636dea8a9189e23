# SPDX-License-Identifier: MIT
"""How far a tie reaches: what is farther apart is not tied, and nobody has to guess that."""

from fractions import Fraction

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.persistence.checkpoints import describe, differences
from tests.cases.block_piles import ABOVE, BELOW, Blocks
from tests.cases.two_bodies import TwoBodies

COMM = MPI.COMM_WORLD
NEAREST = 0.01


def lifted(x, slope=0.5):
    """Lift the right half of the upper body: it stands off by slope (x - 1/2) more."""
    x = x.copy()
    x[:, -1] += np.where(x[:, -1] > 0.5 * NEAREST, slope * np.maximum(x[:, 0] - 0.5, 0.0), 0.0)
    return x


def tied(cell="quadrilateral", *, gap=NEAREST, transform=lifted, held=(1, 2), **options):
    """Return a problem of two bodies with four and six facets along; tags of what is held."""
    n = ((4, 1), (6, 1)) if cell == "quadrilateral" else ((4, 4, 1), (6, 6, 1))
    case = TwoBodies(cell, n_lower=n[0], n_upper=n[1], gap=gap, transform=transform)
    return case.problem([case.interface(dm.Tie, **options)], [case.held(tag) for tag in held])


def kept(problem):
    """Return the coordinates x of the slave nodes with a multiplier, all ranks, sorted."""
    link = problem.system.links[0]
    X = problem.V.tabulate_dof_coordinates()[link.nodes][link.coupling.kept.all(axis=1)]
    return np.sort(np.concatenate(COMM.allgather(X[:, 0])))


def warned(audit):
    return [w for w in audit.warnings if "within=" in w]


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "rows", "slope"), [("quadrilateral", 1, 0.5), ("hexahedron", 5, 0.65)]
)
def test_what_is_far_is_not_tied(cell, rows, slope):
    """The sides part by more than half of a facet on the last one; its diagonal is longer."""
    problem = tied(cell, transform=lambda x: lifted(x, slope))
    audit = problem.audit()
    (found,) = audit.interfaces
    assert np.allclose(kept(problem), np.repeat([0.0, 0.25, 0.5, 0.75], rows))
    assert found.reach.beyond == found.uncovered_nodes == rows
    # pairs end at x = 2/3 and 3/4, and their points lie within them
    assert NEAREST + slope / 6 < found.reach.farthest < NEAREST + slope / 4
    (told,) = warned(audit)
    assert f"up to {found.reach.farthest:.3g} apart" in told and f"{rows} slave nodes" in told
    assert f"distances up to {found.reach.farthest:.3g}" in str(found)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("within", "nodes", "farthest"),
    [(NEAREST, 3, NEAREST), (Fraction(1, 10), 4, 0.1), (1, 5, 0.26)],
)
def test_a_distance_that_was_given(within, nodes, farthest):
    """It counts as it is, also where the sides are just as far apart; nothing to warn of."""
    problem = tied(within=within)
    audit = problem.audit()
    assert np.allclose(kept(problem), np.linspace(0.0, 1.0, 5)[:nodes])
    reach = audit.interfaces[0].reach
    assert reach.farthest <= farthest * (1 + 1e-12) and reach.farthest > 0.8 * farthest
    assert reach.beyond == 5 - nodes and warned(audit) == []
    report = dm.newton(problem)
    gap = problem.interfaces[0].gap.x.array[: problem.n]
    assert COMM.allreduce(int(np.isnan(gap).sum())) == reach.beyond
    assert report.certificate.row_sum_error < 1e-12


@pytest.mark.mpi
def test_sides_that_are_apart_everywhere():
    """All of them are tied across the constant gap, and the audit tells how wide it is."""
    audit = tied(gap=0.5, transform=None).audit()
    (found,) = audit.interfaces
    assert (found.kept_nodes, found.reach.beyond) == (5, 0)
    assert found.reach.farthest == pytest.approx(0.5, rel=1e-12)
    assert found.reach.share == pytest.approx(2.0, rel=1e-12)
    (told,) = warned(audit)
    assert "up to 0.5 apart, 2 of a facet" in told and "not tied" not in told
    assert warned(tied(gap=0.0, transform=None).audit()) == []


@pytest.mark.mpi
def test_a_body_that_no_tie_reaches():
    with pytest.raises(ValueError, match=r"nothing holds.*does not reach 5 slave nodes: .*within="):
        tied(gap=0.5, transform=None, within=0.4, held=(1,)).audit()


@pytest.mark.mpi
def test_who_is_out_of_reach_claims_no_node():
    """A node below two bodies belongs to the one that touches it, though the other comes first."""
    boxes = [(0.0, 1.0, -1.0, 0.0, 4, 2), (0.0, 0.5, 0.3, 1.0, 2, 2), (0.5, 1.0, 0.0, 1.0, 2, 2)]
    b = Blocks(boxes)
    sides = {"slave": 10 + ABOVE}
    ties = [dm.Tie(b.facets, master=10 * k + BELOW, within=0.2, **sides) for k in (2, 3)]
    bcs = [b.fix(2, ABOVE), b.fix(3, ABOVE), b.fix(1, BELOW)]
    found = b.problem(ties, bcs).audit().interfaces
    assert [i.kept_nodes for i in found] == [0, 3] and found[1].removed_nodes == 0


@pytest.mark.mpi
@pytest.mark.parametrize("within", [0.0, np.nan, True, "near", pytest.param(10**400, id="huge")])
def test_what_is_no_distance(within):
    with pytest.raises(ValueError, match=r"within is .*a length > 0"):
        tied(within=within)


@pytest.mark.mpi
def test_what_a_tie_says():
    """How far it reaches, with all digits: it tells problems and checkpoints apart."""
    problems = [tied(within=within) for within in (None, 0.1, np.float64(0.1), 0.1 + 1e-12)]
    shown = [repr(p.interfaces[0]) for p in problems]
    assert shown[0] == "Tie(slave=3, master=4)"
    assert shown[1] == shown[2] == "Tie(slave=3, master=4, within=0.1)"
    saved, *present = [describe(p.state) for p in problems[1:]]
    assert [len(differences(saved, other)) for other in present] == [0, 1]
