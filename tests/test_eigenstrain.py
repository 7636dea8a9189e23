# SPDX-License-Identifier: MIT
"""Eigenstrain: bodies that are free have no stress, others that of the strain without it."""

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.meshes import BOTTOM_OF_UPPER, LOWER, TOP_OF_LOWER, UPPER
from tests.cases.meshes_3d import rotation
from tests.cases.pointwise_laws import Radial
from tests.cases.pressed_blocks import rejected
from tests.cases.rings import held_ends, shrink_fit_pressure, tubes
from tests.cases.solid import (
    COMM,
    create_displacement,
    hold,
    largest,
    plane,
    rectangle,
    residual,
    rollers,
    set_wave,
    solid_on,
    stand,
    total,
)
from tests.choice import quick

pytestmark = pytest.mark.mpi
E, NU = 1000.0, 0.3
LAW = dm.Elastic(E, NU)
TENSOR = np.array([[1e-3, 4e-4, 0.0], [4e-4, -5e-4, 0.0], [0.0, 0.0, 2e-3]])


def block(d, cells=3, cell=None):
    cell = cell or ("triangle", "tetrahedron")[d - 2]
    return rectangle([d * [0.0], d * [1.0]], d * [cells], cell)


def displacement(d):
    return create_displacement(block(d))


def held_as_a_rigid_body(V):
    """Hold a point, and where a second and third one may go."""
    bcs, d = [], V.mesh.geometry.dim
    for axes, at in (((0, 1, 2), (0, 0, 0)), ((1, 2), (1, 0, 0)), ((2,), (0, 1, 0))):
        for W in (V.sub(i) for i in axes if i < d):
            f = fem.Function(W.collapse()[0])
            dofs = fem.locate_dofs_geometrical(
                (W, f.function_space), lambda x, at=at: np.isclose(x.T, at).all(axis=1)
            )
            bcs.append(fem.dirichletbc(f, dofs, W))
    return bcs


def test_a_free_body_takes_the_strain_and_has_no_stress():
    problem = stand(block(3), LAW, held_as_a_rigid_body, eigenstrain=TENSOR.tolist())
    dm.newton(problem, rtol=1e-13)
    u = problem.u
    assert largest(problem.solid.stress.x.array) < 1e-11 * E * 2e-3
    for (i, j), strain in np.ndenumerate(TENSOR):
        found = fem.assemble_scalar(fem.form(ufl.sym(ufl.grad(u))[i, j] * ufl.dx))
        assert COMM.allreduce(found) == pytest.approx(strain, rel=1e-10, abs=1e-14)


RUBBER, SOFT = dm.NeoHooke(E, NU), dm.MooneyRivlin(10.0, 5.0, 1e3)
KINEMATIC, PLASTIC = dm.VonMises(E, NU, 5.0, 50.0), dm.VonMises(E, NU, 5.0, 0.0, 50.0)
PLATE, MEAN = {"kinematics": "plane_stress"}, {"volumetric": "reduced"}
MAPPED = [(RUBBER, PLATE), (RUBBER, {}), (SOFT, MEAN), (PLASTIC, PLATE), (KINEMATIC, MEAN)]
MAPPED += [(Radial(E, NU, 5.0, 50.0), {}), (LAW, {})]


@pytest.mark.parametrize(("law", "options"), quick(MAPPED, MAPPED[0], MAPPED[4]))
def test_a_strip_that_bends_by_heat_alone(law, options):
    """Conformal maps turn and stretch evenly: z + a z^2 has no stress if |1 + 2 a z| grows."""
    domain = rectangle([(0, 0), (1, 0.5)], (4, 3), "quadrilateral")
    (x, y), a = ufl.SpatialCoordinate(domain), fem.Constant(domain, 0.0)
    growth = ufl.sqrt((1 + 2 * a * x) ** 2 + (2 * a * y) ** 2) - 1
    if options is not PLATE:  # none out of the plane
        growth = ufl.as_tensor([[growth, 0, 0], [0, growth, 0], [0, 0, 0]])
    how = {"strain": "finite", "degree": 2, "eigenstrain": growth} | options
    problem = stand(domain, law, held_as_a_rigid_body, **how)
    exact, steep = fem.Function(problem.V), "volumetric" in options
    exact.interpolate(lambda x: [x[0] ** 2 - x[1] ** 2, 2 * x[0] * x[1]])
    for a.value in (0.02,) if steep else (0.02, 0.2):
        forces = [it.force_residual for it in dm.newton(problem, rtol=1e-12).iterations]
        problem.commit()
        assert len(forces) <= 9 and forces[-1] < max(forces[-2] ** 1.5, 1e-11)
        assert largest(problem.u.x.array - a.value * exact.x.array) < 1e-10
        assert largest(problem.solid.stress.x.array) < 1e-10 * E


