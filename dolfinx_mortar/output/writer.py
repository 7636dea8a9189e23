# SPDX-License-Identifier: MIT
"""The writer of results.

dolfinx's own XDMF writer gives every function a grid of its own, of which meshio keeps the last
one only. Here each step is one grid with the mesh and all fields. The heavy numbers are written in
parallel to one HDF5 file next to the XDMF file; no field is gathered on one rank.

Points are the nodes of the displacement space, whatever its degree, so that node fields need no
interpolation.
"""

from __future__ import annotations

import hashlib
import logging
import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem, plot
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arguments import FLAG, NUMBER, check
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.disk import check_path
from dolfinx_mortar.output.files import (
    claim_files,
    create_tree,
    demand_space_for_step,
    field_keys,
    release_files,
    replace_tree,
)
from dolfinx_mortar.output.grids import Step, free_name, insert, read_steps
from dolfinx_mortar.output.layout import KINDS, TOPOLOGY, Layout
from dolfinx_mortar.output.numbers import Numbers
from dolfinx_mortar.output.tool_file import ToolFile, create_tool_file, tools_of

log = logging.getLogger(__name__)


class Writer:
    """Write the fields of a problem step by step (collective in every method).

        with Writer("out.xdmf", problem) as out:
            ...
            out.write(t)

    The fields are ``problem.output_fields()``: Lagrange Functions on the problem's mesh, written
    at the nodes of ``problem.solid.V`` (interpolated if their degree differs), and
    piecewise-constant Functions (DG0), written per cell. Vectors are padded to three components
    (x, y, z); tensors of shape (2, 2) or (3, 3), and symmetric ones stored in four or six
    components in the order of `materials.tensor`, to nine (xx, xy, xz, yx, ...); other shapes are
    written as a flat row of components.

    Rigid tools go to a second file, out.tools.xdmf with the same times: their surfaces as far as
    the sides that meet them may get, with the number of the tool in "tool".

    After every step the HDF5 file is closed and the XDMF file replaced in one move, so what has
    been written stays readable whatever happens next. An error on one rank is raised on all.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        problem: Any,
        *,
        notes: Mapping[str, Any] | None = None,
        resume: bool = False,
    ) -> None:
        """Create the files and write the mesh.

        Args:
            path: File to write, ending in .xdmf; the numbers go next to it, ending in .h5. Earlier
                files of these names are replaced; the folder must exist.
            problem: A `ContactProblem`, or what else has ``solid.V`` and ``output_fields()``, and
                perhaps ``steps_done``.
            notes: Kept in the file, such as {"units": "mm, MPa"}; texts as they are, other values
                in JSON.
            resume: Continue the file of an earlier run, if there is one: its steps stay, and a
                step computed again, after a checkpoint, replaces the earlier one. New values go to
                another HDF5 file, such as out.2.h5.

        Raises:
            ValueError: on all ranks, naming a wrong argument, as files that cannot be written,
                resumed, or are open in another Writer.
            OSError: on all ranks, if there is no space on the disk.
        """
        V = _space(problem)
        self.comm: MPI.Intracomm = V.mesh.comm
        cell = V.mesh.topology.cell_type.name, V.dofmap.dof_layout.num_dofs
        self.path = check_path(self.comm, path)
        check_same_on_all_ranks(self.comm, resume=resume)
        with raised_together(self.comm):
            if self.path.suffix != ".xdmf":
                raise ValueError(f"path is {str(path)!r}: give the name of a file ending in .xdmf.")
            self._root, self._collection = create_tree({} if notes is None else notes)
            check("resume", resume, FLAG)
            if cell not in TOPOLOGY:
                raise ValueError(f"problem: {cell[0]} cells with {cell[1]} nodes: no XDMF name.")
        self._steps = read_steps(self.comm, self.path) if resume else []
        self._numbers = Numbers(self.comm, free_name(self.path, self._steps))
        claim_files(self.comm, self.path, self._numbers.path, self, resume=resume)
        self.problem = problem
        self._layout = Layout(V)
        self._tools: ToolFile | None = None
        self._open = True
        try:
            self._grid_head = self._write_mesh(V, TOPOLOGY[cell])
            given = problem, self.path, {} if notes is None else notes
            self._tools = create_tool_file(self.comm, *given, resume=resume)
        except BaseException:
            self._leave()
            raise

    def write(self, t: float) -> None:
        """Add the problem's current fields as the step at time (or load) t.

        Args:
            t: More than those before; where loads fall, give the number of the step.

        Raises:
            ValueError: After `close`, for a time that does not rise, for fields of another mesh,
                with names that collide, or with values that are NaN or infinite.
            OSError: If there is no space on the disk, naming the file; what was written before
                stays readable, and the step may be written again.
        """
        if not self._open:
            raise ValueError(f"Writer of {str(self.path)!r} is closed: make a new one.")
        fields, tools = self.problem.output_fields(), tools_of(self.problem)
        number = sum(not step.earlier for step in self._steps)
        grid = ET.Element("Grid", GridType="Uniform")
        with raised_together(self.comm):
            check("t", t, NUMBER, "give the time or load of the step, a finite number")
            done, brought = getattr(self.problem, "steps_done", (0, 0))
            step = Step(grid, done, float(t), self._mesh)
            steps = insert(self._steps, step, made=done > brought)
            keys = field_keys(fields)
            self._layout.check(fields)
        grid.set("Name", f"step {steps.index(step)}")
        ET.SubElement(grid, "Time", Value=repr(step.time))
        step.remember()
        found = {name: self._layout.values(name, f) for name, f in fields.items()}
        self._check_finite({name: values for name, (values, _) in found.items()})
        grid.extend(self._grid_head)
        size = sum(values.nbytes for values, _ in found.values())
        demand_space_for_step(self.comm, self.path, self._numbers.path, size, len(found))
        with self._numbers.viewer("a") as viewer:
            for name, (values, centre) in found.items():
                kind = KINDS.get(values.shape[1], "Matrix")
                about = {"Name": name, "AttributeType": kind, "Center": centre}
                item = self._numbers.write(viewer, f"{keys[name]}_{number:06d}", values)
                ET.SubElement(grid, "Attribute", about).append(item)
        with raised_together(self.comm):
            if self._tools is not None:  # first: what the results lack is dropped
                self._tools.write(steps, step, tools)
        self._collection[:] = [one.grid for one in steps]
        replace_tree(self.comm, self.path, self._root)
        self._steps = steps

    def _check_finite(self, found: Mapping[str, Floats]) -> None:
        """Raise a ValueError on all ranks for values that are NaN or infinite; collective."""
        bad = np.array([np.sum(~np.isfinite(values)) for values in found.values()])
        for name, count in zip(found, self.comm.allreduce(bad), strict=True):
            if count:
                raise ValueError(
                    f"output field {name!r}: {count} values are NaN or infinite, and the step is "
                    "not written; check what they come from."
                )

    def close(self) -> None:
        """End the writing: other writers may use the files; collective."""
        self._leave()
        self.comm.Barrier()

    def _leave(self) -> None:
        self._open = False
        release_files(self.path, self)
        if self._tools is not None:
            self._tools.leave()

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: Any) -> None:
        """Close; without a barrier after an exception, which may be that of one rank."""
        if kind is None:
            self.close()
        else:
            self._leave()

    def _write_mesh(self, V: fem.FunctionSpace, topology: str) -> list[ET.Element]:
        """Write cells and points, to which the grids of all steps refer; return these references.

        Those of an earlier run serve if nodes and cells are numbered in the same way.
        """
        nodes, _, _ = plot.vtk_mesh(V)
        k = V.dofmap.dof_layout.num_dofs
        local = nodes.reshape(-1, k + 1)[:, 1:]  # the first column repeats the number of nodes
        cells = V.dofmap.index_map.local_to_global(local.reshape(-1).astype(np.int32))
        cells = cells.reshape(-1, k)
        x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
        count = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
        head = ET.Element("Topology", TopologyType=topology, NumberOfElements=str(count))
        geometry = ET.Element("Geometry", GeometryType="XYZ")
        self._mesh = _digest(self.comm, cells, x)
        for step in self._steps:
            if step.mesh == self._mesh:
                with self._numbers.viewer("w"):
                    return [one for one in step.grid if one.tag in ("Topology", "Geometry")]
        if self._steps and self.comm.rank == 0:
            log.warning(
                "%s: nodes are numbered in another way than in its earlier steps, as on another "
                "number of ranks; ParaView reads the mesh of each step, meshio only the first one",
                self.path,
            )
        size = cells.nbytes + x.nbytes
        demand_space_for_step(self.comm, self.path, self._numbers.path, size, 2)
        with self._numbers.viewer("w") as viewer:
            head.append(self._numbers.write_cells(viewer, "cells", cells))
            geometry.append(self._numbers.write(viewer, "points", x))
        return [head, geometry]


def _space(problem: Any) -> fem.FunctionSpace:
    """Return the displacement's space of a problem, or raise ValueError if it is none."""
    V = getattr(getattr(problem, "solid", None), "V", None)
    if not isinstance(V, fem.FunctionSpace) or not callable(
        getattr(problem, "output_fields", None)
    ):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem.")
    return V


def _digest(comm: MPI.Comm, cells: Ints, x: Floats) -> str:
    """Return a digest of cells and points of all ranks; collective."""
    own = hashlib.sha256(cells.astype(np.int64).tobytes() + x.astype(np.float64).tobytes())
    return hashlib.sha256("".join(comm.allgather(own.hexdigest())).encode()).hexdigest()
