# SPDX-License-Identifier: MIT
"""The parts of `Kinematics`, measure, weight and rigid motions, and that the solid uses them."""

import dataclasses
import math

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx_mortar.solid.kinematics import (
    axisymmetric,
    plane_strain,
    spatial,
)
from dolfinx_mortar.supports.bodies import find_bodies, free_motions, rigid_motions
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER
from tests.cases.pointwise_laws import Radial
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.solid import COMM, create_displacement, rectangle, residual, total
from tests.cases.user_laws import green_lagrange

pytestmark = pytest.mark.mpi
LAW = dm.Elastic(1000.0, 0.3)


GREEN = dataclasses.replace(plane_strain, name="finite", measure=green_lagrange)


def body(d):
    """Return a displacement in a box of d dimensions, beside the axis."""
    low = np.r_[1.0, np.zeros(d - 1)]
    return create_displacement(rectangle([low, low + [2.0, 1.0, 1.5][:d]], (4, 3, 2)[:d]))


def weighing(weight):
    """Return plane strain with another weight."""
    return dataclasses.replace(plane_strain, name="ring", weight=weight)


@pytest.mark.parametrize("d", [2, 3])
def test_rigid_motions_strain_nothing(d):
    """All of them, and no more: they are 3 or 6, independent, and the tangent resists none."""
    u = body(d)
    solid = dm.Solid(u, LAW)
    assert solid.kinematics is {2: plane_strain, 3: spatial}[d]
    x = u.function_space.tabulate_dof_coordinates()[:, :d]
    motions = solid.kinematics.rigid_motions(x)
    assert len(motions) == d * (d + 1) // 2
    flat = np.stack([motion.ravel() for motion in motions.values()])
    assert np.linalg.matrix_rank(flat) == len(motions)
    for motion in flat:
        u.x.array[:] = motion
        u.x.scatter_forward()
        scale = LAW.E * np.abs(motion).max()
        assert np.abs(residual(solid)).max(initial=0.0) < 1e-13 * scale
    u.x.array[:] = (x * np.arange(1, d + 1)).ravel()
    assert total(residual(solid) ** 2) > 1.0


@pytest.mark.parametrize(("law", "most"), [(LAW, 5), (Radial(1000.0, 0.3, 1.0, 50.0), 9)])
def test_newton_follows_a_nonlinear_measure(law, most):
    """Quadratic at the end, in few iterations, also for a linear law; its tangent changes, too."""
    case = PressedBlocks()
    case.top.value[:] = 0.1, -0.1
    solids = [dm.Solid(case.u, law, kinematics=k) for k in (None, GREEN)]
    assert [solid.linear for solid in solids] == [law is LAW, False]
    report = dm.newton(case.problem(law=solids[1], geometry="reference"), rtol=1e-10)
    forces = [iteration.force_residual for iteration in report.iterations]
    assert len(forces) <= most and forces[-1] < 1e-3 * forces[-2]


def test_the_weight_is_in_every_integral():
    """With 2 pi r a plane cut stands for a ring: its volume, and each force and energy of it."""
    ring = weighing(lambda x: 2 * np.pi * x[0])
    u = body(2)
    plain = dm.Solid(u, LAW, quadrature_degree=2)
    weighted = dm.Solid(u, LAW, quadrature_degree=2, kinematics=ring)
    assert np.isclose(total(weighted.fields.weights), math.pi * (3.0**2 - 1.0**2), rtol=1e-13)
    # a uniform strain: energy per area times the volume
    u.interpolate(lambda x: np.stack([0.01 * x[0], -0.02 * x[1]]))
    area, volume = 2.0, 8 * math.pi
    assert np.isclose(total(weighted.energy()) / total(plain.energy()), volume / area, rtol=1e-12)
    assert np.isclose(
        weighted.elastic_norm(u) ** 2 / plain.elastic_norm(u) ** 2, volume / area, rtol=1e-12
    )
    force = residual(weighted)
    power = total(force * u.x.array[: len(force)])
    assert np.isclose(power, 2 * total(weighted.energy()), rtol=1e-12)
    assert weighted.element_force_norm() > 2 * math.pi * plain.element_force_norm()


