# SPDX-License-Identifier: MIT
"""The error of the small strain: its measure, and the note where it matters."""

import dataclasses
import math

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.report.small_strain import LARGEST_SHARE, find_left_out
from dolfinx_mortar.solid.kinematics import plane_strain
from tests.cases.hertz import PLASTIC, create_case, create_mesh
from tests.cases.meshes import BOTTOM, LOWER, TOP, UPPER
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import create_displacement, create_domain

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
SOFT = dm.Elastic(1000.0, 0.3)
STEEL = dm.VonMises.from_uniaxial(210e3, 0.3, yield_stress=300.0, plastic_modulus=1000.0)


def green_lagrange(u):
    """Return (F^T F - I) / 2 in the plane, as 3x3."""
    g = ufl.grad(u)
    e = (g + g.T + g.T * g) / 2
    return ufl.as_tensor([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, 0]])


FINITE = dataclasses.replace(plane_strain, name="finite", measure=green_lagrange)


class Moved:
    """A box with a prescribed displacement H x of all of its surface."""

    def __init__(self, law=SOFT, cell="quadrilateral", **options):
        """Create the box; the options are those of the solid."""
        self.u = create_displacement(create_domain(cell, 2))
        V, d = self.u.function_space, self.u.function_space.mesh.topology.dim
        self.prescribed = fem.Function(V)
        V.mesh.topology.create_connectivity(d - 1, d)
        facets = mesh.exterior_facet_indices(V.mesh.topology)
        dofs = fem.locate_dofs_topological(V, d - 1, facets)
        self.solid = dm.Solid(self.u, law, **options)
        self.problem = dm.ContactProblem(self.solid, bcs=[fem.dirichletbc(self.prescribed, dofs)])

    def move(self, H):
        """Solve for u = H x on the surface; return the report."""
        d = len(H)
        self.prescribed.interpolate(lambda x: np.asarray(H) @ x[:d])
        return dm.newton(self.problem)


def turn(degrees):
    """Return R - I in the plane."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c - 1, -s], [s, c - 1]])


def told(report):
    """Return the notes on the small strain."""
    found = [note for note in report.notes if "small strain leaves out" in note]
    return [note for note in found if "no longer small" not in note]


# -- measured exactly ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "kinematics"),
    [
        ("triangle", "plane_strain"),
        ("quadrilateral", "plane_stress"),
        ("tetrahedron", "spatial"),
    ],
)
def test_numbers_of_a_uniform_gradient(cell, kinematics):
    """Against H^T H / 2 and Hooke's law written out."""
    d = 3 if kinematics == "spatial" else 2
    H = np.random.default_rng(2).normal(size=(d, d)) * 0.01
    moved = Moved(cell=cell, kinematics=kinematics)
    c = moved.move(H).certificate
    full = np.zeros((3, 3))
    full[:d, :d] = H
    e, w = (full + full.T) / 2, (full - full.T) / 2
    lame = SOFT.E * SOFT.nu / (1 + SOFT.nu) / (1 - 2 * SOFT.nu)
    if kinematics == "plane_stress":
        lame = SOFT.E * SOFT.nu / (1 - SOFT.nu**2)
    stress = lame * np.trace(e) * np.eye(3) + SOFT.E / (1 + SOFT.nu) * e
    stress[d:] = stress[d:] if kinematics == "plane_strain" else 0.0
    left = full.T @ full / 2
    assert c.left_out_strain == pytest.approx(np.linalg.norm(left) / np.linalg.norm(e), rel=1e-9)
    assert c.left_out_lengths == pytest.approx(np.linalg.norm(left), rel=1e-9)
    assert c.rotation == pytest.approx(np.linalg.norm(w) / math.sqrt(2), rel=1e-9)
    share = abs((stress * (w.T @ w)).sum() / 2) / (stress * e).sum()
    whole = abs((stress * left).sum()) / (stress * e).sum()
    assert c.left_out_work == pytest.approx(max(share, whole / 2), rel=1e-9)


