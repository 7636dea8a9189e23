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
from dolfinx_mortar.solid.kinematics import plane_strain
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, TOP, TOP_OF_LOWER, two_blocks
from tests.cases.rings import Lame
from tests.choice import quick

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
E, NU = 1000.0, 0.3
SHAPES = [("quadrilateral", None), ("quadrilateral", "axisymmetric"), ("hexahedron", None)]
FLAT_BY_DEFAULT = quick(SHAPES, *SHAPES[:2])


def warped(cell, cells=3):
    """Return the displacement of a unit block whose inner nodes are displaced."""
    d = 2 if cell in ("quadrilateral", "triangle") else 3
    make = mesh.create_unit_square if d == 2 else mesh.create_unit_cube
    domain = make(COMM, *d * [cells], mesh.CellType[cell])
    x = domain.geometry.x
    inside = (np.abs(x[:, :d] - 0.5) < 0.499).all(axis=1)
    wave = np.stack(
        [np.sin(7 * x @ [1, 2, 3]), np.cos(9 * x @ [3, 1, 2]), np.sin(8 * x @ [1, 3, 1])]
    )
    x[inside, :d] += 0.25 / cells * wave.T[inside, :d]
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))), name="u")


def halves(u):
    """Return cell tags, 1 on the left and 2 on the right."""
    domain = u.function_space.mesh
    dim = domain.topology.dim
    cells = np.arange(domain.topology.index_map(dim).size_local, dtype=np.int32)
    x = mesh.compute_midpoints(domain, dim, cells)[:, 0]
    return mesh.meshtags(domain, dim, cells, np.where(x < 0.5, 1, 2).astype(np.int32))


def on_boundary(V, values):
    """Return the condition u = values on the whole boundary."""
    tdim = V.mesh.topology.dim
    V.mesh.topology.create_connectivity(tdim - 1, tdim)
    facets = mesh.exterior_facet_indices(V.mesh.topology)
    return fem.dirichletbc(values, fem.locate_dofs_topological(V, tdim - 1, facets))


def largest(values):
    """Return the largest absolute value over all ranks."""
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def total(values):
    """Sum over all ranks."""
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def forces(solid):
    """Return the internal forces as a vector."""
    r = solid.u.x.petsc_vec.duplicate()
    solid.assemble_residual(r)
    return r


@pytest.mark.parametrize(("cell", "kinematics"), quick(SHAPES, SHAPES[1]))
def test_forces_and_tangent_are_derivatives(cell, kinematics):
    """Of the energy, on warped cells of two laws, in plastic flow, with an eigenstrain."""
    u = warped(cell)
    laws, h = {1: dm.VonMises(E, NU, Y=5.0, a=50.0), 2: dm.Elastic(3 * E, 0.4)}, 1e-6
    options = {
        "kinematics": kinematics,
        "eigenstrain": 1e-2 * ufl.SpatialCoordinate(u.function_space.mesh)[1],
    }
    solid = dm.Solid(u, laws, halves(u), volumetric="reduced", **options)
    d = len(u)
    w = fem.Function(u.function_space)
    u.interpolate(lambda x: 0.05 * np.sin(3 * x[:d] + x[[1, 0, 2]][:d]) * x[0])
    w.interpolate(lambda x: np.cos(5 * x[:d] * x[[1, 2, 0]][:d]) * x[0])
    start, at = u.x.array.copy(), forces(solid)
    K, product = solid.create_matrix(), at.duplicate()
    solid.assemble_tangent(K)
    K.mult(w.x.petsc_vec, product)
    ends, energies = [], []
    for side in (1, -1):
        u.x.array[:] = start + side * h * w.x.array
        ends.append(forces(solid))
        energies.append(total(solid.energy()))
    work = at.dot(w.x.petsc_vec)
    assert abs((energies[0] - energies[1]) / (2 * h) - work) < 1e-7 * abs(work)
    difference = ends[0] - ends[1]
    difference.scale(1 / (2 * h))
    assert (difference - product).norm() < 1e-6 * product.norm()
    assert K.isSymmetric(1e-10 * E)


