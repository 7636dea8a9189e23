# SPDX-License-Identifier: MIT
"""Kinematics: measure, weight and rigid motions, and how the solid uses them; rings."""

import dataclasses

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.solid.kinematics import plane_strain, spatial
from dolfinx_mortar.solid.supports import create_dirichlet, rigid_motions
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER, skins
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.rings import Lame
from tests.cases.solid import (
    create_displacement,
    hold,
    plane,
    rectangle,
    residual,
    rollers,
    stand,
    tag_facets,
    total,
)
from tests.cases.two_bodies import create_problem

pytestmark = pytest.mark.mpi


E, NU = 1000.0, 0.3
LAW = dm.Elastic(E, NU)


def body(d):
    low = np.r_[1.0, np.zeros(d - 1)]
    return create_displacement(rectangle([low, low + [2.0, 1.0, 1.5][:d]], (4, 3, 2)[:d]))


def weighing(weight):
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


RING = {"kinematics": "axisymmetric"}


def section(a, b, cells, cell="triangle"):
    return rectangle([(a, 0.0), (b, 1.0)], cells, cell)


def ring(a, b, cells, supports=None, **options):
    return stand(section(a, b, cells), LAW, supports, **RING, **options)


def marked(domain, axis, at):
    return ufl.Measure("ds", domain, subdomain_data=tag_facets(domain, plane(axis, at)))(1)


@pytest.mark.parametrize(("cell", "a"), [("triangle", 0.0), ("quadrilateral", 1.0)])
def test_uniform_strains_have_their_stress_and_energy(cell, a):
    """U = (e_r r, e_z z): strains e_r, e_z, e_r of the whole ring, in that order."""
    u = create_displacement(section(a, a + 2.0, (5, 3), cell))
    solid = dm.Solid(u, LAW, **RING)
    e_r, e_z = 0.01, -0.03
    u.interpolate(lambda x: np.stack([e_r * x[0], e_z * x[1]]))
    solid.evaluate()
    lam, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    trace = 2 * e_r + e_z
    stress = lam * trace + 2 * mu * np.array([e_r, e_z, e_r, -lam * trace / (2 * mu)])
    found = solid.fields.values("stress")
    assert np.abs(found - stress).max(initial=0.0) < 1e-12 * np.abs(stress).max()
    volume = np.pi * ((a + 2.0) ** 2 - a**2)
    assert np.isclose(total(solid.fields.weights), volume, rtol=1e-12)
    energy = volume * (lam / 2 * trace**2 + mu * (2 * e_r**2 + e_z**2))
    assert np.isclose(total(solid.energy()), energy, rtol=1e-12)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_a_thick_cylinder_converges_to_lame(cell):
    """Under pressure inside, n cells across: second order in u."""
    exact = Lame(E, NU, 1.0, 2.0, inside=10.0)
    errors = []
    for n in (4, 8, 16):
        u = create_displacement(section(1.0, 2.0, (n, n), cell))
        V = u.function_space
        loads = 10.0 * ufl.TestFunction(V)[0] * marked(V.mesh, 0, 1.0)
        bcs = rollers(V, [1], (0.0, 1.0))
        dm.newton(create_problem(u, (), bcs, LAW, loads=loads, **RING), rtol=1e-11)
        x = ufl.SpatialCoordinate(V.mesh)
        difference = u[0] - exact.displacement(x[0])
        error = fem.form((difference**2 + u[1] ** 2) * x[0] * ufl.dx)
        errors.append(np.sqrt(total(fem.assemble_scalar(error))))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 1.85).all(), rates
    assert errors[-1] < 2e-3 * exact.displacement(1.0)


