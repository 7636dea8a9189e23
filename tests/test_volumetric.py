# SPDX-License-Identifier: MIT
"""Reduced integration of the volumetric part: consistent, exact where it must be, no locking."""

import dataclasses
from typing import ClassVar

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.materials.tensor import from_components
from dolfinx_mortar.solid.kinematics import plane_strain
from tests.cases.material_point import MaterialPoint
from tests.cases.pressed_blocks import rejected
from tests.cases.rings import Lame
from tests.cases.solid import (
    create_displacement,
    create_domain,
    hold,
    largest,
    plane,
    rectangle,
    residual,
    rollers,
    tag_facets,
    total,
)
from tests.cases.two_bodies import create_problem
from tests.choice import quick

pytestmark = pytest.mark.mpi
E, NU = 1000.0, 0.3
SHAPES = [("quadrilateral", None), ("quadrilateral", "axisymmetric"), ("hexahedron", None)]
FLAT_BY_DEFAULT = quick(SHAPES, *SHAPES[:2])
LAW, PLASTIC = dm.Elastic(E, NU), dm.VonMises(E, NU, 5.0, 50.0)


def warped(cell, cells=3):
    """Return the displacement of a box whose cells are no parallelograms."""
    domain = create_domain(cell, cells)
    x = domain.geometry.x
    x *= 0.5
    x[:, 0] *= 1.0 + 0.4 * x[:, 1]
    x[:, 1] *= 1.0 - 0.3 * x[:, 0]
    return create_displacement(domain)


@pytest.mark.parametrize(("cell", "kinematics"), FLAT_BY_DEFAULT)
def test_patch(cell, kinematics):
    """Linear displacements on the boundary of warped cells: linear inside, uniform stress."""
    u = warped(cell)
    V, exact, d = u.function_space, fem.Function(u.function_space), len(u)
    strain = 1e-3 * np.array([[1.0, 0.4, -0.2], [0.4, -2.0, 0.7], [-0.2, 0.7, 0.5]])[:d, :d]
    if kinematics == "axisymmetric":
        strain = 1e-3 * np.diag([1.0, -2.0])
    exact.interpolate(lambda x: strain @ x[:d])
    solid = dm.Solid(u, LAW, kinematics=kinematics, volumetric="reduced")
    boundary = hold(V, lambda x: np.full(x.shape[1], True), value=exact)
    dm.newton(create_problem(u, (), [boundary], solid), rtol=1e-12)
    assert largest(u.x.array - exact.x.array) < 1e-15
    full = dm.Solid(exact, LAW, kinematics=kinematics)
    full.evaluate()
    stress, expected = (s.fields.values("stress") for s in (solid, full))
    assert largest(stress - expected) < 1e-12 * E < 1e-6 * largest(expected)
    energy = total(solid.energy())
    assert np.isclose(energy, total(full.energy()), rtol=1e-12)
    assert np.isclose(2 * energy, solid.elastic_norm(u) ** 2, rtol=1e-10)


@pytest.mark.parametrize("volumetric", ["full", "reduced"])
@pytest.mark.parametrize(("cell", "kinematics"), quick(SHAPES, SHAPES[0]))
def test_the_stress_shown_is_that_of_the_forces(cell, kinematics, volumetric):
    """Its virtual work is theirs; reduced, its mean is the same at all points of a cell."""
    u = warped(cell)
    d = len(u)
    solid = dm.Solid(u, PLASTIC, kinematics=kinematics, volumetric=volumetric)
    u.interpolate(lambda x: 0.03 * np.sin(3 * x[:d] + x[[1, 0, 2]][:d]) * x[0])
    solid.evaluate()
    stress = solid.fields.values("stress")
    mean = stress[..., :3].mean(axis=2)
    assert (largest(mean - mean[:, :1]) < 1e-11 * largest(mean)) == (volumetric == "reduced")
    assert solid.max("plastic_strain_norm") > 0.0
    w = fem.Function(u.function_space)
    w.interpolate(lambda x: np.cos(2 * x[:d]) * x[0])
    rule = {"quadrature_degree": solid.quadrature_degree, "quadrature_scheme": "default"}
    power = ufl.inner(from_components(solid.stress), solid.kinematics.measure(w))
    weight = 2 * np.pi * ufl.SpatialCoordinate(w.function_space.mesh)[0] if kinematics else 1.0
    work = total(fem.assemble_scalar(fem.form(weight * power * ufl.dx(metadata=rule))))
    force = residual(solid)
    assert np.isclose(work, total(force * w.x.array[: len(force)]), rtol=1e-10)


def test_a_thick_cylinder_that_keeps_its_volume():
    """Under pressure inside, nu = 0.4999, 8 cells across: Lame's growth; full has a fifth of it."""
    nu, found = 0.4999, []
    lame = Lame(E, nu, 1.0, 2.0, inside=10.0)
    for volumetric in ("full", "reduced"):
        domain = rectangle([(1.0, 0.0), (2.0, 1.0)], (8, 2))
        tags = tag_facets(domain, plane(0, 1.0))
        u = create_displacement(domain)
        V = u.function_space
        bcs = rollers(V, [1], (0.0, 1.0))
        ds = ufl.Measure("ds", domain, subdomain_data=tags)
        loads = -10.0 * ufl.dot(ufl.FacetNormal(domain), ufl.TestFunction(V)) * ds(1)
        own = {"kinematics": "axisymmetric", "volumetric": volumetric, "loads": loads}
        dm.newton(create_problem(u, (), bcs, dm.Elastic(E, nu), **own), rtol=1e-10)
        inside = fem.locate_dofs_topological(V, 1, tags.find(1))
        moved = np.linalg.norm(u.x.array.reshape(-1, 2)[inside], axis=1)
        found.append(largest(moved) / lame.displacement(1.0))
    assert abs(found[1] - 1) < 0.01 and found[0] < 0.3