@pytest.mark.slow
def test_a_law_of_which_most_ranks_have_no_cells():
    """A corner of the same elastic material under another name changes nothing."""

    class Corner(dm.Elastic):
        pass

    u = warped("quadrilateral", 8)
    u.interpolate(lambda x: 0.05 * np.sin(3 * x[:2] + x[[1, 0]]) * x[0])
    domain = u.function_space.mesh
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    x = mesh.compute_midpoints(domain, 2, cells)
    corner = (x[:, :2] < 0.1).all(axis=1)
    assert total(corner) == 1
    tags = mesh.meshtags(domain, 2, cells, np.where(corner, 2, 1).astype(np.int32))
    laws = {1: dm.Elastic(E, NU), 2: Corner(E, NU)}
    two, one = (
        forces(dm.Solid(u, *given, volumetric="reduced")) for given in ((laws, tags), (laws[1],))
    )
    assert (two - one).norm() < 1e-12 * one.norm()


@pytest.mark.parametrize(("cell", "kinematics"), FLAT_BY_DEFAULT)
def test_patch(cell, kinematics):
    """Linear displacements on the boundary of warped cells: linear inside, uniform stress."""
    u = warped(cell)
    V, exact, d = u.function_space, fem.Function(u.function_space), len(u)
    strain = 1e-3 * np.array([[1.0, 0.4, -0.2], [0.4, -2.0, 0.7], [-0.2, 0.7, 0.5]])[:d, :d]
    if kinematics == "axisymmetric":
        strain = 1e-3 * np.diag([1.0, -2.0])
    exact.interpolate(lambda x: strain @ x[:d])
    solid = dm.Solid(u, dm.Elastic(E, NU), kinematics=kinematics, volumetric="reduced")
    dm.newton(dm.ContactProblem(solid, bcs=[on_boundary(V, exact)]), rtol=1e-12)
    assert largest(u.x.array - exact.x.array) < 1e-15
    full = np.zeros((3, 3))
    full[:d, :d] = strain
    full[2, 2] = full[2, 2] if d == 3 else strain[0, 0] * (kinematics is not None)
    lam, mu = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    stress = lam * np.trace(full) * np.eye(3) + 2 * mu * full
    parts = [stress[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    found = solid.fields.values("stress")
    assert largest(found - np.array(parts[: found.shape[2]])) < 1e-12 * E
    density = 0.5 * np.sum(stress * full)
    assert np.isclose(total(solid.energy()), density * total(solid.fields.weights), rtol=1e-12)


@pytest.mark.parametrize(("cell", "kinematics"), quick(SHAPES, SHAPES[0]))
def test_the_stress_shown_is_that_of_the_forces(cell, kinematics):
    """Its mean is the same at all points of a cell, and its virtual work is that of the forces."""
    u = warped(cell)
    d = len(u)
    solid = dm.Solid(u, dm.VonMises(E, NU, 5.0, 50.0), kinematics=kinematics, volumetric="reduced")
    u.interpolate(lambda x: 0.03 * np.sin(3 * x[:d] + x[[1, 0, 2]][:d]) * x[0])
    solid.evaluate()
    stress = solid.fields.values("stress")
    mean = stress[..., :3].mean(axis=2)
    assert largest(mean - mean[:, :1]) < 1e-11 * largest(mean)
    assert solid.max("plastic_strain_norm") > 0.0
    w = fem.Function(u.function_space)
    w.interpolate(lambda x: np.cos(2 * x[:d]) * x[0])
    e = fem.Function(solid.stress.function_space)
    strain = solid.kinematics.measure(w)
    index = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))[: stress.shape[2]]
    zero = fem.Constant(u.function_space.mesh, 0.0)
    points = solid.stress.function_space.element.interpolation_points
    points = points() if callable(points) else points
    e.interpolate(fem.Expression(ufl.as_vector([strain[i, j] + zero for i, j in index]), points))
    dofs = e.function_space.dofmap.list[: len(stress)]
    virtual = e.x.array.reshape(-1, len(index))[dofs]
    power = (stress * virtual * ([1.0] * 3 + [2.0] * (len(index) - 3))).sum(axis=2)
    work = total(power * solid.fields.weights)
    assert np.isclose(work, forces(solid).dot(w.x.petsc_vec), rtol=1e-10)


@pytest.mark.parametrize(("cell", "kinematics"), FLAT_BY_DEFAULT)
def test_the_elastic_norm_is_that_of_the_tangent(cell, kinematics):
    u = warped(cell)
    d = len(u)
    solid = dm.Solid(u, dm.Elastic(E, NU), kinematics=kinematics, volumetric="reduced")
    u.interpolate(lambda x: np.sin(3 * x[:d] + x[[1, 0, 2]][:d]) * x[0])
    K, product = solid.create_matrix(), forces(solid)
    for _ in range(2):  # the second time what is constant is known
        solid.assemble_tangent(K)
        K.mult(u.x.petsc_vec, product)
        assert np.isclose(solid.elastic_norm(u) ** 2, product.dot(u.x.petsc_vec), rtol=1e-10)
    assert np.isclose(2 * total(solid.energy()), solid.elastic_norm(u) ** 2, rtol=1e-10)


