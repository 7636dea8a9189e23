# SPDX-License-Identifier: MIT
"""Finite strain in space and on rings: patch, turns, a ball, bifurcation, limit points, volumes."""

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem, mesh
from tests.cases import meshes, meshes_3d
from tests.cases.ball import create_problem
from tests.cases.pressed_blocks import failing
from tests.cases.rings import largest
from tests.cases.solid import COMM, create_displacement
from tests.choice import crosswise, quick

pytestmark = pytest.mark.mpi
E, NU = 1000.0, 0.3
RUBBER = dm.NeoHooke(E, NU)
LU, CELLS = {"pc_type": "lu"}, ["tetrahedron", "hexahedron"]


def compressed(b):
    """Return lateral stretch and axial force per area at X of a bar of stretch b, no side force."""
    mu, lam = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
    a = brentq(lambda a: mu * (a - 1 / a) + lam * np.log(a * a * b) / a, 0.9, 2.0, xtol=1e-14)
    return a, mu * (b - 1 / b) + lam * np.log(a * a * b) / b


def sliding(V, facets, sides):
    """Return conditions on components of sides, (tag, component, value)."""
    dim = V.mesh.topology.dim - 1
    found = []
    for tag, i, value in sides:
        dofs = fem.locate_dofs_topological(V.sub(i), dim, facets.find(tag))
        found.append(fem.dirichletbc(value, dofs, V.sub(i)))
    return found


def zero(domain, shape=()):
    """Return a Constant."""
    return fem.Constant(domain, np.zeros(shape, dtype=default_scalar_type))


def check_uniform(problem, contact, report, area, b=0.6):
    """Compare with the bar: stress, J, force and moment of the contact at X + u."""
    a, nominal = compressed(b)
    solid, d = problem.solid, problem.d
    stress = solid.fields.values("stress").reshape(-1, 2 * d if d == 3 else 4)
    axial = d - 1
    scale = abs(nominal) / a**2
    assert largest(stress[:, axial] + scale) < 1e-7 * scale
    assert largest(np.delete(stress, axial, axis=1)) < 1e-7 * scale
    assert largest(solid.fields.values("J") - a * a * b) < 1e-8
    # on the slave side, the top of the lower body
    assert contact.force[axial] == pytest.approx(nominal * area, rel=1e-7)
    certificate = report.certificate
    assert certificate.force_balance < 1e-9 and certificate.moment_balance < 1e-9
    assert certificate.smallest_J == pytest.approx(a * a * b, rel=1e-8)
    return a


@pytest.mark.parametrize("cell", quick(["triangle", "quadrilateral"], "quadrilateral"))
def test_patch_of_discs_at_40_percent_compression(cell):
    """The same of two discs in contact, whose radius grows; the force is that of the whole."""
    domain, _, facets = meshes.two_blocks(COMM, cell=cell)
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u, down, still = fem.Function(V), zero(domain), zero(domain)
    axis = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[0], 0.0))
    bcs = sliding(V, facets, [(meshes.BOTTOM, 1, still), (meshes.TOP, 1, down)])
    dofs = fem.locate_dofs_topological(V.sub(0), 1, axis)
    bcs.append(fem.dirichletbc(still, dofs, V.sub(0)))
    solid = dm.Solid(u, RUBBER, strain="finite", kinematics="axisymmetric")
    contact = dm.Contact(facets, slave=meshes.TOP_OF_LOWER, master=meshes.BOTTOM_OF_UPPER)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs)
    down.value = -0.4 * 2.0
    report = dm.newton(problem, rtol=1e-10)
    check_uniform(problem, contact, report, np.pi)


@pytest.mark.parametrize(
    ("options", "strain", "cell"),
    crosswise([(LU, 0.15), (None, 0.4)], CELLS)
    + quick([(*case, cell) for case in ((LU, 0.4), (None, 0.15)) for cell in CELLS]),
)
def test_patch_of_boxes_in_space(cell, strain, options):
    """The same of two boxes on symmetry planes, in one step, factorised and by multigrid.

    On frozen surfaces the tangent of 40 % is indefinite, and the fixed point leads away.
    """
    domain, _, facets = meshes_3d.two_boxes(COMM, cell=cell, jitter=0.2)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    u, down, still = fem.Function(V), zero(domain), zero(domain)
    held = [(meshes_3d.BOTTOM, 2), (meshes_3d.LEFT, 0), (meshes_3d.FRONT, 1)]
    bcs = sliding(V, facets, [*((*at, still) for at in held), (meshes_3d.TOP, 2, down)])
    solid = dm.Solid(u, RUBBER, strain="finite")
    sides = {"slave": meshes_3d.TOP_OF_LOWER, "master": meshes_3d.BOTTOM_OF_UPPER}
    contact = dm.Contact(facets, **sides)
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, petsc_options=options)
    down.value = -strain * 2.0
    report = dm.newton(problem, rtol=1e-10)
    check_uniform(problem, contact, report, 1.0, 1.0 - strain)
    # below 1e-9 digits are those of multigrid: they differ with what was solved before
    far = [it for it in report.iterations if options or it.force_residual > 1e-9]
    assert len(far) <= (5 if options else 6)