def test_a_ring_is_widened_and_turned():
    """The strain along the ring, u_r / r, is part of H; its rotation is that of the section."""
    domain = mesh.create_rectangle(COMM, [(1.0, 0.0), (2.0, 1.0)], (2, 2))
    u = fem.Function(fem.functionspace(domain, ("Lagrange", 1, (2,))))
    problem = dm.ContactProblem(dm.Solid(u, SOFT, kinematics="axisymmetric"), bcs=[])
    u.interpolate(lambda x: np.stack([0.2 * x[0], 0.1 * x[0]]))
    problem.solid.evaluate()
    found = find_left_out(problem)
    H = np.array([[0.2, 0, 0], [0.1, 0, 0], [0, 0, 0.2]])
    assert found.strain == pytest.approx(np.linalg.norm(H.T @ H) / 2, rel=1e-12)
    assert found.rotation == pytest.approx(0.05, rel=1e-12)
    assert found.lengths == pytest.approx(found.strain, rel=1e-12)


def test_an_eigenstrain_does_no_work():
    """A bar that is heated and clamped works by its elastic strain, not by the strain, zero."""
    shares = []
    for heated in (0.0, 0.01):
        moved = Moved(eigenstrain=heated)
        strain = heated - 0.01
        H = turn(1.0) + (strain + 1 - math.cos(math.radians(1.0))) * np.eye(2)
        shares.append(moved.move(H).certificate.left_out_work)
    # in the plane the eigenstrain acts out of it as well: compare with its own energy
    a = math.sin(math.radians(1.0)) ** 2 / 2
    lame, mu = 1000 * 0.3 / 1.3 / 0.4, 1000 / 2.6
    for share, e in zip(shares, ((-0.01, -0.01, 0.0), (-0.01, -0.01, -0.01)), strict=True):
        stress = lame * sum(e) + 2 * mu * np.array(e)
        assert share == pytest.approx(abs(a * stress[:2].sum()) / (stress @ e), rel=1e-9)


# -- told where it matters -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "law",
    [
        SOFT,
        pytest.param(STEEL, marks=pytest.mark.slow),
        dm.Orthotropic(*(9e3, 8e3, 7e3, 0.2, 0.2, 0.2, 3e3, 3e3, 3e3)),
    ],
)
def test_a_turned_square(law):
    """All of its stress is made up; with a finite strain there is none, and nothing to tell."""
    report = Moved(law).move(turn(0.5))
    c = report.certificate
    assert c.left_out_work == pytest.approx(1.0, rel=1e-3) == c.left_out_strain
    assert c.rotation == pytest.approx(math.sin(math.radians(0.5)), rel=1e-9)
    (note,) = told(report)
    assert note.startswith("the body around [0.5, 1.0]: ") and "up to 0.5 degrees" in note
    assert "100.0% of the work" in note and "finite strain" in note.why
    finite = Moved(law, kinematics=FINITE)
    report = finite.move(turn(20.0))
    assert not told(report) and finite.solid.max("von_mises") < 1e-6 * 1000.0
    report = finite.move(turn(20.0) + 1e-3 * (np.eye(2) + turn(20.0)))  # stretched, too
    c = report.certificate
    assert not told(report) and finite.solid.max("stress_norm") > 1.0
    assert c.left_out_strain == c.left_out_work == c.left_out_lengths == 0.0
    assert c.rotation == pytest.approx(1.001 * math.sin(math.radians(20.0)), rel=1e-6)


def test_two_pressed_blocks_turned_as_one():
    """The share of the work is the error of the force."""
    case, degrees = PressedBlocks(), 2.0
    sides = {tag: fem.Function(case.V) for tag in (BOTTOM, TOP)}
    bcs = [
        fem.dirichletbc(f, fem.locate_dofs_topological(case.V, 1, case.facets.find(tag)))
        for tag, f in sides.items()
    ]
    contact = case.contact()
    problem = case.problem([contact], bcs)
    pressed = np.array([0.0, -0.02])
    sides[TOP].interpolate(lambda x: np.tile(pressed[:, None], x.shape[1]))
    report = dm.newton(problem)
    problem.commit()
    assert not told(report)
    force = np.linalg.norm(contact.force)
    R = turn(degrees)
    sides[BOTTOM].interpolate(lambda x: R @ x[:2])
    sides[TOP].interpolate(lambda x: R @ x[:2] + ((R + np.eye(2)) @ pressed)[:, None])
    report = dm.newton(problem)
    wrong = np.linalg.norm(contact.force) / force - 1.0
    assert wrong > 0.02
    assert report.certificate.left_out_work == pytest.approx(wrong, rel=0.3)
    assert "and 1 more" in told(report)[0]