@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_a_constant_weight_is_a_thickness(kind):
    """Of bodies and interface alike: forces are 2.5 times as large, pressures the same."""
    case, found = PressedBlocks(), []
    for kinematics in (None, weighing(lambda x: 2.5)):
        case.u.x.array[:] = 0.0
        interface = kind(case.facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
        solid = dm.Solid(case.u, LAW, kinematics=kinematics)
        dm.newton(case.problem([interface], law=solid), rtol=1e-10)
        found.append((interface.force, interface.pressure.x.array.copy()))
    assert np.allclose(found[1][0], 2.5 * found[0][0], rtol=1e-8, atol=1e-8)
    assert np.allclose(found[1][1], found[0][1], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("weight", "message"),
    [
        (
            lambda x: ufl.exp(x[0]),
            r"the weight raised ValueError; .*with UFL and with NumPy",
        ),
        (lambda x: x[0] - 0.5, r"'ring': the weight is negative or NaN at \d+ of \d+ points"),
    ],
)
def test_interfaces_refuse_a_weight_that_is_none(weight, message):
    case = PressedBlocks()
    solid = dm.Solid(case.u, LAW, kinematics=weighing(weight))
    with pytest.raises(ValueError, match=message):
        case.problem(law=solid)


def test_round_off_of_an_axis_has_no_weight():
    """Nodes on the axis may be beyond it by their round-off; what is further is an error."""
    points = np.array([[-1e-17, 0.3], [2.0, 0.4]])
    assert axisymmetric.weights_at(points) == pytest.approx([0.0, 4 * math.pi], abs=0.0)
    assert axisymmetric.weights_at(points[:1]) == 0.0
    with pytest.raises(ValueError, match="negative or NaN at 1 of 2 points"):
        axisymmetric.weights_at(points - [1e-6, 0.0])


def along_the_axis(x):
    """Return the only rigid motion of a ring."""
    return {"shift along the axis": np.tile([0.0, 1.0], (len(x), 1))}


def constraint(bodies, weights):
    """Return a function of the sum of the bodies' mean displacements times weights (bodies, d)."""

    def value(v):
        motion = v.array_r.reshape(-1, 2)
        mean = bodies.mean(motion, np.ones_like(motion, dtype=bool))
        return np.atleast_1d(np.sum(mean * weights) * (COMM.rank == 0))

    return value


def test_motions_that_nothing_holds_are_those_of_the_kinematics():
    """A ring has one only; a body of no rigid motion is held."""
    V = PressedBlocks().V
    assert len(find_bodies(V).rigid_modes()) == 6
    bodies = find_bodies(V, along_the_axis)
    assert [name for _, name, _ in bodies.rigid_modes()] == 2 * ["shift along the axis"]
    across, along = np.array([[0, 0], [0, 1.0]]), np.array([[0, 1.0], [0, -1.0]])
    (free,) = free_motions(bodies, [constraint(bodies, across)])
    assert free.startswith("shift along the axis of the body around [")
    (free,) = free_motions(bodies, [constraint(bodies, along)])
    assert free.startswith("shift along the axis of the bodies around [") and "together" in free
    assert free_motions(bodies, [constraint(bodies, w) for w in (across, along)]) == []
    assert free_motions(find_bodies(V, lambda x: {}), [constraint(bodies, along)]) == []


def test_a_problem_asks_for_the_motions_of_its_kinematics():
    ring = dataclasses.replace(plane_strain, name="ring", rigid_motions=along_the_axis)
    case = PressedBlocks()
    problem = dm.ContactProblem(dm.Solid(case.u, LAW, kinematics=ring))
    with rejected("nothing holds ", "shift along the axis of the body"):
        problem.audit()
    assert len(rigid_motions(problem.bodies)) == 1
