# SPDX-License-Identifier: MIT
"""Ties with a jump: exact states, signs, either slave, what changes between steps."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from tests.cases.block_piles import ABOVE, BELOW, Blocks
from tests.cases.glued_bar import CELLS, CONFINED, NU, Bar, E, largest
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.rings import shrink_fit_pressure
from tests.cases.shells import to_arc, to_sphere
from tests.choice import crosswise

EXACT = 1e-9


@pytest.mark.mpi
@pytest.mark.parametrize(("slave", "degree"), crosswise(["upper", "lower"], [1, 2]))
@pytest.mark.parametrize("cell", CELLS)
def test_a_jump_between_clamped_ends_strains_uniformly(cell, degree, slave):
    """The stress is E_c J / L, where J opens, and L = 2; both slaves, non-matching meshes."""
    J = 1e-3
    case = Bar(cell, degree=degree, slave=slave)
    case.tie.jump = case.along(case.sign * J)  # the upper side goes up
    last = case.d - 1
    bcs = [*case.rollers(), case.hold(BOTTOM, last), case.hold(TOP, last)]
    report = dm.newton(case.problem(bcs), rtol=1e-10)

    def exact(x, upper):
        along = np.where(upper, (1 - x[:, last]) * J / 2, -(1 + x[:, last]) * J / 2)
        return along[:, None] * (np.arange(case.d) == last)

    assert case.error(exact) < EXACT * J
    expected = case.along(case.sign * CONFINED * J / 2)  # pushed apart: the upper one up
    assert np.allclose(case.tie.force, expected, rtol=1e-8, atol=1e-8 * abs(expected[last]))
    assert np.allclose(case.tie.master_force, -case.tie.force, rtol=1e-8, atol=1e-10)
    assert report.certificate.force_balance < 1e-10
    on = case.tie.gather(case.u)
    assert np.allclose(on["gap"], J, rtol=1e-10)
    assert np.allclose(on["pressure"], CONFINED * J / 2, rtol=1e-7)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cell", "degree", "slave", "kind"),
    [
        ("triangle", 1, "upper", "callable"),
        ("quadrilateral", 2, "lower", "function of degree 1"),
        ("tetrahedron", 2, "upper", "function"),
        ("hexahedron", 1, "lower", "callable"),
    ],
)
def test_a_linear_jump_turns_the_body(cell, degree, slave, kind):
    """A jump that is linear along flat sides turns the upper body."""
    wide = {"x_lower": (-0.2, 1.2)} if cell in CELLS[:2] else {"lower": (-0.2, 1.2, -0.1, 1.3)}
    case = Bar(cell, degree=degree, slave=slave, law=dm.Elastic(E, 0.0), **wide)
    d = case.d
    W = 1e-3 * np.array([[0.0, 2.0, -1.0], [-2.0, 0.0, 3.0], [1.0, -3.0, 0.0]])[:d, :d]
    shift = 1e-3 * np.array([0.5, -0.3, 0.2])[:d]
    values = lambda x: case.sign * (W @ x[:d] + shift[:, None])  # noqa: E731
    if kind == "callable":
        case.tie.jump = values
    else:
        own = kind == "function"
        given = fem.Function(case.V if own else fem.functionspace(case.mesh, ("Lagrange", 1, (d,))))
        given.interpolate(values)
        case.tie.jump = given
    dm.newton(case.problem([case.hold(BOTTOM)]), rtol=1e-10)
    exact = lambda x, upper: upper[:, None] * (x[:, :d] @ W.T + shift)  # noqa: E731
    assert case.error(exact) < EXACT * 1e-3


@pytest.mark.parametrize(("slave", "cell"), crosswise(["upper", "lower"], CELLS))
@pytest.mark.parametrize("gap", [0.0, 0.2])
def test_curved_sides_jump_as_a_whole(cell, slave, gap):
    """Also where they stand apart and stand for smooth surfaces, whose master turns an arm."""
    transform = to_arc if cell in CELLS[:2] else to_sphere
    case = Bar(cell, slave=slave, transform=transform, gap=gap)
    J = np.array([3e-3, -2e-3, 1e-3])[: case.d]
    case.tie.jump = case.sign * J
    dm.newton(case.problem([case.hold(BOTTOM)]), rtol=1e-10)
    assert case.error(lambda x, upper: upper[:, None] * J) < EXACT * 1e-3


@pytest.mark.mpi
@pytest.mark.parametrize("as_constant", [True, False])
def test_jumps_change_between_steps(as_constant):
    """They are read anew, by a Constant's value or set; None ends them, and nothing stays."""
    case = Bar("quadrilateral")
    jump = fem.Constant(case.mesh, np.zeros(2))
    bcs = [*case.rollers(), case.hold(BOTTOM, 1), case.hold(TOP, 1)]
    problem = case.problem(bcs)

    def on_time(J):
        jump.value[1] = J
        case.tie.jump = jump if as_constant else [0.0, J]

    forces = [
        case.tie.force[1] for _ in dm.load_steps(problem, [1e-3, 3e-3, -2e-3], on_time=on_time)
    ]
    assert np.allclose(forces, CONFINED / 2 * np.array([1e-3, 3e-3, -2e-3]), rtol=1e-8)
    case.tie.jump = None
    dm.newton(problem)
    assert abs(case.tie.force[1]) < 1e-8 and largest(case.u.x.array) < 1e-11
    assert not largest(case.tie.pressure.x.array) > 1e-8 and not case.tie.gap.x.array.any()


