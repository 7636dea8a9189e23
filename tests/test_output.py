# SPDX-License-Identifier: MIT
"""Round trips through the XDMF file: every field, every step, any number of ranks."""

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem, mesh
from dolfinx_mortar.output import Writer

meshio = pytest.importorskip("meshio")
h5py = pytest.importorskip("h5py")

pytestmark = pytest.mark.mpi
COMM = MPI.COMM_WORLD
CELLS = {"von Mises": (), "stress": (3, 3), "plane": (4,), "spatial": (6,)}


@pytest.fixture
def path(folder):
    return folder / "out.xdmf"


@pytest.fixture
def problem():
    return Problem()


def polynomial(x):
    return 1.0 + 2.0 * x[0] - 3.0 * x[1]


class Problem:
    """Fields that are known functions of place and time."""

    def __init__(self, cell="triangle", degree=1, n=(5, 4)):
        m = mesh.create_rectangle(COMM, [[0.0, 0.0], [2.0, 1.0]], n, mesh.CellType[cell])

        def on(*element):
            return fem.Function(fem.functionspace(m, element))

        self.t, displacement = 0.0, on("Lagrange", degree, (2,))
        self.solid = SimpleNamespace(V=displacement.function_space)
        self.fields = {
            "displacement": displacement,
            "contact pressure [MPa]": on("Lagrange", degree),
            "linear": on("Lagrange", 1),
        } | {name: on("DG", 0, shape) for name, shape in CELLS.items()}

    def output_fields(self):
        f, t = self.fields, self.t
        f["displacement"].interpolate(lambda x: np.stack([t * polynomial(x), -x[1]]))
        f["contact pressure [MPa]"].interpolate(lambda x: t - polynomial(x))
        f["linear"].interpolate(lambda x: t + polynomial(x))
        for name, shape in CELLS.items():
            factors = np.arange(1.0, 1 + np.prod(shape))
            f[name].interpolate(lambda x, by=factors: np.outer(by, polynomial(x) + t))
        return f


EXPECTED = {  # components over the scalar y at the cell centre
    "stress": np.arange(1.0, 10.0),
    "plane": np.array([1.0, 4, 0, 4, 2, 0, 0, 0, 3]),
    "spatial": np.array([1.0, 4, 6, 4, 2, 5, 6, 5, 3]),
}


def check_step(path, step, t, count):
    """Compare one step with the functions it was made of."""
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        assert reader.num_steps == count
        time, node, cell = reader.read_data(step)
    assert time == t
    y = polynomial(points.T)
    assert set(node) == {"displacement", "contact pressure [MPa]", "linear"}
    assert np.allclose(node["displacement"], np.stack([t * y, -points[:, 1], 0 * y], axis=1))
    assert np.allclose(node["contact pressure [MPa]"], t - y)
    assert np.allclose(node["linear"], t + y)
    corners = cells[0].data[:, : 3 if cells[0].type.startswith("tri") else 4]
    centre = polynomial(points[corners].mean(axis=1).T) + t
    assert set(cell) == {"von Mises", *EXPECTED}
    assert np.allclose(cell["von Mises"][0], centre)
    for name, factors in EXPECTED.items():
        assert np.allclose(cell[name][0], centre[:, None] * factors)


def test_every_field_is_read_back_after_each_step(path):
    problem = Problem("triangle", 2)
    with Writer(path, problem) as out:
        for step, t in enumerate((0.25, 0.5, 1.0)):
            problem.t = t
            out.write(t)
            for earlier, time in enumerate((0.25, 0.5, 1.0)[: step + 1]):
                check_step(path, earlier, time, step + 1)
            COMM.Barrier()
    assert {p.name for p in path.parent.iterdir()} == {"out.xdmf", "out.h5"}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_cells_have_their_area_and_vtk_order(path, cell, degree):
    problem = Problem(cell, degree)
    with Writer(path, problem) as out:
        out.write(0.0)
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, (block,) = reader.read_points_cells()
    k = 3 if cell == "triangle" else 4
    nodes = points[block.data]
    corners = nodes[:, :k, :2]
    following = np.roll(corners, -1, axis=1)
    x, y = np.moveaxis(corners, -1, 0)
    area = 0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1))
    assert area.sum() == pytest.approx(2.0, rel=1e-12)
    if degree == 2:
        assert np.allclose(nodes[:, k : 2 * k, :2], 0.5 * (corners + following))
    assert len(points) == (5 * degree + 1) * (4 * degree + 1)


def test_field_of_another_mesh_is_refused(problem, path):
    other = Problem()
    with Writer(path, problem) as out:
        problem.fields = other.fields
        with pytest.raises(ValueError, match="another mesh"):
            out.write(0.0)


def test_notes_of_any_json_type(problem, path):
    """Texts are kept as they are, other values in JSON; what is neither is named."""
    notes = {"E": 206900, "nu": 0.29, "laws": {"1": ["steel", None, True]}, "text": "<&1>"}
    with Writer(path, problem, notes=notes) as out:
        out.write(0.0)
    said = ET.parse(path).getroot().findall("Domain/Information")
    found = {note.attrib["Name"]: note.attrib["Value"] for note in said}
    assert found.pop("text") == "<&1>"
    assert {name: json.loads(text) for name, text in found.items()} == {
        name: notes[name] for name in found
    }
    for wrong in ({"a": np.zeros(2)}, {"a": float("nan")}, {3: "a"}, {"a": "\0"}):
        with pytest.raises(ValueError, match=r"^notes"):
            Writer(path, problem, notes=wrong)
    with pytest.raises(ValueError, match=r"^notes is .*give a dictionary"):
        Writer(path, problem, notes=["mm"])


