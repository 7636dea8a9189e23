# SPDX-License-Identifier: MIT
"""Sides that move as rigid bodies: bent, twisted and turned, by motions and by forces."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem, mesh
from dolfinx_mortar.interfaces.rigid_side import Plate
from tests.cases.meshes import BOTTOM, TOP
from tests.cases.pressed_blocks import PressedBlocks, rejected

COMM = MPI.COMM_WORLD
FIXED, END = 1, 2
LENGTH, HEIGHT, E = 4.0, 1.0, 1000.0
EI = E * HEIGHT**3 / 12.0


def tagged(domain, length):
    """Return tags of both ends of a bar along the last axis in space, the first in a plane."""
    axis, fdim = (2, 2) if domain.topology.dim == 3 else (0, 1)
    facets, values = [], []
    for tag, x0 in ((FIXED, 0.0), (END, length)):
        found = mesh.locate_entities_boundary(
            domain, fdim, lambda x, x0=x0: np.isclose(x[axis], x0)
        )
        facets.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    order = np.argsort(np.concatenate(facets))
    return mesh.meshtags(domain, fdim, np.concatenate(facets)[order], np.concatenate(values)[order])


class Bar:
    """A bar along x from x = 0, the end of which is a rigid side."""

    def __init__(self, law=None, n=(8, 2), strain="small", held=True, comm=COMM, **options):
        """Create mesh, side and problem; the other end is clamped."""
        corners = [[0.0, -HEIGHT / 2], [LENGTH, HEIGHT / 2]]
        domain = mesh.create_rectangle(comm, corners, n, mesh.CellType.quadrilateral)
        tags = tagged(domain, LENGTH)
        self.V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
        self.u = fem.Function(self.V)
        at = fem.locate_dofs_topological(self.V, 1, tags.find(FIXED))
        bcs = [fem.dirichletbc(np.zeros(2), at, self.V)] if held else []
        self.tags = tags
        self.side = dm.RigidSide(tags, END, reference=(LENGTH, 0.0), **options)
        solid = dm.Solid(self.u, law or dm.Elastic(E, 0.0), strain=strain)
        self.problem = dm.ContactProblem(solid, [self.side], bcs=bcs)


@pytest.mark.mpi
def test_bent_by_a_moment():
    """Pure bending without Poisson's ratio is in the space: M L / EI and M L^2 / 2 EI."""
    M = 1.5
    case = Bar(load={"x": 0.0, "y": 0.0, "moment": M})
    report = dm.newton(case.problem)
    assert case.side.travel == pytest.approx([0.0, M * LENGTH**2 / 2 / EI, M * LENGTH / EI])
    assert case.side.force == pytest.approx([0.0, 0.0], abs=1e-9)
    assert case.side.reference_moment == pytest.approx([0.0, 0.0, M])
    support = dm.reaction(case.problem, FIXED, facet_tags=case.tags)
    assert support.moment == pytest.approx(-M) and report.newton_iterations == 1
    # the same motion prescribed has the same moment
    other = Bar()
    other.side.rotation.value = case.side.travel[2]
    other.side.position.value[:] += case.side.travel[:2]
    dm.newton(other.problem)
    assert other.side.reference_moment == pytest.approx([0.0, 0.0, M])
    assert other.u.x.array == pytest.approx(case.u.x.array, abs=1e-12)


@pytest.mark.mpi
def test_some_motions_prescribed():
    """A beam with a guided end: 12 EI u / L^3 but for shear, in balance with the support."""
    case = Bar(load={"y": -2.0})  # x and the rotation stay
    dm.newton(case.problem)
    side = case.side
    assert side.force[1] == pytest.approx(-2.0) and side.travel[[0, 2]].tolist() == [0.0, 0.0]
    shear = LENGTH / (5.0 / 6.0 * E / 2.0 * HEIGHT)
    assert side.travel[1] == pytest.approx(-2.0 * (LENGTH**3 / (12.0 * EI) + shear), rel=0.03)
    assert side.reference_moment[2] == pytest.approx(2.0 * LENGTH / 2.0, rel=1e-6)
    support = dm.reaction(case.problem, FIXED, facet_tags=case.tags)
    assert support.force + side.force == pytest.approx([0.0, 0.0], abs=1e-8)


