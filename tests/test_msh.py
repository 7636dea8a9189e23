"""Meshes from files of Gmsh: bodies and sides by their names, and files that are refused."""

import sys

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from dolfinx_mortar.compat import cell_degree
from tests.cases.integrals import integral
from tests.cases.msh_files import boxes, disc, folder, msh_file, squares

COMM = MPI.COMM_WORLD
pytest.importorskip("gmsh")


def sizes(mesh, tags, measure):
    """Return length, area or volume by name."""
    one = fem.Constant(mesh, 1.0)
    d = ufl.Measure(measure, mesh, subdomain_data=tags)
    return {name: integral(one * d(tags.tag(name))) for name in tags.names}


@pytest.mark.mpi
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"ElementOrder": 2, "Binary": 1},
        {"RecombineAll": 1, "MshFileVersion": 2.2},
        {"RecombineAll": 1, "ElementOrder": 2, "MshFileVersion": 2.2, "Binary": 1},
    ],
)
def test_bodies_and_sides_in_the_plane_have_their_names(options):
    with msh_file(squares, **options) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file, COMM)
    assert mesh.geometry.dim == mesh.topology.dim == 2
    assert cell_degree(mesh) == options.get("ElementOrder", 1)
    cell = "quadrilateral" if "RecombineAll" in options else "triangle"
    assert mesh.topology.cell_name() == cell
    assert cell_tags.names == {"low": 11, "up": 12}
    assert facet_tags.names == {"bottom": 3, "slave": 5, "master": 7}
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 1.5, "up": 1.0})
    lengths = {"bottom": 1.5, "slave": 1.0, "master": 1.5}
    assert sizes(mesh, facet_tags, "ds") == pytest.approx(lengths)
    assert COMM.allreduce(len(facet_tags.find(9))) > 0
    assert (facet_tags.find("slave") == facet_tags.find(5)).all()


@pytest.mark.mpi
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_bodies_in_space(order, hexahedra):
    recombine = {"RecombineAll": 1, "Recombine3DAll": 1} if hexahedra else {}
    with msh_file(lambda m: boxes(m, hexahedra=hexahedra), ElementOrder=order, **recombine) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(str(file))
    assert mesh.topology.cell_name() == ("hexahedron" if hexahedra else "tetrahedron")
    assert cell_degree(mesh) == order
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"ball": 1.0, "plate": 1.0})
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"ball": 1.0, "between": 2.0})


def test_second_order_is_curved():
    area = []
    for order in (1, 2):
        with msh_file(disc, ElementOrder=order, MeshSizeMax=0.25) as file:
            mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
        area.append(sizes(mesh, cell_tags, "dx")["disc"])
        assert not facet_tags.names and not COMM.allreduce(len(facet_tags.values))
    error = np.abs(np.array(area) - np.pi / 4)
    assert error[1] < 1e-4 < 1e-3 < error[0]


def test_numbers_of_nodes_may_have_gaps():
    def draw(model):
        model.occ.addRectangle(3.0, 0.0, 0.0, 1.0, 1.0)
        model.occ.synchronize()
        model.mesh.generate(2)
        count = len(model.mesh.getNodes()[0])
        model.mesh.renumberNodes(np.arange(1, count + 1), 7 * np.arange(1, count + 1))
        model.addPhysicalGroup(2, [1], 1, "body")

    with msh_file(draw) as file:
        mesh, cell_tags, _ = dm.meshing.read_msh(file)
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"body": 1.0})


@pytest.mark.mpi
def test_ranks_that_own_nothing():
    """Two cells in all, which a picture shows, too."""

    def draw(model):
        for k in (0, 1):
            model.occ.addRectangle(0.0, 2.0 * k, 0.0, 1.0, 1.0)
        model.occ.synchronize()
        for _, curve in model.getEntities(1):
            model.mesh.setTransfiniteCurve(curve, 2)
        for k, name in ((1, "low"), (2, "up")):
            model.mesh.setTransfiniteSurface(k)
            model.addPhysicalGroup(2, [k], k, name)
        model.addPhysicalGroup(1, [3], 3, "top")
        model.mesh.generate(2)

    with msh_file(draw, RecombineAll=1) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    assert mesh.topology.index_map(2).size_global == 2
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 1.0, "up": 1.0})
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"top": 1.0})
    axes = dm.plotting.mesh(mesh, cell_tags, facet_tags)
    if COMM.rank == 0:
        assert [len(drawn.get_paths()) for drawn in axes.collections] == [1, 1, 1]


