# SPDX-License-Identifier: MIT
"""Friction over several steps: reversal, energy, coefficients that change, Tresca's law."""

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem
from tests.cases.friction import COMM, create
from tests.choice import crosswise

EXACT = 1e-10
MU, PRESS = 0.3, 0.01


def largest(array):
    """Return the largest absolute value of all ranks."""
    return float(COMM.allreduce(float(np.abs(array).max(initial=0.0)), op=MPI.MAX))


def stored(case):
    """Return the elastic energy of all ranks."""
    return 0.5 * case.problem.solid.elastic_norm(case.problem.u) ** 2


# -- reversal


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_what_is_pushed_back_sticks_at_first(cell):
    """After full slip a small reversal sticks at once, then all slides the other way."""
    case = create(cell, friction=MU)
    rest = (0.0,) if cell == "hexahedron" else ()

    def push(way):
        report = case.solve(way, *rest, -PRESS)
        nodes = case.closed()
        return report, nodes, case.forces[0] / -case.forces[-1]

    push(0.0)
    _, nodes, ratio = push(0.06)
    assert (nodes["status"] == 2.0).all()
    tolerance = EXACT if cell == "triangle" else 1e-2  # in space not all tractions are parallel
    assert ratio == pytest.approx(MU, rel=tolerance)
    before = nodes["slip"]
    _, nodes, ratio = push(0.06 - 1e-5)
    assert (nodes["status"] == 1.0).all()
    assert ratio < MU and np.array_equal(nodes["slip"], before)
    _, nodes, ratio = push(-0.06)
    assert (nodes["status"] == 2.0).all()
    assert ratio == pytest.approx(-MU, rel=tolerance)
    assert (nodes["slip"] > before + 0.01).all()  # the length of the way grows either way


def test_a_stuck_block_is_elastic():
    """While nothing slips a closed loop of pushes leaves nothing behind."""
    case = create("quadrilateral", friction=20.0)
    case.solve(0.0, -PRESS)
    first = case.problem.u.x.array.copy()
    for way in (1e-3, -1e-3, 0.0):
        case.solve(way, -PRESS)
    assert largest(case.problem.u.x.array - first) < EXACT * PRESS
    assert case.contact.dissipation == 0.0


# -- energy


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_sliding_turns_work_into_dissipation(cell, slave):
    """While all slides: work = T times the way = what the contact says, the energy stays."""
    case = create(cell, slave=slave, friction=MU)
    case.solve(0.0, -PRESS)
    case.solve(0.06, -PRESS)
    spent, elastic = case.contact.dissipation, stored(case)
    case.solve(0.08, -PRESS)
    work = case.forces[0] * 0.02
    assert work > 0.0
    assert case.contact.dissipation - spent == pytest.approx(work, rel=1e-9)
    assert stored(case) == pytest.approx(elastic, rel=1e-9)
    assert work == pytest.approx(-MU * case.forces[1] * 0.02, rel=1e-9)


def loop(steps):
    """Push back and forth in so many steps; return work, change of energy, and dissipation.

    The work is that of the top by the trapezoidal rule.
    """
    case = create("triangle", friction=MU)
    case.solve(0.0, -PRESS)
    start = stored(case)
    spent, work, last = case.contact.dissipation, 0.0, 0.0
    force = case.forces[0]
    path = np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in ((0, 0.03), (0.03, 0.0))])
    for way in path:
        case.solve(way, -PRESS)
        work += 0.5 * (force + case.forces[0]) * (way - last)
        force, last = case.forces[0], way
    return work, stored(case) - start, case.contact.dissipation - spent


def test_the_balance_of_energy_in_a_loop():
    """Work = stored + dissipated, up to what steps of finite length lose, which is never gained.

    In a step with closed contacts work - stored = 1/2 sum (T_0 + T_1) . slip, the dissipation is
    sum T_1 . slip, and (T_1 - T_0) . slip >= 0: work <= stored + dissipated. Halving the steps
    halves the difference or better.
    """
    lost = []
    for steps in (4, 8, 16):
        work, stored_, spent = loop(steps)
        assert spent > 0.0 and work > 0.0
        lost.append((stored_ + spent - work) / spent)
    assert min(lost) > -1e-9
    assert lost[0] > lost[1] > lost[2]
    assert lost[1] < 0.6 * lost[0] and lost[2] < 0.6 * lost[1]
    assert lost[2] < 0.02


# -- what the user changes


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


def test_a_coefficient_that_varies_in_space():
    """It slides where mu is zero, and sticks where it is large."""
    case = create("quadrilateral")
    V = case.problem.V
    mu = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
    mu.interpolate(lambda x: np.where(x[0] < 0.45, 0.0, 20.0))
    case = case.again(friction=mu)
    case.solve(0.0, -PRESS)
    case.solve(0.002, -PRESS)
    nodes = case.closed()
    left = nodes["X"][:, 0] < 0.45
    assert left.any() and (~left).any()
    assert (nodes["status"][left] == 2.0).all() and (nodes["status"][~left] == 1.0).all()
    assert largest(nodes["traction"][left]) < EXACT * nodes["pressure"].max()
    assert (np.abs(nodes["step_slip"][left, 0]) > 1e-5).all()
    assert (np.abs(nodes["traction"][~left, 0]) > 0.0).all()