@pytest.mark.parametrize("law", [LAW, RUBBER])
@pytest.mark.parametrize("kinematics", ["plane_strain", "plane_stress", "axisymmetric", "spatial"])
def test_a_bar_between_walls(kinematics, law):
    """Stress, width and energy of a bar that is heated by 20 %: Hencky's law, and a neo-Hookean."""
    d, e, free = 3 if kinematics == "spatial" else 2, 0.2, 2 - (kinematics == "plane_strain")
    domain, axis = rectangle([d * [0], d * [1]], d * [2]), d - 1
    how = {"kinematics": kinematics, "strain": "finite", "eigenstrain": e}
    problem = stand(domain, law, lambda V: [*rollers(V), hold(V, plane(axis, 1.0), axis)], **how)
    dm.newton(problem, rtol=1e-12)
    mu, lam = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
    held = -np.log(1 + e)  # logarithmic elastic strains, the same along and in plane strain across

    def stress(one, other):  # times the volume ratio, where other is the strain of the free sides
        volume = lam * (free * other + (3 - free) * held)
        return volume + mu * (2 * one if law is LAW else np.expm1(2 * one))

    wide = brentq(lambda log: stress(log, log), -1.0, 1.0, xtol=1e-15)
    found = problem.solid.fields.values("stress")
    J = np.exp(free * wide + (3 - free) * held)
    assert largest(found[..., axis] - stress(held, wide) / J) < 1e-9 * E
    assert largest(found[..., 0]) < 1e-9 * E
    assert largest(problem.u.x.array) == pytest.approx((1 + e) * np.exp(wide) - 1, rel=1e-9)
    squares = [
        free * f(wide) + (3 - free) * f(held) for f in (np.square, lambda x: np.expm1(2 * x))
    ]
    energy = squares[0] if law is LAW else squares[1] / 2 - np.log(J)
    energy = lam / 2 * np.log(J) ** 2 + mu * energy
    area = np.pi if kinematics == "axisymmetric" else 1.0
    assert total(problem.solid.energy()) == pytest.approx(area * (1 + e) ** 3 * energy, rel=1e-9)


@pytest.mark.parametrize(("law", "options"), [(SOFT, MEAN), (KINEMATIC, {})])
def test_what_is_turned_afterwards(law, options):
    """Energy and nodal forces of a body with a strain that has directions."""
    domain = block(3, 2, "hexahedron")
    how = {"strain": "finite", "eigenstrain": 50 * TENSOR} | options
    solid, R = solid_on(domain, law, **how), rotation([1.0, 2.0, -1.0], 2.0)
    X = solid.V.tabulate_dof_coordinates()
    set_wave(solid.u, 0.05)
    x = X + solid.u.x.array.reshape(-1, 3)
    found = []
    for turn in (np.eye(3), R):
        solid.u.x.array[:] = (x @ turn.T - X).ravel()
        found.append((total(solid.energy()), residual(solid).reshape(-1, 3) @ turn))
    (energy, forces), (same, turned) = found
    assert same == pytest.approx(energy, rel=1e-12)
    assert largest(turned - forces) < 1e-12 * largest(forces)


