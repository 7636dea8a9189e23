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
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import default_scalar_type, fem, plot
from dolfinx_mortar.agreement import check_same_on_all_ranks
from dolfinx_mortar.algebra.errors import raise_together, raised_together
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.output.files import (
    claim_files,
    create_tree,
    demand_room_of_step,
    field_keys,
    release_files,
    replace_tree,
)
from dolfinx_mortar.output.layout import KINDS, TOPOLOGY, Layout
from dolfinx_mortar.output.steps import Step, check_time, free_name, insert, read_steps

log = logging.getLogger(__name__)


class HasSpace(Protocol):
    """The part of a solid that the writer reads."""

    V: fem.FunctionSpace  # vector Lagrange space of the displacement


class HasOutput(Protocol):
    """The part of a problem that the writer reads."""

    solid: HasSpace
    # and, if load steps are counted, steps_done: see `ContactProblem.steps_done`

    def output_fields(self) -> dict[str, fem.Function]:
        """Return the current fields by name; see `Writer`."""


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

    After every step the HDF5 file is closed and the XDMF file replaced in one move, so what has
    been written stays readable whatever happens next. An error on one rank is raised on all.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        problem: HasOutput,
        *,
        notes: Mapping[str, Any] | None = None,
        resume: bool = False,
    ) -> None:
        """Create the files and write the mesh.

        Args:
            path: File to write, ending in .xdmf; the numbers go next to it, ending in .h5. Earlier
                files of these names are replaced; the folder must exist.
            problem: Problem with ``solid.V`` and ``output_fields()``.
            notes: Kept in the file, such as {"units": "mm, MPa"}; texts as they are, other values
                in JSON.
            resume: Go on with the file of an earlier run, if there is one: its steps stay, and one
                that is made again, after a checkpoint, takes the place of what was written for it.
                New numbers go to an HDF5 file of their own, such as out.2.h5.

        Raises:
            ValueError: If the suffix is another, the files cannot be written or are open in another
                Writer, notes are no JSON values, the problem is none, what is to be resumed is no
                file of a Writer or its numbers are gone, or the cells are of a kind that XDMF has
                no name for (on all ranks).
            OSError: If there is no room on the disk (on all ranks).
        """
        V = _space(problem)
        self.comm: MPI.Intracomm = V.mesh.comm
        cell = V.mesh.topology.cell_type.name, V.dofmap.dof_layout.num_dofs
        check_same_on_all_ranks(self.comm, path=path, resume=resume)
        with raised_together(self.comm):
            self.path = _path(path)
            self._root, self._collection = create_tree({} if notes is None else notes)
            if not isinstance(resume, bool):
                raise ValueError(f"resume is {resume!r}: give True or False.")
            if cell not in TOPOLOGY:
                raise ValueError(f"problem: {cell[0]} cells with {cell[1]} nodes: no XDMF name.")
        self._steps = read_steps(self.comm, self.path) if resume else []
        self._data = free_name(self.path, self._steps)
        claim_files(self.comm, self.path, self._data, self, resume=resume)
        self.problem = problem
        self._layout = Layout(V)
        self._open = True
        try:
            self._grid_head = self._write_mesh(V, TOPOLOGY[cell])
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
            OSError: If there is no room on the disk, naming the file; what was written before
                stays readable, and the step may be written again.
        """
        if not self._open:
            raise ValueError(f"Writer of {str(self.path)!r} is closed: make a new one.")
        fields = self.problem.output_fields()
        number = sum(not step.earlier for step in self._steps)
        grid = ET.Element("Grid", GridType="Uniform")
        with raised_together(self.comm):
            done, brought = getattr(self.problem, "steps_done", (0, 0))
            step = Step(grid, done, check_time(t), self._mesh)
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
        demand_room_of_step(self.comm, self.path, self._data, size, len(found))
        with self._viewer("a") as viewer:
            for name, (values, centre) in found.items():
                kind = KINDS.get(values.shape[1], "Matrix")
                attribute = ET.SubElement(grid, "Attribute", Name=name, AttributeType=kind)
                attribute.set("Center", centre)
                attribute.append(self._write_values(viewer, f"{keys[name]}_{number:06d}", values))
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
        """End the writing; everything is on disk already, so this only lets go of the files."""
        self._leave()
        self.comm.Barrier()

    def _leave(self) -> None:
        self._open = False
        release_files(self.path, self)

    def __enter__(self) -> Writer:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close; an exception may have been raised on one rank only, so wait for nobody then."""
        if kind is None:
            self.close()
        else:
            self._leave()

    @contextmanager
    def _viewer(self, mode: str) -> Iterator[PETSc.Viewer]:
        """Open the HDF5 file for a block, and close it; collective."""
        viewer = PETSc.Viewer()
        self._together(lambda: viewer.createHDF5(str(self._data), mode, comm=self.comm))
        try:
            yield viewer
        finally:
            self._together(viewer.destroy)

    def _together(self, action: Callable[[], Any]) -> None:
        """Do what all ranks do together; an error on one is raised on all, naming the file."""
        failed = None
        try:
            action()
        except Exception as error:
            failed = OSError(f"{self._data} could not be written: {error}")
        raise_together(self.comm, failed)

    def _write_mesh(self, V: fem.FunctionSpace, topology: str) -> list[ET.Element]:
        """Write cells and points once; every step's grid refers to them.

        Those of an earlier run are as good where nodes and cells are numbered in the same way.
        """
        nodes, _, _ = plot.vtk_mesh(V)
        k = V.dofmap.dof_layout.num_dofs
        local = nodes.reshape(-1, k + 1)[:, 1:]  # the first column repeats the number of nodes
        cells = V.dofmap.index_map.local_to_global(local.reshape(-1).astype(np.int32))
        x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
        head, geometry = ET.Element("Topology", TopologyType=topology), ET.Element("Geometry")
        shape = V.mesh.topology.index_map(V.mesh.topology.dim).size_global, k
        head.set("NumberOfElements", str(shape[0]))
        head.append(self._item("cells", shape, "Int", np.dtype(PETSc.IntType).itemsize))
        geometry.set("GeometryType", "XYZ")
        self._mesh = _digest(self.comm, cells, x)
        for step in self._steps:
            if step.mesh == self._mesh:
                with self._viewer("w"):
                    return [one for one in step.grid if one.tag in ("Topology", "Geometry")]
        if self._steps and self.comm.rank == 0:
            log.warning(
                "%s: nodes are numbered in another way than in its earlier steps, as on other "
                "ranks; ParaView reads the mesh of each step, but meshio that of the first only",
                self.path,
            )
        size = cells.nbytes + x.nbytes
        demand_room_of_step(self.comm, self.path, self._data, size, 2)
        with self._viewer("w") as viewer:
            indices = PETSc.IS().createGeneral(cells.astype(PETSc.IntType), comm=self.comm)
            indices.setBlockSize(k)
            indices.setName("cells")
            self._together(lambda: indices.view(viewer))
            indices.destroy()
            geometry.append(self._write_values(viewer, "points", x))
        return [head, geometry]

    def _write_values(self, viewer: PETSc.Viewer, key: str, values: Floats) -> ET.Element:
        """Write the rows of this rank, shape (n, components), and return the reference to them."""
        n, components = values.shape
        vector = PETSc.Vec().createWithArray(
            np.ascontiguousarray(values, dtype=default_scalar_type).reshape(-1),
            size=(n * components, None),
            bsize=components,
            comm=self.comm,
        )
        vector.setName(key)
        self._together(lambda: vector.view(viewer))
        rows = vector.getSize() // components
        vector.destroy()
        return self._item(key, (rows, components) if components > 1 else (rows,), "Float", 8)

    def _item(self, key: str, shape: tuple[int, ...], kind: str, precision: int) -> ET.Element:
        item = ET.Element("DataItem", Dimensions=" ".join(map(str, shape)), NumberType=kind)
        item.set("Precision", str(precision))
        item.set("Format", "HDF")
        item.text = f"{self._data.name}:/{key}"
        return item