def round_bar(n, comm=COMM):
    """Return a bar along z with a round section of radius 1."""
    domain = mesh.create_box(
        comm, [[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]], [n, n, 2], mesh.CellType.hexahedron
    )
    x, y = domain.geometry.x[:, 0].copy(), domain.geometry.x[:, 1].copy()
    domain.geometry.x[:, 0] = x * np.sqrt(1.0 - y**2 / 2.0)
    domain.geometry.x[:, 1] = y * np.sqrt(1.0 - x**2 / 2.0)
    return domain


@pytest.mark.mpi
def test_twisted():
    """A round bar, Saint-Venant: G pi R^4 / 2 times the angle over the length, with order 2."""
    twist, errors = 0.01, []
    for n in (4, 8):
        domain = round_bar(n)
        tags = tagged(domain, 2.0)
        V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
        u = fem.Function(V)
        free = dict.fromkeys(("x", "y", "z", "moment x", "moment y"), 0.0)
        side = dm.RigidSide(tags, END, reference=(0.0, 0.0, 2.0), load=free)
        at = fem.locate_dofs_topological(V, 2, tags.find(FIXED))
        bcs = [fem.dirichletbc(np.zeros(3), at, V)]
        problem = dm.ContactProblem(dm.Solid(u, dm.Elastic(200.0, 0.3)), [side], bcs=bcs)
        side.rotation.value[2] = twist
        dm.newton(problem)
        moment = 200.0 / 2.6 * np.pi / 2.0 * twist / 2.0
        errors.append(1.0 - side.reference_moment[2] / moment)
        assert np.abs(side.reference_moment[:2]).max() < 1e-8 * moment
        assert np.abs(side.force).max() < 1e-8 * moment
    assert 3.0 < errors[0] / errors[1] < 5.0 and errors[1] < 0.04


def test_a_round_rod_is_pulled():
    """Rings: the force on all of the rod, F L / (E pi R^2), nodes of the axis included."""
    domain = mesh.create_rectangle(COMM, [[0.0, 0.0], [0.5, LENGTH]], (3, 4))
    end = np.sort(mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], LENGTH)))
    tags = mesh.meshtags(domain, 1, end, np.full(len(end), END, dtype=np.int32))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    side = dm.RigidSide(tags, END, reference=(0.0, LENGTH), load={"y": 3.0})
    bcs = [
        fem.dirichletbc(
            0.0, fem.locate_dofs_geometrical((V.sub(i), V.sub(i).collapse()[0]), at)[0], V.sub(i)
        )
        for i, at in ((0, lambda x: np.isclose(x[0], 0.0)), (1, lambda x: np.isclose(x[1], 0.0)))
    ]
    solid = dm.Solid(fem.Function(V), dm.Elastic(E, 0.0), kinematics="axisymmetric")
    dm.newton(dm.ContactProblem(solid, [side], bcs=bcs))
    assert side.travel[1] == pytest.approx(3.0 * LENGTH / (E * np.pi * 0.25))
    assert side.force[1] == pytest.approx(3.0)
    wrong = dm.RigidSide(tags, END, reference=(0.0, LENGTH), load={"x": 3.0})
    with rejected("load", "axis only"):
        dm.newton(dm.ContactProblem(solid, [wrong], bcs=bcs))


RUBBER = dm.NeoHooke(E, 0.0)


