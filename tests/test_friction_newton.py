# SPDX-License-Identifier: MIT
"""Newton iterations with friction, elastic and plastic, up to mu = 1."""

from itertools import pairwise

import numpy as np
import pytest

import dolfinx_mortar as dm
from tests.cases.friction import ELASTIC, create
from tests.cases.hertz import PLASTIC as FLOWING
from tests.cases.hertz import create_case, create_mesh
from tests.choice import crosswise

PLASTIC = dm.VonMises.from_uniaxial(1000.0, 0.3, 12.0, 100.0)
IDEAL = dm.VonMises.from_uniaxial(1000.0, 0.3, 12.0, 0.0)
PRESS = 0.02
WALK = ((0.0, 0.5), (0.0, 1.0), (0.01, 1.0), (0.03, 1.0), (0.02, 1.0), (-0.02, 1.0))


def iterations(case, **options):
    """Press, push, and push back; return the iterations of Newton in each step."""
    space = len(case.top.value) == 3
    counts = []
    for way, depth in WALK:
        rest = (0.4 * way,) if space else ()
        case.push(way, *rest, -PRESS * depth)
        report = dm.newton(case.problem, **options)
        case.problem.commit()
        counts.append(report.newton_iterations)
    return np.array(counts)


@pytest.mark.parametrize(
    "law",
    [PLASTIC, *(pytest.param(law, marks=pytest.mark.slow) for law in (ELASTIC, IDEAL))],
    ids=["plastic", "elastic", "ideal"],
)
@pytest.mark.parametrize(
    ("geometry", "cell", "degree"),
    crosswise(["reference", "updated"], [("triangle", 2), ("hexahedron", 1)]),
)
def test_friction_costs_few_iterations(law, cell, degree, geometry):
    """While it is pressed, against the same without friction; pushes strain only with it.

    Without friction a push moves the upper block and strains nothing, so there few is a number.
    """
    options = {"law": law, "degree": degree, "geometry": geometry}
    plain = iterations(create(cell, **options))
    rough = iterations(create(cell, friction=0.3, **options))
    pressed = slice(0, 2)
    assert rough[pressed].sum() <= 1.5 * plain[pressed].sum()
    assert rough.max() <= 7
    if law is ELASTIC and geometry == "reference":
        assert (rough == 1).all()  # one QP is the step


@pytest.mark.parametrize("mu", [pytest.param(0.6, marks=pytest.mark.slow), 1.0])
@pytest.mark.parametrize(
    ("geometry", "cell"), crosswise(["reference", "updated"], ["quadrilateral", "tetrahedron"])
)
def test_much_friction(mu, cell, geometry):
    """Plastic blocks still converge without cuts; the law holds at the end."""
    case = create(cell, friction=mu, law=PLASTIC, geometry=geometry)
    assert iterations(case, rtol=1e-9).max() <= 12
    nodes = case.closed()
    size = np.linalg.norm(nodes["traction"], axis=1)
    slides = nodes["status"] == 2.0
    assert (size <= mu * nodes["pressure"] + 1e-7 * nodes["pressure"].max()).all()
    assert size[slides] == pytest.approx(mu * nodes["pressure"][slides], rel=1e-6)
    assert (case.problem.solid.cell_values("hardening").x.array >= 0.0).all()


def test_the_tail_is_quadratic():
    """Frozen geometry, a hardening law in space, directions that turn: exactly linearised."""
    case = create("tetrahedron", friction=0.3, law=PLASTIC)
    case.solve(0.0, 0.0, -PRESS)
    case.push(0.02, 0.01, -PRESS)
    report = dm.newton(case.problem, rtol=1e-13)
    falls = [i.force_residual for i in report.iterations]
    orders = [np.log(b) / np.log(a) for a, b in pairwise(falls) if b > 1e-13]
    assert report.newton_iterations <= 7
    assert max(orders[-2:]) > 1.5
    assert (case.closed()["status"] == 2.0).any()


@pytest.mark.slow
def test_a_deep_step_of_flowing_bodies():
    """With slips along the partners of the moment, which move with the master, it would take 11."""
    counts = []
    for mu in (0.0, 0.2):
        mesh = create_mesh("graded", 0.1)
        case = create_case(mesh, FLOWING, friction=mu)
        case.press(0.2)
        counts.append(dm.newton(case.problem).newton_iterations)
    assert counts[1] <= 1.5 * counts[0] < 11
