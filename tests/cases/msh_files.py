"""Files of Gmsh: bodies with named sides, sound ones and those that are refused."""

import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

from mpi4py import MPI

COMM = MPI.COMM_WORLD


@contextmanager
def folder():
    """Yield one folder for all ranks; it is gone afterwards."""
    with tempfile.TemporaryDirectory() as own:
        yield Path(COMM.bcast(own))
        COMM.Barrier()


@contextmanager
def msh_file(draw, **options):
    """Yield the file of a model that rank 0 draws and meshes in `draw(gmsh.model)`."""
    with folder() as there:
        file = there / "case.msh"
        if COMM.rank == 0:
            import gmsh

            gmsh.initialize(readConfigFiles=False)
            try:
                gmsh.option.setNumber("General.Terminal", 0)
                gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
                for name, value in options.items():
                    gmsh.option.setNumber(f"Mesh.{name}", value)
                draw(gmsh.model)
                gmsh.write(os.fspath(file))
            finally:
                gmsh.finalize()
        COMM.Barrier()
        yield file


def squares(model, *, z=0.0):
    """Two squares of side 1, one on the other without common nodes, 0.5 wider to the right."""
    for k, width in ((0, 1.5), (1, 1.0)):
        model.occ.addRectangle(0.0, float(k), z, width, 1.0)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [1], 11, "low")
    model.addPhysicalGroup(2, [2], 12, "up")
    for line, (tag, name) in {1: (3, "bottom"), 3: (7, "master"), 5: (5, "slave")}.items():
        model.addPhysicalGroup(1, [line], tag, name)
    model.addPhysicalGroup(1, [7], 9)  # the top has no name
    model.mesh.generate(2)


def boxes(model, *, hexahedra=False, named=True):
    """Two unit cubes, one on the other without common nodes."""
    for k in (0, 1):
        model.occ.addBox(0.0, 0.0, float(k), 1.0, 1.0, 1.0)
    model.occ.synchronize()
    if hexahedra:
        model.mesh.setTransfiniteAutomatic()
    if named:
        model.addPhysicalGroup(3, [1], 1, "ball")
        model.addPhysicalGroup(3, [2], 2, "plate")
        model.addPhysicalGroup(2, [5], 1, "ball")  # z = 0; a side may be called like a body
        model.addPhysicalGroup(2, [6, 11], 2, "between")
    model.mesh.generate(3)
