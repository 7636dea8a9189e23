# SPDX-License-Identifier: MIT
"""No number of the QPs decides an answer: halved or doubled, each gives the same."""

from importlib import import_module
from pkgutil import walk_packages
from types import ModuleType

from mpi4py import MPI

import numpy as np
import pytest
from programs import gathered, membrane

from dolfinx_mortar import qp as qp_floor
from dolfinx_mortar.qp import LinearSolver, solve

COMM = MPI.COMM_WORLD

# What the floor still has in numbers: all are costs, or units of round-off.
NUMBERS = ["BOX", "LIMIT", "MAX_ITERATIONS", "REFACTOR_AFTER", "ROUND_OFF", "SHARE"]
NUMBERS += ["SETUP_AFTER", "SINGULAR_LOSS"]
CASES = [(name, "cholesky") for name in ("active-set", "interior-point", "tron")]
CASES += [("active-set", "gamg")]


def modules() -> list[ModuleType]:
    found = walk_packages(qp_floor.__path__, f"{qp_floor.__name__}.")
    return [import_module(module.name) for module in found]


def test_the_numbers_are_all_known() -> None:
    """EPS and what is no length, rate or count aside."""
    names = {
        name
        for module in modules()
        for name, value in vars(module).items()
        if name.isupper() and isinstance(value, (int, float)) and name not in ("EPS", "T")
    }
    assert names - {"LOOSE", "TIGHT", "OUT_OF_MEMORY"} == set(NUMBERS)


@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("name", NUMBERS)
def test_no_number_changes_an_answer(
    monkeypatch: pytest.MonkeyPatch, name: str, factor: float
) -> None:
    """Halved and doubled: for each backend, factorisation and multigrid, two tangents."""
    expected = [two_tangents(backend, pc) for backend, pc in CASES]
    for module in modules():
        if hasattr(module, name):
            value = getattr(module, name)
            monkeypatch.setattr(module, name, type(value)(factor * value))
    for (backend, pc), before in zip(CASES, expected, strict=True):
        scale = np.abs(before).max()
        np.testing.assert_allclose(two_tangents(backend, pc), before, atol=1e-8 * scale)


def two_tangents(backend: str, pc: str) -> np.ndarray:
    """Return the reactions of two neighbouring problems, from loose to tight."""
    qp = membrane(14)
    linear = LinearSolver(COMM, prefix="numbers_", options={"pc_type": pc})
    first = solve(qp, backend, linear, rtol=1e-4)
    diagonal = qp.A.getDiagonal()
    diagonal.array[::5] *= 1.05
    qp.A.setDiagonal(diagonal)
    return gathered(solve(qp, backend, linear, start_active=first.active, rtol=1e-11).z)
