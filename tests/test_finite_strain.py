# SPDX-License-Identifier: MIT
"""Finite strain through the whole package: patches, turns, bifurcation, volumes."""

import numpy as np
import pytest
from scipy.optimize import brentq

import dolfinx_mortar as dm
from dolfinx import default_scalar_type, fem
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.meshes_3d import rotation
from tests.cases.pressed_blocks import failing, rejected
from tests.cases.solid import (
    create_displacement,
    create_domain,
    hold,
    largest,
    plane,
    rectangle,
    rollers,
    stand,
    tag_facets,
)
from tests.cases.two_bodies import TwoBodies, create_problem
from tests.choice import quick

pytestmark = pytest.mark.mpi
E, NU = 1000.0, 0.3
RUBBER = dm.NeoHooke(E, NU)
LU, PETSC = {"pc_type": "lu"}, {"pc_type": "cholesky", "pc_factor_mat_solver_type": "petsc"}


def compressed(b, free):
    """Return axial force per area at X and J of a bar of stretch b, some of its sides free."""
    mu, lam = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)

    def nominal(stretch, a):
        return mu * (stretch - 1 / stretch) + lam * np.log(a**free * b) / stretch

    a = brentq(lambda a: nominal(a, a), 0.9, 2.0, xtol=1e-14)
    return nominal(b, a), a**free * b


PATCHES = [
    ("plane_strain", "triangle", 0.4, None),
    ("axisymmetric", "quadrilateral", 0.4, None),
    ("plane_stress", "triangle", 0.4, None),
    ("spatial", "tetrahedron", 0.15, LU),
    ("spatial", "hexahedron", 0.4, None),
]


@pytest.mark.parametrize(("kinematics", "cell", "strain", "options"), PATCHES)
def test_patch_at_40_percent_compression(kinematics, cell, strain, options):
    """Uniform stress in closed form through the contact, in one step, with a quadratic tail."""
    d = 3 if kinematics == "spatial" else 2
    case, axial = TwoBodies(cell, jitter=0.2 if d == 3 else 0.0), d - 1
    contact, bcs = case.interface(), rollers(case.V, range(axial))
    bcs += [case.held(BOTTOM, 0.0, axial), case.held(TOP, -2.0 * strain, axial)]
    how = {"strain": "finite", "kinematics": kinematics, "petsc_options": options}
    problem = case.problem([contact], bcs, RUBBER, **how)
    report, solid = dm.newton(problem, rtol=1e-10), problem.solid
    nominal, J = compressed(1.0 - strain, 1 if kinematics == "plane_strain" else 2)
    stress = solid.fields.values("stress")
    pressure = nominal * (1.0 - strain) / J
    stress = stress - pressure * (np.arange(stress.shape[-1]) == axial)
    across = [2] if kinematics == "plane_strain" else []
    assert largest(np.delete(stress, across, axis=-1)) < 1e-7 * abs(pressure)
    assert largest(solid.fields.values("J") - J) < 1e-8
    area = np.pi if kinematics == "axisymmetric" else 1.0
    assert contact.force[axial] == pytest.approx(nominal * area, rel=1e-7)
    certificate = report.certificate
    assert certificate.force_balance < 1e-9 and certificate.moment_balance < 1e-9
    assert certificate.smallest_J == pytest.approx(J, rel=1e-8)
    forces = [it.force_residual for it in report.iterations]
    if d == 2 or options:
        assert len(forces) <= 7 and forces[-2] < 10 * forces[-3] ** 2
    else:  # below 1e-9 digits are those of multigrid
        assert len([f for f in forces if f > 1e-9]) <= 6


SHAPES = {
    2: {"n_upper": (3, 2), "n_lower": (9, 3), "x_lower": (-1.0, 2.0), "heights": (1.0, 0.6)},
    3: {"lower": (-0.2, 1.2, -0.1, 1.3)},
}


class Turned:
    """Two bodies whose ends are turned after the upper one has moved."""

    def __init__(self, d, friction, geometry="updated"):
        case = TwoBodies(("triangle", "hexahedron")[d - 2], **SHAPES[d])
        self.contact, self.ends = case.interface(friction=friction), []
        self.ends = [fem.Function(case.V) for _ in range(2)]
        bcs = [case.held(tag, end) for tag, end in zip((BOTTOM, TOP), self.ends, strict=True)]
        how = {"strain": "finite", "petsc_options": LU, "geometry": geometry}
        self.problem = case.problem([self.contact], bcs, RUBBER, **how)

    def place(self, R, *way):
        """Return the report of a step, and what turns with the bodies, turned back, or stays."""
        problem, contact, d = self.problem, self.contact, len(R)
        for end, shift in zip(self.ends, (np.zeros(d), np.array(way)), strict=True):
            end.interpolate(lambda x, shift=shift: R @ (x[:d] + shift[:, None]) - x[:d])
        report = dm.newton(problem, rtol=1e-12)
        problem.commit()
        found, nodes = dm.reaction(problem, problem.bcs[1]), contact.gather(problem.u)
        turns = [found.force, contact.force, found.moment, contact.moment]
        turns += [nodes["traction"]] if "traction" in nodes else []
        back = [v @ R if v.shape[-1:] == (d,) else v for v in map(np.array, turns)]
        return report, [*back, nodes["pressure"], problem.solid.fields.values("J").copy()]


