# SPDX-License-Identifier: MIT
"""Contact between smooth surfaces: what it mends, on any mesh, slave and ranks; its arguments."""

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem, mesh
from dolfinx_mortar.meshing.bodies import distribute
from tests.meshes import BOTTOM_OF_UPPER, TOP, TOP_OF_LOWER
from tests.pressed_blocks import PressedBlocks, rejected
from tests.test_audit import create_ring

COMM = MPI.COMM_WORLD
RADIUS = 8.0
CELLS = ["tetrahedron", "hexahedron"]


def rings(comm, inner, outer, counts, layers):
    """Return two rings, the mesh, tags 1 to 4 of its circles from inside, and its space."""
    parts = [
        create_ring(*radii, 2 * np.pi * np.arange(n) / n, layers=k)
        for radii, n, k in zip((inner, outer), counts, layers, strict=True)
    ]
    domain, _ = distribute(comm, lambda: parts, "quadrilateral")
    domain.topology.create_connectivity(1, 2)
    facets = mesh.exterior_facet_indices(domain.topology)
    to_cell = domain.topology.connectivity(1, 2)
    cells = np.array([to_cell.links(f)[0] for f in facets], dtype=np.int32)
    x = mesh.compute_midpoints(domain, 1, facets)
    away = np.einsum("mi,mi->m", x, x - mesh.compute_midpoints(domain, 2, cells)) > 0
    first = np.linalg.norm(mesh.compute_midpoints(domain, 2, cells), axis=1) < inner[1]
    values = np.where(first, 1, 3) + away
    return domain, mesh.meshtags(domain, 1, facets, values.astype(np.int32))


def hold(V, radius):
    """Return conditions that keep a circle from moving as a whole, and nothing else."""
    bcs = []
    for angle, component in ((0.0, 1), (np.pi, 1), (np.pi / 2, 0)):
        at = radius * np.array([np.cos(angle), np.sin(angle)])
        W = V.sub(component)
        dofs = fem.locate_dofs_geometrical(
            (W, W.collapse()[0]), lambda x, at=at: np.linalg.norm(x[:2].T - at, axis=1) < 1e-6
        )
        bcs.append(fem.dirichletbc(fem.Function(W.collapse()[0]), dofs, W))
    return bcs


def lame_pressure(a, b, c, overlap, inner, outer):
    """Return the pressure between two rings a to b and b to c, in plane strain (Lame)."""
    give = 0.0
    for (E, nu), sign, r in ((inner, -1, a), (outer, 1, c)):
        ratio = (b**2 + r**2) / abs(b**2 - r**2)
        give += b * (1 - nu**2) / E * (ratio + sign * nu / (1 - nu))
    return overlap / give


@pytest.mark.parametrize("geometry", ["updated", "reference"])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("counts", [(192, 144), (144, 192), (160, 160)])
def test_shrink_fit_is_lames(counts, swap, geometry):
    """Uniform to 3 % and right to 1 %, whatever the numbers of facets and the slave."""
    a, b, c, overlap = 10.0, 20.0, 30.0, 0.02
    steels = ((200e3, 0.3), (100e3, 0.33))
    domain, tags = rings(COMM, (a, b + overlap), (b, c), counts, (16, 16))
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    inside = mesh.locate_entities(domain, 2, lambda x: np.hypot(x[0], x[1]) < b + overlap / 2)
    values = np.full(domain.topology.index_map(2).size_local, 2, dtype=np.int32)
    values[inside[inside < len(values)]] = 1
    cells = mesh.meshtags(domain, 2, np.arange(len(values), dtype=np.int32), values)
    solid = dm.Solid(fem.Function(V), {k + 1: dm.Elastic(*s) for k, s in enumerate(steels)}, cells)
    slave, master = (3, 2) if swap else (2, 3)
    contact = dm.Contact(tags, slave=slave, master=master, surface="smooth")
    bcs = [*hold(V, a), *hold(V, c)]
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry=geometry)
    dm.newton(problem)
    nodes = contact.gather(problem.u)
    assert np.abs(nodes["gap"]).max() < 1e-5 * overlap
    pressure = nodes["pressure"] / lame_pressure(a, b, c, overlap, *steels)
    assert 0.99 < pressure.mean() < 1.01
    assert np.ptp(pressure) < 0.03


def pin_in_a_hole(counts, swap, surface):
    """Return the report and the slave nodes of a loaded pin with a clearance of 1 %."""
    R, clearance, force = 10.0, 0.1, 5000.0
    domain, tags = rings(COMM, (1.0, R - clearance), (R, 25.0), counts, (8, 12))
    pin = np.hypot(*domain.geometry.x[:, :2].T) < R - clearance / 2
    domain.geometry.x[pin, 1] -= clearance  # it touches at the bottom
    V = fem.functionspace(domain, ("Lagrange", 1, (2,)))
    slave, master = (3, 2) if swap else (2, 3)
    contact = dm.Contact(tags, slave=slave, master=master, surface=surface)
    ds, v = ufl.Measure("ds", domain, subdomain_data=tags), ufl.TestFunction(V)
    length = COMM.allreduce(fem.assemble_scalar(fem.form(fem.Constant(domain, 1.0) * ds(1))))
    outer = fem.locate_dofs_topological(V, 1, tags.find(4))
    W = V.sub(0)
    axis = fem.locate_dofs_geometrical(
        (W, W.collapse()[0]), lambda x: (np.abs(x[0]) < 1e-9) & (np.abs(x[1]) < R / 2)
    )
    bcs = [
        fem.dirichletbc(np.zeros(2), outer, V),
        fem.dirichletbc(fem.Function(W.collapse()[0]), axis, W),
    ]
    solid = dm.Solid(fem.Function(V), dm.Elastic(200e3, 0.3))
    problem = dm.ContactProblem(solid, [contact], bcs=bcs, loads=-force / length * v[1] * ds(1))
    return dm.newton(problem), contact.gather(problem.u)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("counts", [(64, 96), (96, 64)])