@pytest.mark.mpi
@pytest.mark.parametrize(("degree", "other"), [(1, 2), (2, 1)])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_a_coefficient_of_another_degree_than_the_displacement(cell, degree, other):
    """Zeros stay zeros, which interpolation makes -1e-17; only its owned values need be set."""
    case = create(cell, degree=degree)
    V = case.problem.V
    mu = fem.Function(fem.functionspace(V.mesh, ("Lagrange", other)))
    case = case.again(friction=mu)
    own = mu.function_space.dofmap.index_map.size_local
    x = mu.function_space.tabulate_dof_coordinates()[:own]
    mu.x.array[own:] = np.nan
    mu.x.array[:own] = 0.5 + 0.1 * x[:, 0]
    nodes = V.tabulate_dof_coordinates()[: case.problem.n]
    assert (
        largest(
            case.contact.law.values(case.contact.gap.function_space) - (0.5 + 0.1 * nodes[:, 0])
        )
        < 1e-14
    )
    # 0, 0.17 and 0.3 in turns, so that zeros have all kinds of neighbours
    mu.x.array[:own] = np.array([0.0, 0.17, 0.3])[
        np.round(7 * x[:, :2].sum(axis=1)).astype(int) % 3
    ]
    found = case.contact.law.values(case.contact.gap.function_space)
    assert (found >= 0.0).all() and COMM.allreduce(int((found == 0.0).sum())) > 0


# -- none


@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_the_number_zero_is_no_friction(geometry):
    """Bit for bit what a contact without friction gives; a Constant 0 gives it to round-off.

    On several ranks sums come in as they will, and no two runs are the same to the bit.
    """
    bits = 0.0 if COMM.size == 1 else EXACT
    case = create("triangle", geometry=geometry, friction=0)
    plain = case.again()
    zero = case.again(friction=fem.Constant(case.problem.V.mesh, 0.0))
    for way in (0.0, 0.01):
        for each in (case, plain, zero):
            each.solve(way, -PRESS)
        u, v, w = (each.problem.u.x.array for each in (case, plain, zero))
        assert largest(u - v) <= bits * largest(u)
        assert np.allclose(case.contact.force, plain.contact.force, rtol=bits, atol=bits)
        assert largest(w - u) < EXACT * largest(u)
        assert zero.contact.force == pytest.approx(plain.contact.force, rel=EXACT, abs=EXACT)
    assert abs(zero.contact.dissipation) < EXACT * abs(case.forces[1]) * PRESS
    for each in (case, plain):
        with pytest.raises(AttributeError, match="no friction"):
            each.contact.traction  # noqa: B018


# -- Tresca


@pytest.mark.parametrize(
    ("cell", "geometry"),
    crosswise(["triangle", "quadrilateral", "hexahedron", "tetrahedron"], ["reference", "updated"]),
)
def test_tresca_with_the_limits_of_coulomb(cell, geometry):
    """With s = mu p of the solution of Coulomb's law, Tresca's law has the same solution."""
    case = create(cell, friction=MU, geometry=geometry)
    way = (0.006, 0.002) if len(case.top.value) == 3 else (0.006,)
    case.solve(*way, -PRESS)
    status = case.closed()["status"]
    assert (status == 1.0).any() and (status == 2.0).any()
    limit = fem.Function(case.contact.pressure.function_space)
    limit.x.array[:] = MU * case.contact.pressure.x.array
    other = case.again(tresca=limit)
    other.solve(*way, -PRESS)
    u, v = case.problem.u.x.array, other.problem.u.x.array
    assert largest(u - v) < 1e-8 * largest(u)
    a, b = case.closed(), other.closed()
    assert largest(a["traction"] - b["traction"]) < 1e-8 * a["pressure"].max()
    assert np.array_equal(a["status"], b["status"])


def test_tresca_knows_no_pressure():
    """Full slip resists with s times the closed length, however hard it is pressed."""
    s, forces = 1.0, []
    for press in (PRESS, 2 * PRESS):
        case = create("quadrilateral", tresca=s, mesh_options={"x_lower": (0.0, 1.0)})
        case.solve(0.0, -press)
        case.solve(0.05, -press)
        nodes = case.closed()
        assert np.abs(nodes["traction"][:, 0]) == pytest.approx(s, rel=EXACT)
        forces.append(case.forces[0])
    assert (nodes["status"] == 2.0).all() and len(nodes["status"]) == 8
    assert forces[1] == pytest.approx(s, rel=EXACT)
