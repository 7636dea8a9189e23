# SPDX-License-Identifier: MIT
"""Coefficients of friction as functions of pressure and slip, and wrong ones."""

import numpy as np
import pytest

from tests.cases.friction import create as create_pushed
from tests.cases.pressed_blocks import rejected

REST, SLIDING = 0.5, 0.3


def drag(case):
    """Return the tangential over the normal force."""
    force = np.abs(case.contact.force)
    return force[:-1].max() / force[-1]


@pytest.mark.mpi
def test_static_and_kinetic_friction():
    """The drag rises to the coefficient at rest, and falls once all has slipped."""
    case = create_pushed(friction=lambda p, s: np.where(s > 0.0, SLIDING, REST))
    case.solve(0.0, -0.02)
    case.solve(0.002, -0.02)
    assert drag(case) < SLIDING
    case.solve(0.05, -0.02)
    assert drag(case) == pytest.approx(REST, rel=1e-10)
    case.solve(0.06, -0.02)
    assert drag(case) == pytest.approx(SLIDING, rel=1e-10)


@pytest.mark.mpi
def test_a_coefficient_that_falls_with_the_pressure():
    """A block that slides on is dragged by the pressures of the step before, node by node."""
    law = lambda p, s: 0.3 / (1.0 + p / 20.0)  # noqa: E731
    case = create_pushed(friction=law)
    case.solve(0.0, -0.02)
    case.solve(0.05, -0.02)
    before = case.contact.gather(case.problem.u)["pressure"]
    case.solve(0.06, -0.02)
    now = case.contact.gather(case.problem.u)
    assert (now["status"][before > 0.0] == 2.0).all() and before.max() > 10.0
    sliding = np.linalg.norm(now["traction"], axis=1)
    assert sliding == pytest.approx(law(before, None) * now["pressure"], rel=1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize("bad", [-0.1, np.nan])
def test_a_wrong_coefficient_is_named_with_its_place(bad):
    case = create_pushed(friction=lambda p, s: np.where(p > 0.0, bad, 0.3))
    case.solve(0.0, -0.02)
    u = case.problem.u.x.array.copy()
    case.push(0.01, -0.02)
    with rejected("friction", f"{bad:g}", "at (", ">= 0"):
        case.solve(0.01, -0.02)
    assert np.array_equal(case.problem.u.x.array, u)


def test_a_function_of_another_shape():
    case = create_pushed(friction=lambda p, s: [0.1, 0.2, 0.3])
    with rejected("friction", "(n,)"):
        case.solve(0.0, -0.02)
