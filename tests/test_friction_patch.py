# SPDX-License-Identifier: MIT
"""Exact states with friction: constant stress, slopes, stacks of bodies, bodies that turn."""

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem
from tests.cases import meshes
from tests.cases.block_piles import ABOVE, BELOW, EAST, WEST, Blocks
from tests.cases.friction import ALIKE, ELASTIC, create, largest
from tests.cases.pressed_blocks import failing
from tests.cases.two_bodies import create_problem, held

EXACT = 1e-10
MU, P = 0.3, 2.0


def loaded(case, loads, bottom):
    """Return the problem of blocks of which the upper one is held by contact alone."""
    V, bcs = case.problem.V, [held(case.problem.V, case.contact.facet_tags, meshes.BOTTOM, bottom)]
    own = {"loads": loads, "geometry": case.problem.geometry}
    return create_problem(V, [case.contact], bcs, ELASTIC, **own)


@pytest.mark.parametrize(
    ("cell", "d", "degree", "slave"),
    [
        *(("triangle", 2, 2, "lower"), ("quadrilateral", 2, 1, "upper")),
        *(("tetrahedron", 3, 1, "upper"), ("hexahedron", 3, 2, "lower")),
    ],
)
def test_constant_shear_below_the_limit(cell, d, degree, slave):
    """Tau = 0.9 mu p everywhere: nothing slips, and displacement and tractions are exact."""
    options = {"degree": degree, "slave": slave, "angle": 0.4, "mesh_options": ALIKE[d]}
    case = create(cell, friction=MU, **options)
    V, contact, turn, tau = case.problem.V, case.contact, case.turn, 0.9 * MU * P
    way = turn[:, 0] if d == 2 else turn[:, :2] @ (0.8, 0.6)
    shear, normal = tau * np.outer(way, turn[:, -1]), turn[:, -1]
    stress = shear + shear.T - P * np.outer(normal, normal)
    E, nu, mean = ELASTIC.E, ELASTIC.nu, np.trace(stress) * np.eye(d)
    strain = (1 + nu) / E * (stress - (nu if d == 2 else nu / (1 + nu)) * mean)
    exact = fem.Function(V)
    exact.interpolate(lambda x: strain @ x[:d])
    ds = ufl.Measure("ds", V.mesh, subdomain_data=contact.facet_tags)
    traction = fem.Constant(V.mesh, default_scalar_type(stress)) * ufl.FacetNormal(V.mesh)
    outside = (meshes.TOP, *range(5, 7 if d == 2 else 9))
    problem = loaded(case, ufl.inner(traction, ufl.TestFunction(V)) * ds(outside), exact)
    dm.newton(problem, rtol=1e-12)
    u, nodes = exact.x.array, contact.gather(problem.u)
    assert largest(problem.u.x.array - u) < EXACT * largest(u)
    on = nodes["status"] == 1.0
    assert on.sum() >= 4 and not (nodes["status"] == 2.0).any()
    assert largest(nodes["pressure"][on] - P) < EXACT * P
    tau *= 1.0 if slave == "lower" else -1.0
    assert largest(nodes["traction"][on] - tau * way) < EXACT * P
    assert largest(nodes["step_slip"]) == 0.0


def on_slope(slope, mu, cell, slave):
    """Return a problem: a block on a wide one, under gravity that leans by tan(angle) = slope."""
    case = create(cell, friction=mu, slave=slave, mesh_options={"heights": (1.0, 0.5)})
    V, gravity = case.problem.V, np.array([slope, -1.0]) / np.hypot(slope, 1.0)
    dx = ufl.Measure("dx", V.mesh, subdomain_data=case.cells)
    weight = fem.Constant(V.mesh, default_scalar_type(gravity))
    loads = ufl.inner(weight, ufl.TestFunction(V)) * dx(meshes.UPPER)
    return loaded(case, loads, fem.Function(V)), case.contact, gravity


@pytest.mark.parametrize(
    ("cell", "slave", "mu"),
    [("triangle", "upper", MU), ("quadrilateral", "lower", 0.05), ("quadrilateral", "lower", 0.8)],
)
def test_a_block_on_a_slope(cell, slave, mu):
    """Where tan(angle) = 0.99 mu, friction carries its weight; steeper there is no equilibrium."""
    problem, contact, gravity = on_slope(0.99 * mu, mu, cell, slave)
    assert problem.audit().held_by_contact
    dm.newton(problem, rtol=1e-11)
    force = contact.force if slave == "upper" else contact.master_force
    assert force == pytest.approx(-0.5 * gravity, rel=1e-9)
    assert (contact.gather(problem.u)["status"] == 1.0).any()
    problem, *_ = on_slope(1.01 * mu, mu, cell, slave)
    said = "The loads may exceed what friction carries", "slides or rolls freely"
    with failing(problem, *said) as caught:
        dm.newton(problem)
    assert "choose a factorisation" not in caught.value.message


CORNER = [(0.0, 1.0, 0.0, 1.0, 3, 2), (1.0, 2.0, 0.0, 1.0, 4, 3), (0.0, 2.0, 1.0, 2.0, 5, 2)]


