# SPDX-License-Identifier: MIT
"""Meshes of assemblies from STEP files of CAD programs."""

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from mpi4py import MPI

from dolfinx_mortar.algebra.parallel import raised_together
from dolfinx_mortar.common import compat
from dolfinx_mortar.common.arguments import POSITIVE, check, instance, integer
from dolfinx_mortar.common.disk import check_path
from dolfinx_mortar.common.tags import Tags
from dolfinx_mortar.meshing.two_bodies import TaggedMesh, gmsh_model

BYTES = 2_000  # of a tetrahedron with its nodes in Gmsh, measured with 4.13: 1.3 to 1.8 kB


def read_step(
    path: str | os.PathLike[str],
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    size: float,
    degree: int = 1,
) -> TaggedMesh:
    """Mesh the solids of a STEP file with tetrahedra (collective).

        mesh, bodies, faces = dm.meshing.read_step("clamp.step", size=2.0)
        sides, contacts = dm.find_pairs(mesh, bodies)

    Each solid is a body with nodes of its own, under its name in the file; a repeated name gets a
    number. Facet tags have the faces of the solids in the order of the file, "NAME 1", "NAME 2" ..,
    for supports and loads. Lengths are those that Gmsh reads, millimetres unless the file has other
    units. Rank 0 meshes and distributes.

    Args:
        path: the file.
        comm: communicator of the mesh.
        size: of the cells, a length; curved faces have at least 12 cells around a full circle.
        degree: of the cells, 1 or 2.

    Raises:
        OSError: if the file is missing.
        ValueError: if it has no solids or is no STEP file, or if cells of this size would not fit
            into half of the memory.
        RuntimeError: without gmsh. All on all ranks.
    """
    check("comm", comm, instance(MPI.Intracomm, "give a communicator, such as MPI.COMM_WORLD"))
    check("size", size, POSITIVE)
    check("degree", degree, integer(1, 2))
    file = check_path(comm, path)
    options = {
        "Mesh.MeshSizeMin": size / 100.0,
        "Mesh.MeshSizeMax": float(size),
        "Mesh.MeshSizeFromCurvature": 12.0,
    }
    model: Any = None
    names: list[dict[str, int]] = [{}, {}]
    with ExitStack() as stack:
        with raised_together(comm):
            if comm.rank == 0:
                if not file.is_file():
                    raise FileNotFoundError(f"path = {str(file)!r}: there is no such file")
                gmsh = stack.enter_context(gmsh_model())
                for name, value in options.items():
                    gmsh.option.setNumber(name, value)
                names = _open(gmsh, file, size)
                gmsh.model.mesh.generate(3)
                gmsh.model.mesh.setOrder(degree)
                model = gmsh.model
        domain, bodies, faces = compat.mesh_from_gmsh(model, comm, 3)
    domain.name = file.stem
    bodies.name, faces.name = "bodies", "faces"
    of_solids, of_faces = comm.bcast(names)
    return TaggedMesh(domain, Tags(bodies, of_solids), Tags(faces, of_faces))


def _open(gmsh: Any, file: Path, size: float) -> list[dict[str, int]]:
    """Read solids as physical groups; return their names and those of their faces."""
    try:
        gmsh.model.occ.importShapes(str(file), format="step")
    except Exception as error:  # gmsh raises bare Exception
        raise ValueError(f"path = {str(file)!r} is no STEP file: gmsh says: {error}") from error
    gmsh.model.occ.synchronize()
    solids = [tag for _, tag in gmsh.model.getEntities(3)]
    if not solids:
        raise ValueError(
            f"path = {str(file)!r} has no solids, only faces or curves: export closed bodies"
        )
    cells = 8.5 * sum(gmsh.model.occ.getMass(3, tag) for tag in solids) / size**3
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if cells * BYTES > memory / 2:
        least = size * (cells * BYTES / (memory / 2)) ** (1 / 3)
        raise ValueError(
            f"size is {size:g}: about {cells:.1e} cells, more than half of the memory; give at "
            f"least {least:.2g}"
        )
    bodies: dict[str, int] = {}
    faces: dict[str, int] = {}
    for solid in solids:
        name = gmsh.model.getEntityName(3, solid).rpartition("/")[2]
        name = "solid" if not name or name.startswith("Open CASCADE") else name
        alike = sum(known.partition("#")[0] == name for known in bodies)
        name = f"{name}#{alike + 1}" if alike else name
        bodies[name] = gmsh.model.addPhysicalGroup(3, [solid], solid)
        _, own = gmsh.model.getAdjacencies(3, solid)
        for i, face in enumerate(own, 1):
            faces[f"{name} {i}"] = gmsh.model.addPhysicalGroup(2, [face], face)
    return [bodies, faces]
