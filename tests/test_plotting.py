"""Pictures: what is drawn where, on any number of ranks, and what is refused."""

import subprocess
import sys

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
import ufl
from dolfinx import fem
from tests.cases.hertz import ELASTIC, create_case, create_mesh
from tests.cases.meshes import two_blocks
from tests.cases.msh_files import folder
from tests.cases.pressed_blocks import PressedBlocks

COMM = MPI.COMM_WORLD
FIRST = COMM.rank == 0
pyplot = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture(autouse=True)
def no_figures_left():
    yield
    pyplot.close("all")


def pressed(cell="triangle", degree=1):
    case = create_case(create_mesh("graded", 0.5, cell=cell), ELASTIC, degree=degree)
    case.press(0.05)
    dm.newton(case.problem)
    return case


def area(polygons):
    """Return the sum of the areas (m,) of polygons (m, k, 2)."""
    x, y = np.moveaxis(polygons, 2, 0)
    return 0.5 * np.abs((x * np.roll(y, -1, 1) - y * np.roll(x, -1, 1)).sum(axis=1)).sum()


def polygons(collection):
    return np.array([path.vertices[:-1] for path in collection.get_paths()])


@pytest.mark.mpi
def test_a_mesh_shows_bodies_and_sides_by_name():
    mesh = create_mesh("graded", 0.5)
    ax = dm.plotting.mesh(*mesh)
    assert (ax is None) != FIRST
    if FIRST:
        names = [text.get_text() for text in ax.get_legend().get_texts()]
        assert names == ["block", "disc", "bottom", "flat", "top", "arc"]
        block, disc, bottom, *_ = ax.collections
        assert area(polygons(block)) == pytest.approx(300.0)
        assert 80.0 < area(polygons(disc)) < np.pi * 32.0
        ends = np.array([path.vertices for path in bottom.get_paths()])
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(30.0)
        assert ends[:, :, 1] == pytest.approx(-10.0)


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "degree"), [("triangle", 2), ("quadrilateral", 1)])
def test_a_field_of_cells_lies_on_the_deformed_bodies(cell, degree):
    """Colours are the cell averages, their cells those at X + scale u, with curved edges."""
    case = pressed(cell, degree)
    solid, u = case.problem.solid, case.problem.u
    scale = 3.0
    ax = dm.plotting.field(case.problem, "von_mises", scale=scale)
    values = solid.cell_values("von_mises")
    owned = values.function_space.dofmap.index_map.size_local
    every = np.concatenate(COMM.allgather(values.x.array[:owned]))
    V = u.function_space
    x = V.tabulate_dof_coordinates()[:, :2] + scale * u.x.array.reshape(-1, 2)
    x = np.concatenate(COMM.allgather(x[: V.dofmap.index_map.size_local]))
    if FIRST:
        (drawn,) = ax.collections
        assert np.sort(np.asarray(drawn.get_array())) == pytest.approx(np.sort(every), rel=1e-12)
        corners = polygons(drawn)
        sides = 3 if cell == "triangle" else 4
        assert corners.shape == (len(every), sides * degree, 2)
        nodes = {tuple(p) for p in np.round(x, 9)}
        assert {tuple(p) for p in np.round(corners.reshape(-1, 2), 9)} <= nodes
        assert ax.figure.axes[1].get_ylabel() == "von_mises"
    flat = dm.plotting.field(case.problem, "von_mises", scale=0.0)
    one = fem.Constant(V.mesh, 1.0)
    whole = COMM.allreduce(fem.assemble_scalar(fem.form(one * ufl.dx)))
    if FIRST:
        around = polygons(flat.collections[0])
        assert area(around) == pytest.approx(whole, rel=1e-12)


@pytest.mark.mpi
def test_displacements_are_shaded():
    case = pressed("quadrilateral", 2)
    case.problem.u.interpolate(lambda x: np.stack([3.0 * x[0], 4.0 * x[1]]))
    for name in ("displacement", "displacement_y"):
        ax = dm.plotting.field(case.problem.solid, name, scale=0.0)
        if FIRST:
            drawn = ax.collections[0]  # a mesh of triangles with values at its nodes
            x, y = drawn._triangulation.x, drawn._triangulation.y
            wanted = 4.0 * y if name[-1] == "y" else np.hypot(3.0 * x, 4.0 * y)
            assert np.asarray(drawn.get_array()) == pytest.approx(wanted, abs=1e-9)
            corners = np.stack([x, y], axis=1)[drawn._triangulation.triangles]
            assert area(corners) == pytest.approx(area(polygons(ax.collections[1])), rel=1e-9)


@pytest.mark.mpi
def test_pressure_along_the_interface():
    """Facet by facet between the slave nodes; under it lies the force."""
    case, degree = pressed(degree=2), 2
    nodes = case.contact.gather(case.problem.u)
    ax = dm.plotting.pressure(case.problem)
    force = case.force
    if FIRST:
        (line,) = ax.get_lines()
        s, p = (np.reshape(values, (-1, degree + 2)) for values in line.get_data())
        assert np.isnan(s[:, -1]).all() and np.isnan(p[:, -1]).all()
        s, p = s[:, :-1], p[:, :-1]
        assert (np.abs(np.diff(np.sign(np.diff(s, axis=1)), axis=1)) == 0.0).all()  # along lines
        found = {(round(x, 9), round(y, 6)) for x, y in zip(s.flat, p.flat, strict=True)}
        x = nodes["x"][:, 0]
        assert found == {
            (round(a, 9), round(b, 6)) for a, b in zip(x, nodes["pressure"], strict=True)
        }
        assert abs(np.trapezoid(p, s, axis=1)).sum() == pytest.approx(force, rel=0.1)
        assert ax.get_xlabel() == "x"


