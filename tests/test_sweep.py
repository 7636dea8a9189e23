# SPDX-License-Identifier: MIT
"""Random problems, whose solutions an independent check judges."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.sweep.draws import KINDS
from tests.sweep.problems import COMM, create
from tests.sweep.recheck import residuals
from tests.sweep.run import TOLERANCE, run

SLOW_SEEDS = {  # failures, cuts, most iterations, cells turned out at a corner
    "hertz": (0, 1, 11, 12, 15, 28, 35, 39),
    "boxes3": (1, 2, 11, 18, 24, 26, 30, 36),
    "finite": (0, 1, 2, 8, 9, 5013, 5026),  # not 2023: no step is small enough at a rim
    "friction": (5, 6, 7, 8, 18, 28, 31, 33),
}


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("kind", KINDS)
def test_random_problems(kind):
    """Without a failure that has no excuse."""
    outcomes = [run(kind, seed) for seed in SLOW_SEEDS.get(kind, range(8))]
    assert not [(o.seed, o.failure) for o in outcomes if o.is_failed]


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        *(("hertz", 1), ("boxes3", 1), ("ring", 1), ("friction", 17), ("finite", 29)),
        *(pytest.param("friction", n, marks=pytest.mark.slow) for n in (9, 10, 16)),
        pytest.param("finite", 12, marks=pytest.mark.slow),  # smoothers estimate anew
    ],
)
def test_some_random_problems(kind, seed):
    outcome = run(kind, seed)
    assert not outcome.failure
    assert 0.0 < max(outcome.residuals.values()) <= TOLERANCE


@pytest.mark.mpi
def test_a_random_problem_on_ranks():
    assert not run("ring", 7).failure


def solved(kind, seed):
    case = create(kind, seed)
    for _ in dm.load_steps(case.problem, case.levels, on_time=case.on_time):
        pass
    return case


def test_the_check_sees_what_is_wrong():
    """Each residual jumps when what it judges is spoilt, by far more than the tolerance."""
    case = solved("hertz", 7)
    contact, u = case.problem.contacts[0], case.problem.u.x.array
    stress, pressure = case.problem.solid.stress.x.array, contact.pressure.x.array
    assert max(residuals(case).values()) <= TOLERANCE
    on, open_ = pressure > 0.0, (pressure == 0.0) & (contact.gap.x.array > 0.0)

    def spoilt(array, where, value):
        before = array.copy()
        array[where] = value
        result = residuals(case)
        array[:] = before
        return {name for name, value in result.items() if value > 10.0 * TOLERANCE}

    assert spoilt(stress, slice(None), 1.01 * stress) == {"equilibrium"}
    assert spoilt(pressure, on, 1.01 * pressure[on]) == {"equilibrium", "force"}
    assert "sign" in spoilt(pressure, np.flatnonzero(on)[:1], -1.0 * pressure.max())
    assert "complementarity" in spoilt(pressure, open_, pressure.max())
    dofs = case.problem.V.dofmap.list[case.cell_tags.find(2)]
    down = np.unique(2 * dofs + 1)
    assert "gap" in spoilt(u, down, u[down] - 0.01)
    stress *= 1.01  # the displacement of a body that has flown away is no excuse
    assert "equilibrium" in spoilt(u, down, u[down] - 1e12)


def test_the_check_sees_a_stress_that_is_no_cauchy_stress():
    """At finite strain the residual of forces knows J and F; Kirchhoff's stress does not pass."""
    case = solved("finite", 29)
    solid = case.problem.solid
    assert max(residuals(case).values()) <= TOLERANCE
    J, points = solid.fields.values("J"), solid.stress.function_space.dofmap
    assert np.abs(J - 1.0).max() > 0.05
    stress = solid.stress.x.array.reshape(-1, points.bs)
    stress[points.list[: len(J)].ravel()] *= J.reshape(-1, 1)
    assert residuals(case)["equilibrium"] > 10.0 * TOLERANCE


def test_the_check_sees_friction_that_is_wrong():
    """A limit, a direction, a slip or a state is off."""
    case = create("friction", 9, "smooth")
    for _ in dm.load_steps(case.problem, case.levels[:-1], on_time=case.on_time):
        pass
    before = case.problem.u.x.array[: case.problem.d * case.problem.n].copy()
    assert len(list(dm.load_steps(case.problem, case.levels[-1:], on_time=case.on_time))) == 1
    contact = case.problem.contacts[0]

    def off():
        return {k for k, v in residuals(case, before).items() if v > 10.0 * TOLERANCE}

    assert not off()
    assert 0 < COMM.allreduce(np.count_nonzero(contact.status.x.array == 2.0))
    traction, status = contact.traction.x.array, contact.status.x.array
    traction *= 1.01
    assert off() >= {"limit", "equilibrium"}
    traction /= -1.01
    assert off() >= {"slip", "equilibrium"}
    traction *= -0.99
    assert off() >= {"slip", "status"}
    traction /= 0.99
    assert not off()
    kept = status.copy()
    status[status == 2.0] = 1.0
    assert off() == {"status"}
    status[:] = kept
    case.limit.x.array[:] *= 0.99
    assert off() >= {"limit", "status"}
