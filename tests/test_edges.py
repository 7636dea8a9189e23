# SPDX-License-Identifier: MIT
"""Contact at edges and corners: forces are normal to both sides, whole skins cost what sides do."""

import re

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.geometry.facets import facet_normals, points_of
from dolfinx_mortar.mortar.integrals import find_segments
from dolfinx_mortar.mortar.pairing import create_pairing, received_facets
from dolfinx_mortar.mortar.surface import create_surface, facets_at
from dolfinx_mortar.report.penetration import find_overlaps, notes_on_overlaps
from tests.cases.ball import create_problem
from tests.cases.meshes import BOTTOM, BOTTOM_OF_UPPER, LEFT, TOP, skins
from tests.cases.meshes_3d import rotation
from tests.cases.moving_bodies import Blocks
from tests.cases.two_bodies import SIDES, TwoBodies

COMM = MPI.COMM_WORLD
SLAVES = pytest.mark.parametrize("slave", SIDES)
pytestmark = pytest.mark.mpi


def crossing(x, low=55, high=33):
    """Turn two cubes so that an edge of one lies across one of the other, both of them tilted."""
    upper = x[:, 2] > 0.5
    low = (x - [0.5, 1.0, 0.0]) @ rotation((1, 0, 0), np.radians(low)).T
    high = (x - [1.0, 0.5, 1.0]) @ rotation((0, 1, 0), np.radians(high)).T
    low[:, 2] -= low[~upper, 2].max()
    high[:, 2] -= high[upper, 2].min()
    return np.where(upper[:, None], high, low)


@SLAVES
def test_forces_of_crossing_edges_are_normal_to_both(slave):
    """Without friction: horizontal forces of averaged normals are a fifth of the vertical one."""
    n = (2, 2, 2)
    case = TwoBodies("hexahedron", whole=True, n_lower=n, n_upper=n, gap=1.0, transform=crossing)
    contact = case.interface(slave=slave)
    dm.newton(case.problem([contact], case.bcs(0.0, 0.0, -0.08)))
    *across, along = contact.force
    assert abs(along) > 1.0
    assert np.hypot(*across) < 0.01 * abs(along)


@pytest.mark.parametrize("slave", ["ball", "block"])
def test_normals_of_contact_point_out_of_both_sides(slave):
    """Also of a ball that overhangs the corner of a block, where no direction is normal to both."""
    problem, _ = create_problem(h=0.125, slave=slave, cell="hexahedron", depth=0.05)
    problem.begin_step()
    (link,) = problem.system.links
    coupling = link.coupling
    along = (coupling.normals * coupling.operators.normals).sum(axis=1)
    assert (along[coupling.kept[:, 0]] > 0.0).all()


STACKS = {
    "equal": {"n_lower": (4, 4), "n_upper": (5, 5)},
    "small on large": {"n_lower": (6, 4), "n_upper": (4, 4), "x_upper": (0.23, 0.77)},
    "overhang": {"n_lower": (5, 4), "n_upper": (5, 4), "x_upper": (0.5, 1.5)},
}


@SLAVES
@pytest.mark.parametrize("name", STACKS)
def test_whole_skins_do_what_their_sides_do(name, slave):
    """In no more iterations, with the same force; averaged normals take five times as many."""
    found = []
    for whole in (False, True):
        case = TwoBodies(whole=whole, **STACKS[name])
        contact = case.interface(slave=slave)
        report = dm.newton(case.problem([contact], case.bcs(0.005, -0.01)))
        found.append((report.newton_iterations, contact.force))
    (expected, force), (iterations, of_skins) = found
    assert iterations <= expected
    assert np.abs(of_skins - force).max() < 1e-3 * np.abs(force).max()


def on_a_corner(n_lower=(3, 2), n_upper=(2, 2)):
    """Return a block that stands on a corner, in the middle of the lower one."""

    def turned(x):
        upper = (x - [0.0, 1.0]) @ rotation((0, 0, 1), np.pi / 4)[:2, :2].T + [0.5, 0.0]
        return np.where(x[:, 1:] > 0.5, upper, x)

    options = {"n_lower": n_lower, "n_upper": n_upper, "gap": 1.0, "transform": turned}
    return TwoBodies(whole=True, **options)