def test_a_tangent_follows_the_parameters():
    """What is constant for given parameters is formed anew for others."""
    u = warped("quadrilateral")
    modulus = fem.Constant(u.function_space.mesh, E)
    solid, stiff = (dm.Solid(u, dm.Elastic(e, NU), volumetric="reduced") for e in (modulus, 2 * E))
    K, wanted = solid.create_matrix(), stiff.create_matrix()
    solid.assemble_tangent(K)
    before = K.norm()
    stiff.assemble_tangent(wanted)
    modulus.value = 2 * E
    solid.assemble_tangent(K)
    assert np.isclose(K.norm(), 2 * before, rtol=1e-12)
    wanted.axpy(-1.0, K)
    assert wanted.norm() < 1e-12 * before


@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric"])
def test_a_thick_cylinder_that_keeps_its_volume(kinematics):
    """Under pressure inside, nu = 0.4999, 8 cells across: Lame's growth; full has a fifth of it."""
    nu, found = 0.4999, []
    lame = Lame(E, nu, 1.0, 2.0, inside=10.0)
    cells = (8, 2) if kinematics == "axisymmetric" else (8, 12)
    for volumetric in ("full", "reduced"):
        domain = mesh.create_rectangle(
            COMM, [(1.0, 0.0), (2.0, 1.0)], cells, mesh.CellType.quadrilateral
        )
        x = domain.geometry.x
        inner = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 1.0))
        ends = [
            mesh.locate_entities_boundary(domain, 1, lambda x, at=at: np.isclose(x[1], at))
            for at in (0.0, 1.0)
        ]
        held = [1, 1]
        if kinematics == "plane_strain":  # a quarter of the section
            r, angle = x[:, 0].copy(), np.pi / 2 * x[:, 1]
            x[:, 0], x[:, 1], held = r * np.cos(angle), r * np.sin(angle), [1, 0]
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        u = fem.Function(V)
        bcs = [
            fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(i), 1, facets), V.sub(i))
            for i, facets in zip(held, ends, strict=True)
        ]
        tags = mesh.meshtags(domain, 1, np.sort(inner), np.ones(len(inner), dtype=np.int32))
        ds = ufl.Measure("ds", domain, subdomain_data=tags)
        loads = -10.0 * ufl.dot(ufl.FacetNormal(domain), ufl.TestFunction(V)) * ds(1)
        solid = dm.Solid(u, dm.Elastic(E, nu), kinematics=kinematics, volumetric=volumetric)
        dm.newton(dm.ContactProblem(solid, bcs=bcs, loads=loads), rtol=1e-10)
        inside = fem.locate_dofs_topological(V, 1, inner)
        moved = np.linalg.norm(u.x.array.reshape(-1, 2)[inside], axis=1)
        found.append(largest(moved) / lame.displacement(1.0))
    assert abs(found[1] - 1) < 0.01 and found[0] < 0.3


def punch(volumetric, n, depth):
    """Return the mean pressure over the shear yield stress under a smooth punch of half width one.

    Half of a block, 5 wide and 3 deep, in plane strain; perfectly plastic.
    """
    domain = mesh.create_rectangle(
        COMM, [(0.0, -3.0), (5.0, 0.0)], (5 * n, 3 * n), mesh.CellType.quadrilateral
    )
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    k = 1.0
    solid = dm.Solid(
        fem.Function(V), dm.VonMises(E, NU, Y=np.sqrt(2) * k, a=0.0), volumetric=volumetric
    )

    def dofs(i, where):
        facets = mesh.locate_entities_boundary(domain, 1, where)
        return fem.locate_dofs_topological(V.sub(i), 1, facets)

    push = fem.Constant(domain, 0.0)
    under = dofs(1, lambda x: np.isclose(x[1], 0.0) & (x[0] < 1 + 1e-9))
    bcs = [fem.dirichletbc(push, under, V.sub(1))]
    bcs += [
        fem.dirichletbc(0.0, dofs(0, lambda x, a=a: np.isclose(x[0], a)), V.sub(0)) for a in (0, 5)
    ]
    bcs += [
        fem.dirichletbc(0.0, dofs(i, lambda x: np.isclose(x[1], -3.0)), V.sub(i)) for i in (0, 1)
    ]
    problem = dm.ContactProblem(solid, bcs=bcs)
    pressures = []
    for _ in dm.load_steps(
        problem, depth * np.arange(1, 9) / 8, on_time=lambda t: push.value.fill(-t)
    ):
        own = under[under < len(forces(solid).array)]
        # the punch reaches half a cell beyond its last node
        pressures.append(-total(forces(solid).array[own]) / (1 + 0.5 / n) / k)
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
        domain = make(MPI.COMM_SELF, *d * [1], mesh.CellType[cell])
        u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))))
        solid = dm.Solid(u, dm.Elastic(E, NU), kinematics=kinematics, volumetric=volumetric)
        K = solid.create_matrix()
        solid.assemble_tangent(K)
        eigenvalues.append(np.linalg.eigvalsh(K.convert("dense").getDenseArray()))
    rigid = len(solid.kinematics.rigid_motions(np.zeros((1, d))))
    for values in eigenvalues:
        assert np.abs(values[:rigid]).max() < 1e-12 * values[-1]
    assert eigenvalues[1][rigid] > 0.2 * eigenvalues[0][rigid]


