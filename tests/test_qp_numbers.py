# SPDX-License-Identifier: MIT
"""No number of the QPs decides an answer: halved or doubled, each gives the same."""

from importlib import import_module
from pkgutil import walk_packages

from mpi4py import MPI

import numpy as np
import pytest
from programs import gathered, membrane

from dolfinx_mortar import qp as qp_package
from dolfinx_mortar.qp import LinearSolver, QPNotSolved, solve

COMM = MPI.COMM_WORLD

# Numbers of the sub-package qp: all are costs, or units of round-off.
COSTS = {"RENEWAL_COST": 0.2, "HALF_OF_DIGITS": 1e12}
DECIDE = {"LIMIT": 0.0, "ROUND_OFF": 1e12, "SHARE": 1e12, "QUARTER_OF_DIGITS": 1e-12}
ABSURD = COSTS | DECIDE  # with factors that must be felt
NUMBERS = sorted(ABSURD)
CASES = [(name, "cholesky") for name in ("active-set", "interior-point")]
CASES += [("active-set", "gamg")]


def modules():
    found = walk_packages(qp_package.__path__, f"{qp_package.__name__}.")
    return [import_module(module.name) for module in found]


def test_the_numbers_are_all_known():
    """EPS, TINY, UNDERFLOW and what is no length, rate or count aside."""
    names = {
        name
        for module in modules()
        for name, value in vars(module).items()
        if name.isupper() and (isinstance(value, (int, float)) or is_table(value))
    }
    elsewhere = {"EPS", "TINY", "UNDERFLOW", "SAME", "MOST_FACTORISED", "RESOLVED"}
    assert names - {"LOOSE", "TIGHT", "OUT_OF_MEMORY"} - elsewhere == set(NUMBERS)


def is_table(value):
    """Tell whether a value is a table of numbers, not of options."""
    return isinstance(value, dict) and all(isinstance(v, (int, float)) for v in value.values())


def scale(monkeypatch, name, factor):
    """Multiply a number wherever it is known."""
    for module in modules():
        if hasattr(module, name):
            value = getattr(module, name)
            table = value if is_table(value) else {"": value}
            scaled = {key: type(v)(factor * v) for key, v in table.items()}
            monkeypatch.setattr(module, name, scaled if is_table(value) else scaled[""])


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", NUMBERS)
def test_no_number_changes_an_answer(monkeypatch, name, factor):
    """Halved and doubled: for each backend, factorisation and multigrid, two tangents."""
    expected = [two_tangents(backend, pc)[0] for backend, pc in CASES]
    scale(monkeypatch, name, factor)
    for (backend, pc), before in zip(CASES, expected, strict=True):
        size = np.abs(before).max()
        np.testing.assert_allclose(two_tangents(backend, pc)[0], before, atol=1e-8 * size)


@pytest.mark.parametrize("name", NUMBERS)
def test_an_absurd_number_is_felt(monkeypatch, name):
    """Those that decide leave something unsolved, costs are others: the test above can fail."""
    costs = [two_tangents(backend, pc)[1] for backend, pc in CASES]
    scale(monkeypatch, name, ABSURD[name])
    found = []
    for backend, pc in CASES:
        try:
            found.append(two_tangents(backend, pc)[1])
        except QPNotSolved:
            found.append(None)
    assert (None in found) == (name in DECIDE)
    assert found != costs


def two_tangents(backend, pc):
    """Return the reactions of two neighbouring problems, from loose to tight, and the costs."""
    qp = membrane(14)
    linear = LinearSolver(COMM, prefix="numbers_", options={"pc_type": pc})
    first = solve(qp, backend, linear, rtol=1e-4)
    diagonal = qp.A.getDiagonal()
    diagonal.array[::5] *= 1.05
    qp.A.setDiagonal(diagonal)
    second = solve(qp, backend, linear, start_active=first.active, rtol=1e-11)
    costs = [first.updates, second.updates, linear.counts.iterations, linear.counts.factorisations]
    return gathered(second.z), costs
