# SPDX-License-Identifier: MIT
"""Contact nodes without mass along their normals: the mass of bodies of any thickness is kept."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.interfaces.interface import FEATURE_ANGLE
from dolfinx_mortar.mortar.contact_normals import contact_normals
from dolfinx_mortar.mortar.surface import find_boundary
from tests.choice import quick
from tests.meshes import LOWER, UPPER
from tests.meshes_3d import BOTTOM_OF_UPPER, TOP_OF_LOWER, rotation, two_boxes
from tests.moving_bodies import Blocks, Rod
from tests.pressed_blocks import rejected

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.mpi
NORMAL = {"relief": "normal"}


def steps(problem, times, **options):
    """Walk to round-off, without lines."""
    return dm.time_steps(problem, times, **{"progress": False, "rtol": 1e-10} | options)


def rigid_mass(inertia, mass, body):
    """Return the sums r_a . M r_b of the rigid motions of a body."""
    motions = inertia.solid.kinematics.rigid_motions(mass.X).values()
    fields = [r * body[:, None] for r in motions]
    return np.array([[inertia.sum((a * mass.times(b)).sum()) for b in fields] for a in fields])


def boxes(cell, jitter, layers, turn=None):
    """Return a problem of two boxes in space, with relief along the normals."""
    domain, cells, facets = two_boxes(
        COMM, (3, 3, layers), (4, 3, layers), cell=cell, jitter=jitter, turn=turn, gap=0.02
    )
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    solid = dm.Solid(fem.Function(V), dm.Elastic(1000.0, 0.3))
    down = (np.eye(3) if turn is None else turn) @ [0.0, 0.0, -1.0]
    velocity = {LOWER: (0.0, 0.0, 0.0), UPPER: tuple(down)}
    inertia = dm.Inertia(solid, {1: 1.0, 2: 2.0}, cells, velocity=velocity, **NORMAL)
    contact = dm.Contact(facets, slave=BOTTOM_OF_UPPER, master=TOP_OF_LOWER)
    problem = dm.ContactProblem(solid, [contact], terms=[inertia], geometry="reference")
    return problem, inertia, contact


def check(problem, inertia):
    """Check that bodies weigh what they do, and that contact nodes have no mass along normals."""
    M, contact = inertia.mass, problem.system.can_open[: problem.n]
    assert np.array_equal(M.massless, contact)
    label = problem.bodies.label
    for body in range(problem.bodies.count):
        found, wanted = (rigid_mass(inertia, m, label == body) for m in (M, inertia.plain))
        assert found == pytest.approx(wanted, abs=1e-11 * np.abs(wanted).max())
    normals = contact_normals(problem.V, find_boundary(problem.V), contact, FEATURE_ANGLE)
    x = np.random.default_rng(COMM.rank).normal(size=M.X.shape)
    along = (M.times(x) * normals).sum(axis=1)
    assert np.abs(along).max(initial=0.0) < 1e-12 * np.abs(M.times(x)).max(initial=1.0)
    assert inertia.energy_of(x) > 0.0


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("layers", [1, 3])
def test_the_moments_of_inertia(cell, layers):
    down = {UPPER: (0.0, -1.0), LOWER: (0.0, 0.0)}
    case = Blocks((4, layers), (5, layers), cell=cell, jitter=0.4, velocity=down, **NORMAL)
    check(case.problem, case.inertia)
    (step,) = steps(case.problem, [0.01])  # the matrix has room for nodes that share no cell
    assert case.contact.force[1] > 0.0 and abs(step.report.ledger.defect) < 1e-11


@pytest.mark.parametrize(("cell", "jitter"), [("tetrahedron", 0.4), ("hexahedron", 0.0)])
def test_the_moments_of_inertia_in_space(cell, jitter):
    problem, inertia, _ = boxes(cell, jitter, 2, rotation((1.0, 2.0, 3.0), 0.7))
    check(problem, inertia)


@pytest.mark.parametrize("layers", quick([1, 2], 1))
def test_thin_bodies_keep_their_energy(layers):
    """All layers of the block have mass; with relief in all directions 3 to 7 % appear."""
    case = Blocks(
        (4, 4), (4, layers), gap=0.01, velocity={UPPER: (0.2, -1.0), LOWER: (0, 0)}, **NORMAL
    )
    for step in steps(case.problem, 2e-3 * np.arange(1, 66), rtol=1e-12):
        assert abs(step.report.ledger.defect) < 1e-10
        assert not any("energy" in note or "inertia" in note for note in step.report.notes)
    assert case.contact.force[1] == 0.0 and case.inertia.momentum()[1] > 0.8


@pytest.mark.slow
def test_a_rod_on_a_wall():
    """As with relief in all directions (tests/test_impact.py); the plateau is flatter, to .5 %."""
    rod = Rod(50, **NORMAL)
    dt = 0.5 * rod.h / rod.wave
    times, forces = dt * np.arange(1, int(1.6e-4 / dt)), []
    for step in steps(rod.problem, times):
        forces.append(rod.contact.force[1])
        assert abs(step.report.ledger.defect) < 1e-11
    touching = times[np.array(forces) > 0.0]
    assert abs(touching[0] - rod.touches) <= dt and abs(touching[-1] + dt - rod.leaves) <= dt
    held = np.array(forces)[(times > 6e-5) & (times < 1.35e-4)]
    assert held.mean() == pytest.approx(rod.force, rel=2e-4)
    assert np.abs(held / rod.force - 1.0).max() < 0.005
    assert rod.inertia.momentum()[1] / rod.mass == pytest.approx(rod.velocity, rel=5e-3)


@pytest.mark.slow
def test_two_boxes_of_one_layer_collide_in_space():
    """Turned in space, so that all components are coupled; by multigrid."""
    problem, inertia, contact = boxes("hexahedron", 0.0, 1, rotation((1.0, 2.0, 3.0), 0.7))
    momentum, moment, touched = inertia.momentum(), inertia.moment_of_momentum(), 0
    for step in steps(problem, 8e-3 * np.arange(1, 25), rtol=1e-12):
        touched += np.linalg.norm(contact.force) > 0.0
        assert inertia.momentum() == pytest.approx(momentum, abs=1e-10)
        assert inertia.moment_of_momentum() == pytest.approx(moment, abs=1e-10)
        assert abs(step.report.ledger.defect) < 1e-10
    assert touched > 5 and np.linalg.norm(contact.force) == 0.0


def test_edges_lose_mass_in_all_directions():
    """Of a block whose bottom and flanks may meet something: its lower corners."""
    case = Blocks((1, 1), (6, 6))
    X, V = case.problem.X, case.problem.V
    upper = case.problem.bodies.label == case.problem.bodies.centre[:, 1].argmax()
    low, left = np.isclose(X[:, 1], 0.0) & upper, np.isclose(X[:, 0], 0.0) & upper
    inertia = dm.Inertia(case.solid, 1.0, **NORMAL)
    normals = contact_normals(V, find_boundary(V), low | left, FEATURE_ANGLE)
    inertia.meet_along(lambda: normals)
    inertia.meet(low | left, case.problem.bodies.label)
    assert np.allclose(normals[low & ~left], [0.0, -1.0])
    assert np.allclose(normals[left & ~low], [-1.0, 0.0])
    assert not normals[low & left].any() and inertia.mass.massless[low & left].all()
    v = np.random.default_rng(COMM.rank).normal(size=X.shape)
    assert np.abs(inertia.mass.times(v)[low & left]).max(initial=0.0) < 1e-12
    found, wanted = (rigid_mass(inertia, m, upper) for m in (inertia.mass, inertia.plain))
    assert found == pytest.approx(wanted, abs=1e-11)


def test_reliefs_that_are_none():
    case = Blocks(friction=0.3, **NORMAL)
    with rejected("relief", "'all' or 'normal'"):
        dm.Inertia(case.solid, 1.0, relief="tangential")
    with rejected("relief='normal'", "friction"):
        next(steps(case.problem, [0.1]))
    finite = dm.Solid(case.u, dm.NeoHooke(1.0, 0.3), strain="finite")
    with rejected("relief", "finite strain"):
        dm.Inertia(finite, 1.0, **NORMAL)