def punch(volumetric, n, depth):
    """Return the mean pressure over the shear yield stress under a smooth punch of half width one.

    Half of a block, 5 wide and 3 deep, in plane strain; perfectly plastic.
    """
    u = create_displacement(rectangle([(0.0, -3.0), (5.0, 0.0)], (5 * n, 3 * n)))
    V, push, k = u.function_space, fem.Constant(u.function_space.mesh, 0.0), 1.0
    solid = dm.Solid(u, dm.VonMises(E, NU, Y=np.sqrt(2) * k, a=0.0), volumetric=volumetric)
    punched = hold(V, lambda x: plane(1)(x) & (x[0] < 1 + 1e-9), 1, push)
    under = punched.dof_indices()[0]
    bcs = [punched, *rollers(V, [0], (0.0, 5.0)), hold(V, plane(1, -3.0))]
    problem = create_problem(u, (), bcs, solid)
    pressures = []
    for _ in dm.load_steps(
        problem, depth * np.arange(1, 9) / 8, on_time=lambda t: push.value.fill(-t)
    ):
        force = residual(solid)
        # the punch reaches half a cell beyond its last node
        pressures.append(-total(force[under[under < len(force)]]) / (1 + 0.5 / n) / k)
    return pressures


@pytest.mark.slow
def test_the_limit_load_of_a_punch():
    """Prandtl's (2 + pi) k: reduced, the pressure stays there; full, it goes on growing."""
    full, reduced = (punch(volumetric, 4, 0.06) for volumetric in ("full", "reduced"))
    limit = 2 + np.pi
    assert abs(reduced[-1] / limit - 1) < 0.05 and reduced[-1] - reduced[-3] < 0.005 * limit
    assert full[-1] > 1.1 * limit and full[-1] - full[-3] > 0.02 * limit


@pytest.mark.parametrize(("cell", "kinematics"), FLAT_BY_DEFAULT)
def test_no_hourglass(cell, kinematics):
    """One cell resists all but its rigid motions, not much less than a full one."""
    eigenvalues = []
    for volumetric in ("full", "reduced"):
        make = mesh.create_unit_square if cell == "quadrilateral" else mesh.create_unit_cube
        d = 2 if cell == "quadrilateral" else 3
        u = create_displacement(make(MPI.COMM_SELF, *d * [1], mesh.CellType[cell]))
        solid = dm.Solid(u, LAW, kinematics=kinematics, volumetric=volumetric)
        K = solid.create_matrix()
        solid.assemble_tangent(K)
        eigenvalues.append(np.linalg.eigvalsh(K.convert("dense").getDenseArray()))
    rigid = len(solid.kinematics.rigid_motions(np.zeros((1, d))))
    for values in eigenvalues:
        assert np.abs(values[:rigid]).max() < 1e-12 * values[-1]
    assert eigenvalues[1][rigid] > 0.2 * eigenvalues[0][rigid]


@dataclasses.dataclass(frozen=True)
class Coupled(dm.Elastic):
    """A law that does not say that it splits."""

    splits: ClassVar[bool] = False


LATER = {"kinematics": dataclasses.replace(plane_strain, name="finite")}
REFUSED = [
    ("quadrilateral", LAW, {"volumetric": "half"}, "'half': choose 'full' or"),
    ("triangle", LAW, {}, "not for triangles"),
    ("quadrilateral", Coupled(E, NU), {}, ": Coupled does not declare splits"),
    ("quadrilateral", LAW, LATER, "not for 'finite': choose 'full'"),
    ("quadrilateral", PLASTIC, {"kinematics": "plane_stress"}, "not for 'plane stress': choose"),
    ("quadrilateral", LAW, {"quadrature_degree": 1}, "degree is 1: give 2 or"),
]


@pytest.mark.parametrize(("cell", "law", "options", "said"), REFUSED)
def test_what_cannot_be_reduced_is_refused(cell, law, options, said):
    with rejected(said):
        dm.Solid(warped(cell), law, **{"volumetric": "reduced"} | options)


@pytest.mark.parametrize("law", [LAW, PLASTIC])
def test_laws_that_say_so_split(law, rng):
    """psi(e) = psi(dev e) + K/2 tr(e)^2, with internal variables that see the deviator only."""
    assert type(law).splits
    point, found = MaterialPoint(law), []
    strain = 0.02 * rng.normal(size=(3, 3))
    strain, trace = strain + strain.T, 2 * np.trace(strain)
    for e in (strain, strain - trace / 3 * np.eye(3)):
        point.stress(e)
        density = np.sum(point.solid.energy()) / point.solid.fields.weights.sum()
        found.append((density, [f.x.array.copy() for f in point.solid.points.staged.values()]))
    assert np.isclose(found[0][0] - found[1][0], E / (6 * (1 - 2 * NU)) * trace**2, rtol=1e-12)
    for a, b in zip(found[0][1], found[1][1], strict=True):
        assert np.abs(a - b).max() < 1e-15 and a.any()