def test_wrong_arguments_are_named_at_construction(problem, path):
    for wrong in (None, SimpleNamespace(solid=problem.solid)):
        with pytest.raises(ValueError, match=r"^problem is .*give a ContactProblem"):
            Writer(path, wrong)
    for name in (3, path.with_suffix(""), "a\0b.xdmf", "\ud800.xdmf"):
        with pytest.raises(ValueError, match=r"^path is .*give the name of a file"):
            Writer(name, problem)
    for name in (path.with_suffix(".vtu"), path.parent / "missing" / "out.xdmf"):
        with pytest.raises(ValueError, match=r"^path is "):
            Writer(name, problem)


def test_times_rise(problem, path):
    """ParaView and others take them for an order; what is refused can be written at another one."""
    with Writer(path, problem) as out:
        problem.t = 0.5
        out.write(0.5)
        for t in (0.5, 0.25, np.nan, np.inf, None):
            words = "times have to rise" if t in (0.5, 0.25) else "finite number"
            with pytest.raises(ValueError, match=rf"^t is .*{words}"):
                out.write(t)
        problem.t = 0.75
        out.write(0.75)
    check_step(path, 0, 0.5, 2)
    check_step(path, 1, 0.75, 2)


@pytest.mark.parametrize(("name", "number"), [("displacement", np.nan), ("von Mises", np.inf)])
def test_what_is_not_finite_is_not_written(problem, path, name, number):
    """Told with the name of the field on all ranks, wherever it is; the file stays as it was."""
    fields = problem.output_fields
    with Writer(path, problem) as out:
        out.write(0.0)

        def spoiled():
            found = fields()
            if COMM.rank == COMM.size - 1:
                found[name].x.array[0] = number
            return found

        problem.output_fields, problem.t = spoiled, 1.0
        with pytest.raises(ValueError, match=f"^output field '{name}': 1 values are NaN or inf"):
            out.write(1.0)
        COMM.Barrier()
        check_step(path, 0, 0.0, 1)
        COMM.Barrier()
        problem.output_fields = fields
        out.write(1.0)
    check_step(path, 1, 1.0, 2)


def test_a_closed_writer_writes_no_more(problem, path):
    with Writer(path, problem) as out:
        out.write(0.0)
    with pytest.raises(ValueError, match=r"out\.xdmf' is closed"):
        out.write(1.0)
    COMM.Barrier()
    check_step(path, 0, 0.0, 1)


def test_one_file_has_one_writer(problem, path, monkeypatch):
    """A second one would spoil it, also by another path; once the first is closed it may start."""
    first = Writer(path, problem)
    first.write(0.0)
    monkeypatch.chdir(path.parent)
    for same in (path, "out.xdmf", path.parent / ".." / path.parent.name / "out.xdmf"):
        with pytest.raises(ValueError, match="open in another Writer: close it first"):
            Writer(same, problem)
    check_step(path, 0, 0.0, 1)
    COMM.Barrier()
    first.close()
    with Writer(path, problem) as second:
        problem.t = 2.0
        second.write(2.0)
    check_step(path, 0, 2.0, 1)


@pytest.mark.parametrize("names", [("von Mises", "von_mises"), ("p [MPa]", "p/MPa/"), ("A", "a")])
def test_names_that_differ_little_are_two_fields(problem, path, names):
    functions = problem.fields["linear"], problem.fields["plane"]
    problem.output_fields = lambda: dict(zip(names, functions, strict=True))
    with Writer(path, problem) as out:
        out.write(0.0)
    if COMM.rank == 0:
        items = [a.find("DataItem").text for a in ET.parse(path).iter("Attribute")]
        with h5py.File(path.with_suffix(".h5")) as file:
            shapes = [file[item.partition(":")[2]].shape for item in items]
        assert len({*items}) == len(shapes) == 2 and shapes[0] != shapes[1]


def test_an_error_on_one_rank_is_raised_on_all(problem, path, monkeypatch):
    """Neither a bad argument nor a failing disk of one rank lets the others wait."""
    last = COMM.rank == COMM.size - 1
    with pytest.raises(ValueError, match="notes"):
        Writer(path, problem, notes={"a": np.zeros(2) if last else 1})
    with Writer(path, problem) as out:
        out.write(0.0)
        with pytest.raises(ValueError, match="t is 'now'"):
            out.write("now" if last else 1.0)
        draft = Path.open

        def full(self, *arguments, **options):
            if self.suffix == ".part":
                raise OSError(28, "No space left on device", str(self))
            return draft(self, *arguments, **options)

        monkeypatch.setattr(Path, "open", full)  # only rank 0 writes it
        with pytest.raises(OSError, match=r"No space left on device.*out\.xdmf"):
            out.write(1.0)
        monkeypatch.undo()
        COMM.Barrier()
        check_step(path, 0, 0.0, 1)
        COMM.Barrier()
        problem.t = 2.0
        out.write(2.0)
    check_step(path, 1, 2.0, 2)


def test_the_space_asked_for_is_enough(path, monkeypatch, n=90):
    """No file grows by more than what was made sure of, for the mesh and for every step."""
    asked = []
    monkeypatch.setattr(
        "dolfinx_mortar.common.disk.demand_space", lambda file, size: asked.append(size)
    )
    problem = Problem(n=(n, n))
    more = problem.fields["plane"]
    problem.output_fields = lambda: problem.fields | {f"c{i}": more for i in range(5)}
    size = 0
    with Writer(path, problem) as out:
        for step in range(12):
            files_now = [path.with_suffix(".h5"), path]
            grown = sum(f.stat().st_size for f in files_now if f.exists()) - size
            assert COMM.rank > 0 or grown <= asked[-1]
            size += grown
            COMM.Barrier()
            out.write(float(step))