@pytest.mark.parametrize(("d", "friction"), [(2, None), (2, 2.0), (3, 2.0)])
def test_everything_turned_in_one_step(d, friction):
    """Forces, moments about the origin and tractions, also those that friction holds."""
    case, way = Turned(d, friction), (*(0.02, 0.01)[: d - 1], -0.05)
    case.place(np.eye(d), *np.zeros(d - 1), -0.05)
    _, before = case.place(np.eye(d), *way)
    R = rotation([0.0, 0.0, 1.0], np.radians(200.0))[:2, :2]
    R = R if d == 2 else rotation([1.0, 2.0, -1.0], np.pi / 2)
    report, after = case.place(R, *way)
    for one, same in zip(before, after, strict=True):
        np.testing.assert_allclose(same, one, atol=1e-9 * largest(one), rtol=0.0)
    if friction:
        assert (case.contact.status.x.array != 2.0).all()  # no slip
        assert abs(before[1][0]) > 1.0
    assert largest(before[0]) > 1.0 and report.newton_iterations <= 3
    assert report.certificate.internal_moment < 1e-12
    assert report.certificate.moment_balance < 1e-5  # a defect of the facets, O(h^2)


def test_a_pair_that_turns_in_frozen_geometry_is_noted():
    """The normals stay what they are at X."""
    case = Turned(2, None, "reference")
    for angle, noted in ((0.0, False), (0.02, False), (0.1, True)):
        report, _ = case.place(rotation([0.0, 0.0, 1.0], angle)[:2, :2], 0.0, -0.05)
        assert any("has turned by" in note for note in report.notes) == noted


def column(d, depth, imperfection=0.0, options=None, cells=(1, 2, 12)):
    """Return a slender column that its top, free to move aside, is pressed down on."""
    domain = rectangle([d * [0.0], [*(d - 1) * [0.1], 1.0]], (2, 20) if d == 2 else cells)
    x = domain.geometry.x
    x[:, d - 2] += imperfection * np.sin(np.pi * x[:, d - 1] / 2)

    def ends(V):
        return [hold(V, plane(d - 1)), hold(V, plane(d - 1, 1.0), d - 1, -depth)]

    how = {"strain": "finite", "volumetric": "reduced", "given": {"petsc_options": options}}
    return stand(domain, RUBBER, ends, **how)


@pytest.mark.parametrize(("d", "options"), [(2, None), (3, None), (2, LU)])
def test_an_indefinite_tangent_is_made_convex(d, options):
    """A column far beyond its critical load bends aside, in one step; the shift is gone then."""
    problem = column(d, 0.1, 1e-3, options)
    report = dm.newton(problem, max_it=60)
    shifts = [it.shift for it in report.iterations]
    assert max(shifts) > 0.0 and shifts[-1] == 0.0
    assert largest(problem.u.x.array[d - 2 :: d]) > 0.3
    assert any("indefinite" in note for note in report.notes)
    assert d == 3 or not any("unstable" in n or "degree 2" in n for n in report.notes)


def test_the_coarsest_level_tells_an_indefinite_tangent():
    """Its inverse hides the negative eigenvalue from conjugate gradients; advice, if it ends."""
    problem = column(3, 0.05, 1e-3, cells=(1, 1, 4))
    with failing(problem, "indefinite in ", "prescribed already"):
        dm.newton(problem, max_it=5)
    assert "instead of forces" not in problem.diagnose()[-1]
    report = dm.newton(problem)
    assert report.newton_iterations <= 10 and max(it.shift for it in report.iterations) > 0.0
    assert largest(problem.u.x.array[1::3]) == pytest.approx(0.1945, abs=1e-3)


@pytest.mark.serial  # PETSc's own factorisation is
@pytest.mark.parametrize(
    ("d", "options"), [(2, None), (2, LU), (2, PETSC), (3, None), (3, LU)], ids=str
)
def test_an_unstable_balance_is_told(d, options):
    """In space the least eigenvalues of the tangent are 1.0e-3 at .006, -6.2e-4 at .01 (LAPACK)."""
    for depth, unstable in ((0.006, False), (0.01, True)):
        notes = dm.newton(column(d, depth, options=options)).notes
        assert any("equilibrium found is unstable" in note for note in notes) == unstable


