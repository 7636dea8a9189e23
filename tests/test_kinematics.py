# SPDX-License-Identifier: MIT
"""The parts of `Kinematics`, measure, weight and rigid motions, and that the solid uses them."""

import dataclasses
import math

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.materials import DruckerPrager, Elastic, VonMisesVoce
from dolfinx_mortar.solid.kinematics import (
    axisymmetric,
    kinematics_of_dimension,
    plane_strain,
    spatial,
)
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.supports.bodies import find_bodies, free_motions, rigid_motions
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER, two_blocks
from tests.cases.pointwise_laws import Radial
from tests.cases.pressed_blocks import PressedBlocks
from tests.choice import quick

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
LAW = Elastic(1000.0, 0.3)


def create_displacement(d):
    """Return a displacement in a box of d dimensions."""
    if d == 2:
        domain = mesh.create_rectangle(COMM, [(1.0, 0.0), (3.0, 1.0)], (4, 3))
    else:
        domain = mesh.create_box(COMM, [(0, 0, 0), (1.0, 2.0, 1.5)], (3, 3, 2))
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))), name="u")


def forces(solid):
    """Return the owned internal forces."""
    r = solid.u.x.petsc_vec.duplicate()
    solid.assemble_residual(r)
    return r.array.copy()


def total(values):
    """Sum over all ranks."""
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def green_lagrange(u):
    """Return the finite strain (F^T F - I)/2 in the plane, as 3x3."""
    g = ufl.grad(u)
    e = (g + g.T + g.T * g) / 2
    return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, 0]])


FINITE = dataclasses.replace(plane_strain, name="finite", measure=green_lagrange)


def test_the_dimension_chooses():
    assert kinematics_of_dimension(2) is plane_strain and kinematics_of_dimension(3) is spatial
    for d, chosen in ((2, plane_strain), (3, spatial)):
        assert Solid(create_displacement(d), LAW).kinematics is chosen


@pytest.mark.parametrize("d", [2, 3])
def test_rigid_motions_strain_nothing(d):
    """All of them, and no more: they are 3 or 6, independent, and the tangent resists none."""
    u = create_displacement(d)
    solid = Solid(u, LAW)
    x = u.function_space.tabulate_dof_coordinates()[:, :d]
    motions = solid.kinematics.rigid_motions(x)
    assert len(motions) == d * (d + 1) // 2
    flat = np.stack([motion.ravel() for motion in motions.values()])
    assert np.linalg.matrix_rank(flat) == len(motions)
    for motion in flat:
        u.x.array[:] = motion
        u.x.scatter_forward()
        scale = LAW.E * np.abs(motion).max()
        assert np.abs(forces(solid)).max(initial=0.0) < 1e-13 * scale
    u.x.array[:] = (x * np.arange(1, d + 1)).ravel()
    assert total(forces(solid) ** 2) > 1.0


def moved(solid, side=0.0):
    """Set a displacement with rotations and strains of a tenth, along a direction; return that."""
    u, w = solid.u, fem.Function(solid.V)
    u.interpolate(lambda x: np.stack([0.1 * np.sin(2 * x[0] + x[1]), 0.2 * np.cos(x[0] - x[1])]))
    w.interpolate(lambda x: np.stack([np.cos(x[0] * x[1]), x[1] - np.sin(3 * x[0])]))
    u.x.array[:] += side * w.x.array
    return w


def test_forces_of_a_nonlinear_measure_are_the_derivative_of_its_energy():
    """Int S : d eps/du [w] = d Psi/du [w]."""
    solid = Solid(create_displacement(2), LAW, kinematics=FINITE)
    w, h, energies = moved(solid), 1e-6, []
    own = forces(solid)
    power = total(own * w.x.array[: len(own)])
    for side in (h, -h):
        moved(solid, side)
        energies.append(total(solid.energy()))
    assert abs((energies[0] - energies[1]) / (2 * h) - power) < 1e-7 * abs(power)


# how a law gives its tangent: derived from energy or stress, stated, or as numbers
TANGENTS = {
    "energy": LAW,
    "stress": DruckerPrager(1000.0, 0.3, 1e6, 0.3),
    "stated": VonMisesVoce(1000.0, 0.3, 1e6, 0.0, 0.0, 1.0, 1.0),
    "stated, flowing": VonMisesVoce(1000.0, 0.3, 1.0, 50.0, 20.0, 10.0, 5.0),
    "numbers": Radial(1000.0, 0.3, 1.0, 50.0),
}


@pytest.mark.parametrize("name", quick(TANGENTS, "energy", "numbers"))
def test_the_tangent_of_a_nonlinear_measure_is_that_of_its_forces(name):
    """With the geometric part S : d2 eps/du2, however a law gives its tangent."""
    solid = Solid(create_displacement(2), TANGENTS[name], kinematics=FINITE)
    w, own = moved(solid), len(forces(solid))
    tangent, product = solid.create_matrix(), solid.u.x.petsc_vec.duplicate()
    solid.assemble_tangent(tangent)
    tangent.mult(w.x.petsc_vec, product)
    differences = []
    for h in (2e-4, 1e-4):  # the error of both is of second order: extrapolated
        sides = []
        for side in (h, -h):
            moved(solid, side)
            sides.append(forces(solid))
        differences.append((sides[0] - sides[1]) / (2 * h))
    change = (4 * differences[1] - differences[0]) / 3
    assert len(change) == own
    assert total((change - product.array) ** 2) < 1e-16 * total(product.array**2)