@pytest.mark.parametrize(("stretch", "noted"), [(0.05, False), (1.0, True)])
def test_large_plastic_strain(stretch, noted):
    report = Moved(STEEL).move(np.diag([stretch, -stretch]))
    assert bool(told(report)) == noted
    assert report.certificate.left_out_lengths == pytest.approx(stretch**2 / math.sqrt(2))


@pytest.mark.parametrize(("depth", "noted"), [(0.3, False), (2.0, True)])
def test_a_strip_that_is_bent(depth, noted):
    """By a fifth of its length: its end is to come back by 1.2 d^2 / (2 L), which it does not."""
    domain = mesh.create_rectangle(
        COMM, [(0.0, 0.0), (10.0, 0.4)], (40, 2), mesh.CellType.quadrilateral
    )
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    W, down = V.sub(1), fem.Constant(domain, -depth)
    domain.topology.create_connectivity(1, 2)
    ends = [
        mesh.locate_entities_boundary(domain, 1, lambda x, at=at: np.isclose(x[0], at))
        for at in (0.0, 10.0)
    ]
    bcs = [
        fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(V, 1, ends[0]), V),
        fem.dirichletbc(down, fem.locate_dofs_topological(W, 1, ends[1]), W),
    ]
    u = fem.Function(V)
    report = dm.newton(dm.ContactProblem(dm.Solid(u, SOFT, kinematics="plane_stress"), bcs=bcs))
    assert bool(told(report)) == noted
    back = 1.2 * depth**2 / (2 * 10.0) / 10.0  # of its length; along and across, so sqrt(2) of it
    assert report.certificate.left_out_lengths == pytest.approx(math.sqrt(2) * back, rel=0.02)


# -- and only there --------------------------------------------------------------------------------


def test_what_is_pressed_in_is_no_rotation():
    """The largest load of the paper: 7 degrees at the edge, forces right to 1.4 %."""
    case = create_case(create_mesh("paper", 0.05), PLASTIC)
    case.press(0.4)
    report = dm.newton(case.problem)
    assert not told(report)
    assert 0.2 * LARGEST_SHARE < report.certificate.left_out_work < 0.9 * LARGEST_SHARE
    assert report.certificate.left_out_lengths < 0.1 * LARGEST_SHARE


@pytest.mark.slow
def test_a_ball_in_a_perfectly_plastic_block():
    """What the small strain loses of the force is told to a factor of two: a third."""
    domain = mesh.create_rectangle(
        COMM, [(0.0, -640.0), (640.0, 0.0)], (16, 16), mesh.CellType.quadrilateral
    )
    top = np.sort(mesh.locate_entities_boundary(domain, 1, lambda x: x[1] > -1e-9))
    tags = mesh.meshtags(domain, 1, top, np.ones(len(top), dtype=np.int32))
    law = dm.VonMises.from_uniaxial(
        210e3, 0.3, yield_stress=50.0, plastic_modulus=0.0, isotropic=1.0
    )
    forces = []
    for strain in ("finite", "small"):
        V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
        foot = fem.locate_dofs_geometrical(V, lambda x: x[1] < -640.0 + 1e-9)
        radial, _ = V.sub(0).collapse()
        axis = fem.locate_dofs_geometrical((V.sub(0), radial), lambda x: x[0] < 1e-9)
        bcs = [
            fem.dirichletbc(np.zeros(2), foot, V),
            fem.dirichletbc(fem.Function(radial), axis, V.sub(0)),
        ]
        options = {"kinematics": "axisymmetric", "strain": strain, "volumetric": "reduced"}
        solid = dm.Solid(fem.Function(V), law, **options)
        ball = dm.Obstacle(tags, slave=1, shape=dm.shapes.Sphere((0.0, 500.0), 500.0))
        problem = dm.ContactProblem(solid, [ball], bcs=bcs)
        ramp = {ball.position: [(0, (0.0, 500.0)), (1, (0.0, 480.0))]}
        steps = dm.load_steps(problem, [1.0], ramp=ramp, progress=False)
        (*_, last) = steps
        forces.append(-ball.force[1])
    lost = 1.0 - forces[1] / forces[0]
    assert 0.25 < lost < 0.4
    assert 0.5 * lost < last.report.certificate.left_out_work < 2.0 * lost


