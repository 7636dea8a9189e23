# SPDX-License-Identifier: MIT
"""No number in geometry and mortar decides an answer: halved or doubled, each gives the same.

And an absurd value of each makes a test fail.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dolfinx_mortar.geometry import segments
from dolfinx_mortar.mortar import (
    common_normals,
    curvature_correction,
    duals,
    integrals,
    passing,
    self_contact,
    surface,
)
from tests import (
    test_corners,
    test_curvature_jumps,
    test_dual,
    test_edges,
    test_margin,
    test_passing,
    test_segments_3d,
    test_self_contact,
    test_surface,
)

ROOT = Path(__file__).resolve().parent.parent
NUMBERS = [
    "BLUR", "CHUNK", "EPS", "FACING", "HALF_OF_DIGITS", "JUMP", "LEAST_COVERAGE", "LEAST_WEIGHT",
    "LIMIT", "PROJECTIONS", "QUARTER_OF_DIGITS", "REACH", "ROUND_OFF", "SAME", "STEP",
    "THROUGH", "TINY", "TURN", "VERTICES", "area._HIGHEST", "integrals._FALL", "segments._SLIDING",
    "surface._MOST_WARPED",
]  # fmt: skip
# Numbers that its cases do not reach: absurd values, and tests that fail with them. LEAST_WEIGHT is
# in test_axisymmetric_patch, PROJECTIONS in test_smooth_3d, LIMIT of parts, which only a kernel
# sees, in test_elements.
FELT = {
    "ALPHA": (
        duals,
        (0.2, 0.01),
        test_dual.test_vertices_of_six_node_facets_are_the_centres_of_their_functions,
    ),
    "BLUR": (
        common_normals,
        (10.0,),
        lambda: test_edges.test_forces_of_crossing_edges_are_normal_to_both(test_edges.SIDES[0]),
    ),
    "FACING": (
        segments,
        (0.0, 0.9),
        lambda: [
            test_segments_3d.test_what_stands_steeper_than_a_fifth_does_not_face(*case)
            for case in ((0.18, 0.0), (0.22, 1.0))
        ],
    ),
    "JUMP": (
        curvature_correction,
        (0.5,),
        lambda: test_curvature_jumps.test_what_varies_smoothly_does_not_jump(3.0, 32, 0.25),
    ),
    "_FALL": (
        integrals,
        (1e12,),
        lambda: test_corners.test_what_stands_back_behind_a_step_does_not_count("triangle", 1, 0.0),
    ),
    "REACH": (
        self_contact,
        (0.1,),
        test_self_contact.test_parts_that_come_near_ask_for_a_search,
    ),
    "TURN": (passing, (1e9,), lambda: test_passing.test_a_hub_may_turn_in_a_ring(90.0, 2)),
    "_MOST_WARPED": (
        surface,
        (0.0, 0.9),
        lambda: [test_surface.test_how_far_a_facet_may_be_warped(c) for c in (0.29, 0.31)],
    ),
    "_SLIDING": (
        segments,
        ({2: 0.0, 3: 0.0}, {2: 9.0, 3: 9.0}),
        lambda: test_margin.test_margin_of_sliding("stripes"),
    ),
}
DEFINITIONS = {"ALPHA"}  # of the multipliers' space, not of accuracy: see test_tying
SAME = 1e-12
pytestmark = [pytest.mark.serial, pytest.mark.slow]


@pytest.fixture(scope="module")
def changes():
    """Return how halving and doubling changes [operators, resultants] for every number."""
    program = [sys.executable, "-m", "tests.numbers_program"]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_no_number_is_left_out(changes):
    assert sorted(changes.keys() - {"absurd", "again"} - DEFINITIONS) == NUMBERS


@pytest.mark.parametrize("name", [name for name in NUMBERS if name != "LEAST_COVERAGE"])
def test_same_operators(changes, name):
    assert max(nodal for nodal, _ in changes[name]) < SAME


def test_coverage_decides_who_carries_but_not_what(changes):
    """Which nodes have a multiplier depends on it; what the sides exchange in total does not."""
    assert max(total for _, total in changes["LEAST_COVERAGE"]) < SAME


def test_the_kernels_see_the_numbers(changes):
    """With absurd ones, such as a round-off of a tenth, the operators change."""
    assert {name: found for name, found in changes["absurd"].items() if found[0] < 1e-6} == {}
    assert changes["again"][0] == [0.0, 0.0]


@pytest.mark.parametrize("name", FELT)
def test_an_absurd_value_fails(name, monkeypatch):
    module, values, test = FELT[name]
    usual = getattr(module, name)
    for value in values:
        monkeypatch.setattr(module, name, value)
        with pytest.raises((AssertionError, RuntimeError, ValueError, pytest.fail.Exception)):
            test()
        monkeypatch.setattr(module, name, usual)
    test()
