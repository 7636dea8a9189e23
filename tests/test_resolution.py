# SPDX-License-Identifier: MIT
"""Notes on contacts with too few nodes, whose largest pressure is not resolved."""

import re

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.ball import create_problem
from tests.cases.hertz import ELASTIC, create_case, create_mesh
from tests.cases.meshes import BOTTOM_OF_UPPER, LEFT, TOP_OF_LOWER
from tests.cases.pressed_blocks import PressedBlocks
from tests.choice import quick

pytestmark = pytest.mark.mpi


def said(report):
    found = [
        re.search(r"largest pressure is not resolved: its patch has (\d+) nodes", note)
        for note in report.notes
    ]
    return [int(match[1]) for match in found if match]


@pytest.mark.parametrize(("depth", "few"), [(1e-3, True), (0.02, False)])
def test_few_nodes_of_a_disc(depth, few):
    """As many as are active, which is what the error of the peak goes by."""
    case = create_case(create_mesh("graded", 0.1), ELASTIC)
    case.press(depth)
    report = dm.newton(case.problem)
    active = report.certificate.active_nodes
    assert said(report) == ([active] if few else []) and (active < 7) == few
    hertz = dm.analytic.hertz_line(case.force, 8.0, 206_900.0, 0.29, 206_900.0, 0.29)
    found = case.contact.gather(case.problem.u)
    assert (abs(found["pressure"].max() / hertz.peak_pressure - 1.0) < 0.03) != few


@pytest.mark.parametrize(
    ("cell", "few"), quick([("hexahedron", 13), ("tetrahedron", 9)], ("tetrahedron", 9))
)
def test_a_quarter_stands_for_the_whole(cell, few):
    """Nodes on no plane of symmetry count four times, on one twice."""
    problem, contact = create_problem(h=0.25, cell=cell, depth=0.017 if few < 10 else 0.0294)
    report = dm.newton(problem)
    found = contact.gather(problem.u)
    x = found["X"][found["active"] > 0]
    whole = (2 ** (np.abs(x[:, :2]) > 1e-9).sum(axis=1)).sum()
    assert said(report) == [whole] == [few]
    problem, _ = create_problem(h=0.25, cell=cell, depth=0.05)
    assert not said(dm.newton(problem))


@pytest.mark.parametrize(("slope", "times"), [(0.01, 1), (0.0, 2)])
def test_a_roller_is_no_plane_of_symmetry(slope, times):
    """Where a side ends at an angle, no node stands for two; at a right angle all but one do."""

    def inclined(x):
        rise = np.abs(slope * x[:, 0] if slope else 0.03 * np.maximum(x[:, 0] - 0.2, 0.0))
        return np.column_stack([x[:, 0], x[:, 1] + np.where(x[:, 1] > 0.0, rise, 0.0)])

    options = {"n_lower": (13, 4), "n_upper": (10, 4), "gap": 1e-6, "cell": "quadrilateral"}
    blocks = PressedBlocks(transform=inclined, **options)
    contact = blocks.contact(slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    rollers = fem.locate_dofs_topological(blocks.V.sub(0), 1, blocks.facets.find(LEFT))
    held = fem.dirichletbc(0.0, rollers, blocks.V.sub(0))
    blocks.top.value[1] = -5e-3 if slope else -2e-3
    report = dm.newton(blocks.problem([contact], bcs=[*blocks.bcs(), held]))
    active = report.certificate.active_nodes
    assert active > 2 and said(report) == [1 + times * (active - 1)]