@pytest.mark.parametrize("pressed", [-1e-4, 1e-4, 0.04])
@SLAVES
def test_a_corner_that_no_node_sees_is_noted(slave, pressed):
    """However little it is pressed, as there is no force; facets are 1/3 long at least."""
    case = on_a_corner()
    contact = case.interface(slave=slave)
    report = dm.newton(case.problem([contact], case.bcs(0.0, -pressed)))
    found = [note for note in report.notes if "deep in each other" in note]
    if slave == BOTTOM_OF_UPPER:
        assert found == [] and (contact.force[1] > 0.01) == (pressed > 0.0)
        return
    assert len(found) == (pressed > 0.0) and not contact.active.x.array.any()
    for note in found:
        assert f"lie {pressed:.3g} deep in each other around (0.5, {-pressed:.4g})" in note
        part = "12%" if pressed == 0.04 else "0.0003"
        assert f", {part} of the finer facet there" in note
        assert f"{contact}" in note and "finer or sharper side be the slave" in note.why


def lost(contact, problem):
    """Return place, depth and share [%] of what the notes on overlaps say at u as it is now."""
    form = r"lie (.*) deep in each other around \((.*)\), (.*)% of the finer facet"
    notes = notes_on_overlaps(problem, find_overlaps(problem))
    found = (re.search(form, note).groups() for note in notes)
    return [([float(c) for c in x.split(",")], float(d), int(s)) for d, x, s in found]


def test_an_overlap_where_supports_hold_the_slave_is_said_to_be_that():
    """A block that is held whole, as the slave: it has no multiplier, and stops nothing."""
    case = Blocks((6, 2), (4, 4), gap=-0.05)
    notes = []
    for slave, master in (SIDES, SIDES[::-1]):
        contact = dm.Contact(case.facets, slave=slave, master=master)
        problem = dm.ContactProblem(case.solid, [contact], bcs=case.bcs, terms=[case.inertia])
        problem.audit()
        notes.append(notes_on_overlaps(problem, find_overlaps(problem)))
    (held,), free = notes
    assert "Dirichlet data prescribe" in held.why and "let the other side" in held.why
    assert "0.05 deep" in held and not free  # those of free nodes the step removes


@SLAVES
def test_a_bulge_between_vertices_is_seen(slave):
    """Curved sides lie in each other where neither has a vertex."""
    case = TwoBodies(degree=2, n_lower=(1, 1), n_upper=(1, 1), gap=0.01)
    contact, u = case.interface(slave=slave), case.u
    problem = case.problem([contact])
    dm.newton(problem)
    bulge = lambda x: np.stack([0.0 * x[0], -0.4 * x[0] * (1.0 - x[0])])  # noqa: E731
    u.interpolate(bulge, case.cells.find(2))
    u.x.scatter_forward()
    ((place, depth, share),) = lost(contact, problem)
    assert 0.07 < depth <= 0.09 and 0.2 < place[0] < 0.8 and share == round(100.0 * depth)


@pytest.mark.parametrize(("n", "degree", "noted"), [(2, 1, False), (3, 1, True), (3, 2, True)])
@SLAVES
def test_edges_that_cross_between_nodes_are_noted(slave, n, degree, noted):
    """Facets are 1/n long, and edges lost by 0.06 of them; where they cross at nodes, none is."""
    cell = "hexahedron" if noted else "tetrahedron"
    options = {"n_lower": (n, n, n), "n_upper": (n, n, n), "gap": 1.0}
    options["transform"] = lambda x: crossing(x, 45, 45)
    case = TwoBodies(cell, degree, whole=True, **options)
    contact = case.interface(slave=slave)
    problem = case.problem([contact], case.bcs(0.0, 0.0, -0.02))
    notes = dm.newton(problem).notes
    assert any("deep in each other" in note for note in notes) is noted
    if noted and degree == 1:
        place = pytest.approx([0.0, 0.0, -0.01], abs=0.0101)
        assert lost(contact, problem) == [(place, 0.02, 6)]
    assert (np.abs(contact.force[2]) > 1.0) is not noted


def arcs(x):
    angle, radius = 2.0 * (x[:, 0] - 0.5), 2.0 - x[:, 1]
    return np.stack([radius * np.sin(angle), -radius * np.cos(angle)], axis=1)


@SLAVES
def test_the_height_of_smooth_surfaces_is_no_overlap(slave):
    """Facets of 2/3 of a radian stand off the arc by 0.11, 8 % of their length; of 1/2, by 0.06."""
    case = TwoBodies(n_lower=(3, 2), n_upper=(4, 2), transform=arcs)
    contact = case.interface(slave=slave)
    report = dm.newton(case.problem([contact], case.bcs(0.0, -0.001)))
    assert contact.force[1] != 0.0
    assert not [note for note in report.notes if "deep in each other" in note]


