# SPDX-License-Identifier: MIT
"""The entries of the certificate about the mortar operators."""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.algebra.parallel import maximum
from dolfinx_mortar.common.arrays import ROUND_OFF
from dolfinx_mortar.interfaces.link import nodal_gaps
from dolfinx_mortar.problem.checks import StepData
from dolfinx_mortar.problem.contacts import Contacts, Scales, measure
from dolfinx_mortar.problem.linearisation import find_balance, linearise
from dolfinx_mortar.report.certificate import StepEnd, create_certificate, set_results
from tests.cases.close_fits import create_shrink_fit
from tests.cases.hertz import ELASTIC, paper

COMM = MPI.COMM_WORLD


def create_wedge():
    """Return a solved problem in which some slave nodes are closed and some are open."""
    case = paper(ELASTIC, geometry="reference")
    return case.problem, case.move(0.0, 0.05, rtol=1e-10)


def judge(problem, report, active, multipliers):
    """Return the certificate of the present displacement with some multipliers."""
    data = StepData(problem.supports.values(), np.zeros((problem.n, 2)), 0.0)
    balance = find_balance(problem, data)
    lin = linearise(problem, balance)
    contacts = Contacts(active, multipliers)
    _, balances = set_results(problem, balance, contacts)
    scales = Scales(problem.system.facet_length)
    residual = measure(problem.u, balance, contacts, lin.diagonal, scales, 1.0, 1e-6)
    found = balance, contacts, residual, lin.diagonal
    return create_certificate(StepEnd(problem, report, *found), balances)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("spoil", "fields"),
    [
        ("displacement", {"equilibrium"}),
        ("approach", {"gap", "complementarity"}),
        ("tension", {"sign", "equilibrium"}),
        ("force in a gap", {"complementarity", "equilibrium"}),
        ("Q", {"force_balance", "moment_balance"}),
    ],
)
def test_every_field_jumps(spoil, fields):
    """Exact to 1e-8 as solved; what is spoilt by a per mille is seen, and in its own field."""
    problem, report = create_wedge()
    (link,) = problem.system.links
    active, multipliers = problem.committed.active.copy(), np.zeros(problem.n)
    multipliers[link.nodes] = link.interface.multiplier
    right = judge(problem, report, active, multipliers.copy())
    names = ("equilibrium", "gap", "sign", "complementarity", "force_balance", "moment_balance")
    assert all(getattr(right, name) < 1e-8 for name in names)

    X = problem.V.tabulate_dof_coordinates()
    strongest = multipliers >= maximum(COMM, multipliers.max(initial=0.0))[0]
    if spoil == "displacement":
        inside = (np.abs(X[:, 0]) < 5) & (X[:, 1] < -1) & (X[:, 1] > -9)
        problem.u.x.array[1::2][inside] *= 1.01
    elif spoil == "approach":
        problem.u.x.array[1::2][X[:, 1] > 1e-9] -= 1e-3
    elif spoil == "tension":
        multipliers[strongest] *= -1e-3
    elif spoil == "force in a gap":
        gap = nodal_gaps(problem.system.links, problem.positions(), problem.n)
        far = np.isfinite(gap) & (gap > 0.1)
        multipliers[far] = 1e-3 * maximum(COMM, multipliers.max(initial=0.0))[0]
        active = active | far
    else:
        right_half = X[link.nodes[link.pattern.row], 0] > 0.0
        factor = 1.0 + 1e-3 * right_half[:, None, None]
        coupling = replace(link.coupling, blocks=factor * link.coupling.blocks)
        present = replace(problem.system.present, links=[replace(link, coupling=coupling)])
        problem.system.present = present
    spoilt = judge(problem, report, active, multipliers)
    assert all(getattr(spoilt, name) > 1e-5 for name in fields)


def imbalances_of_a_fit(shift):
    """Return force and moment balance (3, 2) of a ring on a shaft: solved, and with two errors."""
    case = create_shrink_fit((16, 24), True, shift=shift)
    report, problem = dm.newton(case.problem, rtol=1e-10), case.problem
    found = [report.certificate]
    (link,) = problem.system.links
    active, multipliers = problem.committed.active.copy(), np.zeros(problem.n)
    multipliers[link.nodes] = link.interface.multiplier
    blocks, p = link.coupling.blocks, link.pattern
    of_M = (np.arange(len(p.row)) >= p.split)[:, None, None]
    x = (problem.X[link.nodes[p.row], 0] - shift[0])[:, None, None]
    half = np.where(np.abs(x) < 1e-3, 0.5, x > 0.0)
    s, c = np.sin(0.01), np.cos(0.01)
    for wrong in ((1.0 + 0.01 * half) * blocks, blocks @ [[c, s], [-s, c]]):
        coupling = replace(link.coupling, blocks=np.where(of_M, wrong, blocks))
        links = [replace(link, coupling=coupling)]
        problem.system.present = replace(problem.system.present, links=links)
        found.append(judge(problem, report, active, multipliers))
    return np.array([[c.force_balance, c.moment_balance] for c in found])


@pytest.mark.mpi
def test_balances_where_resultants_cancel():
    """Around a shaft, by the origin or 1000 diameters away; coordinates have round-off there."""
    near, far = (imbalances_of_a_fit(shift) for shift in ((0.0, 0.0), (5e4, -3e4)))
    assert max(near[0].max(), far[0].max()) < ROUND_OFF * 6e4 / 20.0
    moment = np.sin(0.01) / (1.0 + 2.0 * np.sin(np.pi / 24))
    assert near[1:].ravel() == pytest.approx([0.01 / np.pi, 0.0, 0.0, moment], rel=0.03, abs=1e-4)
    assert far[1:] == pytest.approx(near[1:], rel=1e-6, abs=1e-9)