def test_loads_are_tractions_and_forces_those_of_the_ring():
    """Body forces, tractions and a potential: each is weighed by 2 pi r."""
    u = create_displacement(section(1.0, 3.0, (4, 2)))
    V, v = u.function_space, ufl.TestFunction(u.function_space)
    solid = dm.Solid(u, LAW, **RING)
    area = np.pi * (3.0**2 - 1.0**2)
    f = u.x.petsc_vec.duplicate()
    up = marked(V.mesh, 1, 1.0)
    for loads, expected in ((2.5 * v[1] * up, 2.5 * area), (-4.0 * v[1] * ufl.dx, -4.0 * area)):
        problem = dm.ContactProblem(solid, loads=loads)
        problem.terms.begin(0.0, 0.0)
        problem.terms.assemble_forces(f)
        assert np.isclose(total(f.array[1::2]), -expected, rtol=1e-12)
    spring = dm.ContactProblem(solid, potential=0.5 * 7.0 * u[1] ** 2 * up)
    u.interpolate(lambda x: np.stack([0 * x[0], 0 * x[0] + 0.1]))
    ((_, term),) = spring.terms.named
    assert np.isclose(total(term.energy()), 0.5 * 7.0 * 0.01 * area, rtol=1e-12)


def test_the_only_rigid_motion_is_along_the_axis():
    problem = ring(0.0, 1.0, (2, 2), lambda V: rollers(V, [0]))
    solid = problem.solid
    (motion,) = rigid_motions(problem.bodies)
    K, zero = solid.create_matrix(), motion.duplicate()
    solid.assemble_tangent(K)
    K.mult(motion, zero)
    assert zero.norm() < 1e-12 * K.norm() * motion.norm()
    with rejected("nothing holds ", " translation along the axis of "):
        problem.audit()


@pytest.mark.parametrize(
    ("given", "d", "words"),
    [
        ("axisymmetric", 3, ("'axisymmetric': on a mesh in 3D choose 'spatial'",)),
        (spatial, 2, ("'spatial': on a mesh in 2D choose 'plane_strain' or ",)),
        ("axisymetric", 2, ("kinematics is 'axisymetric': ", "or give a Kinematics")),
    ],
)
def test_wrong_kinematics_are_refused(given, d, words):
    domain = rectangle([d * [0.0], d * [1.0]], d * [1])
    with rejected(*words):
        stand(domain, LAW, kinematics=given)


def test_negative_radii_are_refused():
    with rejected("nodes at r = x[0] < 0, down to -0.25; ", " r >= 0"):
        ring(-0.25, 1.0, (5, 2))


def test_a_free_axis_is_refused():
    """Also where the radius of its points is round-off, of either sign."""
    domain = section(0.0, 1.0, (2, 3))
    x = domain.geometry.x
    x[x[:, 0] == 0.0, 0] = [0.0, 1e-17, -1e-17, 1e-17][: np.sum(x[:, 0] == 0.0)]
    with rejected("4 nodes on the axis r = 0 are not held in r", "V.sub(0)"):
        dm.newton(stand(domain, LAW, lambda V: rollers(V, [1]), **RING))
    stand(domain, LAW, rollers, **RING).audit()


def test_an_axis_that_shall_open_is_refused():
    """In any step, with the displacement as it was."""
    domain = section(0.0, 1.0, (2, 3))
    radial = fem.Constant(domain, 0.0)

    def held(V):
        return [*rollers(V, [1]), hold(V, plane(0), 0, radial)]

    problem = stand(domain, LAW, held, **RING)
    dm.newton(problem)
    radial.value = 1e-9
    with rejected("4 nodes on the axis r = 0 are prescribed to leave it"):
        dm.newton(problem)
    assert (problem.u.x.array == 0.0).all()


def test_contact_on_the_axis_is_refused():
    """A facet of zero radius has no area."""
    case = PressedBlocks()
    contact = case.contact(4, 3, skins(case.mesh, case.cells, case.facets))
    bcs = [*rollers(case.V, [0]), *rollers(case.V, [1], (-1.0, 1.0))]
    with rejected("slave=4: 3 facets lie on the axis r = 0"):
        case.problem([contact], bcs, dm.Solid(case.u, LAW, **RING)).audit()


def test_conditions_that_differ_by_round_off_agree():
    """Values interpolated in two ways differ by hundreds of units in the last place."""
    V = create_displacement(section(1.0, 3.0, (4, 2))).function_space
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 1.0))
    for off, agree in ((200 * np.finfo(float).eps, True), (1e-10, False)):
        bcs = [fem.dirichletbc(np.array([value, 0.0]), dofs, V) for value in (1.0, 1.0 + off)]
        if agree:
            create_dirichlet(V, bcs)
        else:
            with rejected("bcs"):
                create_dirichlet(V, bcs)
