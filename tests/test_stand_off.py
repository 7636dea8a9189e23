# SPDX-License-Identifier: MIT
"""Warnings and notes on facets that approximate curved sides badly."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.mortar.curvature_correction import (
    find_parting,
    find_smooth_sides,
)
from dolfinx_mortar.report import notes
from tests.cases.close_fits import create_pin, create_shrink_fit
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.shells import MASTER, SLAVE, octants
from tests.cases.two_bodies import create_problem, held
from tests.test_smooth_contact import PEAK

COMM = MPI.COMM_WORLD


# -- before a step ---------------------------------------------------------------------------------


def test_nothing_to_say_of_smooth_surfaces():
    problem = create_pin((64, 96), True, surface="smooth").problem
    (warning,) = problem.audit().warnings
    assert warning.startswith("contact alone holds the body around [")


@pytest.mark.mpi
@pytest.mark.parametrize("clearance", [0.1, 4.0, 6.0])
def test_how_far_curvatures_are_apart(clearance):
    """For circles with nodes anywhere on them, c / R."""
    problem = create_pin((48, 72), False, clearance=clearance, surface="facets").problem
    problem.audit()
    (link,) = problem.system.links
    smooth = find_smooth_sides(link.pairing, link.sides.fixed, link.interface.feature_angle)
    parting = find_parting(link.pairing, link.mortar[1].segments, problem.u, smooth)
    assert parting == pytest.approx(clearance / 10.0, rel=1e-3)


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
    assert any("facets of curved" in note for note in report.notes) == spoilt


@pytest.mark.mpi
def test_a_note_is_logged_once(caplog):
    """Not in every step that has it, with other numbers; each report keeps it."""
    pin = create_pin((64, 96), True, surface="facets")
    with caplog.at_level("WARNING", logger="dolfinx_mortar.report"):
        for _ in range(3):
            report, _ = pin.solve()
            assert any("are known to" in note for note in report.notes)
            pin.problem.commit()
            pin.problem.u.x.array[:] *= 1.01
    told = [r for r in caplog.records if "are known to" in r.getMessage()]
    assert len(told) == (COMM.rank == 0)


@pytest.mark.mpi
@pytest.mark.parametrize(("pressure", "told"), [(10.0, True), (-10.0, False)])
def test_facets_that_keep_sides_apart_are_told_of(pressure, told):
    """Rings that fit, of which the inner one is pressed against the outer one, or away from it."""
    options = {"overlap": 0.0, "pressure": pressure, "surface": "facets"}
    case = create_shrink_fit((48, 68), False, **options)
    report = dm.newton(case.problem)
    assert not case.contact.pressure.x.array.any()
    assert any("forces may be missing" in note for note in report.notes) == told
    assert bool(report.notes) == told


@pytest.mark.mpi
@pytest.mark.parametrize(("swap", "pressure"), [(False, 1.0), (True, 10.0), (True, 1000.0)])
def test_heights_that_are_known_too_little_are_told_of(swap, pressure):
    """Rings that fit, where the largest or least pressure is wrong by more than a fifth."""
    case = create_shrink_fit((48, 68), swap, overlap=0.0, pressure=pressure)
    report = dm.newton(case.problem)
    found = case.contact.gather(case.problem.u)["pressure"] / case.pressure
    spoilt = bool(np.abs(found - 1.0).max() > 0.2)
    assert spoilt == (pressure < 100.0)
    assert (
        any("smooth surfaces through the nodes are known to" in n for n in report.notes) == spoilt
    )
    assert not any("forces and moments are" in note for note in report.notes)


@pytest.mark.mpi
@pytest.mark.parametrize("cell", ["ring", "tetrahedron", "hexahedron"])
@pytest.mark.parametrize("swap", [False, True])
def test_what_heights_miss(cell, swap):
    """It bounds the gaps of sides that fit, the coarser or the finer one as slave."""
    if cell == "ring":
        problem = create_shrink_fit((48, 36), swap, overlap=0.0).problem
    else:
        domain, tags = octants(COMM, (0.5, 1.0, 1.5), (4, 3), 1, cell)
        V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
        planes = [held(V, tags, 5 + i, 0.0, i) for i in range(3)]
        slave, master = (MASTER, SLAVE) if swap else (SLAVE, MASTER)
        contact = dm.Contact(tags, slave=slave, master=master)
        problem = create_problem(V, [contact], planes)
    problem.update_geometry()
    (link,) = problem.system.links
    found = [link.gaps(problem.positions()), notes._missed(link, None)]
    gaps, missed = (np.concatenate(COMM.allgather(part)) for part in found)
    # the change of normals over the distance is left out
    assert np.abs(gaps).max() < 1.5 * np.abs(missed).max()