@pytest.mark.parametrize("options", [{}, PLATE, {"kinematics": "axisymmetric"} | MEAN])
def test_small_and_finite_strain_differ_by_the_square(options):
    domain, apart = rectangle([(0, 0), (1, 1)], (3, 3)), []
    heat = fem.Constant(domain, 0.0)
    given = {"eigenstrain": heat * ufl.SpatialCoordinate(domain)[1]} | options
    held = [
        stand(domain, LAW, lambda V: [hold(V, plane(1)), hold(V, plane(0), 0)], **given, strain=s)
        for s in ("small", "finite")
    ]
    for heat.value in (2e-3, 1e-3):
        for problem in held:
            dm.newton(problem, rtol=1e-11)
        apart.append(largest(held[0].u.x.array - held[1].u.x.array))
    assert apart[0] / apart[1] == pytest.approx(4.0, abs=0.05)


def test_a_tensor_that_is_not_symmetric():
    """No strain, such as a gradient whose skew part is a rotation; round-off is none."""
    u, tensor = displacement(3), 2e-3 * np.eye(3)
    tensor[0, 1] = 1e-15
    value = fem.Constant(u.function_space.mesh, tensor)
    solid = dm.Solid(u, LAW, eigenstrain=value)
    value.value[0, 1] = 1e-6
    with rejected("eigenstrain is not symmetric", "ufl.sym(..)"):
        solid.follow()
    value.value[1, 0] = 1e-6
    solid.follow()
    w = fem.Function(u.function_space)
    w.interpolate(lambda x: [x[1], 0 * x[0], 0 * x[0]])
    gradient = ufl.grad(w)
    with rejected("eigenstrain is not symmetric"):
        dm.Solid(u, LAW, eigenstrain=gradient)
    dm.Solid(u, LAW, eigenstrain=ufl.sym(gradient))


@pytest.mark.parametrize(("d", "volumetric"), [(2, "full"), (2, "reduced"), (3, "full")])
def test_a_clamped_body_is_pressed_from_all_sides(d, volumetric):
    """-E e0 / (1 - 2 nu) in all directions, and the energy of that, in one iteration."""
    domain, how = rectangle([d * [0], d * [1]], d * [2]), {"volumetric": volumetric}
    problem = stand(domain, LAW, lambda V: rollers(V, ends=(0, 1)), eigenstrain=2e-3, **how)
    report, u, solid = dm.newton(problem, rtol=1e-12), problem.u, problem.solid
    pressed = -E * 2e-3 / (1 - 2 * NU)
    stress = solid.fields.values("stress")
    assert largest(stress - pressed * (np.arange(stress.shape[2]) < 3)) < 1e-12 * E
    assert total(solid.energy()) == pytest.approx(0.5 * 3 * 2e-3 * -pressed, rel=1e-12)
    assert largest(u.x.array) < 1e-14 and solid.linear and report.newton_iterations == 1


def test_it_may_vary_in_space_and_change_in_time():
    """UFL of coordinates, a Constant and a Function: followed at once, without compiling."""
    u = displacement(2)
    V = u.function_space
    T = fem.Function(fem.functionspace(V.mesh, ("Lagrange", 1)))
    T.interpolate(lambda x: 10 + 0 * x[0])
    alpha = fem.Constant(V.mesh, 1e-4)
    solid = dm.Solid(u, LAW, eigenstrain=2 * alpha * T * ufl.SpatialCoordinate(V.mesh)[0])
    solid.evaluate()
    found = []
    for change in (lambda: None, lambda: alpha.value.fill(3e-4), lambda: T.x.array.fill(-5.0)):
        change()
        solid.evaluate()
        found.append(solid.fields.integral("stress_xx"))
    pressed = -E / (1 - 2 * NU) * np.array([1e-3, 3e-3, -1.5e-3])
    assert np.allclose(found, pressed, rtol=1e-12)


