# SPDX-License-Identifier: MIT
"""The Hertz meshes: areas, tags, symmetry, separation of the bodies, sizes."""

from mpi4py import MPI

import numpy as np
import pytest
from scipy.spatial import cKDTree

import ufl
from dolfinx import fem, mesh
from dolfinx_mortar import meshing
from dolfinx_mortar.meshing import two_bodies
from tests.cases.integrals import integral

COMM = MPI.COMM_WORLD
CELLS = ["triangle", "quadrilateral"]


def owned_counts(m: meshing.TaggedMesh) -> list[int]:
    owned = m.mesh.topology.index_map(2).size_local
    return [COMM.allreduce(int(np.sum(m.cell_tags.values[:owned] == tag))) for tag in (1, 2)]


def nodes_and_cells(m: meshing.TaggedMesh) -> tuple[np.ndarray, np.ndarray]:
    V = fem.functionspace(m.mesh, ("Lagrange", 1))
    return V.tabulate_dof_coordinates()[:, :2], V.dofmap.list


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("kind", ["paper", "graded"])
def test_areas_lengths_and_flux_of_tagged_parts(kind, cell):
    m = meshing.hertz(COMM, kind=kind, h=0.3, radius=6.0, block=(20.0, 8.0), gap=0.25, cell=cell)
    one = fem.Constant(m.mesh, 1.0)
    dx = ufl.Measure("dx", m.mesh, subdomain_data=m.cell_tags)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    assert integral(one * dx(m.cell_tags.tag("block"))) == pytest.approx(160.0, rel=1e-12)
    assert integral(one * dx(m.cell_tags.tag("disc"))) == pytest.approx(np.pi * 18.0, rel=2e-2)
    lengths = [integral(one * ds(tag)) for tag in (1, 2, 3, 4)]
    assert lengths[:3] == pytest.approx([20.0, 12.0, 20.0], rel=1e-12)
    assert lengths[3] == pytest.approx(np.pi * 6.0, rel=1e-2)
    n_y = ufl.FacetNormal(m.mesh)[1]
    flux = [integral(n_y * ds(tag)) for tag in (1, 2, 3, 4)]  # outward: bottom down, arc down
    assert flux == pytest.approx([-20.0, 12.0, 20.0, -12.0], rel=1e-12)


def test_paper_counts():
    block, disc = owned_counts(meshing.hertz(COMM))
    assert block == 2720
    assert disc == pytest.approx(1200, rel=0.02)


@pytest.mark.parametrize("gap", [0.0, -0.05])
def test_bodies_share_no_node_and_both_have_the_contact_point(gap):
    m = meshing.hertz(COMM, kind="graded", h=0.2, gap=gap)
    dofmap = fem.functionspace(m.mesh, ("Lagrange", 1))
    x = dofmap.tabulate_dof_coordinates()[:, :2]
    owned = dofmap.dofmap.index_map.size_local
    body = np.zeros((2, len(x)), dtype=bool)
    for i in (0, 1):
        body[i, dofmap.dofmap.list[m.cell_tags.find(i + 1)]] = True
    assert not np.any(body[0] & body[1])
    for i, y in ((0, 0.0), (1, gap)):
        here = body[i, :owned] & (np.abs(x[:owned] - [0.0, y]).max(axis=1) < 1e-12)
        assert COMM.allreduce(int(here.sum())) == 1


@pytest.mark.parametrize("cell", CELLS)
def test_mesh_is_symmetric(cell):
    m = meshing.hertz(MPI.COMM_SELF, kind="graded", h=0.2, gap=0.1, cell=cell)
    x, cells = nodes_and_cells(m)
    for points in (x, x[cells].mean(axis=1)):
        distance, image = cKDTree(points).query(points * [-1.0, 1.0])
        assert distance.max() < 1e-12
        assert np.array_equal(np.sort(image), np.arange(len(points)))


