# SPDX-License-Identifier: MIT
"""Finite strain in plane stress: every law is the spatial one without stress out of the plane."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from tests.cases import meshes
from tests.cases.pressed_blocks import COMM, rejected
from tests.cases.solid import create_displacement, create_domain, residual, set_wave
from tests.test_finite_in_space import compressed, sliding, zero
from tests.test_finite_laws import OGDEN

LAWS = {
    "neo-Hooke": dm.NeoHooke(1000.0, 0.3),
    "rubber": dm.MooneyRivlin(0.293, 0.177, 1410.0),
    "Ogden": OGDEN,
    "logarithmic": dm.Elastic(1000.0, 0.3),
    "plastic": dm.VonMises(1000.0, 0.3, 10.0, 0.0, 50.0),
    "kinematic": dm.VonMises(1000.0, 0.3, 10.0, 20.0, 0.0),
    "orthotropic": dm.Orthotropic(1e3, 500.0, 400.0, 0.3, 0.2, 0.1, 200.0, 150.0, 100.0, yaw=0.4),
}
QUICK = ("neo-Hooke", "plastic")
CHOICE = [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in LAWS]
PATH = [np.array([[1.3, 0.4], [0.1, 0.9]]), np.array([[0.8, 0.3], [-0.3, 1.2]])]


def deformed(domain, law, kinematics):
    """Return stresses (xx, yy, xy), J and plastic strains of a cell that follows PATH.

    In space it slides on z = 0 and has no other load or support out of the plane.
    """
    d = domain.geometry.dim
    V = fem.functionspace(domain, ("Lagrange", 1, (d,)))
    u = fem.Function(V)
    solid = dm.Solid(u, law, strain="finite", kinematics=kinematics)
    bcs, values = [], []
    for i in range(2):
        W, _ = V.sub(i).collapse()
        given = fem.Function(W)
        dofs = fem.locate_dofs_geometrical((V.sub(i), W), lambda x: np.full(x.shape[1], True))
        values.append(given)
        bcs.append(fem.dirichletbc(given, dofs, V.sub(i)))
    if d == 3:
        low = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0.0))
        bcs.append(
            fem.dirichletbc(zero(domain), fem.locate_dofs_topological(V.sub(2), 2, low), V.sub(2))
        )
    problem, found = dm.ContactProblem(solid, [], bcs=bcs), []
    for F in PATH:
        for i, given in enumerate(values):
            given.interpolate(lambda x, i=i, F=F: F[i] @ x[:2] - x[i])
        dm.newton(problem, rtol=1e-12)
        problem.commit()
        stress, J = (solid.fields.values(name) for name in ("stress", "J"))
        parts = [stress[..., [0, 1, 3]].reshape(-1, 3), J.reshape(-1, 1)]
        if "plastic_strain" in solid.state:
            parts.append(solid.fields.values("plastic_strain")[..., :4].reshape(-1, 4))
        found.append(np.hstack(parts)[0])
        assert np.abs(stress[..., 2]).max() < 1e-9 * np.abs(stress).max()
    return np.array(found)


@pytest.mark.slow
@pytest.mark.serial
@pytest.mark.parametrize("name", LAWS)
def test_as_a_cube_without_stress_on_two_faces(name):
    """Stretched and sheared by 40 %, then back and beyond: stress, J and plastic strain."""
    square = mesh.create_unit_square(COMM, 1, 1, mesh.CellType.quadrilateral)
    cube = mesh.create_unit_cube(COMM, 1, 1, 1, mesh.CellType.hexahedron)
    flat = deformed(square, LAWS[name], "plane_stress")
    space = deformed(cube, LAWS[name], None)
    size = np.abs(space).max(axis=0)
    np.testing.assert_allclose(flat, space, atol=1e-7 * size.max())
    assert np.abs(space[:, 3] - 1.0).min() > 1e-5


@pytest.mark.parametrize("name", CHOICE)
def test_the_condensed_tangent_is_the_derivative(name):
    """Symmetric, and as differences of the forces, to 1e-7, at strains of some ten per cent."""
    domain = create_domain("quadrilateral", 2)
    u = create_displacement(domain)
    solid = dm.Solid(u, LAWS[name], strain="finite", kinematics="plane_stress")
    v = fem.Function(u.function_space)
    set_wave(u, 0.1)
    set_wave(v, 1.0, 0.7)
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    change, start, t = (K * v.x.petsc_vec).array.copy(), u.x.array.copy(), 1e-5

    def at(s):
        u.x.array[:] = start + s * v.x.array
        return residual(solid)

    difference = (8 * (at(t) - at(-t)) - (at(2 * t) - at(-2 * t))) / (12 * t)
    scale = max(COMM.allgather(np.abs(change).max(initial=0.0)))
    assert np.abs(difference - change).max(initial=0.0) < 1e-7 * scale
    assert K.isSymmetric(1e-9 * scale)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "cell", ["triangle", pytest.param("quadrilateral", marks=pytest.mark.slow)]
)
def test_patch_of_sheets_at_40_percent_compression(cell):
    """Two sheets in contact: a bar of free sides, whose force is per thickness at X."""
    domain, _, facets = meshes.two_blocks(COMM, cell=cell)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, down, still = fem.Function(V), zero(domain), zero(domain)
    left = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
    bcs = sliding(V, facets, [(meshes.BOTTOM, 1, still), (meshes.TOP, 1, down)])
    dofs = fem.locate_dofs_topological(V.sub(0), 1, left)
    bcs.append(fem.dirichletbc(still, dofs, V.sub(0)))
    law = dm.NeoHooke(1000.0, 0.3)  # that of `compressed`
    solid = dm.Solid(u, law, strain="finite", kinematics="plane_stress")
    contact = dm.Contact(facets, slave=meshes.TOP_OF_LOWER, master=meshes.BOTTOM_OF_UPPER)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    down.value = -0.4 * 2.0
    report = dm.newton(problem, rtol=1e-10)
    a, nominal = compressed(0.6)
    assert contact.force[1] == pytest.approx(nominal, rel=1e-7)
    assert report.certificate.smallest_J == pytest.approx(a * a * 0.6, rel=1e-8)
    stress = solid.fields.values("stress")[..., 1]
    assert np.abs(stress - nominal / a**2).max(initial=0.0) < 1e-7 * abs(nominal)


def test_what_is_refused():
    u = create_displacement(create_domain("quadrilateral", 2))
    flat = {"strain": "finite", "kinematics": "plane_stress"}
    with rejected("volumetric", "plane stress"):
        dm.Solid(u, dm.NeoHooke(1.0, 0.3), volumetric="reduced", **flat)
    with rejected("plane_stress", "in space"):
        dm.materials.check(dm.NeoHooke(1.0, 0.3), plane_stress=True)
