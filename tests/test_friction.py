# SPDX-License-Identifier: MIT
"""A block pushed along another one: it sticks, slides at mu N, and does so from anywhere."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.friction import COMM, create
from tests.choice import crosswise

EXACT = 1e-10
MU = 0.3
PRESS, PUSH = 0.01, 0.05  # of the top, in parts of the block; it slides from 0.02 on
CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}
ALL_CELLS = [
    *((cell, degree) for cell in CELLS[2] for degree in (1, 2)),
    *((cell, 1) for cell in CELLS[3]),
    *(pytest.param(cell, 2, marks=pytest.mark.slow) for cell in CELLS[3]),
]
ALIKE = {  # two blocks that are as wide as each other
    2: {"x_lower": (0.0, 1.0), "n_lower": (5, 2)},
    3: {"lower": (0.0, 1.0, 0.0, 1.0)},
}


def dimension(cell):
    """Return the number of axes."""
    return 2 if cell in CELLS[2] else 3


def pressed(cell="triangle", **options):
    """Return a block that has been pressed on."""
    case = create(cell, **{"friction": MU} | options)
    case.solve(*np.zeros(dimension(cell) - 1), -PRESS)
    return case


def pushed(cell="triangle", way=None, **options):
    """Return a block that has been pressed and pushed, by default until it slides."""
    case = pressed(cell, **options)
    way = (PUSH, 0.02)[: dimension(cell) - 1] if way is None else way
    report = case.solve(*way, -PRESS)
    return case, report


def largest(array):
    """Return the largest absolute value."""
    return float(np.abs(array).max(initial=0.0))


@pytest.mark.parametrize(("cell", "degree"), ALL_CELLS)
def test_it_slides_at_the_limit(cell, degree):
    """|tau| = mu p at each closed node, against the slip, with any cell and degree."""
    case, _ = pushed(cell, degree=degree)
    nodes = case.closed()
    assert len(nodes["status"]) > 1 and (nodes["status"] == 2.0).all()
    tau, p, slip = (nodes[name] for name in ("traction", "pressure", "step_slip"))
    assert largest(np.linalg.norm(tau, axis=1) - MU * p) < EXACT * p.max()
    assert largest(tau[:, -1]) < EXACT * p.max()
    way = np.linalg.norm(slip, axis=1)
    assert (way > 0.2 * PUSH).all()
    against = slip / way[:, None]
    assert largest(tau + MU * p[:, None] * against) < EXACT * p.max()
    assert largest(nodes["slip"] - way) < 0.2 * PUSH  # some have slipped as it was pressed


@pytest.mark.parametrize("cell", CELLS[2])
@pytest.mark.parametrize(
    ("slave", "geometry"), crosswise(["lower", "upper"], ["reference", "updated"])
)
@pytest.mark.parametrize("way", [PUSH, -PUSH])
def test_the_resultants_of_a_sliding_block(cell, slave, geometry, way):
    """T = mu N in the plane, whichever side is the slave, and T goes with the push."""
    case, _ = pushed(cell, (way,), slave=slave, geometry=geometry)
    tangential, normal = case.forces
    assert normal < 0.0
    if geometry == "reference":
        assert tangential == pytest.approx(-MU * normal * np.sign(way), rel=EXACT)
    else:  # the sides have bent by a hundredth
        assert tangential == pytest.approx(-MU * normal * np.sign(way), rel=0.02)
        nodes = case.closed()
        size = np.linalg.norm(nodes["traction"], axis=1)
        assert largest(size - MU * nodes["pressure"]) < EXACT * nodes["pressure"].max()


@pytest.mark.parametrize("angle", [0.0, 0.9, np.pi / 2, 4.0])
def test_any_direction_in_the_plane(angle):
    """What is dragged over a symmetric base goes where it is dragged."""
    far = PUSH * np.array([np.cos(angle), np.sin(angle)])
    case, _ = pushed("hexahedron", far)
    across = np.array([-np.sin(angle), np.cos(angle)])
    *tangential, normal = case.forces
    size = MU * abs(normal)
    assert np.dot(tangential, far) / PUSH == pytest.approx(size, rel=1e-2)
    assert abs(np.dot(tangential, across)) < 0.02 * size  # the base is not round
    assert np.linalg.norm(tangential) <= size * (1.0 + EXACT)


@pytest.mark.parametrize(("cell", "degree"), ALL_CELLS)
def test_a_turned_block_has_the_turned_answer(cell, degree):
    """Turned by 37 degrees, in space about an oblique axis: forces and nodes turn as well."""
    way = (0.015, -0.005)[: dimension(cell) - 1]  # some stick, some slip
    plain, turned = (
        pushed(cell, way, degree=degree, angle=angle)[0] for angle in (0.0, np.radians(37.0))
    )
    assert turned.forces == pytest.approx(
        plain.forces, rel=EXACT, abs=EXACT * largest(plain.forces)
    )
    a, b = (case.closed() for case in (plain, turned))
    order = [np.lexsort(np.round(c["X"], 9).T) for c in (a, b)]
    for name in ("traction", "step_slip", "slip", "status", "pressure"):
        first, second = a[name][order[0]], b[name][order[1]]
        assert largest(first - second) < 1e3 * EXACT * EXACT + EXACT * largest(first), name


@pytest.mark.parametrize(("cell", "degree"), ALL_CELLS)
@pytest.mark.parametrize("slave", ["lower", "upper"])
def test_what_sticks_is_as_good_as_tied(cell, degree, slave):
    """Pressed and pushed from where the blocks touch, with much friction: all as with a tie."""
    d = dimension(cell)
    case = create(cell, degree=degree, slave=slave, friction=20.0, mesh_options=ALIKE[d])
    case.push(*(0.001, 0.0005)[: d - 1], -PRESS)
    dm.newton(case.problem, rtol=1e-12)
    nodes = case.closed()
    assert (nodes["status"] == 1.0).all()
    assert largest(nodes["step_slip"]) == 0.0 and case.contact.dissipation == 0.0
    tied = case.again(dm.Tie)
    dm.newton(tied.problem, rtol=1e-12)
    u, v = case.problem.u.x.array, tied.problem.u.x.array
    error = COMM.allreduce(largest(u - v), op=MPI.MAX)
    assert error < EXACT * PRESS
    assert case.forces == pytest.approx(tied.forces, rel=EXACT)


def test_below_the_limit_it_sticks():
    """Nodes stick where |tau| < mu p; the force is not at its limit."""
    case, _ = pushed("triangle", (0.002,))
    nodes = case.closed()
    share = np.abs(nodes["traction"][:, 0]) / (MU * nodes["pressure"])
    stick = nodes["status"] == 1.0
    assert stick.sum() >= 2
    assert share[stick].max() < 1.0 and largest(nodes["step_slip"][stick]) == 0.0
    assert share[~stick] == pytest.approx(1.0, rel=EXACT)
    assert 0.05 * MU < case.forces[0] / -case.forces[1] < 0.9 * MU


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize(
    ("slave", "geometry"), crosswise(["lower", "upper"], ["reference", "updated"])
)
@pytest.mark.parametrize("surface", ["facets", "smooth"])
def test_action_is_reaction(cell, slave, geometry, surface):
    """Forces and moments on the two sides, about the origin, cancel."""
    options = {"slave": slave, "geometry": geometry, "surface": surface}
    case, report = pushed(cell, **options)
    contact, size = case.contact, largest(case.forces)
    assert largest(contact.force + contact.master_force) < EXACT * size
    tolerance = EXACT if geometry == "reference" else 1e-6
    assert largest(contact.moment + contact.master_moment) < tolerance * size
    assert report.certificate.force_balance < EXACT


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_both_sides_as_slave_agree(cell):
    """To what coarse meshes that do not match can show."""
    way = (0.01, 0.0)[: dimension(cell) - 1]
    lower, upper = (pushed(cell, way, slave=slave)[0].forces for slave in ("lower", "upper"))
    assert upper == pytest.approx(lower, rel=0.06, abs=0.06 * largest(lower))
