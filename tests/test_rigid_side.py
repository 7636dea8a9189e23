# SPDX-License-Identifier: MIT
"""Sides that move as rigid bodies: bent, twisted and turned, by motions and by forces."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.interfaces.rigid_side import Plate
from tests.cases.meshes import TOP
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.solid import hold, plane
from tests.tool_case import BASE, Box
from tests.tool_case import TOP as END

COMM = MPI.COMM_WORLD
LENGTH, HEIGHT, E = 4.0, 1.0, 1000.0
EI = E * HEIGHT**3 / 12.0
HOOKE, RUBBER = dm.Elastic(E, 0.0), dm.NeoHooke(E, 0.0)


class Bar(Box):
    """A bar along x from x = 0, in the plane, or along z; its end is a rigid side."""

    def __init__(
        self,
        law=HOOKE,
        n=(8, 2),
        *,
        low=(0.0, -HEIGHT / 2),
        high=(LENGTH, HEIGHT / 2),
        degree=2,
        strain="small",
        held=True,
        comm=COMM,
        move=None,
        **options,
    ):
        d = len(n)
        axis = 0 if d == 2 else 2
        cell = ("quadrilateral", "hexahedron")[d - 2]
        super().__init__(cell, n, low, high, axis=axis, degree=degree, comm=comm, move=move)
        end = high[axis] * np.eye(d)[axis]
        self.side = dm.RigidSide(self.facets, END, reference=end, **options)
        bcs = [self.hold(BASE)] if held else []
        self.mechanics = self.problem([self.side], law, bcs=bcs, strain=strain)

    def solve(self, **options):
        """Return the report of a step."""
        return dm.newton(self.mechanics, **options)

    def turned(self, R):
        """Return the displacement of a rotation about the middle of the end."""
        X = self.V.tabulate_dof_coordinates()[:, :2] - [LENGTH, 0.0]
        return (X @ (np.asarray(R) - np.eye(2)).T).ravel()


def moment(value):
    """Return the load of a moment alone."""
    return {"x": 0.0, "y": 0.0, "moment": value}


def is_quadratic(values):
    """Tell whether the last three values fall with an order of 1.5."""
    a, b, c = np.log(values[-3:])
    return c < 1.5 * b < 1.5**2 * a < 0.0


@pytest.mark.mpi
def test_bent_by_a_moment():
    """Pure bending without Poisson's ratio is in the space: M L / EI and M L^2 / 2 EI."""
    M = 1.5
    case, other = Bar(load=moment(M)), Bar()
    report = case.solve()
    assert case.side.travel == pytest.approx([0.0, M * LENGTH**2 / 2 / EI, M * LENGTH / EI])
    assert case.side.force == pytest.approx([0.0, 0.0], abs=1e-9)
    assert case.side.reference_moment == pytest.approx([0.0, 0.0, M])
    support = dm.reaction(case.mechanics, BASE, facet_tags=case.facets)
    assert support.moment == pytest.approx(-M) and report.newton_iterations == 1
    other.side.rotation.value = case.side.travel[2]  # prescribed, it has the same moment
    other.side.position.value[:] += case.side.travel[:2]
    other.solve()
    assert other.side.reference_moment == pytest.approx([0.0, 0.0, M])
    assert other.u.x.array == pytest.approx(case.u.x.array, abs=1e-12)


@pytest.mark.mpi
def test_twisted():
    """A round bar, Saint-Venant: G pi R^4 / 2 times the angle over the length, with order 2."""

    def move(x):
        root = [np.sqrt(1.0 - x[:, k] ** 2 / 2.0) for k in (1, 0)]
        return np.column_stack([x[:, 0] * root[0], x[:, 1] * root[1], x[:, 2]])

    twist, errors = 0.01, []
    expected = 200.0 / 2.6 * np.pi / 2.0 * twist / 2.0
    for n in (4, 8):
        free = dict.fromkeys(("x", "y", "z", "moment x", "moment y"), 0.0)
        size = {"low": (-1.0, -1.0, 0.0), "high": (1.0, 1.0, 2.0), "degree": 1, "move": move}
        case = Bar(dm.Elastic(200.0, 0.3), (n, n, 2), load=free, **size)
        case.side.rotation.value[2] = twist
        case.solve()
        errors.append(1.0 - case.side.reference_moment[2] / expected)
        assert np.abs(case.side.reference_moment[:2]).max() < 1e-8 * expected
        assert np.abs(case.side.force).max() < 1e-8 * expected
    assert 3.0 < errors[0] / errors[1] < 5.0 and errors[1] < 0.04


def test_a_round_rod_is_pulled():
    """Rings: the force on all of the rod, F L / (E pi R^2), nodes of the axis included."""
    rod = Box("triangle", (3, 4), high=(0.5, LENGTH))
    side = dm.RigidSide(rod.facets, END, reference=(0.0, LENGTH), load={"y": 3.0})
    options = {"bcs": [hold(rod.V, plane(0), 0), rod.hold(BASE, 1)], "kinematics": "axisymmetric"}
    dm.newton(rod.problem([side], HOOKE, **options))
    assert side.travel[1] == pytest.approx(3.0 * LENGTH / (E * np.pi * 0.25))
    assert side.force[1] == pytest.approx(3.0)
    wrong = dm.RigidSide(rod.facets, END, reference=(0.0, LENGTH), load={"x": 3.0})
    with rejected("load", "axis only"):
        dm.newton(rod.problem([wrong], HOOKE, **options))