@pytest.mark.mpi
def test_what_is_drawn_of_a_tie_is_its_normal_traction():
    """The stress of a bar that is pulled, which is no pressure; positive in compression."""
    case = PressedBlocks(degree=2, order=2)
    case.top.value[1] = 0.02
    problem = case.problem([case.tie()], law=dm.Elastic(E=100.0, nu=0.0))
    dm.newton(problem)
    ax = dm.plotting.pressure(problem)  # nothing else is there
    if FIRST:
        assert ax.get_ylabel() == "normal traction"
        (line,) = ax.get_lines()
        drawn = line.get_ydata()
        assert drawn[~np.isnan(drawn)] == pytest.approx(-1.0, rel=1e-9)


@pytest.mark.mpi
def test_pictures_are_written_and_axes_shared():
    case = pressed()
    with folder() as there:
        for draw in (
            lambda **to: dm.plotting.mesh(*create_mesh("graded", 0.5), **to),
            lambda **to: dm.plotting.field(case.problem, "stress_yy", **to),
            lambda **to: dm.plotting.pressure(case.problem, case.contact, **to),
        ):
            file = there / "a.png"
            ax = draw(file=str(file))
            COMM.Barrier()
            assert file.stat().st_size > 5000
            COMM.Barrier()
            if FIRST:
                file.unlink()
                ax.clear()
            assert draw(ax=ax) is ax


# -- what is refused ------------------------------------------------------------------------------


@pytest.mark.mpi
def test_wrong_arguments():
    case, (other, *_) = pressed(), two_blocks(COMM, (2, 1), (1, 1))
    problem, tags = case.problem, case.contact.facet_tags
    tie = dm.Tie(tags, slave=3, master=4)
    unpack = r"unpack what a reader returns, mesh\(\*found\)"
    moved = "choose 'displacement', 'displacement_x'"
    for call, said in (
        (lambda: dm.plotting.mesh((other, None, None)), unpack),
        (lambda: dm.plotting.mesh(other, view=(0, 1, 0)), r"view is \(0, 1, 0\): for bodies"),
        (lambda: dm.plotting.mesh(problem.solid.mesh, tags), "cell_tags.*dimension 2"),
        (
            lambda: dm.plotting.field(problem, "von_misses"),
            "name is 'von_misses': choose .*von_mises",
        ),
        (lambda: dm.plotting.field(problem, "displacement_z"), moved),
        (lambda: dm.plotting.pressure(None), "problem is None: give a ContactProblem"),
        (lambda: dm.plotting.pressure(problem, file=5), "file is 5: give the name of a picture"),
        (lambda: dm.plotting.pressure(problem, tie), r"interfaces is \[Tie\(.*no contact or tie"),
        (lambda: dm.plotting.pressure(dm.ContactProblem(problem.solid)), "no contact or tie"),
    ):
        with pytest.raises(ValueError, match=said):
            call()
    fresh = create_case(create_mesh("graded", 0.5), ELASTIC)
    with pytest.raises(RuntimeError, match="solve a step first"):
        dm.plotting.pressure(fresh.problem)
    with pytest.raises(OSError, match="nowhere"):  # on all ranks
        dm.plotting.mesh(*create_mesh("graded", 0.5), file="/nowhere/at/all/a.png")


@pytest.mark.serial
def test_the_library_starts_without_companions_and_what_draws():
    """They are imported when they are first used, not at the start."""
    code = (
        "import sys, dolfinx_mortar as dm; print([m for m in sys.argv[1:] if m in sys.modules]);"
        "assert {'analytic', 'meshing', 'plotting'} < {*dir(dm)} and dm.analytic.hertz_line"
    )
    companions = [f"dolfinx_mortar.{name}" for name in ("analytic", "meshing", "plotting")]
    foreign = [
        "matplotlib",
        "pyvista",
        "vtk",
        "gmsh",
        "meshio",
        "h5py",
        "scipy.sparse",
        "scipy.spatial",
    ]
    run = [sys.executable, "-c", code, *companions, *foreign]
    assert subprocess.run(run, capture_output=True, text=True, check=True).stdout.strip() == "[]"


@pytest.mark.serial
@pytest.mark.parametrize("library", ["matplotlib", "pyvista"])
def test_a_missing_library_is_named_with_its_extra(library, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    drawer = f"dolfinx_mortar.plotting.{'in_plane' if library == 'matplotlib' else 'in_space'}"
    monkeypatch.delitem(sys.modules, drawer, raising=False)
    if library == "matplotlib":
        mesh = create_mesh("graded", 0.5)
    else:
        mesh = dm.meshing.sphere(COMM, h=1.0, core=2.0)
    with pytest.raises(ImportError, match=rf"{library} is needed.*dolfinx_mortar\[demo\]"):
        dm.plotting.mesh(*mesh)
