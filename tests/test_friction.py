# SPDX-License-Identifier: MIT
"""A block pushed along another one: it sticks, slides at mu N, and does so from anywhere."""

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx_mortar.algebra.parallel import any_rank
from dolfinx_mortar.qp import active_set
from dolfinx_mortar.qp.held import Outcome
from tests.cases.friction import ALIKE, check_coulomb, create, largest

EXACT = 1e-10
MU = 0.3
PRESS, PUSH = 0.01, 0.05  # of the top, in parts of the block; it slides from 0.02 on
SPACE = ("tetrahedron", "hexahedron")


def rest(cell, across=0.0):
    """Return the second component of a push, of blocks in space."""
    return (across,) if cell in SPACE else ()


@pytest.mark.parametrize(
    ("cell", "degree", "slave", "geometry", "surface"),
    [
        ("triangle", 1, "lower", "reference", "facets"),
        ("triangle", 2, "upper", "updated", "facets"),
        ("quadrilateral", 1, "upper", "updated", "smooth"),
        ("quadrilateral", 2, "lower", "reference", "facets"),
        ("tetrahedron", 1, "lower", "updated", "facets"),
        ("hexahedron", 1, "upper", "reference", "smooth"),
        *(
            pytest.param(c, 2, "lower", "reference", "facets", marks=pytest.mark.slow)
            for c in SPACE
        ),
    ],
)
def test_it_slides_at_the_limit(cell, degree, slave, geometry, surface):
    """Pressed, pushed a little, until all slides, and back: Coulomb's law in every state."""
    options = {"degree": degree, "slave": slave, "geometry": geometry, "surface": surface}
    case, found = create(cell, friction=MU, **options), []
    for way in (0.0, 0.002, PUSH, PUSH - 1e-5, -PUSH):
        report = case.solve(way, *rest(cell, 0.4 * way), -PRESS)
        nodes = check_coulomb(case, MU)
        assert report.certificate.force_balance < EXACT
        *tangential, normal = case.forces
        ratio = np.linalg.norm(tangential) / (-MU * normal)
        found.append((nodes["status"], nodes["slip"], ratio, tangential[0]))
    _, begun, slides, sticks, back = found
    assert (begun[0] == 1.0).sum() >= 2 and begun[2] < 0.9 and begun[3] > 0.0
    limit = pytest.approx(1.0, rel=EXACT if geometry == "reference" and not rest(cell) else 0.02)
    for state, sign in ((slides, 1.0), (back, -1.0)):
        assert (state[0] == 2.0).all() and state[2] == limit and sign * state[3] > 0.0
    assert (slides[1] > 0.2 * PUSH).all()
    assert (sticks[0] == 1.0).all() and sticks[2] < 1.0 and largest(sticks[1] - slides[1]) == 0.0
    assert (back[1] > slides[1] + 0.01).all()  # the length of the way grows either way


@pytest.mark.parametrize(
    ("cell", "degree", "slave"),
    [
        *(("triangle", 2, "lower"), ("quadrilateral", 1, "upper")),
        *(("tetrahedron", 1, "upper"), ("hexahedron", 1, "lower")),
    ],
)
def test_what_sticks_is_as_good_as_tied(cell, degree, slave):
    """Pressed and pushed from where the blocks touch, with much friction: all as with a tie."""
    d = 3 if rest(cell) else 2
    case = create(cell, degree=degree, slave=slave, friction=20.0, mesh_options=ALIKE[d])
    case.push(0.001, *rest(cell, 0.0005), -PRESS)
    dm.newton(case.problem, rtol=1e-12)
    nodes = case.closed()
    assert (nodes["status"] == 1.0).all()
    assert largest(nodes["step_slip"]) == 0.0 and case.contact.dissipation == 0.0
    tied = case.again(dm.Tie)
    dm.newton(tied.problem, rtol=1e-12)
    u, v = case.problem.u.x.array, tied.problem.u.x.array
    assert largest(u - v) < EXACT * PRESS
    assert case.forces == pytest.approx(tied.forces, rel=EXACT)


# -- iterations

PLASTIC = dm.VonMises.from_uniaxial(1000.0, 0.3, 12.0, 100.0)
WALK = ((0.0, 0.5), (0.0, 1.0), (0.01, 1.0), (0.03, 1.0), (0.02, 1.0), (-0.02, 1.0))


def iterations(case, **options):
    """Press, push, and push back; return the iterations of Newton in each step."""
    counts = []
    for way, depth in WALK:
        report = case.solve(way, *([0.4 * way] * (case.problem.d - 2)), -0.02 * depth, **options)
        counts.append(report.newton_iterations)
    return np.array(counts)


@pytest.mark.parametrize(
    ("geometry", "cell", "degree", "mu"),
    [
        ("reference", "triangle", 2, 0.3),
        ("updated", "hexahedron", 1, 0.3),
        ("updated", "quadrilateral", 1, 1.0),
        ("reference", "tetrahedron", 1, 1.0),
    ],
)
def test_friction_costs_few_iterations(cell, degree, geometry, mu):
    """Of plastic blocks while pressed, against none; much of it holds at the end, too."""
    options = {"law": PLASTIC, "degree": degree, "geometry": geometry}
    case = create(cell, friction=mu, **options)
    rough = iterations(case, rtol=1e-6 if mu < 1.0 else 1e-9)
    assert rough.max() <= (7 if mu < 1.0 else 12)
    if mu < 1.0:
        plain = iterations(create(cell, **options), rtol=1e-6)
        assert rough[:2].sum() <= 1.5 * plain[:2].sum()
    else:
        check_coulomb(case, mu, 1e-6)


# -- fallbacks of a QP


def given_limits(monkeypatch):
    """Let the exact linearisation go in circles."""
    update = active_set._update

    def go_in_circles(problem, start, level):
        if any_rank(problem.qp.comm, problem.qp.friction.coefficient.any())[0]:
            first = problem.hold(start, level)  # what it has seen until then
            return Outcome(first.predicted, 1, "it came back")
        return update(problem, start, level)

    monkeypatch.setattr(active_set, "_update", go_in_circles)
    return "given limits"


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_fallbacks_have_the_same_answer(cell, monkeypatch):
    """And the report says how friction was linearised."""
    found, said = [], "exact linearisation"
    for k in range(2):
        said = given_limits(monkeypatch) if k else said
        case = create(cell, friction=MU)
        for x in (0.0, 0.006, 0.03):
            report = case.solve(x, *rest(cell), -0.02, rtol=1e-11)
            assert report.friction == said
        found.append(case.contact.gather(case.problem.u))
    for name in ("pressure", "traction", "slip", "x", "status"):
        scale = np.abs(found[0][name]).max()
        assert np.abs(found[1][name] - found[0][name]).max() <= 1e-7 * scale, name