def test_a_corner_beside_a_clamped_node_is_noted():
    """Its gap is a mean up to that node, over a facet that stands open: it lies .014 deep."""
    case = on_a_corner((6, 3), (2, 1))
    report = dm.newton(case.problem([case.interface(swap=True)], case.bcs(0.0, -0.02)))
    assert any("deep in each other" in note for note in report.notes)


@SLAVES
def test_pressure_is_constant_beside_a_clamped_node(slave):
    """Uniaxial strain, given on the left as well: facets share out, one of them in all."""
    case = TwoBodies(whole=True, n_lower=(2, 2), n_upper=(1, 2))
    exact = fem.Function(case.V)
    exact.interpolate(lambda x: np.stack([0.0 * x[0], -0.01 * (x[1] + 1.0)]))
    contact, bcs = case.interface(slave=slave), [case.held(t, exact) for t in (BOTTOM, TOP, LEFT)]
    dm.newton(case.problem([contact], bcs, dm.Elastic(1000.0, 0.0)), rtol=1e-11)
    assert np.abs(case.u.x.array - exact.x.array).max(initial=0) < 1e-12
    pressure = contact.gather(case.u)["pressure"]
    assert np.abs(pressure[pressure > 0] - 10.0).max() < 1e-8


# -- partners, and what whole skins hold


@pytest.mark.parametrize("gap", [0.1, -0.1])
@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])
def test_partners_face_each_other_from_outside(cell, gap):
    """Whole skins have the partners of the two sides between the bodies, and no others."""
    if cell == "triangle":
        up, sizes = np.array([-np.sin(0.4), np.cos(0.4)]), {"n_upper": (5, 4), "angle": 0.4}
    else:
        turn = rotation((1, 2, 3), 0.7)
        up, sizes = turn[:, 2], {"n_upper": (2, 3, 2), "turn": turn}
    n_lower = (6, 3) if cell == "triangle" else (3, 3, 2)
    case = TwoBodies(cell, n_lower=n_lower, heights=(0.5, 0.75), gap=gap, **sizes)
    V, tags = case.V, skins(case.mesh, case.cells, case.facets, keep=())
    for slave, master in (SIDES, SIDES[::-1]):
        sides = (create_surface(V, tags, tag, "side") for tag in (slave, master))
        pairing = create_pairing(*sides, None)
        points, _ = find_segments(pairing, None)
        facets = facets_at(pairing.slave, pairing.slave.X)
        n = facet_normals(facets)[points.slave]
        across = np.abs(n @ up) > 0.5
        x_m = points_of(received_facets(pairing, None), points.master, points.xi_m)
        along = ((x_m - points_of(facets, points.slave, points.xi_s)) * n).sum(axis=1)
        assert np.abs(along[across] - gap).max(initial=0) < 1e-12
        # in the plane averaged normals fan out at the edges, one way or the other
        fan = 2 * abs(gap) if cell == "triangle" else 1e-12
        assert COMM.allreduce(points.weight[across].sum()) == pytest.approx(1.0, abs=fan)
        # flanks that overlap look through both bodies, one thickness deep
        assert not (~across).any()


@pytest.mark.parametrize("cells", [2, 4])
def test_clamped_bodies_are_held(cells):
    """What edges seem to take from the contact is no part of what clamps hold."""
    sizes = {"n_lower": (3, 3, 2), "n_upper": (cells, cells, 2), "upper": (0.2, 0.8, 0.2, 0.8)}
    case = TwoBodies("tetrahedron", whole=True, **sizes)
    audit = case.problem([case.interface(swap=True)]).audit()
    assert not audit.held_by_contact
    assert audit.interfaces[0].least_gap == audit.interfaces[0].largest_gap == 0.0


def test_a_tall_block_stands_on_a_plate():
    """It cannot tilt: edges are no facets of a curved side, along which a body may slide."""
    case = TwoBodies(whole=True, n_lower=(4, 2), n_upper=(3, 6), heights=(1.0, 4.0))
    V = case.V.sub(0)
    corner = fem.locate_dofs_geometrical(
        (V, V.collapse()[0]), lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], 4.0)
    )
    slide = fem.dirichletbc(fem.Function(V.collapse()[0]), corner, V)
    assert case.problem(bcs=[case.held(BOTTOM), slide]).audit().held_by_contact
