"""Pictures of bodies in space: with and without a screen, on any number of ranks."""

import os
import select
import shutil
import signal
import subprocess
import sys

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx_mortar as dm
from dolfinx import fem
from dolfinx_mortar.plotting import gather_bodies
from tests import jobs
from tests.cases.msh_files import boxes, msh_file

COMM = MPI.COMM_WORLD
FIRST = COMM.rank == 0
SPACE = """
import sys
from mpi4py import MPI
import numpy as np
import dolfinx_mortar as dm
import ufl
from dolfinx import fem
comm, (file, folder, degree) = MPI.COMM_WORLD, sys.argv[1:]
mesh, cell_tags, facet_tags = dm.meshing.read_msh(file, comm)
plotter = dm.plotting.mesh(mesh, cell_tags, facet_tags, file=f"{folder}/mesh.png")
V = fem.functionspace(mesh, ("Lagrange", int(degree), (3,)))
u = fem.Function(V)
law = dm.Elastic(E=100.0, nu=0.0)
solid = dm.Solid(u, law)
bcs = []
for name, x in (("floor", 0.0), ("top", -0.01)):
    dofs = fem.locate_dofs_topological(V, 2, facet_tags.find(name))
    bcs.append(fem.dirichletbc(np.array([0.0, 0.0, x]), dofs, V))
contact = dm.Contact(facet_tags, slave="lower", master="upper")
problem = dm.ContactProblem(solid, [contact], bcs=bcs)
dm.newton(problem)
drawn = [dm.plotting.field(problem, "stress_zz", file=f"{folder}/field.png", view=(1, 2, 3))]
drawn += [dm.plotting.field(problem, "displacement_z"), dm.plotting.pressure(problem)]
try:
    dm.plotting.pressure(problem, ax=None if comm.rank else 1)  # axes are on rank 0 alone
except ValueError as error:
    assert "leave it out" in str(error), error
else:
    raise AssertionError
tie = dm.Tie(facet_tags, slave="lower", master="upper")
tied = dm.ContactProblem(dm.Solid(fem.Function(V), law), [tie], bcs=bcs)
dm.newton(tied)
drawn.append(dm.plotting.pressure(tied, tie))
if comm.rank == 0:
    titles = [plotter.scalar_bar.GetTitle().strip() for plotter in drawn]
    assert titles == ["stress_zz", "displacement_z", "contact pressure", "normal traction"], titles
    for plotter, low, high in zip(drawn, (-0.51, -0.01, 0.49, 0.49), (-0.49, 0.0, 0.51, 0.51)):
        found = plotter.scalar_bar.GetLookupTable().GetRange()
        assert low <= found[0] <= found[1] <= high, found
        plotter.show()
    print("drawn")
else:
    assert drawn == [None] * 4
"""


def columns(model):
    """Two cubes on each other with sides for contact."""
    boxes(model, named=False)
    for body in (1, 2):
        model.addPhysicalGroup(3, [body], body, f"body {body}")
    for tag, name in ((5, "floor"), (6, "lower"), (11, "upper"), (12, "top")):
        model.addPhysicalGroup(2, [tag], tag, name)


@pytest.mark.serial
@pytest.mark.slow
@pytest.mark.parametrize(
    ("order", "degree", "ranks"),
    [(2, 2, 1), (1, 2, 3)],
)
def test_bodies_in_space_without_a_screen(order, degree, ranks, monkeypatch, tmp_path):
    """As a program of its own: what VTK cannot do ends the program."""
    pytest.importorskip("pyvista")
    monkeypatch.delenv("DISPLAY", raising=False)
    with msh_file(columns, ElementOrder=order) as file:
        done = jobs.run(ranks, "-c", SPACE, file, tmp_path, degree)
    assert done.returncode == 0 and "drawn" in done.stdout, done.stderr
    assert all((tmp_path / f"{name}.png").stat().st_size > 5000 for name in ("mesh", "field"))


