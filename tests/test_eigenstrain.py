# SPDX-License-Identifier: MIT
"""Eigenstrain: bodies that are free have no stress, others that of the strain without it."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from tests.cases.meshes import BOTTOM_OF_UPPER, LOWER, TOP_OF_LOWER, UPPER
from tests.cases.pointwise_laws import Radial
from tests.cases.pressed_blocks import rejected
from tests.cases.rings import held_ends, shrink_fit_pressure, tubes
from tests.choice import quick

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
E, NU = 1000.0, 0.3
LAW = dm.Elastic(E, NU)
TENSOR = np.array([[1e-3, 4e-4, 0.0], [4e-4, -5e-4, 0.0], [0.0, 0.0, 2e-3]])


def block(d, cells=3):
    """Return the displacement of a unit block."""
    kind = mesh.create_unit_square if d == 2 else mesh.create_unit_cube
    domain = kind(COMM, *d * [cells])
    return fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))), name="u")


def rollers(V, axes, ends=(0.0,)):
    """Return the conditions u_i = 0 at x[i] = 0 (or other ends) for some axes i."""
    bcs = []
    for i in axes:
        for end in ends:
            facets = mesh.locate_entities_boundary(
                V.mesh, V.mesh.topology.dim - 1, lambda x, i=i, end=end: np.isclose(x[i], end)
            )
            dofs = fem.locate_dofs_topological(V.sub(i), V.mesh.topology.dim - 1, facets)
            bcs.append(fem.dirichletbc(0.0, dofs, V.sub(i)))
    return bcs


def largest(values):
    """Return the largest absolute value over all ranks."""
    return COMM.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


def heated(d, given, **options):
    """Return a solid of one law with an eigenstrain, in a block on rollers, after a step."""
    u = block(d)
    solid = dm.Solid(u, LAW, eigenstrain=given, **options)
    problem = dm.ContactProblem(solid, bcs=rollers(u.function_space, range(d)))
    dm.newton(problem, rtol=1e-13)
    return solid


@pytest.mark.parametrize(
    "given", [2e-3, 2e-3 * np.eye(3), TENSOR], ids=["scalar", "same", "tensor"]
)
def test_a_free_body_takes_the_strain_and_has_no_stress(given):
    """In space; shear turns the block on its rollers, so it is left out of the third."""
    tensor = 2e-3 * np.eye(3) if np.ndim(given) == 0 else np.diag(np.diag(given))
    solid = heated(3, given if np.ndim(given) == 0 else tensor.tolist())
    expected = fem.Function(solid.V)
    expected.interpolate(lambda x: tensor @ x)
    assert largest(solid.u.x.array - expected.x.array) < 1e-15
    assert largest(solid.stress.x.array) < 1e-12 * E * 2e-3


def test_shear_strains_are_free_too():
    """Only rigid motions are held: at a point, and where a second and third one may go."""
    u = block(3)
    V = u.function_space
    bcs = []
    for axes, at in (((0, 1, 2), (0, 0, 0)), ((1, 2), (1, 0, 0)), ((2,), (0, 1, 0))):
        for i in axes:
            dofs = fem.locate_dofs_geometrical(
                (V.sub(i), V.sub(i).collapse()[0]),
                lambda x, at=at: np.isclose(x, np.array(at)[:, None]).all(axis=0),
            )
            bcs.append(fem.dirichletbc(fem.Function(V.sub(i).collapse()[0]), dofs, V.sub(i)))
    solid = dm.Solid(u, LAW, eigenstrain=TENSOR)
    dm.newton(dm.ContactProblem(solid, bcs=bcs), rtol=1e-13)
    assert largest(solid.stress.x.array) < 1e-11 * E * 2e-3
    shear = fem.assemble_scalar(fem.form(ufl.sym(ufl.grad(u))[0, 1] * ufl.dx))
    assert np.isclose(COMM.allreduce(shear), 4e-4, rtol=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("d", quick([2, 3], 3))
def test_a_tensor_that_is_not_symmetric(d):
    """No strain, such as a gradient whose skew part is a rotation; round-off is none."""
    u, tensor = block(d), 2e-3 * np.eye(3)
    tensor[0, 1] = 1e-15
    value = fem.Constant(u.function_space.mesh, tensor)
    solid = dm.Solid(u, LAW, eigenstrain=value)
    value.value[0, 1] = 1e-6
    with rejected("eigenstrain is not symmetric", "ufl.sym(..)"):
        solid.follow()
    value.value[1, 0] = 1e-6
    solid.follow()
    w = fem.Function(u.function_space)
    w.interpolate(lambda x: [x[1], *np.zeros((d - 1, x.shape[1]))])
    gradient = ufl.as_tensor(
        [[ufl.grad(w)[i, j] if max(i, j) < d else 0.0 for j in range(3)] for i in range(3)]
    )
    with rejected("eigenstrain is not symmetric"):
        dm.Solid(u, LAW, eigenstrain=gradient)
    dm.Solid(u, LAW, eigenstrain=ufl.sym(gradient))


def test_plane_strain_holds_the_thickness():
    """Heated and free in the plane: sigma_zz = -E e0, u = (1 + nu) e0 x."""
    solid = heated(2, 2e-3)
    stress = solid.fields.values("stress")
    assert largest(stress - np.array([0.0, 0.0, -E * 2e-3, 0.0])) < 1e-12 * E
    expected = fem.Function(solid.V)
    expected.interpolate(lambda x: (1 + NU) * 2e-3 * x[:2])
    assert largest(solid.u.x.array - expected.x.array) < 1e-15


@pytest.mark.parametrize("d", [2, 3])
def test_a_clamped_body_is_pressed_from_all_sides(d):
    """-E e0 / (1 - 2 nu) in all directions, and the energy of that."""
    u = block(d)
    V = u.function_space
    solid = dm.Solid(u, LAW, eigenstrain=2e-3)
    bcs = rollers(V, range(d), (0.0, 1.0))
    dm.newton(dm.ContactProblem(solid, bcs=bcs), rtol=1e-12)
    pressed = -E * 2e-3 / (1 - 2 * NU)
    stress = solid.fields.values("stress")
    assert largest(stress - pressed * (np.arange(stress.shape[2]) < 3)) < 1e-12 * E
    energy = COMM.allreduce(solid.energy())
    assert np.isclose(energy, 0.5 * 3 * 2e-3 * -pressed, rtol=1e-12)


def test_a_bar_between_walls():
    """Held along x only: sigma_xx = -E e0, nothing else."""
    u = block(3)
    V = u.function_space
    solid = dm.Solid(u, LAW, eigenstrain=1e-3)
    bcs = [*rollers(V, [0], (0.0, 1.0)), *rollers(V, [1, 2])]
    dm.newton(dm.ContactProblem(solid, bcs=bcs), rtol=1e-12)
    assert largest(solid.fields.values("stress") - np.array([-1.0, 0, 0, 0, 0, 0])) < 1e-10


def test_it_may_vary_in_space_and_change_in_time():
    """UFL of coordinates, a Constant and a Function: followed at once, without compiling."""
    u = block(2)
    V = u.function_space
    T = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
    T.interpolate(lambda x: 10 + 0 * x[0])
    alpha = fem.Constant(V.mesh, 1e-4)
    solid = dm.Solid(
        u, LAW, eigenstrain=alpha * T * ufl.SpatialCoordinate(V.mesh)[0] * 0 + alpha * T
    )
    solid.evaluate()
    found = []
    for change in (lambda: None, lambda: alpha.value.fill(3e-4), lambda: T.x.array.fill(-5.0)):
        change()
        solid.evaluate()
        found.append(solid.max("stress_xx"))
    pressed = -E / (1 - 2 * NU) * np.array([1e-3, 3e-3, -1.5e-3])
    assert np.allclose(found, pressed, rtol=1e-12)


def test_a_linear_gradient_of_temperature_bends_without_stress():
    """In space, e0 linear in y is compatible: the energy vanishes as the square of the size."""
    energies, c = [], 1e-3 / 2
    for n in (3, 6):
        u = block(3, n)
        V, x = u.function_space, ufl.SpatialCoordinate(u.function_space.mesh)
        solid = dm.Solid(u, LAW, eigenstrain=2 * c * x[1])
        exact = fem.Function(V)
        exact.interpolate(
            lambda x: (
                c * np.stack([2 * x[0] * x[1], x[1] ** 2 - x[0] ** 2 - x[2] ** 2, 2 * x[1] * x[2]])
            )
        )
        dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
        dm.newton(dm.ContactProblem(solid, bcs=[fem.dirichletbc(exact, dofs)]), rtol=1e-12)
        energies.append(COMM.allreduce(solid.energy()))
    assert energies[0] < 0.1 * 1.5 * E / (1 - 2 * NU) * c**2
    assert np.log2(energies[0] / energies[1]) > 1.7


def test_plastic_bodies_see_it_as_they_see_strain():
    """The response at strain e with eigenstrain e0 is that at e - e0; also their state."""
    law = dm.VonMises(E, NU, Y=0.5, a=50.0)
    x0 = TENSOR
    states, stresses = [], []
    for given, shift in ((TENSOR, 0.0), (None, 1.0)):
        u = block(3, 2)
        strain = np.array([[3e-3, 0, 1e-3], [0, -1e-3, 0], [1e-3, 0, 0]])
        u.interpolate(lambda x, s=shift, e=strain: (e - s * x0) @ x)
        solid = dm.Solid(u, law, eigenstrain=given)
        solid.evaluate()
        solid.commit()
        states.append(solid.state["plastic_strain"].x.array.copy())
        stresses.append(solid.stress.x.array.copy())
    assert largest(states[0]) > 1e-4
    assert largest(states[0] - states[1]) < 1e-16 and largest(stresses[0] - stresses[1]) < 1e-12


PERFECT = dm.VonMises(E, NU, Y=E * 1e-3, a=0.0)  # flows from strains of 1e-3 on
BEYOND = [6e-3, -3e-3, 6e-3]
SWELLING = {
    "plate": (2, PERFECT, [5e-3] * 3, {"kinematics": "plane_stress"}),
    "ring": (2, PERFECT, BEYOND, {"kinematics": "axisymmetric"}),
    "space": (3, PERFECT, BEYOND, {}),
    "arrays": (3, Radial(E, NU, E * 1e-3, 0.0), BEYOND, {}),
    "mean dilatation": (3, PERFECT, BEYOND, {"volumetric": "reduced"}),
}


@pytest.mark.parametrize("name", quick(SWELLING, "plate", "mean dilatation"))
@pytest.mark.parametrize("before", ["virgin", "flowed", "elsewhere"])
def test_what_does_not_harden_may_swell_beyond_yield(name, before):
    """In one step, also after flow in tension, and with a start beyond yield.

    The tangent is singular where all flows: a step begins with that of the committed state.
    """
    d, law, strain, options = SWELLING[name]
    cell = mesh.CellType.quadrilateral if d == 2 else mesh.CellType.hexahedron
    kind = mesh.create_unit_square if d == 2 else mesh.create_unit_cube
    domain = kind(COMM, *d * [2], cell)
    V = fem.functionspace(domain, ("Lagrange", 1, (d,)))
    u, swollen, end = fem.Function(V), fem.Function(V), fem.Constant(domain, 0.0)
    swollen.interpolate(lambda x: np.diag(strain[:d]) @ x[:d])
    heat = fem.Constant(domain, np.zeros((3, 3)))
    solid, bcs = dm.Solid(u, law, eigenstrain=heat, **options), rollers(V, range(d))
    if before == "flowed":
        (top,) = rollers(V, [d - 1], ends=(1.0,))
        bcs.append(fem.dirichletbc(end, top.dof_indices()[0], V.sub(d - 1)))
    problem = dm.ContactProblem(solid, bcs=bcs, petsc_options={"pc_type": "cholesky"})
    if before == "flowed":
        end.value = 3e-3
        dm.newton(problem, rtol=1e-12)
        problem.commit()
        assert solid.max("plastic_strain_norm") > 1e-3
    expected, stress = u.x.array + swollen.x.array, solid.stress.x.array.copy()
    if before == "elsewhere":
        u.x.array[:] = 7.0 * swollen.x.array
    heat.value, end.value = np.diag(strain), end.value + strain[d - 1]
    report = dm.newton(problem, rtol=1e-12)
    assert report.newton_iterations == 1
    assert largest(u.x.array - expected) < 1e-14
    assert largest(solid.stress.x.array - stress) < 1e-11 * E


@pytest.mark.parametrize("slave", [TOP_OF_LOWER, BOTTOM_OF_UPPER])
def test_a_shrink_fit_by_cooling(slave):
    """The outer tube is cooled in ten parts, plane strain kept: Lame's pressure; by tags.

    Its strain is e0 (1 + nu) in the plane, which is an overlap of that times the radius.
    """
    radii = (1.0, 1.5, 2.5)
    domain, cell_tags, tags = tubes(radii, ((6, 8), (9, 16)), cell="quadrilateral")
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    cooling = fem.Constant(domain, 0.0)
    solid = dm.Solid(
        fem.Function(V),
        {LOWER: LAW, UPPER: LAW},
        cell_tags,
        kinematics="axisymmetric",
        eigenstrain={UPPER: cooling},
    )
    contact = dm.Contact(tags, slave=slave, master=TOP_OF_LOWER + BOTTOM_OF_UPPER - slave)
    problem = dm.ContactProblem(solid, [contact], bcs=held_ends(V, tags))
    steps = dm.load_steps(problem, [0.5, 1.0], on_time=lambda t: cooling.value.fill(-1e-6 * t))
    pressures = []
    for step in steps:
        assert step.report.converged
        pressures.append(largest(contact.pressure.x.array))
    expected = shrink_fit_pressure(E, NU, radii, (1 + NU) * 1e-6 * radii[1])
    assert np.allclose(pressures, [0.5 * expected, expected], rtol=2e-3)


def test_a_linear_body_needs_its_tangent_once():
    """The eigenstrain is a load: it does not make the problem nonlinear."""
    u = block(2)
    solid = dm.Solid(u, LAW, eigenstrain=fem.Constant(u.function_space.mesh, 1e-3))
    assert solid.linear
    problem = dm.ContactProblem(solid, bcs=rollers(u.function_space, range(2)))
    assert dm.newton(problem).newton_iterations == 1


def test_cutbacks_put_it_back():
    """A step that is made in parts passes the levels between, through the same function."""
    u = block(2, 6)
    V = u.function_space
    heat, x = fem.Constant(V.mesh, 0.0), ufl.SpatialCoordinate(V.mesh)
    law = dm.VonMises(E, NU, Y=0.5, a=10.0)
    solid = dm.Solid(u, law, eigenstrain=heat * ufl.sin(5 * x[0]) * x[1])
    problem = dm.ContactProblem(solid, bcs=rollers(V, range(2)))
    levels = []

    def on_time(t):
        levels.append(t)
        heat.value = 5e-3 * t

    (step,) = dm.load_steps(problem, [1.0], on_time=on_time, max_it=4, rtol=1e-9)
    assert step.report.converged and step.report.cuts > 0 and levels[-1] == 1.0
    assert np.isclose(heat.value, 5e-3)


def test_a_step_that_fails_shows_what_was_before():
    """Stress and state are those of the eigenstrain before, and the next try takes the new one."""
    u = block(2, 6)
    V = u.function_space
    heat, x = fem.Constant(V.mesh, 1e-4), ufl.SpatialCoordinate(V.mesh)
    law = dm.VonMises(E, NU, Y=0.5, a=10.0)
    solid = dm.Solid(u, law, eigenstrain=heat * ufl.sin(5 * x[0]) * x[1])
    problem = dm.ContactProblem(solid, bcs=rollers(V, range(2)))
    dm.newton(problem)
    problem.commit()
    before = solid.stress.x.array.copy()
    heat.value = 5e-3
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1)
    assert largest(solid.stress.x.array - before) < 1e-12
    assert solid.max("plastic_strain_norm") == 0.0
    assert dm.newton(problem).converged and solid.max("plastic_strain_norm") > 1e-4


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.eye(2), r"eigenstrain has the shape \(2, 2\): give a scalar .*component out of it"),
        (np.zeros(3), r"eigenstrain has the shape \(3,\): give a scalar"),
        ("hot", r"eigenstrain is a str: give a scalar"),
        ({7: 1e-3}, r"eigenstrain: no cell has the tag 7; cell_tags has 1, 2"),
        ({1: np.nan}, r"eigenstrain\[1\] is NaN or infinite at \d+ integration points"),
        (np.inf, r"eigenstrain is NaN or infinite"),
        (
            [[0, 0, 1e-3], [0, 0, 0], [1e-3, 0, 0]],
            r"has components xz or yz at \d+ ",
        ),
        ([["a"]], r"eigenstrain is \[\['a'\]\]: give a scalar"),
        (True, "eigenstrain is True: give a scalar"),
        (1j, "eigenstrain is 1j: give a scalar .* real number"),
        (1j * np.eye(3), "(?s)eigenstrain is \\[\\[1j.*: give a scalar .* real number"),
        ({1: np.bool_(True)}, r"eigenstrain\[1\] is a bool: give a scalar"),
    ],
)
def test_what_is_no_eigenstrain_is_refused(given, message):
    domain, cell_tags, _ = tubes((1.0, 1.5, 2.0), ((2, 2), (3, 2)))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    with pytest.raises(ValueError, match=message):
        dm.Solid(u, {1: LAW, 2: LAW}, cell_tags, eigenstrain=given)


def test_it_must_not_depend_on_the_displacement_or_another_mesh():
    u, other = block(2), block(2)
    for value, message in ((u[0], "depends on the displacement"), (other[0], "another mesh")):
        with pytest.raises(ValueError, match=message):
            dm.Solid(u, LAW, eigenstrain=value)
    with pytest.raises(ValueError, match=r"eigenstrain is a .*: give a scalar"):
        dm.Solid(u, LAW, eigenstrain=ufl.TestFunction(u.function_space)[0])
    with pytest.raises(ValueError, match="dictionary by cell tag: give an entry, and cell_tags"):
        dm.Solid(u, LAW, eigenstrain={1: 1e-3})


def test_what_becomes_undefined_later_is_refused_and_nothing_changes():
    u = block(2)
    heat = fem.Constant(u.function_space.mesh, 1e-3)
    solid = dm.Solid(u, LAW, eigenstrain=heat)
    solid.evaluate()
    before = solid.stress.x.array.copy()
    problem = dm.ContactProblem(solid, bcs=rollers(u.function_space, range(2)))
    heat.value = np.nan
    for call in (solid.evaluate, lambda: dm.newton(problem)):
        with pytest.raises(ValueError, match="eigenstrain is NaN or infinite at"):
            call()
    assert (u.x.array == 0.0).all() and (solid.stress.x.array == before).all()
    heat.value = 2e-3
    dm.newton(problem)
    assert np.isclose(solid.max("stress_zz"), -E * 2e-3)


@pytest.mark.parametrize("volumetric", ["full", "reduced"])
@pytest.mark.parametrize("d", quick([2, 3], 2))
def test_a_clamped_block_has_all_of_the_stress(d, volumetric):
    """Nothing moves, sigma = -E e / (1 - 2 nu) in all directions; in plane strain as well."""
    kind, strain = ("quadrilateral", "hexahedron")[d - 2], 2e-3
    create = mesh.create_unit_square if d == 2 else mesh.create_unit_cube
    domain = create(COMM, *d * [2], getattr(mesh.CellType, kind))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (d,))))
    solid = dm.Solid(u, LAW, eigenstrain=strain, volumetric=volumetric)
    bcs = rollers(u.function_space, range(d), (0.0, 1.0))
    dm.newton(dm.ContactProblem(solid, bcs=bcs), rtol=1e-13)
    stress = solid.stress.x.array.reshape(-1, 4 if d == 2 else 6)
    expected = np.zeros(stress.shape[1])
    expected[:3] = -E * strain / (1.0 - 2.0 * NU)
    assert largest(u.x.array) < 1e-12 * strain
    assert largest(stress - expected) < 1e-12 * E * strain