@pytest.mark.parametrize("cell", CELLS)
def test_half_is_half_of_the_whole(cell):
    options = {"kind": "graded", "h": 0.3, "radius": 6.0, "block": (20.0, 8.0), "gap": 0.25}
    m = meshing.hertz(COMM, half=True, cell=cell, **options)
    one, ds = fem.Constant(m.mesh, 1.0), ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    lengths = [integral(one * ds(tag)) for tag in (1, 2, 3, 5)]
    assert lengths == pytest.approx([10.0, 6.0, 10.0, 14.0], rel=1e-12)
    assert integral(one * ds(4)) == pytest.approx(np.pi * 3.0, rel=1e-2)
    (x, cells), (whole, all_cells) = (
        nodes_and_cells(meshing.hertz(MPI.COMM_SELF, half=half, cell=cell, **options))
        for half in (True, False)
    )
    assert m.mesh.geometry.x[:, 0].min(initial=0.0) == 0.0
    assert 2 * len(cells) == len(all_cells)
    assert len(x) == np.sum(whole[:, 0] > -1e-12)
    assert cKDTree(whole).query(x)[0].max() < 1e-12


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("limit", [10.0, 4.0])
def test_graded_sizes(cell, limit):
    h = 0.1
    m = meshing.hertz(MPI.COMM_SELF, kind="graded", h=h, cell=cell, limit=limit)
    m.mesh.topology.create_entities(1)
    edges = np.arange(m.mesh.topology.index_map(1).size_local, dtype=np.int32)
    ends = m.mesh.geometry.x[mesh.entities_to_geometry(m.mesh, 1, edges)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    r = np.linalg.norm(ends.mean(axis=1), axis=1)
    size = h * np.clip(1 + r - 2.5, 1.0, limit)
    assert np.median(length / size) == pytest.approx(1.0, abs=0.1)
    near = r < 2.5
    assert length[near].max() < 1.6 * h
    assert length[near].min() > 0.4 * h
    # no sliver: area against the longest edge of each cell
    x, cells = nodes_and_cells(m)
    a, b = x[cells[:, 1]] - x[cells[:, 0]], x[cells[:, 2]] - x[cells[:, 0]]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    longest = m.mesh.h(2, np.arange(len(cells), dtype=np.int32))
    assert (area / longest**2).min() > 0.1


@pytest.mark.serial
def test_a_running_gmsh_is_left_as_it_was(monkeypatch):
    """Its options and its current model, also if the meshing fails; nothing of theirs is used."""
    import gmsh

    alone = meshing.hertz(COMM, kind="graded", h=0.6, cell="quadrilateral").mesh.geometry.x
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        theirs = {"Mesh.MeshSizeMax": 0.3, "Mesh.Algorithm": 5.0, "General.Terminal": 0.0}
        theirs |= {"Mesh.Algorithm3D": 4.0, "Mesh.MeshSizeFromCurvature": 12.0}
        for name, value in theirs.items():
            gmsh.option.setNumber(name, value)
        gmsh.model.add("theirs")
        for cell in ("quadrilateral", "triangle"):
            found = meshing.hertz(COMM, kind="graded", h=0.6, cell=cell).mesh.geometry.x
            assert cell == "triangle" or np.array_equal(found, alone)
        meshing.sphere(COMM, h=1.0, cell="tetrahedron")
        monkeypatch.setattr(two_bodies, "read_cells", lambda *_: 1 / 0)
        with pytest.raises(RuntimeError, match="gmsh failed"):
            meshing.hertz(COMM, kind="graded", h=0.6)
        assert gmsh.model.getCurrent() == "theirs" and len(gmsh.model.list()) == 2  # and an empty
        assert {name: gmsh.option.getNumber(name) for name in theirs} == theirs
    finally:
        gmsh.finalize()


def test_meshing_is_deterministic_and_silent(capfd):
    first, second = (meshing.hertz(MPI.COMM_SELF, kind="graded", h=0.3) for _ in range(2))
    assert np.array_equal(first.mesh.geometry.x, second.mesh.geometry.x)
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"kind": "fine"}, "kind"),
        ({"kind": None}, "kind"),
        ({"cell": "tetrahedron"}, "cell"),
        ({"h": 0.0}, "h"),
        ({"h": np.nan}, "h"),
        ({"h": (0.1, -1.0)}, "h"),
        ({"h": "0.1"}, "h"),
        ({"h": (0.1, 0.2, 0.3)}, "h"),
        ({"kind": "graded", "h": 5.0}, "h"),
        ({"radius": -8.0}, "radius"),
        ({"radius": (8.0,)}, "radius"),
        ({"block": (30.0, 0.0)}, "block"),
        ({"block": 30.0}, "block"),
        ({"block": (30.0, 30.0, 10.0)}, "block"),
        ({"limit": 1.0}, "limit"),
        ({"limit": "10"}, "limit"),
        ({"core": 0.0}, "core"),
        ({"gap": np.inf}, "gap"),
        ({"gap": None}, "gap"),
        ({"gap": -8.0}, "gap"),  # the block reaches the flat face
        ({"gap": -2.5, "block": (30.0, 2.5)}, "gap"),  # the disc reaches the bottom
    ],
)
def test_bad_input_is_named_on_all_ranks(arguments, name, monkeypatch):
    monkeypatch.setattr(two_bodies, "distribute", pytest.fail)
    with pytest.raises(ValueError, match=f"^{name} is "):
        meshing.hertz(COMM, **arguments)


