# SPDX-License-Identifier: MIT
"""Loads and the potential: closed-form answers, and derivatives against finite differences."""

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from dolfinx_mortar.materials import Elastic
from dolfinx_mortar.solid.solid import Solid
from dolfinx_mortar.terms.sum import Terms
from dolfinx_mortar.terms.weak_forms import DeadLoads, WeakForm, check_form
from tests.choice import quick

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD


NAMES = ("springs", "weighted", "body", "dead", "hardening", "one-sided", "both")


def create_box(d):
    """Return a displacement on a box of height 1 (the last direction), and its facets' measure."""
    if d == 2:
        domain = mesh.create_rectangle(
            COMM, [(0, 0), (2.0, 1.0)], (4, 3), mesh.CellType.quadrilateral
        )
    else:
        domain = mesh.create_box(COMM, [(0, 0, 0), (2.0, 1.5, 1.0)], (3, 2, 3))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))), name="u")
    found = [
        mesh.locate_entities_boundary(domain, d - 1, lambda x, h=h: np.isclose(x[d - 1], h))
        for h in (0.0, 1.0)
    ]
    values = np.concatenate([np.full(len(f), 1 + i, np.int32) for i, f in enumerate(found)])
    facets = np.concatenate(found)
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, d - 1, facets[order], values[order])
    return u, ufl.Measure("ds", domain, subdomain_data=tags), tags


def wave(f, size, phase=0.0):
    """Set a Function to a smooth field, the same on any number of ranks."""
    d = f.function_space.mesh.geometry.dim
    f.interpolate(
        lambda x: size * np.stack([np.sin(2 * x[0] + (i + 1) * x[1] + phase) for i in range(d)])
    )


def total(values):
    """Sum over all ranks."""
    return COMM.allreduce(float(np.sum(values)), op=MPI.SUM)


def potentials(u, ds):
    """Return functionals by name: whether they are at most quadratic, and the form."""
    domain = u.function_space.mesh
    d, x = domain.geometry.dim, ufl.SpatialCoordinate(domain)
    pressure = fem.Constant(domain, default_scalar_type(3.0))
    n = ufl.FacetNormal(domain)
    return {
        "springs": (True, 0.5 * 7.0 * ufl.inner(u, u) * ds(1)),
        "weighted": (True, 0.5 * (1 + x[0]) * u[d - 1] ** 2 * ds(1, degree=4)),
        "body": (True, 0.5 * ufl.inner(u, u) * ufl.dx),
        "dead": (True, -pressure * ufl.inner(u, n) * ds(2)),
        "hardening": (False, ufl.inner(u, u) ** 2 * ds(2)),
        "one-sided": (False, 0.5 * 5.0 * ufl.max_value(u[0], 0) ** 2 * ds(2)),
        "both": (False, ufl.exp(u[0]) * ds(1) + u[1] ** 2 * ufl.dx),
    }


@pytest.mark.parametrize("name", quick(NAMES, "hardening", "one-sided", "both"))
@pytest.mark.parametrize("d", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_forces_and_tangent_are_derivatives(d, name):
    """Energy, forces and tangent of each functional fit, beside forces and tangent of a solid."""
    u, ds, _ = create_box(d)
    V = u.function_space
    linear, form = potentials(u, ds)[name]
    solid = Solid(u, Elastic(10.0, 0.3))
    term = WeakForm(solid, energy=form)
    assert term.linear is linear
    w = fem.Function(V)
    wave(u, 0.3), wave(w, 1.0, 1.0)
    start, h = u.x.array.copy(), 1e-5

    def state(t):
        u.x.array[:] = start + t * w.x.array
        F = u.x.petsc_vec.duplicate()
        solid.assemble_residual(F)
        term.add_forces(F)
        return total(solid.energy()) + total(term.energy()), F.array.copy()

    (e1, f1), (e0, f0), (_, f) = state(h), state(-h), state(0.0)
    K = solid.create_matrix()
    solid.assemble_tangent(K)
    entries = K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    term.add_tangent(K)
    K.assemble()
    assert K.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] == entries
    product = u.x.petsc_vec.duplicate()
    K.mult(w.x.petsc_vec, product)
    power = total(f * w.x.array[: len(f)])
    assert abs((e1 - e0) / (2 * h) - power) < 1e-8 * abs(power)
    # a kink inside the difference quotient is the one thing that it does not see
    tolerance = 1e-3 if name == "one-sided" else 1e-8
    difference = (f1 - f0) / (2 * h) - product.array
    assert total(difference**2) < tolerance**2 * total(product.array**2)
    if name == "one-sided":
        return
    skew = K.duplicate(copy=True)
    skew.axpy(-1.0, PETSc.Mat().createTranspose(K).convert("aij"))
    assert skew.norm() < 1e-13 * K.norm()


