# SPDX-License-Identifier: MIT
"""Reactions of supports: equilibrium to round-off, contact nodes, rings, invalid input."""

import json

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import default_scalar_type, fem, mesh
from tests.cases.block_piles import ABOVE, BELOW, BRIDGE, COMM, EAST, PILE, STEEL, WEST, Blocks
from tests.cases.pressed_blocks import PressedBlocks, rejected
from tests.cases.solid import create_displacement, hold, plane, tag_facets
from tests.cases.two_bodies import create_problem

pytestmark = pytest.mark.mpi
TIGHT = 1e-11


def loaded_bridge(geometry="reference"):
    """Return a solved bridge of three blocks under tractions, and its two supports."""
    b = Blocks(BRIDGE)
    contact = b.join(dm.Contact, (1, ABOVE), (2, BELOW))
    tie = b.join(dm.Tie, (3, BELOW), (1, ABOVE))
    loads = b.traction(2, ABOVE, (0.0, -2.0)) + b.traction(3, EAST, (1.0, 0.0))
    dx = ufl.Measure("dx", b.mesh, subdomain_data=b.cells)
    loads += ufl.inner(fem.Constant(b.mesh, (0.0, -0.5)), ufl.TestFunction(b.V)) * dx(2)
    law = {1: STEEL, 2: dm.Elastic(500.0, 0.2), 3: dm.VonMises(800.0, 0.3, 50.0, 10.0)}
    base, wall = b.fix(1, BELOW), b.fix(2, WEST, component=0)
    problem = b.problem([contact, tie], [base, wall], law, loads=loads, geometry=geometry)
    return problem, dm.newton(problem, rtol=TIGHT), base, wall


@pytest.mark.parametrize("geometry", ["reference", "updated"])
def test_supports_balance_the_loads(geometry):
    """Loads: -2.6 and the weight .65 on the middle of [0, 1.3]; 1 to the right at y = 1/2."""
    problem, report, base, wall = loaded_bridge(geometry)
    contact, tie = problem.interfaces
    total = dm.reaction(problem)
    assert total.force == pytest.approx([-1.0, 3.25], rel=1e-9)
    assert contact.master_force[1] == pytest.approx(3.25, rel=1e-8)
    assert contact.force == pytest.approx(-contact.master_force, rel=1e-8)
    assert tie.force == pytest.approx([-1.0, 0.0], abs=1e-8)
    c = report.certificate
    assert max(c.equilibrium, c.gap, c.sign, c.complementarity, c.force_balance) < 1e-8
    assert c.row_sum_error < 1e-12
    parts = [dm.reaction(problem, one) for one in (base, wall)]
    assert sum(one.force for one in parts) == pytest.approx(total.force, rel=1e-12)
    assert parts[1].force[1] == 0.0  # nothing is held there
    assert dm.reaction(problem, [base, wall]).force == pytest.approx(total.force, rel=1e-12)
    assert dm.reaction(problem, 10 + BELOW).force == pytest.approx(parts[0].force, rel=1e-12)
    if geometry == "reference":  # forces act at X, as loads do
        assert total.moment == pytest.approx(3.25 * 0.65 + 1.0 * 0.5, rel=1e-9)
        about = np.array([0.3, 2.0])
        moved = dm.reaction(problem, about=about)
        arm = about[0] * total.force[1] - about[1] * total.force[0]
        assert moved.moment == pytest.approx(total.moment - arm, rel=1e-12)
        assert (moved.about == about).all() and (total.about == 0.0).all()


@pytest.mark.parametrize("friction", [None, 0.3])
@pytest.mark.parametrize("slave", [1, 2])
def test_a_side_that_is_held_and_touched(slave, friction):
    """What a block gives through a contact is carried by the very nodes that it presses on."""
    b = Blocks(PILE[:2])
    sides = (10 + ABOVE, 20 + BELOW)[:: 1 if slave == 1 else -1]
    contact = dm.Contact(b.facets, slave=sides[0], master=sides[1], friction=friction)
    anvil, guide = b.fix(1, ABOVE, component=1), b.fix(2, WEST, component=0)
    bcs = [anvil, guide, b.fix(1, ABOVE, component=0), b.fix(1, BELOW)]
    if slave == 1:  # no direction is left to a slave node that is held altogether
        bcs = [b.fix(1, BELOW), guide]
        anvil = bcs[0]
    loads = b.traction(2, ABOVE, (0.5, -2.0))
    problem = b.problem([contact], bcs, loads=loads, geometry="reference")
    dm.newton(problem, rtol=TIGHT)
    assert dm.reaction(problem, anvil).force[1] == pytest.approx(2.0, rel=1e-8)
    assert dm.reaction(problem).force == pytest.approx([-0.5, 2.0], rel=1e-8)
    dragged = abs(dm.reaction(problem, guide).force[0] + 0.5)
    assert dragged > 1e-2 if friction else dragged < 1e-8


def cube():
    """Return a cube that is held at its foot and pulled askew at its head, and its tags."""
    box = mesh.create_unit_cube(COMM, 2, 2, 2)
    u = create_displacement(box)
    V = u.function_space
    tags = dm.Tags(tag_facets(box, plane(2), plane(2, 1.0)), {"foot": 1, "head": 2})
    bcs = [hold(V, tags.find("foot"), value=fem.Function(V))]
    ds = ufl.Measure("ds", box, subdomain_data=tags)
    pull = fem.Constant(box, default_scalar_type((1.0, 2.0, 3.0)))
    loads = ufl.inner(pull, ufl.TestFunction(V)) * ds(2)
    return create_problem(u, (), bcs, STEEL, loads=loads), tags