@pytest.mark.mpi
def test_blocks_that_meet_in_a_corner_shrink_without_slip():
    """One law, no gaps: all is one block that is pressed together, by 10 per cent in one step."""
    pile, shrink = Blocks(CORNER, cell="quadrilateral"), -0.1
    sides = [(10 + EAST, 20 + WEST), (10 + ABOVE, 30 + BELOW), (20 + ABOVE, 30 + BELOW)]
    rough = [dm.Contact(pile.facets, slave=s, master=m, friction=MU) for s, m in sides]
    whole = fem.Function(pile.V)
    whole.interpolate(lambda x: shrink * x[:2])
    rim = fem.locate_dofs_geometrical(pile.V, lambda x: np.isclose(abs(x[:2] - 1), 1).any(axis=0))
    bcs, law = [fem.dirichletbc(whole, rim)], dm.NeoHooke(E=1000.0, nu=0.3)
    dm.newton(pile.problem(rough, bcs, law, strain="finite"), rtol=1e-11)
    mu, lame, stretch = 1000.0 / 2.6, 300.0 / (1.3 * 0.4), 1.0 + shrink
    pressure = -(mu * (stretch**2 - 1.0) + 2.0 * lame * np.log(stretch)) / stretch**2
    assert largest(pile.u.x.array - whole.x.array) < EXACT
    for contact in rough:
        nodes = contact.gather(pile.u)
        closed = nodes["active"] > 0.0
        assert np.allclose(nodes["pressure"][closed], pressure, rtol=1e-9)
        assert largest(nodes["step_slip"]) < EXACT


# -- prescribed nodes


@pytest.mark.mpi
@pytest.mark.parametrize("swap", [False, True])
def test_prescribed_nodes_have_their_friction(swap):
    """A block pushed by its side face, whose corner slides as prescribed: T = mu N."""
    wide = [(-0.5, 1.5, -1.0, 0.0, 8, 2), (0.0, 1.0, 0.0, 1.0, 5, 2)]
    b = Blocks(wide, cell="quadrilateral")
    sides = (10 + ABOVE, 20 + BELOW)[:: 1 if swap else -1]
    contact = dm.Contact(b.facets, slave=sides[0], master=sides[1], friction=0.3)
    way = fem.Constant(b.mesh, 0.0)
    bcs = [b.fix(1, BELOW), b.fix(2, ABOVE, 1, -0.01), b.fix(2, EAST, 0, way)]
    problem = b.problem([contact], bcs, geometry="reference")
    forces = []
    for way.value in (0.0, 0.005, 0.03, 0.0305, 0.0305, 0.06, 0.03):
        report = dm.newton(problem, rtol=1e-10)
        problem.commit()
        forces.append(contact.force if swap else contact.master_force)
        assert report.certificate.force_balance < 1e-14
        supports = sum(dm.reaction(problem, bc).force for bc in bcs[1:])
        assert supports == pytest.approx(forces[-1], abs=1e-8)
    begun, slides, goes_on, rests, more, back = np.array(forces)[1:]
    assert 0.0 < begun[0] < 0.29 * abs(begun[1])
    for force in (slides, goes_on, rests, more):
        assert force[0] == pytest.approx(0.3 * abs(force[1]), rel=1e-8)
    assert back[0] == pytest.approx(-0.3 * abs(back[1]), rel=1e-8)
    assert rests == pytest.approx(goes_on, rel=1e-8)


@pytest.mark.parametrize("swap", [False, True])
def test_nodes_on_a_plane_of_symmetry_have_no_friction(swap):
    """What is prescribed on both sides alike does not slide; what moves by 2e-3 of a facet does."""
    b = Blocks([(-1.0, 0.0, 0.0, 1.0, 5, 2), (-1.0, 0.0, 1.0, 2.0, 4, 2)], cell="quadrilateral")
    sides = (10 + ABOVE, 20 + BELOW)[:: -1 if swap else 1]
    contact = dm.Contact(b.facets, slave=sides[0], master=sides[1], friction=0.3)
    aside = fem.Constant(b.mesh, 0.0)
    held = [b.fix(1, BELOW), b.fix(1, EAST, 0), b.fix(2, EAST, 0, aside)]
    problem = b.problem([contact], [*held, b.fix(2, ABOVE, 1, -0.01)])
    for aside.value, low, high in ((0.0, 0.0, 1e-4), (2e-3 / 4, 0.01, 0.1)):
        dm.newton(problem)
        problem.commit()
        found = contact.gather(problem.u)
        at = found["X"][:, 0] > -1e-9
        share = np.abs(found["traction"][at, 0] / found["pressure"][at] / 0.3)
        assert (low <= share).all() and (share <= high).all()


@pytest.mark.parametrize(
    ("height", "gap", "friction"),
    [(0.123, 0.0, 0.3), (-1e3, -1e-3, 0.3), (0.0, 0.01, None), (-1e3, 0.0, None)],
)
def test_where_nothing_acts_nothing_happens(height, gap, friction):
    """Contact alone holds the upper block at level 0, where round-off must not open it."""
    y = height + 2.0
    b = Blocks([(0.0, 4.0, height, y, 8, 4), (0.0, 3.0, y + gap, y + 2.0, 7, 5)])
    sides = {"slave": 20 + BELOW, "master": 10 + ABOVE}
    contact, t = dm.Contact(b.facets, **sides, friction=friction), fem.Constant(b.mesh, 0.0)
    loads = t * b.traction(2, ABOVE, (0.0, -1.0))
    problem = b.problem([contact], [b.fix(1, BELOW), b.fix(2, WEST, 0)], loads=loads)
    for step in dm.load_steps(
        problem, [0, 0, 1, 0], ramp={t: [(0, 0.0), (1, 1.0)]}, progress=False
    ):
        assert abs(contact.force[1] - 3.0 * step.time) < 1e-6 * max(step.time, 1e-3)
        assert step.report.cuts == 0 and not any("handed" in n for n in step.report.notes)
        assert step.number > 2 or largest(b.u.x.array) < 1e-12 * (1 + abs(height)) - min(gap, 0.0)
