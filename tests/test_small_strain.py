# SPDX-License-Identifier: MIT
"""The error of the small strain: its measure, and the note where it matters."""

import dataclasses
import math

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.report.certificate import LARGEST_SHARE, find_left_out
from dolfinx_mortar.solid.kinematics import plane_strain
from tests.cases.hertz import PLASTIC, create_case, create_mesh
from tests.cases.material_point import MaterialPoint
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import PressedBlocks
from tests.cases.solid import create_displacement, create_domain, hold, plane, rectangle
from tests.cases.two_bodies import create_problem
from tests.cases.user_laws import green_lagrange

pytestmark = pytest.mark.mpi
SOFT = dm.Elastic(1000.0, 0.3)
STEEL = dm.VonMises.from_uniaxial(210e3, 0.3, yield_stress=300.0, plastic_modulus=1000.0)


FINITE = dataclasses.replace(plane_strain, name="finite", measure=green_lagrange)


class Moved:
    """A box with a prescribed displacement H x of all of its surface."""

    def __init__(self, law=SOFT, cell="quadrilateral", **options):
        u = create_displacement(create_domain(cell, 2))
        V = u.function_space
        self.prescribed = fem.Function(V)
        bcs = [hold(V, lambda x: np.full(x.shape[1], True), value=self.prescribed)]
        self.problem = create_problem(u, (), bcs, dm.Solid(u, law, **options))
        self.solid = self.problem.solid

    def move(self, H):
        d = len(H)
        self.prescribed.interpolate(lambda x: np.asarray(H) @ x[:d])
        return dm.newton(self.problem)


def turn(degrees):
    """Return R - I in the plane."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c - 1, -s], [s, c - 1]])


def told(report):
    found = [note for note in report.notes if "small strain leaves out" in note]
    return [note for note in found if "no longer small" not in note]


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
    stress = MaterialPoint(SOFT, d, kinematics).stress(full)
    left = full.T @ full / 2
    assert c.left_out_strain == pytest.approx(np.linalg.norm(left) / np.linalg.norm(e), rel=1e-9)
    assert c.left_out_lengths == pytest.approx(np.linalg.norm(left), rel=1e-9)
    assert c.rotation == pytest.approx(np.linalg.norm(w) / math.sqrt(2), rel=1e-9)
    share = abs((stress * (w.T @ w)).sum() / 2) / (stress * e).sum()
    whole = abs((stress * left).sum()) / (stress * e).sum()
    assert c.left_out_work == pytest.approx(max(share, whole / 2), rel=1e-9)


def test_a_ring_is_widened_and_turned():
    """The strain along the ring, u_r / r, is part of H; its rotation is that of the section."""
    u = create_displacement(rectangle([(1.0, 0.0), (2.0, 1.0)], (2, 2)))
    problem = create_problem(u, law=SOFT, kinematics="axisymmetric")
    u.interpolate(lambda x: np.stack([0.2 * x[0], 0.1 * x[0]]))
    problem.solid.evaluate()
    found = find_left_out(problem)
    H = np.array([[0.2, 0, 0], [0.1, 0, 0], [0, 0, 0.2]])
    assert found.strain == pytest.approx(np.linalg.norm(H.T @ H) / 2, rel=1e-12)
    assert found.own[1].max() == pytest.approx(0.05, rel=1e-12)
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


@pytest.mark.parametrize(
    "law", [SOFT, dm.Orthotropic(*(9e3, 8e3, 7e3, 0.2, 0.2, 0.2, 3e3, 3e3, 3e3))]
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
    assert not small_no_more(report)
    report = finite.move(turn(20.0) + 1e-3 * (np.eye(2) + turn(20.0)))  # stretched, too
    c = report.certificate
    assert not told(report) and finite.solid.max("stress_norm") > 1.0
    assert c.left_out_strain == c.left_out_work == c.left_out_lengths == 0.0
    assert c.rotation == pytest.approx(1.001 * math.sin(math.radians(20.0)), rel=1e-6)


@pytest.mark.parametrize(("stretch", "noted"), [(0.05, False), (1.0, True)])
def test_large_plastic_strain(stretch, noted):
    report = Moved(STEEL).move(np.diag([stretch, -stretch]))
    assert bool(told(report)) == noted
    assert report.certificate.left_out_lengths == pytest.approx(stretch**2 / math.sqrt(2))


def test_what_is_pressed_in_is_no_rotation():
    """The largest load of the paper: 7 degrees at the edge, forces right to 1.4 %."""
    case = create_case(create_mesh("paper", 0.05), PLASTIC)
    case.press(0.4)
    report = dm.newton(case.problem)
    assert not told(report)
    assert 0.2 * LARGEST_SHARE < report.certificate.left_out_work < 0.9 * LARGEST_SHARE
    assert report.certificate.left_out_lengths < 0.1 * LARGEST_SHARE


def small_no_more(report):
    return [note for note in report.notes if "no longer small" in note]


@pytest.mark.parametrize(
    ("degrees", "noted", "work"), [(2.5, False, False), (6.0, True, False), (11.5, False, True)]
)
def test_a_turn_that_nothing_resists_is_noted(degrees, noted, work):
    """A linear rotation strains nothing, and 6 degrees change lengths by half a percent only."""
    a = math.radians(degrees)
    report = Moved().move(np.array([[0.0, -a], [a, 0.0]]))
    assert bool(told(report)) == work and report.certificate.left_out_work == 0.0
    notes = small_no_more(report)
    assert len(notes) == noted
    for note in notes:
        assert f"rotations of up to {degrees} degrees" in note and "strain='finite'" in note.why
        assert note.startswith("the body around [0.5, 1.0]")


@pytest.mark.parametrize(("size", "noted"), [(0.06, False), (0.25, True)])
def test_a_strain_in_a_small_part_is_noted(size, noted):
    """One node is pulled; the body as a whole feels it neither in its work nor in lengths."""
    u = create_displacement(rectangle([(0.0, 0.0), (10.0, 10.0)], (10, 10)))
    V = u.function_space
    x = V.tabulate_dof_coordinates()
    corner = np.flatnonzero(np.all(np.isclose(x[:, :2], 0.0), axis=1)).astype(np.int32)
    bcs = [hold(V, plane(1, 10.0)), fem.dirichletbc(np.array([-size, 0.0]), corner, V)]
    problem = create_problem(u, (), bcs, SOFT)
    report = dm.newton(problem)
    assert (find_left_out(problem).own[0].max() > 0.05) == noted
    assert not told(report) and report.certificate.left_out_work < 0.5 * LARGEST_SHARE
    assert bool(small_no_more(report)) == noted


def test_a_body_at_rest_leaves_nothing_out():
    c = Moved().move(np.zeros((2, 2))).certificate
    assert c.left_out_strain == c.left_out_work == c.left_out_lengths == c.rotation == 0.0


def test_the_note_names_the_body_that_turns():
    """Of two that do not touch; the other one does not count."""
    case = PressedBlocks()
    top = fem.Function(case.V)
    top.interpolate(lambda x: turn(1.0) @ (x[:2] - np.array([[0.5], [9.0]])) + [[0.0], [1.0]])
    (note,) = told(dm.newton(case.problem(bcs=[case.bc(BOTTOM), case.bc(TOP, top)])))
    assert note.startswith("the body around [0.5, 0.5]: ")