def test_moments_in_space():
    """The pull (1, 2, 3) acts at (.5, .5, 1); every way to name the support is the same."""
    problem, tags = cube()
    dm.newton(problem, rtol=TIGHT)
    about, pull = np.array([0.1, -0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    expected = -np.cross(np.array([0.5, 0.5, 1.0]) - about, pull)
    (bc,) = problem.bcs
    nodes = fem.locate_dofs_topological(problem.V, 2, tags.find("foot"))
    dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
    for support in ("foot", 1, np.int32(1), bc, [bc], dofs, None):
        facet_tags = tags if isinstance(support, str | int | np.int32) else None
        found = dm.reaction(problem, support, facet_tags, about=about)
        assert found.force == pytest.approx(-pull, rel=1e-9)
        assert found.moment == pytest.approx(expected, rel=1e-9) and found.moment.shape == (3,)


def test_the_whole_ring():
    """A tube 1 < r < 2 pressed at its end: 3 pi p; no moment about the axis' points."""
    b = Blocks([(1.0, 2.0, 0.0, 1.0, 3, 2)], cell="quadrilateral")
    foot = b.fix(1, BELOW, component=1)
    bore = b.fix(1, WEST, component=0)
    own = {"kinematics": "axisymmetric", "loads": b.traction(1, ABOVE, (0.0, -5.0))}
    problem = b.problem([], [foot, bore], **own)
    dm.newton(problem, rtol=TIGHT)
    assert dm.reaction(problem, foot).force == pytest.approx([0.0, 15 * np.pi], rel=1e-9)
    assert dm.reaction(problem, bore).force[0] < -1.0  # the wider tube is held back, all around
    assert dm.reaction(problem).moment == 0.0
    with rejected("about is ", "leave it out"):
        dm.reaction(problem, about=[0.0, 0.0])


def test_it_is_that_of_the_last_step_whatever_comes_after():
    """Loads and u that are set anew, a failed step: as with the forces of contacts."""
    problem, _, base, _ = loaded_bridge()
    before = dm.reaction(problem, base)
    problem.commit()
    assert (dm.reaction(problem, base).force == before.force).all()
    problem.u.x.array[:] += 1.0
    assert dm.reaction(problem, base).moment == before.moment
    problem.u.x.array[:] *= 1e8  # one iteration leaves the round-off of that
    with pytest.raises(dm.NewtonNotConverged):
        dm.newton(problem, max_it=1, rtol=1e-13)
    assert (dm.reaction(problem, base).force == before.force).all()
    fresh = Blocks(PILE[:1])
    problem = fresh.problem([], [fresh.fix(1, BELOW)])
    with rejected("no reactions yet", "solve a step first"):
        dm.reaction(problem)


def test_rows_of_load_steps_have_it_and_a_checkpoint_too(folder):
    file, case, other = folder / "walk.h5", PressedBlocks(), PressedBlocks()
    problem, again = case.problem(), other.problem()
    (step,) = dm.load_steps(problem, [1.0], checkpoint=file)
    row, first = dm.summarise(step), dm.reaction(problem, problem.bcs[1])
    assert row["forces"] == [problem.interfaces[0].force.tolist()]
    found = row["reactions"][1]
    assert found["force"] == first.force.tolist() and found["moment"] == first.moment
    again.restore(file)
    found = dm.reaction(again, again.bcs[1])
    assert [*found.force, found.moment] == pytest.approx([*first.force, first.moment], rel=1e-14)
    assert dm.summarise(again.history[-1])["reactions"] == json.loads(json.dumps(row["reactions"]))


def test_supports_that_are_none():
    problem, tags = cube()
    dm.newton(problem)
    (bc,) = problem.bcs
    other = fem.dirichletbc(np.zeros(3), np.zeros(0, np.int32), cube()[0].V)
    top = fem.locate_dofs_topological(problem.V.sub(0), 2, tags.find("head"))
    last = 3 * len(problem.u.x.array)
    none = np.zeros(0, np.int32)
    for words, support, facet_tags in (
        (("facet_tags is None", "reaction(problem, support, facet_tags)"), 1, None),
        (("support is 5", "'foot' (1), 'head' (2)"), 5, tags),
        (("support is 'head'", "prescribe nothing"), "head", tags),
        (("of another mesh",), "foot", cube()[1]),
        (("support holds dof",), [last] if COMM.rank == 0 else none, None),
        (("not prescribed by problem.bcs", "returns nodes"), top, None),
        (("support is [[",), [[1, 2], [3]], None),
        (("support: one is", "fem.dirichletbc"), [bc, 3], None),
        (("support holds", "another space"), other, None),
    ):
        with rejected(*words):
            dm.reaction(problem, support, facet_tags)
    with rejected("about is ", "3 finite coordinates"):
        dm.reaction(problem, about=[0.0, np.nan, 0.0])
    if COMM.size > 1:
        with rejected("support differs between the ranks"):
            dm.reaction(problem, "foot" if COMM.rank else "head", tags)
    with rejected("problem is "):
        dm.reaction(problem.solid)