def solve(terms, u, fixed):
    """Solve the linear problem with prescribed values (dofs, value) for u."""
    K, f = terms.create_matrix(), u.x.petsc_vec.duplicate()
    terms.begin(0.0, 0.0)
    terms.assemble_tangent(K)
    terms.assemble_forces(f)
    f.scale(-1.0)
    x = u.x.petsc_vec.duplicate()
    x.set(0.0)
    layout, d = u.function_space.dofmap.index_map, u.function_space.dofmap.index_map_bs
    owned = [(dofs[dofs < d * layout.size_local], value) for dofs, value in fixed]
    for dofs, value in owned:
        x.array[dofs] = value - u.x.array[dofs]
    rows = np.concatenate([dofs for dofs, _ in owned]) + d * layout.local_range[0]
    K.zeroRowsColumns(rows.astype(PETSc.IntType), diag=1.0, x=x, b=f)
    solver = PETSc.KSP().create(COMM)
    solver.setOperators(K)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.solve(f, x)
    u.x.array[: len(x.array)] += x.array
    u.x.scatter_forward()


def held(u, component, where):
    """Return the dofs of a component on the nodes where a predicate of x holds."""
    V = u.function_space.sub(component)
    facets = mesh.locate_entities_boundary(V.mesh, V.mesh.topology.dim - 1, where)
    return fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)


@pytest.mark.parametrize("d", [2, 3])
def test_spring_bed(d):
    """A block pressed by 0.01 on springs as stiff as itself: they take half of it, in one solve."""
    u, ds, _ = create_box(d)
    E = k = 1000.0
    solid = Solid(u, Elastic(E, 0.0))
    bed = WeakForm(solid, energy=0.5 * k * u[d - 1] ** 2 * ds(1))
    fixed = [(held(u, d - 1, lambda x: np.isclose(x[d - 1], 1.0)), -0.01)]
    for i in range(d - 1):
        fixed.append((held(u, i, lambda x, i=i: np.isclose(x[i], 0.0)), 0.0))
    for _ in range(2):  # a second solve finds the same
        solve(Terms(solid, [("bed", bed)]), u, fixed)
        bottom = u.x.array[held(u, d - 1, lambda x: np.isclose(x[d - 1], 0.0))]
        assert np.allclose(bottom, -0.005, rtol=1e-12)
        stored = 0.5 * k * 0.005**2 * (2.0 if d == 2 else 3.0)
        assert np.isclose(total(bed.energy()), stored, rtol=1e-12)


@pytest.mark.parametrize("d", [2, 3])
def test_bed_and_traction(d):
    """A traction 5 on a bed of k = 1000: the bottom sinks by 5/1000, the top by 5/E more."""
    u, ds, _ = create_box(d)
    V = u.function_space
    q = fem.Constant(V.mesh, default_scalar_type(0.0))
    traction = -q * ufl.TestFunction(V)[d - 1] * ds(2)
    solid = Solid(u, Elastic(2000.0, 0.0))
    bed = WeakForm(solid, energy=0.5 * 1000.0 * u[d - 1] ** 2 * ds(1))
    fixed = [(held(u, i, lambda x, i=i: np.isclose(x[i], 0.0)), 0.0) for i in range(d - 1)]
    q.value = 5.0  # read at every assembly
    solve(Terms(solid, [("loads", DeadLoads(solid, traction)), ("bed", bed)]), u, fixed)
    for height, sinks in ((0.0, 0.005), (1.0, 0.0075)):
        dofs = held(u, d - 1, lambda x, height=height: np.isclose(x[d - 1], height))
        assert np.allclose(u.x.array[dofs], -sinks, rtol=1e-12)


def test_a_linear_potential_is_a_load():
    """-p u.n as potential and p v.n as loads give the same forces."""
    u, ds, _ = create_box(2)
    V = u.function_space
    n, v = ufl.FacetNormal(V.mesh), ufl.TestFunction(V)
    solid = Solid(u, Elastic(1.0, 0.3))
    dead = DeadLoads(solid, 3.0 * ufl.inner(n, v) * ds(2))
    dead.begin(0.0, 0.0)
    forces = []
    for term in (dead, WeakForm(solid, energy=-3.0 * ufl.inner(u, n) * ds(2))):
        F = u.x.petsc_vec.duplicate()
        F.set(0.0)
        term.add_forces(F)
        forces.append(F.array.copy())
    assert np.sqrt(total(forces[0] ** 2)) > 1.0 and np.allclose(*forces, atol=1e-14)


