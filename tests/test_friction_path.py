# SPDX-License-Identifier: MIT
"""Friction over several steps: energy, limits that change, how steps begin."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, Blocks
from tests.cases.friction import COMM, create, largest
from tests.choice import crosswise

EXACT = 1e-10
MU, PRESS = 0.3, 0.01


def walk(case, ways, press=PRESS):
    """Push the top along; return updates of active sets, and factorisations, of each step."""
    found = []
    for way in ways:
        rest = (0.3 * way,) if case.problem.d == 3 else ()
        parts = case.solve(way, *rest, -press).iterations
        found.append([sum(i.updates for i in parts), sum(i.factorisations for i in parts)])
    return found


# -- energy


def stored(case):
    """Return the elastic energy of all ranks."""
    return 0.5 * case.problem.solid.elastic_norm(case.problem.u) ** 2


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "slave"), [("triangle", "upper"), ("quadrilateral", "lower")])
def test_sliding_turns_work_into_dissipation(cell, slave):
    """While all slides: work = T times the way = what the contact says, the energy stays."""
    case = create(cell, slave=slave, friction=MU)
    walk(case, [0.0, 0.06])
    spent, elastic = case.contact.dissipation, stored(case)
    walk(case, [0.08])
    work = case.forces[0] * 0.02
    assert work > 0.0
    assert case.contact.dissipation - spent == pytest.approx(work, rel=1e-9)
    assert stored(case) == pytest.approx(elastic, rel=1e-9)
    assert work == pytest.approx(-MU * case.forces[1] * 0.02, rel=1e-9)
    assert largest(case.contact.slip.x.array) > 0.02


# -- limits of the user


def test_a_coefficient_that_changes_between_steps():
    """The force follows mu N of the moment."""
    case = create("triangle")
    mu = fem.Constant(case.problem.V.mesh, 0.5)
    case = case.again(friction=mu)
    case.solve(0.0, -PRESS)
    for way, value in ((0.1, 0.5), (0.1, 0.1), (0.12, 0.1), (0.2, 0.4)):
        mu.value = value
        case.solve(way, -PRESS)
        tangential, normal = case.forces
        assert tangential == pytest.approx(-value * normal, rel=EXACT)


@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_the_number_zero_is_no_friction(geometry):
    """Bit for bit what a contact without friction gives; a Constant 0 gives it to round-off."""
    bits = 0.0 if COMM.size == 1 else EXACT
    case = create("triangle", geometry=geometry, friction=0)
    plain = case.again()
    zero = case.again(friction=fem.Constant(case.problem.V.mesh, 0.0))
    for each in (case, plain, zero):
        walk(each, [0.0, 0.01])
    u, v, w = (each.problem.u.x.array for each in (case, plain, zero))
    assert largest(u - v) <= bits * largest(u)
    assert largest(w - u) < EXACT * largest(u)
    assert abs(zero.contact.dissipation) < EXACT * abs(case.forces[1]) * PRESS
    with pytest.raises(AttributeError, match="no friction"):
        case.contact.traction  # noqa: B018


@pytest.mark.parametrize(
    ("cell", "geometry"), crosswise(["triangle", "hexahedron"], ["reference", "updated"])
)
def test_tresca_with_the_limits_of_coulomb(cell, geometry):
    """With s = mu p of the solution of Coulomb's law, Tresca's law has the same solution."""
    case = create(cell, friction=MU, geometry=geometry)
    walk(case, [0.006])
    status = case.closed()["status"]
    assert (status == 1.0).any() and (status == 2.0).any()
    limit = fem.Function(case.contact.pressure.function_space)
    limit.x.array[:] = MU * case.contact.pressure.x.array
    other = case.again(tresca=limit)
    walk(other, [0.006])
    u, v = case.problem.u.x.array, other.problem.u.x.array
    assert largest(u - v) < 1e-8 * largest(u)
    a, b = case.closed(), other.closed()
    assert largest(a["traction"] - b["traction"]) < 1e-8 * a["pressure"].max()
    assert np.array_equal(a["status"], b["status"])


# -- a step begins with the slips of the last one


PRESSURE, MUS = 2.0, (0.5, 0.25, 0.4)
TOWER = [
    (-3.2, 3.2, 0.0, 1.0, 12, 3),
    (-2.6, 2.6, 1.0, 2.0, 13, 4),
    (-2.2, 2.2, 2.0, 3.0, 11, 3),
    (-1.6, 1.6, 3.0, 4.0, 8, 3),
]


@pytest.mark.parametrize("way", [0.03, 0.2])
def test_a_block_of_a_tower_slides_on(way):
    """By the weakest interface, at its limit; begun stuck, nodes slip one by one and it fails."""
    b = Blocks(TOWER, cell="quadrilateral")
    contacts = [
        dm.Contact(b.facets, slave=10 * (k + 1) + BELOW, master=10 * k + ABOVE, friction=mu)
        for k, mu in enumerate(MUS, start=1)
    ]
    top, weak = fem.Constant(b.mesh, 0.0), contacts[1]
    bcs, loads = [b.fix(1, BELOW), b.fix(4, ABOVE, 0, top)], b.traction(4, ABOVE, (0, -PRESSURE))
    problem = b.problem(contacts, bcs, loads=loads, geometry="reference")
    for top.value in (0.0, 0.01, 0.03, 0.03 + way):
        slid = weak.dissipation
        report = dm.newton(problem)
        problem.commit()
    counts = np.sum([(i.updates, i.factorisations) for i in report.iterations], axis=0)
    assert (counts <= [2, 3]).all()
    width = TOWER[3][1] - TOWER[3][0]
    limit = MUS[1] * PRESSURE * width
    assert np.abs(weak.force) == pytest.approx([limit, PRESSURE * width], rel=1e-5)
    assert weak.dissipation - slid == pytest.approx(limit * way, rel=1e-4)