PERFECT = dm.VonMises(E, NU, Y=E * 1e-3, a=0.0)  # flows from strains of 1e-3 on
BEYOND = [6e-3, -3e-3, 6e-3]
SWELLING = {
    "plate": (2, PERFECT, [5e-3] * 3, {"kinematics": "plane_stress"}),
    "ring": (2, PERFECT, BEYOND, {"kinematics": "axisymmetric"}),
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
    domain = rectangle([d * [0], d * [1]], d * [2])
    heat, end = fem.Constant(domain, np.zeros((3, 3))), fem.Constant(domain, 0.0)

    def supports(V):
        pulled = [hold(V, plane(d - 1, 1.0), d - 1, end)] if before == "flowed" else []
        return rollers(V) + pulled

    options = options | {"eigenstrain": heat, "given": {"petsc_options": {"pc_type": "cholesky"}}}
    problem = stand(domain, law, supports, **options)
    u, solid, swollen = problem.u, problem.solid, fem.Function(problem.V)
    swollen.interpolate(lambda x: np.diag(strain[:d]) @ x[:d])
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
    domain, cells, tags = tubes(radii, ((6, 8), (9, 16)), cell="quadrilateral")
    cooling, laws = fem.Constant(domain, 0.0), {LOWER: LAW, UPPER: LAW}
    how = {"cell_tags": cells, "kinematics": "axisymmetric", "eigenstrain": {UPPER: cooling}}
    contact = dm.Contact(tags, slave=slave, master=TOP_OF_LOWER + BOTTOM_OF_UPPER - slave)
    problem = stand(domain, laws, lambda V: held_ends(V, tags), [contact], **how)
    steps = dm.load_steps(problem, [0.5, 1.0], on_time=lambda t: cooling.value.fill(-1e-6 * t))
    pressures = []
    for step in steps:
        assert step.report.converged
        pressures.append(largest(contact.pressure.x.array))
    expected = shrink_fit_pressure(E, NU, radii, (1 + NU) * 1e-6 * radii[1])
    assert np.allclose(pressures, [0.5 * expected, expected], rtol=2e-3)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (np.eye(2), "eigenstrain has the shape (2, 2): give a scalar "),
        ("hot", "eigenstrain is a str: give a scalar"),
        ({7: 1e-3}, "eigenstrain: no cell has the tag 7; cell_tags has 1, 2"),
        ({1: np.nan}, "eigenstrain[1] is NaN or infinite at "),
        ([[0, 0, 1e-3], [0, 0, 0], [1e-3, 0, 0]], "has components xz or yz at "),
        ({2: -1.0}, "eigenstrain[2] is -1 or below at "),
        (np.diag([0.1, -2.0, 0.0]), "eigenstrain is -1 or below at "),
        (True, "eigenstrain is True: give a scalar"),
        (1j, "eigenstrain is 1j: give a scalar "),
        (lambda u: u[0], "depends on the displacement"),
        (lambda u: displacement(2)[0], "another mesh"),
    ],
)
def test_what_is_no_eigenstrain_is_refused(given, said):
    domain, cell_tags, _ = tubes((1.0, 1.5, 2.0), ((2, 2), (3, 2)))
    how = {"strain": "finite"} if "-1" in said else {}
    u = create_displacement(domain)
    with rejected(said):
        given = given(u) if callable(given) else given
        dm.Solid(u, {1: LAW, 2: LAW}, cell_tags, eigenstrain=given, **how)
    with rejected("dictionary by cell tag: give an entry, and cell_tags"):
        dm.Solid(u, LAW, eigenstrain={1: 1e-3})


def test_what_becomes_undefined_later_is_refused_and_nothing_changes():
    domain = block(2)
    heat = fem.Constant(domain, 1e-3)
    problem = stand(domain, LAW, rollers, eigenstrain=heat)
    solid = problem.solid
    solid.evaluate()
    before = solid.stress.x.array.copy()
    heat.value = np.nan
    for call in (solid.evaluate, lambda: dm.newton(problem)):
        with pytest.raises(ValueError, match="eigenstrain is NaN or infinite at"):
            call()
    assert (problem.u.x.array == 0.0).all() and (solid.stress.x.array == before).all()
    heat.value = 2e-3
    dm.newton(problem)  # rollers hold it along z alone
    assert np.isclose(solid.max("stress_zz"), -E * 2e-3)