def test_contact_of_reduced_bodies():
    """Uniaxial pressure across a flat interface, as with full integration."""
    domain, _, tags = two_blocks(COMM, (3, 3), (4, 3), cell="quadrilateral")
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    solid = dm.Solid(fem.Function(V), dm.VonMises(E, NU, 5.0, 50.0), volumetric="reduced")
    sides = [(0, LEFT), (1, BOTTOM)]
    bcs = [
        fem.dirichletbc(0.0, fem.locate_dofs_topological(V.sub(i), 1, tags.find(tag)), V.sub(i))
        for i, tag in sides
    ]
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    contact = dm.Contact(tags, slave=TOP_OF_LOWER, master=BOTTOM_OF_UPPER)
    loads = -10.0 * ufl.TestFunction(V)[1] * ds(TOP)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, loads=loads, geometry="reference")
    dm.newton(problem, rtol=1e-11)
    pressure = contact.pressure.x.array[problem.system.link(contact).nodes]
    assert largest(pressure - 10.0) < 1e-8 and solid.max("plastic_strain_norm") > 0.0


@dataclasses.dataclass(frozen=True)
class Coupled(dm.Elastic):
    """A law that does not say that it splits."""

    splits: ClassVar[bool] = False


@pytest.mark.parametrize(
    ("cell", "law", "options", "message"),
    [
        ("quadrilateral", dm.Elastic(E, NU), {"volumetric": "half"}, r"'half': choose 'full' or"),
        ("triangle", dm.Elastic(E, NU), {}, r"quadrilaterals and hexahedra .* not for triangles"),
        ("tetrahedron", dm.Elastic(E, NU), {}, r"not for tetrahedrons of degree 1: choose 'full'"),
        ("quadrilateral", Coupled(E, NU), {}, r"split into .*: Coupled does not declare splits"),
        (
            "quadrilateral",
            dm.Elastic(E, NU),
            {"kinematics": dataclasses.replace(plane_strain, name="finite")},
            r"not for 'finite': choose 'full'",
        ),
        ("quadrilateral", dm.Elastic(E, NU), {"quadrature_degree": 1}, r"degree is 1: give 2 or"),
    ],
)
def test_what_cannot_be_reduced_is_refused(cell, law, options, message):
    with pytest.raises(ValueError, match=message):
        dm.Solid(warped(cell), law, **{"volumetric": "reduced"} | options)


@pytest.mark.parametrize("law", [dm.Elastic(E, NU), dm.VonMises(E, NU, 5.0, 50.0)])
def test_laws_that_say_so_split(law):
    """psi(e) = psi(dev e) + K/2 tr(e)^2, with internal variables that see the deviator only."""
    assert type(law).splits
    rng, found = np.random.default_rng(1), []
    strain = rng.normal(size=(3, 3)) * 0.02
    strain = strain + strain.T
    trace = np.trace(strain)
    for e in (strain, strain - trace / 3 * np.eye(3)):
        u = warped("hexahedron", 1)
        u.interpolate(lambda x, e=e: e @ x)
        solid = dm.Solid(u, law)
        solid.evaluate()
        states = [f.x.array.copy() for f in solid.points.staged.values()]
        found.append((total(solid.energy()), states))
    bulk = E / (3 * (1 - 2 * NU))
    assert np.isclose(found[0][0] - found[1][0], bulk / 2 * trace**2, rtol=1e-12)
    for a, b in zip(found[0][1], found[1][1], strict=True):
        assert largest(a - b) < 1e-15 and largest(a) > 0.0