def test_loads_that_contain_the_displacement_are_refused():
    u, ds, _ = create_box(2)
    v = ufl.TestFunction(u.function_space)
    other = fem.Function(u.function_space)
    for inside in (u[1], u.sub(1), ufl.grad(u)[0, 1]):
        with pytest.raises(ValueError, match=r"^loads contain the displacement .*potential=\.\.\."):
            check_form(u, "loads", -inside * v[1] * ds(1), arguments=1, dead=True)
    check_form(u, "loads", other[1] * v[1] * ds(1), arguments=1, dead=True)


def wrong_potentials():
    """Return potentials that cannot work, by what the message should say."""
    u, ds, _ = create_box(2)
    V = u.function_space
    w, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    foreign, _, _ = create_box(2)
    jump = ufl.inner(ufl.jump(u), ufl.jump(u))
    cases = {
        "is a float": 3.0,
        "is a Sum": u[0] + u[1],
        "compiled form": fem.form(u[0] ** 2 * ds),
        "has 1 test": ufl.inner(u, v) * ds,
        "has 2 test": ufl.inner(w, v) * ds,
        "interior_facet": jump * ufl.dS,
        "another mesh": foreign[0] ** 2 * ufl.dx,
        "does not contain": fem.Function(V)[0] ** 2 * ds,
        r"write u\[i\]": u.sub(1) ** 2 * ds,
    }
    return u, cases


def test_wrong_potentials_are_refused():
    u, cases = wrong_potentials()
    for message, potential in cases.items():
        with pytest.raises(ValueError, match=rf"^potential.*{message}"):
            check_form(u, "potential", potential)


@pytest.mark.parametrize("d", [2, 3])
def test_spring_bed_through_newton(d):
    """The same bed in a ContactProblem: half of the way, at once and again, by two iterations."""
    u, ds, _ = create_box(d)
    V = u.function_space
    zero, down = default_scalar_type(0.0), default_scalar_type(-0.01)
    bcs = [fem.dirichletbc(down, held(u, d - 1, lambda x: np.isclose(x[d - 1], 1.0)), V.sub(d - 1))]
    for i in range(d - 1):
        bcs.append(
            fem.dirichletbc(zero, held(u, i, lambda x, i=i: np.isclose(x[i], 0.0)), V.sub(i))
        )
    energy = 0.5 * 1000.0 * u[d - 1] ** 2 * ds(1)
    problem = dm.ContactProblem(Solid(u, Elastic(1000.0, 0.0)), bcs=bcs, potential=energy)
    for _ in range(2):
        assert dm.newton(problem).newton_iterations <= 2
        problem.commit()
        bottom = u.x.array[held(u, d - 1, lambda x: np.isclose(x[d - 1], 0.0))]
        assert np.allclose(bottom, -0.005, rtol=1e-9)


def test_loads_that_contain_the_displacement_are_refused_by_the_problem():
    u, ds, _ = create_box(2)
    form = -1000.0 * u[1] * ufl.TestFunction(u.function_space)[1] * ds(1)
    with pytest.raises(ValueError, match=r"^loads contain the displacement .*potential=\.\.\."):
        dm.ContactProblem(Solid(u, Elastic(1.0, 0.3)), loads=form)


def test_a_one_sided_bed_lets_go():
    """Springs that only push: pulled away, the block is free of them; pressed, they take half."""
    u, ds, _ = create_box(2)
    V = u.function_space
    move = fem.Constant(V.mesh, default_scalar_type(0.0))
    bcs = [
        fem.dirichletbc(move, held(u, 1, lambda x: np.isclose(x[1], 1.0)), V.sub(1)),
        fem.dirichletbc(
            default_scalar_type(0.0), held(u, 0, lambda x: np.isclose(x[0], 0.0)), V.sub(0)
        ),
    ]
    energy = 0.5 * 1000.0 * ufl.min_value(u[1], 0.0) ** 2 * ds(1)
    problem = dm.ContactProblem(Solid(u, Elastic(1000.0, 0.0)), bcs=bcs, potential=energy)
    assert not problem.terms.linear
    for value, expected in ((-0.01, -0.005), (0.01, 0.01), (-0.02, -0.01)):
        move.value = value
        dm.newton(problem)
        problem.commit()
        bottom = u.x.array[held(u, 1, lambda x: np.isclose(x[1], 0.0))]
        assert np.allclose(bottom, expected, rtol=1e-6)