def test_turned_without_strain():
    """Every point is where the rotation takes it, by a right angle; linear at small strain."""
    case = Bar(RUBBER, n=(4, 2), strain="finite", held=False)
    ramp = {case.side.rotation: [(0.0, 0.0), (1.0, np.pi / 2)]}
    levels = np.linspace(0.0, 1.0, 7)[1:]
    for step in dm.load_steps(case.mechanics, levels, ramp=ramp, rtol=1e-10):
        assert step.report.converged
    small = Bar(held=False)
    small.side.rotation.value = 0.3
    small.solve()
    for one, R in ((case, [[0, -1], [1, 0]]), (small, [[1, -0.3], [0.3, 1]])):
        assert one.u.x.array == pytest.approx(one.turned(R), abs=1e-8)
        assert np.abs([*one.side.force, one.side.reference_moment[2]]).max() < 1e-8


@pytest.mark.serial
def test_newton_is_quadratic_with_forces_on_a_turned_side(monkeypatch):
    """Arms turn with the side: without that it takes more iterations, to the same end."""
    counts, ends, motions, loads = [], [], Plate.motions, (100.0, 50.0, 40.0)
    for exact in (True, False):
        if not exact:
            monkeypatch.setattr(Plate, "motions", lambda p, x, X, q: motions(p, x, X, 0.0 * q))
        given = dict(zip(("x", "y", "moment"), loads, strict=True))
        case = Bar(RUBBER, strain="finite", load=given)
        report = case.solve(rtol=1e-10)
        counts.append(report.newton_iterations)
        ends.append(case.side.travel)
        assert case.side.force == pytest.approx(loads[:2], abs=1e-7)
        assert case.side.reference_moment[2] == pytest.approx(loads[2])
        assert not exact or is_quadratic([it.force_residual for it in report.iterations])
    assert ends[0] == pytest.approx(ends[1], rel=1e-7, abs=1e-9) and np.abs(ends[0][2]) > 0.9
    assert counts[0] + 2 < counts[1]


def test_a_strip_is_bent_by_a_right_angle_in_one_step():
    """Elastica: the angle is M L / E'I, the end at (sin a, 1 - cos a) L / a."""
    length, height, angle = 20.0, 0.5, np.pi / 2
    M = E / (1.0 - 0.3**2) * height**3 / 12.0 * angle / length
    size = {"low": (0.0, -height / 2), "high": (length, height / 2)}
    case = Bar(dm.Elastic(E, 0.3), (20, 1), strain="finite", load=moment(M), **size)
    assert not [it for it in case.solve().iterations if it.shift]
    end = np.array([np.sin(angle) - angle, 1.0 - np.cos(angle)]) * length / angle
    assert case.side.travel == pytest.approx([*end, angle], rel=1e-2)


def with_a_plate(geometry, rigid):
    """Return blocks that a plate, or supports in its place, press together with friction."""
    case = PressedBlocks(jitter=0.2)
    case.top.value[:] = 0.0
    contact = dm.Contact(case.facets, slave=3, master=4, friction=0.2)
    plate = dm.RigidSide(case.facets, TOP, reference=(0.5, 2.0))
    bcs = case.bcs()[: 1 if rigid else 2]
    interfaces = [plate, contact][0 if rigid else 1 :]
    problem = case.problem(interfaces, bcs, dm.Elastic(E, 0.3), geometry=geometry)
    return case, plate, contact, problem


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_prescribed_as_by_supports(geometry):
    """Blocks pressed together and along each other with friction: the same as Dirichlet data."""
    found = []
    for rigid in (False, True):
        case, plate, contact, problem = with_a_plate(geometry, rigid)
        for way in ((0.0, -0.1), (0.05, -0.12)):
            plate.position.value[:] = 0.5 + way[0], 2.0 + way[1]
            case.top.value[:] = way
            dm.newton(problem, rtol=1e-10)
            problem.commit()
            found.append([*contact.force, *contact.moment, problem.solid.max("von_mises")])
    assert np.array(found[2:]) == pytest.approx(np.array(found[:2]), rel=1e-8, abs=1e-8)
    assert np.abs(plate.force) == pytest.approx(np.abs(contact.force), rel=1e-8)


# -- bad input


def sides(tag=END, count=1, **options):
    """Make a problem of sides of a bar, whose other end is held."""
    case = Bar()
    given = {"reference": (0.0, 0.0)} | options
    found = [dm.RigidSide(case.facets, tag, **given) for _ in range(count)]
    held = [case.hold(END)] if not options and count == 1 else []
    dm.newton(case.problem(found, HOOKE, bcs=held))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"reference": (0.0,)}, ("reference", "2 finite")),
        ({"load": {"z": 1.0}}, ("load", "'moment'")),
        ({"tag": 77}, ("77", "marks no facet")),
        ({}, (f"RigidSide({END})", "Dirichlet conditions hold 5 of its nodes")),
        ({"count": 2}, (f"RigidSide({END})", "an earlier interface has 5 of its nodes")),
    ],
)
def test_what_is_no_rigid_side(options, words):
    with rejected(*words):
        sides(**options)


@pytest.mark.parametrize("load", [{"x": 1.0}, {"x": 0.0, "y": 1.0, "moment": 0.0}])
def test_what_nothing_resists(load):
    """A bar that only the plate holds, which is free along one motion or along all."""
    case = Bar(held=False, load=load)
    words = ("nothing resists the load", f"RigidSide({END})", "hold the body")
    with rejected(*words, error=dm.NewtonNotConverged):
        case.solve()
    assert not case.side.travel.any() and not case.u.x.array.any()