def test_everything_turned_in_space():
    """By 90 degrees about a slanted axis in one step: forces and moments turn to round-off."""
    domain, _, facets = meshes_3d.two_boxes(COMM, cell="hexahedron", upper=(0.2, 0.8, 0.1, 0.7))
    u = create_displacement(domain)
    V = u.function_space
    low, high = fem.Function(V), fem.Function(V)
    bcs = [
        fem.dirichletbc(f, fem.locate_dofs_topological(V, 2, facets.find(tag)))
        for f, tag in ((low, meshes_3d.BOTTOM), (high, meshes_3d.TOP))
    ]
    solid = dm.Solid(u, RUBBER, strain="finite")
    contact = dm.Contact(facets, slave=meshes_3d.BOTTOM_OF_UPPER, master=meshes_3d.TOP_OF_LOWER)
    problem = dm.ContactProblem(
        solid, [contact], bcs=bcs, petsc_options={"ksp_type": "preonly", "pc_type": "lu"}
    )

    def place(R):
        low.interpolate(lambda x: R @ x - x)
        high.interpolate(lambda x: R @ (x - np.array([[0.0], [0.0], [0.05]])) - x)
        report = dm.newton(problem, rtol=1e-11)
        problem.commit()
        return report, dm.reaction(problem, bcs[1])

    _, before = place(np.eye(3))
    pressing = contact.force.copy()
    R = meshes_3d.rotation([1.0, 2.0, -1.0], np.pi / 2)
    report, after = place(R)
    size = np.linalg.norm(before.force)
    assert size > 1.0
    np.testing.assert_allclose(after.force, R @ before.force, atol=1e-9 * size)
    np.testing.assert_allclose(after.moment, R @ before.moment, atol=1e-9 * size)
    np.testing.assert_allclose(contact.force, R @ pressing, atol=1e-9 * size)
    assert report.newton_iterations <= 3
    assert report.certificate.internal_moment < 1e-12
    assert report.certificate.moment_balance < 1e-5  # a defect of the facets, O(h^2)


@pytest.mark.slow
def test_a_soft_ball_in_space_and_as_a_ring():
    """Pressed by a sixteenth of its radius: the quarter in space has the force of the ring."""
    soft, depth = dm.NeoHooke(100.0, 0.4), 0.5
    problem, contact = create_problem(
        h=0.35,
        degree=2,
        cell="hexahedron",
        depth=depth,
        law=soft,
        strain="finite",
        geometry="updated",
    )
    report = dm.newton(problem)
    assert report.certificate.moment_balance < 1e-5  # a defect of the facets, O(h^2)
    assert report.certificate.smallest_J > 0.5
    space = 4.0 * abs(contact.force[2])
    made = dm.meshing.hertz(COMM, kind="graded", h=0.1, half=True, block=(34.0, 10.0))
    V = fem.functionspace(made.mesh, ("Lagrange", 2, (2,)))
    solid = dm.Solid(fem.Function(V), soft, kinematics="axisymmetric", strain="finite")
    still, push = zero(made.mesh), zero(made.mesh)
    bcs = sliding(
        V,
        made.facet_tags,
        [
            *(("bottom", 0, still), ("bottom", 1, still), ("axis", 0, still)),
            *(("flat", 0, still), ("flat", 1, push)),
        ],
    )
    ring = dm.Contact(made.facet_tags, slave="top", master="arc")
    of_ring = dm.ContactProblem(solid, [ring], bcs=bcs)
    push.value = -depth
    dm.newton(of_ring)
    print(space, ring.force)
    assert space == pytest.approx(abs(ring.force[1]), rel=3e-3)


def column(imperfection, height=1.0, options=None, cells=(1, 2, 12)):
    """Return a slender column in space, its foot held, its top free to move aside.

    The options are those of PETSc.
    """
    domain = mesh.create_box(COMM, [(0, 0, 0), (0.1, 0.1, height)], cells, mesh.CellType.hexahedron)
    x = domain.geometry.x
    x[:, 1] += imperfection * np.sin(np.pi * x[:, 2] / 2 / height)
    u = create_displacement(domain)
    V, down = u.function_space, zero(domain)
    ends = [
        mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z))
        for z in (0.0, height)
    ]
    foot = fem.locate_dofs_topological(V, 2, ends[0])
    top = fem.locate_dofs_topological(V.sub(2), 2, ends[1])
    nothing = np.zeros(3, dtype=default_scalar_type)
    bcs = [fem.dirichletbc(nothing, foot, V), fem.dirichletbc(down, top, V.sub(2))]
    solid = dm.Solid(u, RUBBER, strain="finite", volumetric="reduced")
    return dm.ContactProblem(solid, [], bcs=bcs, petsc_options=options), down


