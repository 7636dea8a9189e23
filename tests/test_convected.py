# SPDX-License-Identifier: MIT
"""Steps in which a body slides over another one begin with the deformation moved along."""

import numpy as np
import pytest

from dolfinx_mortar.problem import predictors
from tests.cases.finite_sliding import indentation, walk

PRESSED, DRAGGED = 3, 4
SIZES = {"radius": 1.0, "length": 6.0, "height": 2.0, "start": 2.0}


def slid(slave, *, tool_held=False):
    """Press a half ring .3 deep and drag it, or the block, by facets; return the drag's steps."""
    case = indentation(n=((24, 5), (16, 2)), slave=slave, friction=0.0, **SIZES)
    place = case.base if tool_held else case.held

    def path(t):
        place.value[:] = (-0.6 if tool_held else 0.6) * max(t - PRESSED, 0.0), 0.0
        case.held.value[1] = -0.1 * min(t, PRESSED)
        return case.held.value.copy()

    steps = walk(case, path, np.arange(1, PRESSED + DRAGGED + 1), rtol=1e-8)
    return steps[PRESSED:]


def count(steps):
    return sum(report.newton_iterations for _, _, report in steps)


@pytest.mark.parametrize(
    "slave",
    [pytest.param("tool", marks=pytest.mark.mpi), pytest.param("block", marks=pytest.mark.slow)],
)
def test_it_saves_iterations_and_changes_no_answer(slave, monkeypatch):
    """Whichever body is moved: that it is the block whose dent moves is found by the overlap."""
    steps, other = slid(slave), slid(slave, tool_held=True)
    monkeypatch.setattr(predictors, "find_slides", lambda *_: [])
    rigid = slid(slave)
    for found in (other, rigid):
        for (_, force, _), (_, same, _) in zip(steps, found, strict=True):
            assert np.abs(same - force).max() < 1e-7 * np.abs(force).max()
    assert abs(count(other) - count(steps)) <= 1
    assert count(steps) + 3 <= count(rigid)