@pytest.mark.mpi
def test_bad_input_of_one_rank_is_an_error_on_all():
    last = COMM.rank == COMM.size - 1
    with pytest.raises(ValueError, match=r"^gap is nan"):
        meshing.hertz(COMM, gap=np.nan if last else 0.0)
    if COMM.size > 1:
        with pytest.raises(ValueError, match=r"^radius differs between the ranks: 8.0 on rank 0"):
            meshing.hertz(COMM, radius=9.0 if last else 8.0)


@pytest.mark.parametrize(
    "arguments",
    [
        {"h": np.float32(0.5)},
        {"h": [0.5, 1]},
        {"h": np.array([0.5, 0.6])},
        {"radius": 8, "block": [30, 10], "gap": np.int64(0)},
    ],
)
def test_numbers_of_any_kind_are_welcome(arguments):
    assert owned_counts(meshing.hertz(COMM, kind="graded", **{"h": 0.6} | arguments))[0] > 0


@pytest.mark.parametrize(
    ("radius", "block", "gap"),
    [
        (8.0, (30.0, 10.0), -7.99),
        (8.0, (30.0, 10.0), 8e3),
        (1e-7, (30.0, 10.0), 0.0),  # the disc is smaller than the round-off of a common scale
        (1e6, (30.0, 10.0), -1.0),
        (8e-6, (30e-6, 10e-6), 1e-7),
    ],
)
def test_no_gap_and_no_size_swallows_a_tag(radius, block, gap):
    m = meshing.hertz(COMM, radius=radius, block=block, gap=gap)
    one = fem.Constant(m.mesh, 1.0)
    ds = ufl.Measure("ds", m.mesh, subdomain_data=m.facet_tags)
    lengths = [integral(one * ds(tag)) for tag in (1, 2, 3)]
    assert lengths == pytest.approx([block[0], 2 * radius, block[0]], rel=1e-9)
    assert integral(one * ds(4)) == pytest.approx(np.pi * radius, rel=1e-2)


@pytest.mark.parametrize("factor", [0.0, 0.5, 2.0, 1e8])
def test_tags_do_not_hang_on_a_tolerance(factor, monkeypatch):
    """Half and twice as much change nothing; none at all, or the size of a body, does."""
    options = {"gap": 0.1} if factor < 3.0 else {"h": 1.0, "core": 2.0}
    make = meshing.hertz if factor < 3.0 else meshing.sphere  # which has nothing to mirror
    before = count_tags(make(COMM, **options).facet_tags)
    monkeypatch.setattr(two_bodies, "HALF_OF_DIGITS", factor * two_bodies.HALF_OF_DIGITS)
    after = count_tags(make(COMM, **options).facet_tags)
    assert np.array_equal(before, after) == (factor in (0.5, 2.0))


def count_tags(tags):
    """Return how many facets of all ranks have each tag; another mesh may be split otherwise."""
    owned = tags.values[tags.indices < tags.topology.index_map(tags.dim).size_local]
    return COMM.allreduce(np.bincount(owned, minlength=7))