def test_a_tool_passes_a_limit_point():
    """It presses an arch at its crown. Open contacts leave the tangent indefinite."""
    domain = rectangle([(-1.0, 0.0), (1.0, 0.05)], (16, 1))
    domain.geometry.x[:, 1] += 0.3 * np.cos(np.pi * domain.geometry.x[:, 0] / 2)
    u = create_displacement(domain, 2)
    support = hold(u.function_space, lambda x: np.isclose(abs(x[0]), 1.0))

    def upper(x):
        return x[1] - 0.3 * np.cos(np.pi / 2 * x[0]) > 0.04

    tags = tag_facets(domain, upper)
    tool = dm.Obstacle(tags, slave=1, shape=dm.shapes.Cylinder((0.0, 0.55), 0.2))
    problem = create_problem(u, [tool], [support], RUBBER, strain="finite")
    forces, iterations = [], []
    for depth in (0.04, 0.08, 0.12, 0.16, 0.2, 0.24):
        tool.position.value[1] = 0.55 - depth
        iterations.append(dm.newton(problem).newton_iterations)
        problem.commit()
        forces.append(abs(tool.force[1]))
    assert max(iterations) <= 6
    assert forces[0] < forces[1] > 1.3 * forces[5]


def pressed_cube(law, n, **options):
    """Return a cube whose bottom is held, and the displacement that is prescribed at its top."""
    domain = rectangle([(0, 0, 0), (1, 1, 1)], (n, n, n))
    move = fem.Constant(domain, np.zeros(3, dtype=default_scalar_type))

    def ends(V):
        return [hold(V, plane(2)), hold(V, plane(2, 1.0), value=move)]

    return stand(domain, law, ends, strain="finite", given=options), move


@pytest.mark.serial
def test_a_step_that_fails_leaves_no_levels_to_later_ones():
    """Levels of its tangents would change the digits of later steps, and near saddles the end."""
    ends = []
    for depths in ((0.05,), (0.05, 0.3)):
        problem, move = pressed_cube(dm.VonMises(200e3, 0.3, 200.0, 0.0, 1000.0), 2)
        for depth in depths:
            move.value[2] = -depth
            with pytest.raises(dm.NewtonNotConverged):
                dm.newton(problem, max_it=1)
        move.value[2] = -0.1
        assert "gamg" in dm.newton(problem).linear_solver
        ends.append(problem.u.x.array.copy())
    assert np.array_equal(*ends)


@pytest.mark.serial
@pytest.mark.parametrize(("n", "depth"), quick([(3, 0.5), (3, 0.7), (4, 0.5)], (3, 0.7)))
def test_a_saddle_is_factorised_where_multigrid_gives_up(n, depth, monkeypatch):
    """Its own tangent leads to it, a shifted one away. What is too large is not factorised."""
    law, options = dm.VonMises(206_900.0, 0.29, 367.0, 1000.0), {"mat_mumps_icntl_14": 40}
    problem, move = pressed_cube(law, n, petsc_options=options)
    move.value[2] = -depth
    report = dm.newton(problem)
    assert len(report.iterations) <= 20 and report.iterations[-1].shift == 0.0
    assert any("later ones are factorised" in note for note in report.notes)
    assert any("the equilibrium found is unstable" in note for note in report.notes)
    first, _, last = report.linear_solver.partition(", from iteration ")
    assert first == "cg + gamg" and "mumps" in last and "gamg" not in last
    assert 1 < int(last.split()[0]) <= len(report.iterations)
    assert not any("without effect" in note for note in report.notes)  # MUMPS has read its option
    monkeypatch.setattr("dolfinx_mortar.qp.linear.MOST_FACTORISED", 100)
    problem, move = pressed_cube(law, n)
    move.value[2] = -depth
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=20)


def test_cells_that_invert():
    """Impossible: an error that names cell and place, all as before; a possible push is made."""
    problem, move = pressed_cube(RUBBER, 3)
    move.value[2] = -1.5
    place = r"inside out.*cell \d+ of the input around \(\S+, \S+, \S+\) at X"
    with pytest.raises(dm.NewtonNotConverged, match=place):
        dm.newton(problem)
    assert "buckle" not in problem.diagnose()[-1]  # cells are the cause, whatever tangents are
    assert not problem.u.x.array.any()
    move.value[2] = -0.95  # takes ten
    with failing(problem, "of a length", "compress it less"):
        dm.newton(problem, max_it=5)
    move.value[2] = -0.5
    assert dm.newton(problem).newton_iterations <= 6
    assert 0.0 < problem.solid.volumes.smallest() < 1.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"strain": "large"}, ("strain", "'small' or 'finite'")),
        ({}, ("NeoHooke", "strain='finite'")),
        (
            {"strain": "finite", "kinematics": "plane_stress", "volumetric": "reduced"},
            ("volumetric", "plane stress"),
        ),
    ],
)
def test_what_finite_strain_does_not_go_with(options, words):
    with rejected(*words):
        stand(create_domain("quadrilateral", 2), RUBBER, **options)