def test_an_indefinite_tangent_in_space_is_made_convex():
    """Conjugate gradients meet a negative curvature; the column bends aside, the shift is gone."""
    problem, down = column(1e-3)
    down.value = -0.1
    report = dm.newton(problem, max_it=60)
    shifts = [it.shift for it in report.iterations]
    assert max(shifts) > 0.0 and shifts[-1] == 0.0
    assert largest(problem.u.x.array[1::3]) > 0.3
    assert any("indefinite" in note for note in report.notes)


def test_the_coarsest_level_tells_an_indefinite_tangent():
    """Its inverse hides the negative eigenvalue from conjugate gradients.

    45 iterations led to the unstable balance, aside by .0026, without a word.
    """
    problem, down = column(1e-3, cells=(1, 1, 4))
    down.value = -0.05
    report = dm.newton(problem)
    assert report.newton_iterations <= 10 and max(it.shift for it in report.iterations) > 0.0
    assert largest(problem.u.x.array[1::3]) == pytest.approx(0.1945, abs=1e-3)


def test_advice_where_displacements_are_prescribed_already():
    """Loads are not the cause, so it is not said to prescribe displacements instead."""
    problem, down = column(1e-3, cells=(1, 1, 4))
    down.value = -0.05
    with failing(problem, "indefinite in ", "prescribed already"):
        dm.newton(problem, max_it=5)
    assert "instead of forces" not in problem.diagnose()[-1]


def test_a_factorisation_that_does_not_tell_an_indefinite_tangent_is_named():
    problem, down = column(1e-3, options=LU, cells=(1, 1, 4))
    down.value = -0.05
    with failing(problem, "'lu'", "petsc_options={'pc_type': 'cholesky'"):
        dm.newton(problem)


def unstable(depth, options=None):
    """Tell whether the report of a straight column says that its balance is unstable."""
    problem, down = column(0.0, options=options)
    down.value = -depth
    return any("equilibrium found is unstable" in note for note in dm.newton(problem).notes)


@pytest.mark.parametrize("options", [None, {"pc_type": "lu"}])
def test_an_unstable_balance_in_space_is_told(options):
    """Also by multigrid. Eigenvalues of the tangent: 1.0e-3 at .006, -6.2e-4 at .01 (LAPACK)."""
    assert not unstable(0.006, options)
    assert unstable(0.01, options)


@pytest.mark.slow
def test_a_limit_point_in_space_passes_under_displacement_control():
    """A shallow arch of hexahedra: the force of its crown rises, falls, and rises again."""
    domain = mesh.create_box(
        COMM, [(-1.0, 0.0, 0.0), (1.0, 0.1, 0.05)], (24, 1, 1), mesh.CellType.hexahedron
    )
    x = domain.geometry.x
    x[:, 2] += 0.1 * np.cos(np.pi * x[:, 0] / 2)
    V = fem.functionspace(domain, ("Lagrange", 2, (3,)))
    u, down = fem.Function(V), zero(domain)
    ends = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(abs(x[0]), 1.0))
    held = fem.locate_dofs_topological(V, 2, ends)
    Vz, _ = V.sub(2).collapse()
    crown = fem.locate_dofs_geometrical(
        (V.sub(2), Vz), lambda x: np.isclose(x[0], 0.0) & np.isclose(x[2], 0.15)
    )[0]
    nothing = np.zeros(3, dtype=default_scalar_type)
    bcs = [fem.dirichletbc(nothing, held, V), fem.dirichletbc(down, crown, V.sub(2))]
    problem = dm.ContactProblem(dm.Solid(u, RUBBER, strain="finite"), [], bcs=bcs)
    forces = []
    for depth in (0.03, 0.06, 0.1, 0.2):
        down.value = -depth
        dm.newton(problem)
        problem.commit()
        forces.append(-dm.reaction(problem, bcs[1]).force[2])
    assert forces[0] < forces[1] > forces[2] < forces[3]