def test_turned_by_a_right_angle():
    """Exact: nothing is strained, and every point is where the rotation takes it."""
    case = Bar(RUBBER, n=(4, 2), strain="finite", held=False)
    ramp = {case.side.rotation: [(0.0, 0.0), (1.0, np.pi / 2)]}
    for step in dm.load_steps(case.problem, np.linspace(0.0, 1.0, 7)[1:], ramp=ramp, rtol=1e-10):
        assert step.report.converged
    assert np.abs(case.side.force).max() < 1e-8 and np.abs(case.side.reference_moment[2]) < 1e-8
    X = case.V.tabulate_dof_coordinates()[:, :2] - [LENGTH, 0.0]
    there = np.stack([-X[:, 1], X[:, 0]], axis=1)
    assert case.u.x.array.reshape(-1, 2) == pytest.approx(there - X, abs=1e-8)
    small = Bar(held=False)
    small.side.rotation.value = 0.3  # linear in the angle where strains are small
    dm.newton(small.problem)
    X = small.V.tabulate_dof_coordinates()[:, :2] - [LENGTH, 0.0]
    there = 0.3 * np.stack([-X[:, 1], X[:, 0]], axis=1)
    assert small.u.x.array.reshape(-1, 2) == pytest.approx(there, abs=1e-10)
    assert np.abs(small.side.force).max() < 1e-8


@pytest.mark.serial
@pytest.mark.parametrize("loads", [(100.0, 50.0, 40.0), (0.0, 0.0, 40.0)])
def test_newton_is_quadratic_with_forces_on_a_turned_side(loads, monkeypatch):
    """Arms turn with the side: without that it takes more iterations, to the same end."""
    counts, ends, motions = [], [], Plate.motions
    for exact in (True, False):
        if not exact:
            monkeypatch.setattr(Plate, "motions", lambda p, x, X, q: motions(p, x, X, 0.0 * q))
        given = dict(zip(("x", "y", "moment"), loads, strict=True))
        case = Bar(RUBBER, strain="finite", load=given)
        report = dm.newton(case.problem, rtol=1e-10)
        counts.append(report.newton_iterations)
        ends.append(case.side.travel)
        assert case.side.force == pytest.approx(loads[:2], abs=1e-7)
        assert case.side.reference_moment[2] == pytest.approx(loads[2])
        if exact:
            last = [iteration.force_residual for iteration in report.iterations[-3:]]
            assert np.log(last[2]) < 1.5 * np.log(last[1]) < 1.5**2 * np.log(last[0]) < 0.0
    assert ends[0] == pytest.approx(ends[1], rel=1e-7, abs=1e-9) and np.abs(ends[0][2]) > 0.9
    assert counts[0] + 2 < counts[1]


@pytest.mark.parametrize("law", [dm.NeoHooke(E, 0.3), dm.Elastic(E, 0.3)])
def test_a_strip_is_bent_by_a_right_angle_in_one_step(law):
    """Elastica: the angle is M L / E'I, the end at (sin a, 1 - cos a) L / a.

    A whole Newton step would stretch the strip by half the square of its angle, so that the search
    along the way of the side, which turns as a rigid body, has to shorten it.
    """
    length, height, angle = 20.0, 0.5, np.pi / 2
    corners = [[0.0, -height / 2], [length, height / 2]]
    domain = mesh.create_rectangle(COMM, corners, (20, 1), mesh.CellType.quadrilateral)
    tags = tagged(domain, length)
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    moment = E / (1.0 - 0.3**2) * height**3 / 12.0 * angle / length
    load = {"x": 0.0, "y": 0.0, "moment": moment}
    side = dm.RigidSide(tags, END, reference=(length, 0.0), load=load)
    at = fem.locate_dofs_topological(V, 1, tags.find(FIXED))
    solid = dm.Solid(fem.Function(V), law, strain="finite")
    problem = dm.ContactProblem(solid, [side], bcs=[fem.dirichletbc(np.zeros(2), at, V)])
    report = dm.newton(problem)
    assert not [it for it in report.iterations if it.shift]
    end = np.array([np.sin(angle) - angle, 1.0 - np.cos(angle)]) * length / angle
    assert side.travel == pytest.approx([*end, angle], rel=1e-2)