def test_a_radial_jump_shrinks_a_ring_on_another_one():
    """The pressure of a shrink fit of equal materials (Lame), in plane strain of rings."""
    a, b, c, J = 1.0, 2.0, 3.0, 1e-3
    # the blocks' y is the axis: they are turned, so that the inner ring is the lower block
    case = Bar(
        "quadrilateral",
        degree=2,
        kinematics="axisymmetric",
        transform=lambda x: np.column_stack([b + x[:, 1], -x[:, 0]]),
    )
    case.tie.jump = [J, 0.0]
    axial = [case.hold(tag, 1) for tag in (5, 6)]
    dm.newton(case.problem(axial), rtol=1e-10)
    p = shrink_fit_pressure(E, NU, (a, b, c), J)
    found = case.tie.gather(case.u)["pressure"]
    assert np.allclose(found, p, rtol=3e-3)
    assert case.tie.force[0] == pytest.approx(2 * np.pi * b * p, rel=1e-3)


@pytest.mark.parametrize("slave", ["upper", "lower"])
def test_a_jump_closes_a_gap_of_many_facets(slave):
    """A body that a jump lifts meets another one: what it is too long by strains the pile."""
    heights, gap, J = (1.0, 1.0, 0.6), 0.4, 0.5
    boxes = [(0, 1, 0, 1, 7, 3), (0, 1, 1, 2, 20, 20), (0, 1, 2 + gap, 2.6 + gap, 24, 12)]
    b = Blocks(boxes, cell="quadrilateral")
    faces = [(2, BELOW), (1, ABOVE)][:: 1 if slave == "upper" else -1]
    sign = 1.0 if slave == "upper" else -1.0
    tie, contact = b.join(dm.Tie, *faces), b.join(dm.Contact, (2, ABOVE), (3, BELOW))
    tie.jump = [0.0, sign * J]
    bcs = [b.fix(1, BELOW), b.fix(3, ABOVE)]
    problem = b.problem([contact, tie], bcs, dm.Elastic(E, 0.0))
    report = dm.newton(problem, rtol=1e-9)
    pressed = -E * (J - gap) / sum(heights)
    assert np.allclose(contact.force, [0.0, pressed], rtol=1e-7, atol=1e-7)
    assert np.allclose(tie.force, [0.0, -sign * pressed], rtol=1e-7, atol=1e-7)
    assert report.newton_iterations <= 4
