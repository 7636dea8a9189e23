# SPDX-License-Identifier: MIT
"""Rings: strains, loads and volumes of the whole ring, Lame's cylinder, what is refused."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.solid.kinematics import KINEMATICS, spatial
from dolfinx_mortar.supports.bodies import find_bodies, rigid_motions
from tests.cases.meshes import BOTTOM_OF_UPPER, TOP_OF_LOWER, two_blocks
from tests.cases.rings import Lame, held_axis
from tests.choice import quick

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
E, NU = 1000.0, 0.3
LAW = dm.Elastic(E, NU)
CELLS = ["triangle", "quadrilateral"]


def section(a, b, cells, cell="triangle", height=1.0):
    """Return the displacement of a ring a <= r <= b, 0 <= z <= height."""
    ends = [(a, 0.0), (b, height)]
    domain = mesh.create_rectangle(COMM, ends, cells, mesh.CellType[cell])
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))), name="u")


def held(V, axis, at):
    """Return the condition u_axis = 0 at x[axis] = at."""
    facets = mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[axis], at))
    return fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(axis), 1, facets), V.sub(axis))


def marked(domain, axis, at):
    """Return the measure of the facets at x[axis] = at."""
    facets = np.sort(mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[axis], at)))
    tags = mesh.meshtags(domain, 1, facets, np.ones(len(facets), dtype=np.int32))
    return ufl.Measure("ds", domain, subdomain_data=tags)(1)


def total(values):
    """Sum over all ranks."""
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("a", [0.0, 1.0])
def test_uniform_strains_have_their_stress_and_energy(cell, a):
    """U = (e_r r, e_z z): strains e_r, e_z, e_r of the whole ring, in that order."""
    u = section(a, a + 2.0, (5, 3), cell)
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
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


@pytest.mark.parametrize("cell", quick(CELLS, "quadrilateral"))
def test_the_tangent_is_the_derivative_of_forces_and_these_of_the_energy(cell):
    u = section(0.0, 1.0, (3, 3), cell)
    law = dm.VonMises(E, NU, Y=5.0, a=50.0)
    solid = dm.Solid(u, law, kinematics="axisymmetric")
    w = fem.Function(u.function_space)
    u.interpolate(lambda x: 0.02 * np.stack([x[0] * np.cos(x[1]), np.sin(2 * x[0] + x[1])]))
    w.interpolate(lambda x: np.stack([x[0] * x[1], np.cos(x[0] - x[1])]))
    start, h = u.x.array.copy(), 1e-7
    tangent, product = solid.create_matrix(), w.x.petsc_vec.duplicate()
    solid.assemble_tangent(tangent)
    tangent.mult(w.x.petsc_vec, product)
    energies, forces = [], []
    for side in (1, -1):
        u.x.array[:] = start + side * h * w.x.array
        energies.append(total(solid.energy()))
        forces.append(w.x.petsc_vec.duplicate())
        solid.assemble_residual(forces[-1])
    u.x.array[:] = start
    now = w.x.petsc_vec.duplicate()
    solid.assemble_residual(now)
    assert np.isclose((energies[0] - energies[1]) / (2 * h), now.dot(w.x.petsc_vec), rtol=1e-6)
    difference = forces[0] - forces[1]
    difference.scale(1 / (2 * h))
    assert (difference - product).norm() < 1e-6 * product.norm()


@pytest.mark.parametrize("cell", CELLS)
def test_a_thick_cylinder_converges_to_lame(cell):
    """Under pressure inside, from n = 4 to 16 cells across: second order in u."""
    exact = Lame(E, NU, 1.0, 2.0, inside=10.0)
    errors = []
    for n in (4, 8, 16):
        u = section(1.0, 2.0, (n, n), cell)
        V = u.function_space
        solid = dm.Solid(u, LAW, kinematics="axisymmetric")
        loads = 10.0 * ufl.TestFunction(V)[0] * marked(V.mesh, 0, 1.0)
        bcs = [held(V, 1, 0.0), held(V, 1, 1.0)]
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
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
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


def test_a_bar_under_its_ends_pressure():
    """A solid cylinder, its axis held: sigma_zz = -p, u_r = nu p r / E."""
    u = section(0.0, 1.0, (3, 4))
    V = u.function_space
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
    loads = -5.0 * ufl.TestFunction(V)[1] * marked(V.mesh, 1, 1.0)
    problem = dm.ContactProblem(solid, bcs=[held(V, 0, 0.0), held(V, 1, 0.0)], loads=loads)
    dm.newton(problem, rtol=1e-12)
    exact = fem.Function(V)
    exact.interpolate(lambda x: np.stack([NU * 5.0 / E * x[0], -5.0 / E * x[1]]))
    assert np.abs(u.x.array - exact.x.array).max(initial=0.0) < 1e-13


def test_the_only_rigid_motion_is_along_the_axis():
    u = section(0.0, 1.0, (2, 2))
    V = u.function_space
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
    bodies = find_bodies(V, solid.kinematics.rigid_motions)
    (motion,) = rigid_motions(bodies)
    K, zero = solid.create_matrix(), motion.duplicate()
    solid.assemble_tangent(K)
    K.mult(motion, zero)
    assert zero.norm() < 1e-12 * K.norm() * motion.norm()
    with pytest.raises(ValueError, match=r"nothing holds .* translation along the axis of "):
        dm.ContactProblem(solid, bcs=[held_axis(V)]).audit()


def test_bodies_are_not_shifted_across_their_axis():
    """A prescribed radial growth is no rigid motion to begin with, one along the axis is."""
    u = section(1.0, 2.0, (2, 2))
    V = u.function_space
    facets = mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[0], 1.0))
    dofs = fem.locate_dofs_topological(V, 1, facets)
    grow = fem.dirichletbc(np.array([0.1, 0.2]), dofs, V)
    problem = dm.ContactProblem(dm.Solid(u, LAW, kinematics="axisymmetric"), bcs=[grow])
    problem.begin_step()
    moved = u.x.array.reshape(-1, 2)
    assert np.abs(moved - [0.0, 0.2]).max(initial=0.0) < 1e-15
    assert dm.newton(problem).converged


@pytest.mark.parametrize(
    ("given", "d", "message"),
    [
        (
            "axisymmetric",
            3,
            r"'axisymmetric': on a mesh in 3D choose 'spatial'",
        ),
        ("plane_strain", 3, r"'plane_strain': on a mesh in 3D"),
        ("spatial", 2, r"'spatial': on a mesh in 2D choose 'plane_strain' or "),
        (spatial, 2, r"'spatial': on a mesh in 2D"),
        ("axisymetric", 2, r"kinematics is 'axisymetric': .* 'axisymmetric', or give a Kinematics"),
        (3, 2, r"kinematics is 3: on a mesh in 2D choose"),
    ],
)
def test_wrong_kinematics_are_refused(given, d, message):
    domain = mesh.create_unit_square(COMM, 2, 2) if d == 2 else mesh.create_unit_cube(COMM, 1, 1, 1)
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))))
    with pytest.raises(ValueError, match=message):
        dm.Solid(u, LAW, kinematics=given)


def test_kinematics_have_names():
    u = section(1.0, 2.0, (1, 1))
    for name in ("plane_strain", "axisymmetric"):
        assert dm.Solid(u, LAW, kinematics=name).kinematics is KINEMATICS[name]


def test_negative_radii_are_refused():
    u = section(-0.25, 1.0, (5, 2))
    with pytest.raises(ValueError, match=r"nodes at r = x\[0\] < 0, down to -0.25; .* r >= 0"):
        dm.Solid(u, LAW, kinematics="axisymmetric")


@pytest.mark.parametrize("noise", [0.0, 1e-17, -1e-17])
def test_a_free_axis_is_refused(noise):
    """Also where the radius of its points is round-off, of either sign."""
    u = section(0.0, 1.0, (2, 3))
    V = u.function_space
    x = V.mesh.geometry.x
    x[x[:, 0] == 0.0, 0] = noise
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
    with pytest.raises(
        ValueError, match=r"4 nodes on the axis r = 0 are not held in r.*V.sub\(0\)"
    ):
        dm.newton(dm.ContactProblem(solid, bcs=[held(V, 1, 0.0)]))
    dm.ContactProblem(solid, bcs=[held(V, 1, 0.0), held_axis(V)]).audit()


def test_an_axis_that_shall_open_is_refused():
    """In any step, with the displacement as it was."""
    u = section(0.0, 1.0, (2, 3))
    V = u.function_space
    radial = fem.Constant(V.mesh, 0.0)
    axis = mesh.locate_entities_boundary(V.mesh, 1, lambda x: np.isclose(x[0], 0.0))
    dofs = fem.locate_dofs_topological(V.sub(0), 1, axis)
    bcs = [held(V, 1, 0.0), fem.dirichletbc(radial, dofs, V.sub(0))]
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
    problem = dm.ContactProblem(solid, bcs=bcs)
    dm.newton(problem)
    radial.value = 1e-9
    with pytest.raises(ValueError, match=r"4 nodes on the axis r = 0 are prescribed to leave it"):
        dm.newton(problem)
    assert (u.x.array == 0.0).all()


@pytest.mark.parametrize("tag", ["slave", "master"])
def test_contact_on_the_axis_is_refused(tag):
    """A facet of zero radius has no area."""
    domain, _, tags = two_blocks(COMM, (2, 2), (2, 2))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    V = u.function_space
    axis = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
    also = {"slave": BOTTOM_OF_UPPER, "master": TOP_OF_LOWER}[tag]
    where = mesh.locate_entities_boundary(domain, 1, lambda x: x[1] < 0)
    axis = np.intersect1d(axis, where) if tag == "master" else np.setdiff1d(axis, where)
    values = np.concatenate([tags.values, np.full(len(axis), also, dtype=np.int32)])
    indices = np.concatenate([tags.indices, axis])
    indices, first = np.unique(indices[::-1], return_index=True)
    marks = mesh.meshtags(domain, 1, indices, values[::-1][first])
    contact = dm.Contact(marks, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    solid = dm.Solid(u, LAW, kinematics="axisymmetric")
    bcs = [held_axis(V), held(V, 1, -1.0), held(V, 1, 1.0)]
    with pytest.raises(ValueError, match=rf"{tag}={also}: \d facets lie on the axis r = 0"):
        dm.ContactProblem(solid, [contact], bcs=bcs).audit()
