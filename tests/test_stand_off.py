# SPDX-License-Identifier: MIT
"""What is said of facets that stand for curved sides: before a step, and after it."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import mesh
from tests.ball_case import create_problem
from tests.close_fits import OVERLAP, create_pin, create_shrink_fit
from tests.hertz_case import ELASTIC, create_case, create_mesh
from tests.meshes import BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.pressed_blocks import PressedBlocks
from tests.test_smooth_contact import PEAK

COMM = MPI.COMM_WORLD


def said(problem):
    """Return what the audit says of facets."""
    return [w for w in problem.audit().warnings if "surface='smooth'" in w]


# -- before a step ---------------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("counts", [(64, 96), (96, 64), (96, 96), (40, 96)])
def test_the_audit_names_sides_that_fit_closely(counts, swap):
    """And does not advise the finer side as slave there, but the coarser one."""
    case = create_pin(counts, swap, surface="facets")
    (warning,) = said(case.problem)
    assert repr(case.contact) in warning
    finer = case.problem.audit().interfaces[0].size_ratio < 1.0
    assert ("let the coarser side be the slave" in warning) == finer
    assert not any("let the finer" in w for w in case.problem.audit().warnings)


def test_nothing_to_say_of_smooth_surfaces():
    problem = create_pin((64, 96), True, surface="smooth").problem
    (warning,) = problem.audit().warnings
    assert warning.startswith("contact alone holds the body around [")


def test_nothing_to_say_of_what_does_not_fit():
    """Flat sides, a disc and a ball on a block."""
    assert not said(PressedBlocks().problem())
    for slave in ("block", "disc"):
        assert not said(create_case(create_mesh("graded", 0.2), ELASTIC, slave=slave).problem)
    for slave in ("block", "ball"):
        assert not said(create_problem(h=0.5, cell="tetrahedron", slave=slave)[0])


@pytest.mark.mpi
@pytest.mark.parametrize("clearance", [0.1, 4.0, 6.0])
def test_how_far_curvatures_are_apart(clearance):
    """For circles with nodes anywhere on them, c / R: it decides whether they fit."""
    problem = create_pin((48, 72), False, clearance=clearance, surface="facets").problem
    (found,) = problem.audit().stand_offs
    assert found.parting == pytest.approx(clearance / 10.0, rel=1e-3)
    assert bool(said(problem)) == (clearance < 5.0)


def test_deep_overlaps_leave_facets_without_importance():
    """Their sagittas change by 1e-3 over a facet."""
    for overlap, told in ((OVERLAP, True), (12 * OVERLAP, False)):
        case = create_shrink_fit((144, 192), True, overlap=overlap, surface="facets")
        assert bool(said(case.problem)) == told


def test_prescribed_motions_count_as_overlaps():
    """In the audit that a step makes, which knows them."""
    case = create_pin((64, 96), True, surface="facets")
    case.problem.update_geometry(10.0)
    audit = case.problem._audit(10.0, [])
    assert audit.stand_offs and not any("surface='smooth'" in w for w in audit.warnings)


@pytest.mark.mpi
def test_the_audit_counts_nodes_on_edges():
    """The upper block is tagged around its two lower corners."""
    case = PressedBlocks(n_lower=(5, 3), n_upper=(4, 3))
    m, tags = case.mesh, case.facets
    above = mesh.compute_midpoints(m, 1, tags.indices)[:, 1] > 1e-9
    values = np.where(above & (tags.values != TOP), BOTTOM_OF_UPPER, tags.values)
    around = mesh.meshtags(m, 1, tags.indices, values.astype(np.int32))
    for angle, nodes in ((40.0, 2), (150.0, 0)):
        contact = dm.Contact(
            around,
            slave=TOP_OF_LOWER,
            master=BOTTOM_OF_UPPER,
            surface="smooth",
            feature_angle=angle,
        )
        audit = case.problem([contact]).audit()
        assert f"{nodes} nodes on edges of {angle:g} degrees or more" in str(audit)
        assert audit.interfaces[0].edges.without_normal == 0
    flat = case.problem([dm.Contact(tags, slave=3, master=4, surface="facets")])
    assert flat.audit().interfaces[0].edges is None and "edges" not in str(flat.audit())


# -- after a step ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts", "swap", "spoilt"),
    [((64, 96), True, True), ((96, 64), False, True), ((64, 96), False, False)],
)
def test_facets_that_spoil_the_pressures_are_told_of(counts, swap, spoilt):
    """Where the peak is wrong by more than a quarter; and not where it is right to 6 %."""
    report, found = create_pin(counts, swap, surface="facets").solve()
    error = abs(found["pressure"].max() / PEAK - 1.0)
    assert error > 0.25 if spoilt else error < 0.06
    assert any("surface='smooth'" in note for note in report.notes) == spoilt