@pytest.mark.mpi
def test_groups_of_one_name_are_one():
    """Gmsh gives a name once, and leaves the other group without one, which is told."""
    with msh_file(squares) as file:
        if COMM.rank == 0:
            text = file.read_text()
            for old, new in (('2 12 "up"', '2 12 "low"'), ('1 7 "master"', '1 7 "slave"')):
                text = text.replace(old, new)
            file.write_text(text)
        COMM.Barrier()
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 2.5})
    assert facet_tags.names == {"bottom": 3, "slave": 5}
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"bottom": 1.5, "slave": 2.5})


def test_a_group_that_has_lost_its_name_is_told(caplog):
    def draw(model):
        squares(model)
        model.addPhysicalGroup(1, [8], 41, "bottom")

    with msh_file(draw) as file:
        facet_tags = dm.meshing.read_msh(file).facet_tags
    assert COMM.allreduce(len(facet_tags.find(41))) > 0
    if COMM.rank == 0:
        assert "without a name, of dimension 1: 9, 41" in caplog.text


def cut(model):
    """Draw the squares, in partitions."""
    squares(model)
    model.mesh.partition(2)


@pytest.mark.mpi
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_partitions_of_a_file_are_left_out(version):
    options = {"MshFileVersion": version, "PartitionCreateGhostCells": 1}
    with msh_file(squares) as file:
        whole = dm.meshing.read_msh(file)
    with msh_file(cut, **options) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    for d in (0, 2):
        counts = [m.topology.index_map(d).size_global for m in (mesh, whole.mesh)]
        assert counts[0] == counts[1] > 0
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"low": 1.5, "up": 1.0})
    lengths = {"bottom": 1.5, "slave": 1.0, "master": 1.5}
    assert sizes(mesh, facet_tags, "ds") == pytest.approx(lengths)


