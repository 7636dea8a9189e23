# SPDX-License-Identifier: MIT
"""Rings: strains, loads and volumes of the whole ring, Lame's cylinder, what is refused."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.solid.kinematics import spatial
from dolfinx_mortar.supports.bodies import find_bodies, rigid_motions
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER, two_blocks
from tests.cases.pressed_blocks import rejected
from tests.cases.rings import Lame
from tests.cases.solid import (
    COMM,
    create_displacement,
    hold,
    plane,
    rectangle,
    rollers,
    tag_facets,
    total,
)

pytestmark = pytest.mark.mpi
E, NU = 1000.0, 0.3
LAW = dm.Elastic(E, NU)
RING = {"kinematics": "axisymmetric"}


def section(a, b, cells, cell="triangle", height=1.0):
    """Return the displacement of a ring a <= r <= b, 0 <= z <= height."""
    return create_displacement(rectangle([(a, 0.0), (b, height)], cells, cell))


def marked(domain, axis, at):
    """Return the measure of the facets at x[axis] = at."""
    return ufl.Measure("ds", domain, subdomain_data=tag_facets(domain, plane(axis, at)))(1)


@pytest.mark.parametrize(("cell", "a"), [("triangle", 0.0), ("quadrilateral", 1.0)])
def test_uniform_strains_have_their_stress_and_energy(cell, a):
    """U = (e_r r, e_z z): strains e_r, e_z, e_r of the whole ring, in that order."""
    u = section(a, a + 2.0, (5, 3), cell)
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
        u = section(1.0, 2.0, (n, n), cell)
        V = u.function_space
        solid = dm.Solid(u, LAW, **RING)
        loads = 10.0 * ufl.TestFunction(V)[0] * marked(V.mesh, 0, 1.0)
        bcs = rollers(V, [1], (0.0, 1.0))
        dm.newton(dm.ContactProblem(solid, bcs=bcs, loads=loads), rtol=1e-11)
        x = ufl.SpatialCoordinate(V.mesh)
        difference = u[0] - exact.displacement(x[0])
        error = fem.form((difference**2 + u[1] ** 2) * x[0] * ufl.dx)
        errors.append(np.sqrt(total(fem.assemble_scalar(error))))
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 1.85).all(), rates
    assert errors[-1] < 2e-3 * exact.displacement(1.0)


def test_loads_are_tractions_and_forces_those_of_the_ring():
    """Body forces, tractions and a potential: each is weighed by 2 pi r."""
    u = section(1.0, 3.0, (4, 2))
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
    f.set(0.0)
    term.add_forces(f)
    assert np.isclose(total(f.array[1::2]), 0.7 * area, rtol=1e-12)


def test_the_only_rigid_motion_is_along_the_axis():
    u = section(0.0, 1.0, (2, 2))
    V = u.function_space
    solid = dm.Solid(u, LAW, **RING)
    bodies = find_bodies(V, solid.kinematics.rigid_motions)
    (motion,) = rigid_motions(bodies)
    K, zero = solid.create_matrix(), motion.duplicate()
    solid.assemble_tangent(K)
    K.mult(motion, zero)
    assert zero.norm() < 1e-12 * K.norm() * motion.norm()
    with pytest.raises(ValueError, match=r"nothing holds .* translation along the axis of "):
        dm.ContactProblem(solid, bcs=rollers(V, [0])).audit()


def test_bodies_are_not_shifted_across_their_axis():
    """A prescribed radial growth is no rigid motion to begin with, one along the axis is."""
    u = section(1.0, 2.0, (2, 2))
    V = u.function_space
    grow = hold(V, plane(0, 1.0), value=(0.1, 0.2))
    problem = dm.ContactProblem(dm.Solid(u, LAW, **RING), bcs=[grow])
    problem.begin_step()
    moved = u.x.array.reshape(-1, 2)
    assert np.abs(moved - [0.0, 0.2]).max(initial=0.0) < 1e-15
    assert dm.newton(problem).converged


@pytest.mark.parametrize(
    ("given", "d", "words"),
    [
        ("axisymmetric", 3, ("'axisymmetric': on a mesh in 3D choose 'spatial'",)),
        ("plane_stress", 3, ("'plane_stress': on a mesh in 3D",)),
        ("plane_strain", 3, ("'plane_strain': on a mesh in 3D",)),
        (spatial, 2, ("'spatial': on a mesh in 2D choose 'plane_strain' or ",)),
        ("axisymetric", 2, ("kinematics is 'axisymetric': ", "or give a Kinematics")),
        (3, 2, ("kinematics is 3: on a mesh in 2D choose",)),
    ],
)
def test_wrong_kinematics_are_refused(given, d, words):
    u = create_displacement(rectangle([d * [0.0], d * [1.0]], d * [1]))
    with rejected(*words):
        dm.Solid(u, LAW, kinematics=given)


def test_negative_radii_are_refused():
    with rejected("nodes at r = x[0] < 0, down to -0.25; ", " r >= 0"):
        dm.Solid(section(-0.25, 1.0, (5, 2)), LAW, **RING)


@pytest.mark.parametrize("noise", [0.0, 1e-17, -1e-17])
def test_a_free_axis_is_refused(noise):
    """Also where the radius of its points is round-off, of either sign."""
    u = section(0.0, 1.0, (2, 3))
    V = u.function_space
    x = V.mesh.geometry.x
    x[x[:, 0] == 0.0, 0] = noise
    solid = dm.Solid(u, LAW, **RING)
    with rejected("4 nodes on the axis r = 0 are not held in r", "V.sub(0)"):
        dm.newton(dm.ContactProblem(solid, bcs=rollers(V, [1])))
    dm.ContactProblem(solid, bcs=rollers(V)).audit()


def test_an_axis_that_shall_open_is_refused():
    """In any step, with the displacement as it was."""
    u = section(0.0, 1.0, (2, 3))
    V = u.function_space
    radial = fem.Constant(V.mesh, 0.0)
    bcs = [*rollers(V, [1]), hold(V, plane(0), 0, radial)]
    solid = dm.Solid(u, LAW, **RING)
    problem = dm.ContactProblem(solid, bcs=bcs)
    dm.newton(problem)
    radial.value = 1e-9
    with rejected("4 nodes on the axis r = 0 are prescribed to leave it"):
        dm.newton(problem)
    assert (u.x.array == 0.0).all()


@pytest.mark.parametrize("tag", ["slave", "master"])
def test_contact_on_the_axis_is_refused(tag):
    """A facet of zero radius has no area."""
    domain, _, tags = two_blocks(COMM, (2, 2), (2, 2))
    u, lower = create_displacement(domain), tag == "master"
    V, also = u.function_space, TOP_OF_LOWER if lower else BOTTOM_OF_UPPER
    axis = mesh.locate_entities_boundary(domain, 1, plane(0))
    where = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < 0)
    axis = axis[np.isin(axis, where) == lower]
    values = np.concatenate([np.full(len(axis), also, dtype=np.int32), tags.values])
    indices, first = np.unique(np.concatenate([axis, tags.indices]), return_index=True)
    marks = mesh.meshtags(domain, 1, indices, values[first])
    contact = dm.Contact(marks, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    solid = dm.Solid(u, LAW, **RING)
    bcs = [*rollers(V, [0]), *rollers(V, [1], (-1.0, 1.0))]
    with pytest.raises(ValueError, match=rf"{tag}={also}: \d facets lie on the axis r = 0"):
        dm.ContactProblem(solid, [contact], bcs=bcs).audit()