@pytest.mark.parametrize(
    ("name", "most"),
    quick([("energy", 5), ("stated, flowing", 9), ("numbers", 9)], ("energy", 5), ("numbers", 9)),
)
def test_newton_follows_a_nonlinear_measure(name, most):
    """Quadratic at the end, in few iterations, also for a linear law; its tangent changes, too."""
    law, case = TANGENTS[name], PressedBlocks()
    case.top.value[:] = 0.1, -0.1
    solids = [Solid(case.u, law, kinematics=k) for k in (None, FINITE)]
    assert [solid.linear for solid in solids] == [law is LAW, False]
    contact, options = case.contact(), {"bcs": case.bcs(), "geometry": "reference"}
    report = dm.newton(dm.ContactProblem(solids[1], [contact], **options), rtol=1e-10)
    forces = [iteration.force_residual for iteration in report.iterations]
    assert len(forces) <= most and forces[-1] < 1e-3 * forces[-2]


def test_a_finite_rotation_is_no_finite_strain():
    solids = [Solid(create_displacement(2), LAW, kinematics=k) for k in (FINITE, None)]
    turn = np.array([[math.cos(1) - 1, -math.sin(1)], [math.sin(1), math.cos(1) - 1]])
    for solid in solids:
        solid.u.interpolate(lambda x: turn @ x[:2])
    assert total(solids[0].energy()) < 1e-20 * LAW.E < 0.1 * LAW.E < total(solids[1].energy())


def test_the_weight_is_in_every_integral():
    """With 2 pi r a plane cut stands for a ring: its volume, and each force and energy of it."""
    ring = weighing(lambda x: 2 * np.pi * x[0])
    u = create_displacement(2)
    plain = Solid(u, LAW, quadrature_degree=2)
    weighted = Solid(u, LAW, quadrature_degree=2, kinematics=ring)
    assert np.isclose(total(weighted.fields.weights), math.pi * (3.0**2 - 1.0**2), rtol=1e-13)
    # a uniform strain: energy per area times the volume
    u.interpolate(lambda x: np.stack([0.01 * x[0], -0.02 * x[1]]))
    area, volume = 2.0, 8 * math.pi
    assert np.isclose(total(weighted.energy()) / total(plain.energy()), volume / area, rtol=1e-12)
    assert np.isclose(
        weighted.elastic_norm(u) ** 2 / plain.elastic_norm(u) ** 2, volume / area, rtol=1e-12
    )
    power = total(forces(weighted) * u.x.array[: len(forces(weighted))])
    assert np.isclose(power, 2 * total(weighted.energy()), rtol=1e-12)
    assert weighted.element_force_norm() > 2 * math.pi * plain.element_force_norm()


def weighing(weight):
    """Return plane strain with another weight."""
    return dataclasses.replace(plane_strain, name="ring", weight=weight)


@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
def test_a_constant_weight_is_a_thickness(kind):
    """Of bodies and interface alike: forces are 2.5 times as large, pressures the same."""
    domain, _, tags = two_blocks(COMM, (2, 2), (3, 2))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    found = []
    for kinematics in (None, weighing(lambda x: 2.5)):
        solid = Solid(fem.Function(V), LAW, kinematics=kinematics)
        interface = kind(tags, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
        ends = [fem.locate_dofs_topological(V, 1, tags.find(tag)) for tag in (1, 2)]
        bcs = [fem.dirichletbc(np.zeros(2), ends[0], V)]
        bcs.append(fem.dirichletbc(np.array([0.0, -0.01]), ends[1], V))
        dm.newton(dm.ContactProblem(solid, [interface], bcs=bcs), rtol=1e-10)
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
    domain, _, tags = two_blocks(COMM, (2, 2), (3, 2))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    contact = dm.Contact(tags, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    solid = dm.Solid(u, LAW, kinematics=weighing(weight))
    with pytest.raises(ValueError, match=message):
        dm.ContactProblem(solid, [contact])


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
    domain, _, _ = two_blocks(COMM, (2, 2), (3, 2))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
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
    domain, _, _ = two_blocks(COMM, (2, 2), (3, 2))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    ring = dataclasses.replace(plane_strain, name="ring", rigid_motions=along_the_axis)
    problem = dm.ContactProblem(Solid(u, LAW, kinematics=ring))
    with pytest.raises(ValueError, match=r"nothing holds .*shift along the axis of the body"):
        problem.audit()
    assert len(rigid_motions(problem.bodies)) == 1


@pytest.mark.parametrize("d", [2, 3])
def test_few_attributes(d):
    assert len(vars(Solid(create_displacement(d), LAW))) <= 12