def test_a_pin_in_its_hole(counts, swap):
    """Clearance of 1 %: the peak is that of a fine mesh, and no node stays falsely open."""
    report, found = pin_in_a_hole(counts, swap, "smooth")
    assert report.newton_iterations <= 6 and not report.notes
    on = np.degrees(np.abs(np.arctan2(found["X"][:, 0], -found["X"][:, 1]))) < 20.0
    assert found["active"][on].all()
    assert found["pressure"].max() == pytest.approx(PEAK, rel=0.015)


@pytest.mark.parametrize(
    ("counts", "swap", "spoilt"),
    [((64, 96), True, True), ((96, 64), False, True), ((64, 96), False, False)],
)
def test_facets_that_spoil_the_pressures_are_told_of(counts, swap, spoilt):
    """Where the peak is wrong by more than a quarter; and not where it is right to 6 %."""
    report, found = pin_in_a_hole(counts, swap, "facets")
    error = abs(found["pressure"].max() / PEAK - 1.0)
    assert error > 0.25 if spoilt else error < 0.06
    assert any("surface='smooth'" in note for note in report.notes) == spoilt


# with 384 and 512 facets, either slave; between 530.2 and 531.4 on five pairs of meshes, on which
# facets give 531 to 954
PEAK = 531.4


@pytest.mark.mpi
@pytest.mark.parametrize("cell", CELLS)
def test_heights_do_not_depend_on_the_ranks(cell):
    """The fan of a node lies on several of them; master facets come from others."""
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        m = dm.meshing.sphere(comm, h=0.5, cell=cell, core=1.0)
        V = fem.functionspace(m.mesh, ("Lagrange", 1, (3,)))
        bcs = []
        for tag, i in ((1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2), (5, 0), (6, 1)):
            dofs = fem.locate_dofs_topological(V.sub(i), 2, m.facet_tags.find(tag))
            bcs.append(fem.dirichletbc(fem.Constant(m.mesh, 0.0), dofs, V.sub(i)))
        contact = dm.Contact(m.facet_tags, slave=3, master=4, surface="smooth")
        solid = dm.Solid(fem.Function(V), dm.Elastic(1.0, 0.3))
        problem = dm.ContactProblem(solid, [contact], bcs=bcs)
        problem.audit()
        (link,) = problem.system.links
        x = V.tabulate_dof_coordinates()[link.nodes]
        rows = np.column_stack([x, link.coupling.heights])
        rows = np.concatenate(comm.allgather(rows))
        found.append(rows[np.lexsort(np.round(rows[:, :3], 9).T)])
    assert found[0] == pytest.approx(found[1], abs=1e-13)
    assert found[1][:, 3].max() > 1e-3


def test_the_audit_shows_the_choice():
    case = PressedBlocks()
    contacts = [
        dm.Contact(case.facets, slave=3, master=4, surface=surface, feature_angle=30.0)
        for surface in ("smooth", "facets")
    ]
    shown = [str(case.problem([contact]).audit()) for contact in contacts]
    assert "surface='smooth', feature_angle=30" in shown[0] and "surface" not in shown[1]


def test_flat_sides_are_the_same_either_way():
    """To round-off, in the forces of a step with frozen surfaces."""
    found = []
    for surface in ("smooth", "facets"):
        case = PressedBlocks(n_lower=(5, 3), n_upper=(4, 3))
        contact = dm.Contact(case.facets, slave=3, master=4, surface=surface)
        dm.newton(case.problem([contact], geometry="reference"), rtol=1e-11)
        found.append(contact.gather(case.u)["pressure"])
    assert found[0] == pytest.approx(found[1], rel=1e-10, abs=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("swap", [False, True])
def test_an_edge_of_either_side_is_none_of_a_curve(swap):
    """The upper block is tagged around its corners; what it says of them reaches the other side."""
    case = PressedBlocks(n_lower=(5, 3), n_upper=(4, 3))
    m, tags = case.mesh, case.facets
    above = mesh.compute_midpoints(m, 1, tags.indices)[:, 1] > 1e-9
    values = np.where(above & (tags.values != TOP), BOTTOM_OF_UPPER, tags.values)
    around = mesh.meshtags(m, 1, tags.indices, values.astype(np.int32))
    slave, master = (BOTTOM_OF_UPPER, TOP_OF_LOWER) if swap else (TOP_OF_LOWER, BOTTOM_OF_UPPER)
    contact = dm.Contact(around, slave=slave, master=master, surface="smooth")
    problem = case.problem([contact])
    problem.audit()
    heights = problem.system.links[0].coupling.heights
    assert np.abs(heights).max(initial=0.0) < 1e-14


@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
@pytest.mark.parametrize("bad", ["spline", None, 1])
def test_bad_surface(bad, kind):
    with rejected("surface is", "'smooth' or 'facets'"):
        kind(polygon_tags(), slave=1, master=2, surface=bad)


@pytest.mark.parametrize("kind", [dm.Contact, dm.Tie])
@pytest.mark.parametrize("bad", [0.0, -1.0, 181.0, np.nan, "40", True, None])
def test_bad_feature_angle(bad, kind):
    with rejected("feature_angle is", "degrees"):
        kind(polygon_tags(), slave=1, master=2, feature_angle=bad)


def polygon_tags():
    """Return tags of something."""
    m = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    none = np.empty(0, dtype=np.int32)
    return mesh.meshtags(m, 1, none, none)