@pytest.mark.parametrize("law", [dm.Elastic(E, 0.0), RUBBER])
def test_unloading(law):
    """Without a load the bar is straight again, and the forces at the start are the scale."""
    moment = fem.Constant(Bar().V.mesh, 0.0)
    strain = "small" if isinstance(law, dm.Elastic) else "finite"
    case = Bar(law, strain=strain, load={"x": 0.0, "y": 0.0, "moment": moment})
    for value in (1.5, 0.0, 0.0):
        moment.value = value
        assert dm.newton(case.problem).newton_iterations <= 4
        case.problem.commit()
        assert case.side.reference_moment[2] == pytest.approx(value, abs=1e-5)
    assert np.abs(case.side.travel).max() < 1e-6


@pytest.mark.serial
@pytest.mark.slow
def test_bent_and_twisted_at_once_in_space():
    """Rotation vectors of two axes: Newton's rate, and moments about the turned point."""
    corners = [[-0.5, -0.5, 0.0], [0.5, 0.5, 4.0]]
    domain = mesh.create_box(COMM, corners, (2, 2, 6), mesh.CellType.hexahedron)
    tags = tagged(domain, 4.0)
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    names = ("x", "y", "z", "moment x", "moment y", "moment z")
    load = dict(zip(names, (0.0, 0.0, 0.0, 3.0, 0.0, 5.0), strict=True))
    side = dm.RigidSide(tags, END, reference=(0.0, 0.0, 4.0), load=load)
    at = fem.locate_dofs_topological(V, 2, tags.find(FIXED))
    solid = dm.Solid(fem.Function(V), dm.NeoHooke(E, 0.3), strain="finite")
    problem = dm.ContactProblem(solid, [side], bcs=[fem.dirichletbc(np.zeros(3), at, V)])
    report = dm.newton(problem, rtol=1e-10)
    assert side.reference_moment == pytest.approx([3.0, 0.0, 5.0], abs=1e-8)
    assert side.force == pytest.approx(np.zeros(3), abs=1e-8) and side.travel[5] > 0.3
    last = [iteration.increment for iteration in report.iterations[-3:]]
    assert np.log(last[2]) < 1.5 * np.log(last[1]) < 1.5**2 * np.log(last[0]) < 0.0