def pressed_cube(law, cells, **options):
    """Return a cube whose bottom is held, and the displacement that is prescribed at its top."""
    domain = mesh.create_box(
        COMM, [(0, 0, 0), (1, 1, 1)], (cells, cells, cells), mesh.CellType.hexahedron
    )
    u = create_displacement(domain)
    V, move = u.function_space, zero(domain, (3,))
    sides = []
    for z in (0.0, 1.0):
        found = mesh.locate_entities_boundary(domain, 2, lambda x, z=z: np.isclose(x[2], z))
        sides.append(fem.locate_dofs_topological(V, 2, found))
    nothing = np.zeros(3, dtype=default_scalar_type)
    bcs = [fem.dirichletbc(nothing, sides[0], V), fem.dirichletbc(move, sides[1], V)]
    return dm.ContactProblem(dm.Solid(u, law, strain="finite"), [], bcs=bcs, **options), move


@pytest.mark.serial
def test_a_step_that_fails_leaves_no_levels_to_later_ones():
    """Levels of its tangents would change the digits of later steps, and near saddles the end."""
    ends = []
    for depths in ((0.05,), (0.3,), (0.05, 0.3)):
        problem, move = pressed_cube(dm.VonMises(200e3, 0.3, 200.0, 0.0, 1000.0), 2)
        for depth in depths:
            move.value[2] = -depth
            with pytest.raises(dm.NewtonNotConverged):
                dm.newton(problem, max_it=1)
        move.value[2] = -0.1
        assert "gamg" in dm.newton(problem).linear_solver
        ends.append(problem.u.x.array.copy())
    assert np.array_equal(ends[0], ends[1]) and np.array_equal(ends[0], ends[2])


@pytest.mark.serial
@pytest.mark.parametrize(
    ("cells", "depth"), quick([(3, 0.5), (3, 0.6), (3, 0.7), (4, 0.45), (4, 0.5)], (3, 0.7))
)
def test_a_saddle_is_factorised_where_multigrid_gives_up(cells, depth, monkeypatch):
    """Its own tangent leads to it, a shifted one away. What is too large is not factorised.

    At 0.5 the energy increases on the last steps; with 4 cells the residual of forces stays above
    3e-3 with shifted tangents.
    """
    law, options = dm.VonMises(206_900.0, 0.29, 367.0, 1000.0), {"mat_mumps_icntl_14": 40}
    problem, move = pressed_cube(law, cells, petsc_options=options)
    move.value[2] = -depth
    report = dm.newton(problem)
    assert len(report.iterations) <= 20 and report.iterations[-1].shift == 0.0
    assert any("rest of this step is factorised" in note for note in report.notes)
    assert any("the equilibrium found is unstable" in note for note in report.notes)
    first, _, last = report.linear_solver.partition(", from iteration ")
    assert first == "cg + gamg" and "mumps" in last and "gamg" not in last
    assert 1 < int(last.split()[0]) <= len(report.iterations)
    assert not any("without effect" in note for note in report.notes)  # MUMPS has read its option
    assert not problem.linear.direct  # the next step begins with multigrid
    monkeypatch.setattr("dolfinx_mortar.qp.linear.MOST_FACTORISED", 100)
    problem, move = pressed_cube(law, cells)
    move.value[2] = -depth
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=20)


def test_cells_that_invert_in_space():
    """Impossible: an error that names cell and place, all as before; a possible push is made."""
    problem, move = pressed_cube(RUBBER, 3)
    u = problem.u
    move.value[2] = -1.5
    place = r"inside out.*cell \d+ of the input around \(\S+, \S+, \S+\) at X"
    with pytest.raises(dm.NewtonNotConverged, match=place):
        dm.newton(problem)
    assert "buckle" not in problem.diagnose()[-1]  # cells are the cause, whatever tangents are
    assert not u.x.array.any()
    move.value[2] = -0.95  # takes ten
    with failing(problem, "of a length", "compress it less"):
        dm.newton(problem, max_it=5)
    move.value[2] = -0.5
    assert dm.newton(problem).newton_iterations <= 6
    assert 0.0 < problem.solid.volumes.smallest() < 1.0


def test_a_metal_flattened_in_one_step():
    """It keeps its volume as it flows, and does not buckle: the step is too large; eighths end."""
    problem, move = pressed_cube(dm.VonMises(200e3, NU, 200.0, 0.0, 5000.0), 3)
    move.value[2] = -0.8
    with failing(problem, "of a length", "smaller load steps"):
        dm.newton(problem, max_it=10)  # takes 16, to a saddle
    assert "buckle" not in problem.diagnose()[-1]
    ramp = {move: [(0.0, (0.0, 0.0, 0.0)), (0.8, (0.0, 0.0, -0.8))]}
    for step in dm.load_steps(problem, np.arange(1, 9) / 10, ramp=ramp, cuts="none"):
        assert step.report.newton_iterations <= 10
    problem.u.x.array[:] = np.nan
    assert not problem.solid.gradients.describe_shortened(0.3)