SCREEN = """
import os, signal, subprocess, sys
from dolfinx_mortar.plotting import in_space
begun = []
class Server(subprocess.Popen):
    def __init__(self, *args, **options):
        own = args[0][0] == "Xvfb"  # ctypes runs programs, too
        super().__init__(*args, **options, **({"pass_fds": [int(sys.argv[1])]} if own else {}))
        begun.extend([self] if own else [])
subprocess.Popen = Server
for _ in range(2):
    in_space.find_screen()
    assert in_space.pyvista.OFF_SCREEN
    in_space.begin(None, None, 1).close()  # the server stays when a picture is closed
(server,) = begun  # one for the whole program
assert os.getpgid(server.pid) != os.getpgrp()  # Ctrl-C is not for the server
print(os.environ["DISPLAY"], flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.serial
def test_the_screen_ends_with_the_program_however_that_ends():
    """The server inherits a pipe, which ends when the last process that has it does."""
    pyvista = pytest.importorskip("pyvista")
    if shutil.which("Xvfb") is None or pyvista.vtk_version_info >= (9, 4):
        pytest.skip("there is no Xvfb, or no need of it")
    read, write = os.pipe()
    run = [sys.executable, "-c", SCREEN, str(write)]
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    done = subprocess.run(run, capture_output=True, text=True, env=environment, pass_fds=[write])
    os.close(write)
    assert done.returncode == -signal.SIGKILL and done.stdout.startswith(":"), done.stderr
    ended, _, _ = select.select([read], [], [], 60)
    os.close(read)
    assert ended


@pytest.mark.serial
@pytest.mark.parametrize(("display", "broken"), [("", False), (":4242", True)])
def test_without_any_screen_the_error_says_what_to_install(display, broken, monkeypatch, tmp_path):
    """Neither an X server that answers, nor an Xvfb that starts, nor a VTK that draws in memory."""
    pyvista = pytest.importorskip("pyvista")
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setenv("PATH", str(tmp_path))
    if broken:
        (tmp_path / "Xvfb").write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / "Xvfb").chmod(0o755)
    monkeypatch.setattr(pyvista, "vtk_version_info", (9, 3, 0))
    mesh = dm.meshing.sphere(COMM, h=1.0, core=2.0)
    with pytest.raises(RuntimeError, match=rf"no screen.*DISPLAY = '{display}'.*install xvfb"):
        dm.plotting.mesh(*mesh)


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "degree"), [("tetrahedron", 1), ("hexahedron", 2)])
def test_only_the_outside_of_bodies_in_space_is_gathered(cell, degree):
    """Its area is that of the bodies, the value of a facet that of its cell."""
    mesh = dm.meshing.sphere(COMM, h=1.0, core=2.0, cell=cell, block=(16.0, 16.0, 6.0))
    V = fem.functionspace(mesh.mesh, ("Lagrange", degree, (3,)))
    DG = fem.Function(fem.functionspace(mesh.mesh, ("DG", 0)))
    DG.interpolate(lambda x: x[2])
    owned = mesh.mesh.topology.index_map(3).size_local
    X = V.tabulate_dof_coordinates()
    shaded = gather_bodies(V, X, X[:, 2], at_nodes=True)
    found = gather_bodies(V, X, DG.x.array[:owned], at_nodes=False)
    assert (found is None) != FIRST
    if FIRST:
        assert shaded.values == pytest.approx(shaded.x[:, 2])
        x = found.x[found.nodes]
        n = 3 if cell == "tetrahedron" else 4
        corners = x[:, :n]
        block = corners[(corners[:, :, 2] <= 1e-9).all(axis=1)]
        a, b, c, d = (block[:, i] for i in (0, 1, 2, n - 1))
        sizes = np.linalg.norm(np.cross(c - a, d - b), axis=1) / 2
        assert sizes.sum() == pytest.approx(2 * 64.0 + 4 * 48.0)
        below = found.values[(corners[:, :, 2] <= 1e-9).all(axis=1)]
        assert (below < 0.0).all()
        middles = {6: (3, 4, 5), 9: (4, 5, 6, 7)}.get(found.nodes.shape[1], ())
        for i, node in enumerate(middles):
            ends = x[:, [i, (i + 1) % n]].mean(axis=1)
            assert x[:, node] == pytest.approx(ends, abs=1e-9)