@pytest.mark.mpi
def test_on_any_ranks():
    """Motions found at finite strain, the same as on one rank to 1e-10."""
    loads = {"y": 5.0, "moment": 10.0}
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        case = Bar(RUBBER, n=(4, 2), strain="finite", comm=comm, load=loads)
        dm.newton(case.problem, rtol=1e-10)
        found.append(case.side.travel)
    assert found[0] == pytest.approx(found[1], rel=1e-9, abs=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("tilted", [False, True])
def test_a_plate_presses_blocks_together(tilted):
    """Contact carries what is on the plate, which may tilt: a force off the middle tilts it."""
    case = PressedBlocks(jitter=0.2)
    load = {"y": -10.0, "moment": -0.5} if tilted else {"y": -10.0}
    plate = dm.RigidSide(case.facets, TOP, reference=(0.5, 2.0), load=load)
    contact = dm.Contact(case.facets, slave=3, master=4, friction=0.2)
    problem = dm.ContactProblem(
        dm.Solid(case.u, dm.Elastic(E, 0.3)),
        [plate, contact],
        bcs=[case.bc(BOTTOM, fem.Constant(case.mesh, (0.0, 0.0)))],
    )
    dm.newton(problem, rtol=1e-10)
    assert plate.force[1] == pytest.approx(-10.0, rel=1e-8)
    assert np.abs(contact.force[1]) == pytest.approx(10.0, rel=1e-7)
    assert dm.reaction(problem, BOTTOM, facet_tags=case.facets).force[1] == pytest.approx(10.0)
    assert (plate.travel[2] < -1e-4) == tilted and plate.travel[1] < 0.0


@pytest.mark.mpi
@pytest.mark.parametrize("geometry", ["updated", "reference"])
def test_prescribed_as_by_supports(geometry):
    """Blocks pressed together and along each other with friction: the same as Dirichlet data."""
    found = []
    for rigid in (False, True):
        case = PressedBlocks(jitter=0.2)
        contact = dm.Contact(case.facets, slave=3, master=4, friction=0.2)
        bcs = [case.bc(BOTTOM, fem.Constant(case.mesh, (0.0, 0.0)))]
        plate = dm.RigidSide(case.facets, TOP, reference=(0.5, 2.0))
        top = fem.Constant(case.mesh, (0.0, 0.0))
        bcs += [] if rigid else [case.bc(TOP, top)]
        solid = dm.Solid(case.u, dm.Elastic(E, 0.3))
        interfaces = [plate, contact] if rigid else [contact]
        problem = dm.ContactProblem(solid, interfaces, bcs=bcs, geometry=geometry)
        for way in ((0.0, -0.1), (0.05, -0.12)):
            plate.position.value[:] = 0.5 + way[0], 2.0 + way[1]
            top.value[:] = way
            dm.newton(problem, rtol=1e-10)
            problem.commit()
            found.append([*contact.force, *contact.moment, problem.solid.max("von_mises")])
    assert np.array(found[2:]) == pytest.approx(np.array(found[:2]), rel=1e-8, abs=1e-8)
    assert np.abs(plate.force) == pytest.approx(np.abs(contact.force), rel=1e-8)


def test_a_walk_goes_on_from_a_checkpoint(tmp_path):
    """Plastic bending and back, half of it from a file, to the last digits."""
    path = COMM.bcast(tmp_path / "state.h5")
    law, levels = dm.VonMises(E, 0.3, 5.0, 50.0), [0.5, 1.0, 2.0]

    def walk(levels, restore=False):
        case = Bar(law)
        moment = fem.Constant(case.V.mesh, 0.0)
        case.side.load = {"x": 0.0, "y": 0.0, "moment": moment}
        if restore:
            case.problem.restore(path)
        ramp = {moment: [(0.0, 0.0), (1.0, 1.3), (2.0, 0.0)]}
        found = []
        for step in dm.load_steps(case.problem, levels, ramp=ramp, progress=False):
            found.append(case.side.travel)
            if len(levels) > 1 and step.time == 1.0:
                case.problem.save(path)
        return found

    whole = walk(levels)
    assert abs(whole[-1][2]) > 1e-4  # what is plastic remains
    assert walk(levels[2:], restore=True)[0] == pytest.approx(whole[-1], rel=1e-9, abs=1e-12)


# -- bad input -----------------------------------------------------------------------------------


def test_what_is_no_rigid_side():
    case = Bar()
    for options, words in (
        ({"reference": (0.0,)}, ("reference", "2 finite")),
        ({"reference": (0.0, 0.0), "load": {"z": 1.0}}, ("load", "'moment'")),
        ({"reference": (0.0, 0.0), "load": {"x": np.nan}}, ("load['x'] is nan", "finite number")),
    ):
        with rejected(*words):
            dm.RigidSide(case.tags, END, **options)
    solid = dm.Solid(case.u, dm.Elastic(E, 0.0))
    with rejected("77", "marks no facet"):
        dm.ContactProblem(solid, [dm.RigidSide(case.tags, 77, reference=(0.0, 0.0))])
    at = fem.locate_dofs_topological(case.V, 1, case.tags.find(END))
    bcs = [fem.dirichletbc(np.zeros(2), at, case.V)]
    with rejected("RigidSide(2)", "Dirichlet conditions hold 5 of its nodes"):
        dm.ContactProblem(solid, [dm.RigidSide(case.tags, END, reference=(0.0, 0.0))], bcs=bcs)
    twice = [dm.RigidSide(case.tags, END, reference=(0.0, 0.0)) for _ in range(2)]
    with rejected("RigidSide(2)", "an earlier interface has 5 of its nodes"):
        dm.newton(dm.ContactProblem(solid, twice))


def test_what_nothing_resists():
    """A bar that only the plate holds, which is free along one motion or along all."""
    for load in ({"x": 1.0}, {"x": 0.0, "y": 1.0, "moment": 0.0}):
        case = Bar(held=False, load=load)
        words = ("nothing resists the load", "RigidSide(2)", "hold the body")
        with rejected(*words, error=dm.NewtonNotConverged):
            dm.newton(case.problem)
        assert not case.side.travel.any() and not case.u.x.array.any()