MESHIO = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
4
1 3 "right of a"
1 4 "left of b"
2 1 "a"
2 2 "b"
$EndPhysicalNames
$Nodes
8
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
5 2 0 0
6 4 0 0
7 4 1 0
8 2 1 0
$EndNodes
$Elements
4
1 3 2 1 0 1 2 3 4
2 3 2 2 0 5 6 7 8
3 1 2 3 0 2 3
4 1 2 4 0 5 8
$EndElements
"""


@pytest.mark.mpi
def test_version_2_without_tags_of_geometry():
    """As meshio writes it, with 0 for the elementary tags."""
    with folder() as there:
        file = there / "case.msh"
        if COMM.rank == 0:
            file.write_text(MESHIO)
        COMM.Barrier()
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file)
    assert (cell_tags.names, facet_tags.names) == (
        {"a": 1, "b": 2},
        {"right of a": 3, "left of b": 4},
    )
    assert sizes(mesh, cell_tags, "dx") == pytest.approx({"a": 1.0, "b": 2.0})
    assert sizes(mesh, facet_tags, "ds") == pytest.approx({"right of a": 1.0, "left of b": 1.0})


@pytest.mark.mpi
def test_a_contact_problem_in_names():
    """Two bars under uniform pressure, E d / 2; gmsh is as it was found, and not running."""
    with msh_file(squares, RecombineAll=1) as file:
        mesh, cell_tags, facet_tags = dm.meshing.read_msh(file, COMM)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u = fem.Function(V)
    laws = {"low": dm.Elastic(E=100.0, nu=0.0), 12: dm.Elastic(E=200.0, nu=0.0)}
    solid = dm.Solid(u, laws, cell_tags, eigenstrain={"low": 0.0, "up": 0.0})
    bottom = fem.locate_dofs_topological(V, 1, facet_tags.find("bottom"))
    top = fem.locate_dofs_topological(V, 1, facet_tags.find(9))
    push = np.array([0.0, -0.01])
    bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(push, top, V)]
    force = {}
    for slave, master in (("slave", "master"), (5, 7), ("master", 5)):
        u.x.array[:] = 0.0
        contact = dm.Contact(facet_tags, slave=slave, master=master)
        problem = dm.ContactProblem(solid, [contact], bcs=bcs, geometry="reference")
        dm.newton(problem, rtol=1e-10)
        force[slave] = contact.force[1]
    assert force["slave"] == pytest.approx(force[5], rel=1e-12)
    assert force["slave"] == pytest.approx(-force["master"], rel=0.05)
    assert repr(contact) == "Contact(slave='master', master='slave')"
    assert repr(dm.Tie(facet_tags, slave=9, master="slave")) == "Tie(slave=9, master='slave')"
    assert "slave='master', master='slave'" in str(problem.audit())
    D = dm.assemble_mortar(V, facet_tags, slave="slave", master="master").D
    assert D.norm() == dm.assemble_mortar(V, facet_tags, slave=5, master=7).D.norm() > 0


# -- files that are refused -----------------------------------------------------------------------


def refused(draw, *words, **options):
    """Expect the words in an error on every rank."""
    with msh_file(draw, **options) as file, pytest.raises(ValueError) as error:
        dm.meshing.read_msh(file, COMM)
    assert all(word in str(error.value) for word in ("case.msh", *words)), str(error.value)


@pytest.mark.mpi
def test_files_that_are_none():
    with folder() as there:
        with pytest.raises(OSError, match=r"no\.msh.* no such file"):
            dm.meshing.read_msh(there / "no.msh")
        with pytest.raises(OSError, match="no such file"):
            dm.meshing.read_msh(there)
        geo, cut = there / "case.geo", there / "cut.msh"
        if COMM.rank == 0:
            geo.write_text("Point(1) = {0, 0, 0};")
            cut.write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 5 1 5\n2 1")
        COMM.Barrier()
        with pytest.raises(ValueError, match=r"case\.geo.* no mesh of Gmsh.*gmsh -3"):
            dm.meshing.read_msh(geo)
        with pytest.raises(ValueError, match=r"cut\.msh.* damaged: gmsh says"):
            dm.meshing.read_msh(cut)


@pytest.mark.mpi
def test_arguments_that_are_none():
    with pytest.raises(ValueError, match=r"comm is None: give a communicator"):
        dm.meshing.read_msh("case.msh", None)
    with pytest.raises(ValueError, match="path is None: give the name of a file"):
        dm.meshing.read_msh(None)


def forgotten(model):
    """Draw the squares, the upper of which is in no group, but sides of it are."""
    squares(model)
    model.removePhysicalGroups([(2, 12), (1, 9)])


def forgotten_in_part(model):
    """The same, of one group of sides for both."""
    forgotten(model)
    model.removePhysicalGroups([(1, 5)])
    model.addPhysicalGroup(1, [4, 8], 21, "left")


def section(model):
    """Draw boxes and a plane beside them."""
    boxes(model)
    plane = model.occ.addRectangle(2.0, 0.0, 0.0, 1.0, 1.0)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [plane], 9, "plane")
    model.mesh.clear()
    model.mesh.generate(3)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("draw", "options", "words"),
    [
        (forgotten, {}, ["4 of the 4", "'slave'", "give it a physical surface"]),
        (forgotten_in_part, {"ElementOrder": 2}, ["4 of the 8", "'left'"]),
        (section, {}, ["'plane'", "dimension 2", "physical volume", "out of the groups"]),
        (section, {"ElementOrder": 2}, ["'plane'"]),
    ],
)
def test_sides_that_bound_no_body(draw, options, words):
    """Dolfinx ends the process at these."""
    refused(draw, "are no facets of a body", *words, **options)


@pytest.mark.mpi
def test_a_file_without_groups():
    def draw(model):
        model.occ.addRectangle(0, 0, 0, 1, 1)
        model.occ.synchronize()
        model.mesh.generate(2)

    refused(draw, "no physical groups", "addPhysicalGroup")


@pytest.mark.mpi
@pytest.mark.parametrize("entities", [[], [99]])
def test_an_empty_group(entities):
    """With a name alone, or with an entity that has no elements."""

    def draw(model):
        squares(model)
        for entity in entities:
            model.addDiscreteEntity(1, entity)
        model.addPhysicalGroup(1, entities, 21, "nothing")

    refused(draw, "'nothing'", "empty", "dimension 1")


def test_volumes_that_were_not_meshed():
    def draw(model):
        model.occ.addBox(0, 0, 0, 1, 1, 1)
        model.occ.synchronize()
        model.addPhysicalGroup(3, [1], 1, "ball")
        model.addPhysicalGroup(2, [1], 2, "side")
        model.mesh.generate(2)

    refused(draw, "'ball'", "empty", "gmsh -3")


@pytest.mark.mpi
def test_mixed_cells():
    def draw(model):
        for x in (0.0, 2.0):
            model.occ.addRectangle(x, 0, 0, 1, 1)
        model.occ.synchronize()
        model.mesh.setRecombine(2, 1)
        model.mesh.setTransfiniteSurface(1)
        model.addPhysicalGroup(2, [1, 2], 1, "bodies")
        model.mesh.generate(2)

    refused(draw, "mixes cells", "Quad", "Triangle")


def test_cells_of_unknown_kinds():
    refused(squares, "Triangle 10", "not supported", ElementOrder=3)
    serendipity = {"RecombineAll": 1, "ElementOrder": 2, "SecondOrderIncomplete": 1}
    refused(squares, "Quadrilateral 8", "SecondOrderIncomplete 0", **serendipity)


@pytest.mark.mpi
def test_a_mesh_of_lines():
    def draw(model):
        model.occ.addLine(model.occ.addPoint(0, 0, 0), model.occ.addPoint(1, 0, 0))
        model.occ.synchronize()
        model.addPhysicalGroup(1, [1], 1, "bar")
        model.mesh.generate(1)

    refused(draw, "dimension 1", "physical surface or volume")


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize(("dim", "entity", "first"), [(2, 1, "low"), (1, 5, "slave")])
def test_what_is_in_two_groups(version, dim, entity, first):
    def draw(model):
        squares(model)
        model.addPhysicalGroup(dim, [entity], 31, "all")

    refused(
        draw,
        f"'{first}' and 'all'",
        "two physical groups",
        "do not fragment",
        MshFileVersion=version,
    )


def test_elements_that_are_there_twice():
    def draw(model):
        squares(model)
        nodes = model.mesh.getElements(2, 1)[2][0]
        model.addDiscreteEntity(2, 50)
        model.mesh.addElementsByType(50, 2, [], nodes)
        model.removePhysicalGroups([(2, 11)])
        model.addPhysicalGroup(2, [1, 50], 11, "low")

    refused(draw, "'low' are in the file twice")


def test_bodies_without_a_group():
    def draw(model):
        squares(model)
        model.removePhysicalGroups([(2, 12)])

    refused(draw, "cells of dimension 2 are in no physical group", SaveAll=1)

    def sides_only(model):
        boxes(model)
        model.removePhysicalGroups([(3, 1), (3, 2)])

    refused(sides_only, "cells of dimension 3 are in no physical group", "volume", SaveAll=1)


def test_surfaces_in_space():
    refused(lambda m: squares(m, z=0.5), "plane z = 0", "z from 0.5 to 0.5")

    def sides_only(model):
        boxes(model)
        model.removePhysicalGroups([(3, 1), (3, 2)])

    refused(sides_only, "plane z = 0", "physical volumes")


@pytest.mark.serial
def test_without_gmsh_the_error_names_the_extra(monkeypatch):
    with msh_file(squares) as file:
        monkeypatch.setitem(sys.modules, "gmsh", None)
        with pytest.raises(RuntimeError, match=r"gmsh is not installed.*dolfinx_mortar\[demo\]"):
            dm.meshing.read_msh(file)