def _space(problem: Any) -> fem.FunctionSpace:
    """Return the displacement's space of a problem, or raise ValueError if it is none."""
    V = getattr(getattr(problem, "solid", None), "V", None)
    if not isinstance(V, fem.FunctionSpace) or not callable(
        getattr(problem, "output_fields", None)
    ):
        raise ValueError(f"problem is {problem!r}: give a ContactProblem.")
    return V


def _path(path: Any) -> Path:
    """Return a path that ends in .xdmf, or raise ValueError."""
    try:
        name = os.fsencode(path)  # a TypeError, or a ValueError for what no file can be called
        good = Path(path).suffix == ".xdmf" and b"\0" not in name
    except (TypeError, ValueError):
        good = False
    if not good:
        given = repr(str(path) if isinstance(path, os.PathLike) else path)
        raise ValueError(f"path = {given} must be the name of a file that ends in .xdmf.")
    return Path(path)


def _digest(comm: MPI.Comm, cells: Ints, x: Floats) -> str:
    """Return a text that tells cells and points of all ranks from others; collective."""
    own = hashlib.sha256(cells.astype(np.int64).tobytes() + x.astype(np.float64).tobytes())
    return hashlib.sha256("".join(comm.allgather(own.hexdigest())).encode()).hexdigest()