def test_a_free_body_may_turn_a_little():
    """A linear rotation, which strains nothing: its stress is round-off, and no work to judge."""
    moved = Moved()
    W = np.array([[0.0, -0.02], [0.02, 0.0]])
    report = moved.move(W)
    assert not told(report) and report.certificate.left_out_work == 0.0
    assert told(moved.move(10.0 * W))


def small_no_more(report):
    """Return the notes on points where strain or rotation is not small."""
    return [note for note in report.notes if "no longer small" in note]


@pytest.mark.parametrize(("degrees", "noted"), [(2.5, False), (6.0, True)])
def test_a_turn_that_nothing_resists_is_noted(degrees, noted):
    """A linear rotation strains nothing, and 6 degrees change lengths by half a percent only."""
    a = math.radians(degrees)
    report = Moved().move(np.array([[0.0, -a], [a, 0.0]]))
    assert not told(report)
    notes = small_no_more(report)
    assert len(notes) == noted
    if noted:
        assert "rotations of up to 6.0 degrees" in notes[0]
        assert notes[0].startswith("the body around [0.5, 1.0]")
        assert "strain='finite'" in notes[0].why


def test_other_measures_have_no_small_strain():
    moved = Moved(kinematics=FINITE)
    assert not small_no_more(moved.move(turn(20.0)))
    moved = Moved(dm.NeoHooke(1000.0, 0.3), strain="finite")
    assert not small_no_more(moved.move(turn(20.0)))


@pytest.mark.parametrize(("size", "noted"), [(0.06, False), (0.25, True)])
def test_a_strain_in_a_small_part_is_noted(size, noted):
    """One node is pulled; the body as a whole feels it neither in its work nor in lengths."""
    domain = mesh.create_rectangle(
        COMM, [(0.0, 0.0), (10.0, 10.0)], (10, 10), mesh.CellType.quadrilateral
    )
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    x = V.tabulate_dof_coordinates()
    corner = np.flatnonzero(np.all(np.isclose(x[:, :2], 0.0), axis=1)).astype(np.int32)
    value = np.array([-size, 0.0])
    top = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 10.0))
    held = fem.locate_dofs_topological(V, 1, top)
    bcs = [fem.dirichletbc(np.zeros(2), held, V), fem.dirichletbc(value, corner, V)]
    problem = dm.ContactProblem(dm.Solid(u, SOFT), bcs=bcs)
    report = dm.newton(problem)
    assert (find_left_out(problem).largest > 0.05) == noted
    assert not told(report) and report.certificate.left_out_work < 0.5 * LARGEST_SHARE
    assert bool(small_no_more(report)) == noted


def test_a_body_at_rest_leaves_nothing_out():
    c = Moved().move(np.zeros((2, 2))).certificate
    assert c.left_out_strain == c.left_out_work == c.left_out_lengths == c.rotation == 0.0


def test_the_note_names_the_steepest_body_below_the_limits():
    """One stretched by .13, and one turned by .112, of whose lengths more is left out."""
    case = PressedBlocks()
    problem = case.problem()
    case.u.interpolate(lambda x: 0.112 * np.stack([-x[1], x[0]]), case.cells.find(LOWER))
    case.u.interpolate(lambda x: np.stack([0.13 * x[0], 0.0 * x[0]]), case.cells.find(UPPER))
    case.u.x.scatter_forward()
    problem.solid.evaluate()
    found = find_left_out(problem)
    assert found.felt == 0 and found.lengths == pytest.approx(0.112**2 / np.sqrt(2.0), rel=1e-6)
    assert problem.bodies.centre[found.told][1] > 0.0
    assert found.own == pytest.approx((0.13, 0.0), rel=1e-6, abs=1e-9)


def test_the_note_names_the_body_that_turns():
    """Of two that do not touch; the other one does not count."""
    case = PressedBlocks()
    top = fem.Function(case.V)
    top.interpolate(lambda x: turn(1.0) @ (x[:2] - np.array([[0.5], [9.0]])) + [[0.0], [1.0]])
    dofs = fem.locate_dofs_topological(case.V, 1, case.facets.find(TOP))
    problem = case.problem(bcs=[case.bc(BOTTOM), fem.dirichletbc(top, dofs)])
    (note,) = told(dm.newton(problem))
    centre = problem.bodies.centre[np.argmax(problem.bodies.centre[:, 1])]
    assert f"the body around [{centre[0]:.4g}" in note and "more)" not in note
