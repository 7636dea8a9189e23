# SPDX-License-Identifier: MIT
"""The writer of results: an XDMF file with a grid for each step, and the HDF5 file of numbers."""

from __future__ import annotations

import json
import logging
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any
from urllib.parse import quote
from weakref import WeakValueDictionary

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import fem, plot
from dolfinx_mortar.algebra.parallel import raise_together, raised_together
from dolfinx_mortar.common import disk
from dolfinx_mortar.common.agreement import check_same_on_all_ranks
from dolfinx_mortar.common.arguments import FLAG, NUMBER, check, instance
from dolfinx_mortar.common.arrays import Floats, Ints, Longs
from dolfinx_mortar.common.spaces import CELLS, HIGHEST
from dolfinx_mortar.materials.tensor import tensor_of

log = logging.getLogger(__name__)

Tools = Sequence[tuple[Any, Floats]]
KINDS = {1: "Scalar", 3: "Vector", 9: "Tensor"}
# Open files of this program by path, on rank 0.
_OPEN: WeakValueDictionary[Path, File] = WeakValueDictionary()
# Characters forbidden in XML.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
DONE = "load steps"  # attribute of a grid: their number


class Writer:
    """Write the fields of a problem step by step (collective in every method).

        with Writer("out.xdmf", problem) as out:
            ...
            out.write(t)

    The fields are ``problem.output_fields()``: Lagrange Functions, written at the nodes of
    ``problem.solid.V`` (interpolated if their degree differs), and piecewise-constant Functions
    (DG0), written per cell. Vectors are padded to three components, stored symmetric tensors
    (`materials.tensor`) to nine (xx, xy, xz, yx, ...); other shapes are written as a flat row.

    Surfaces of rigid tools near the sides are written to out.tools.xdmf, with the number of the
    tool in "tool". Earlier steps stay readable while one is written. Errors are raised on all
    ranks.
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
            path: file to write, ending in .xdmf; the numbers go to a neighbour ending in .h5.
                Earlier files of these names are replaced; the folder must exist.
            problem: a `ContactProblem`, or any object with ``solid.V`` and ``output_fields()``, and
                perhaps ``steps_done``.
            notes: kept in the file, such as {"units": "mm, MPa"}: texts, or JSON values.
            resume: continue the file of an earlier run, if there is one: a step computed again
                replaces the earlier one. New values go to another HDF5 file, such as out.2.h5.

        Raises:
            ValueError: for a wrong argument, as files that cannot be written, resumed, or are open
                in another Writer.
            OSError: if there is no space on the disk.
        """
        V = getattr(getattr(problem, "solid", None), "V", None)
        fields = getattr(problem, "output_fields", None)
        if not isinstance(V, fem.FunctionSpace) or not callable(fields):
            raise ValueError(f"problem is {problem!r}: give a ContactProblem.")
        self.problem, self.comm = problem, V.mesh.comm
        cell, degree = V.mesh.topology.cell_name(), V.ufl_element().degree
        self.path = disk.check_path(self.comm, path)
        check_same_on_all_ranks(self.comm, resume=resume)
        with raised_together(self.comm):
            if self.path.suffix != ".xdmf":
                raise ValueError(f"path is {str(path)!r}: give the name of a file ending in .xdmf.")
            check("resume", resume, FLAG)
            if cell not in CELLS or degree > HIGHEST:
                raise ValueError(f"problem: {cell} cells of degree {degree}: no XDMF name.")
        notes = {} if notes is None else notes
        self._open = True
        self._find_tools: Callable[[], Tools] = getattr(problem, "output_tools", tuple)
        self._tools: _ToolFile | None = None
        self._file = File(self.comm, self.path, notes, resume=resume)
        try:
            self._grid_head = self._write_mesh(V)
            if self._find_tools():
                with raised_together(self.comm):
                    if self.comm.rank == 0:
                        beside = self.path.with_suffix(".tools.xdmf")
                        self._tools = _ToolFile(MPI.COMM_SELF, beside, notes, resume=resume)
        except BaseException:
            self._leave()
            raise

    def write(self, t: float) -> None:
        """Add the problem's current fields as the step at time (or load) t.

        Args:
            t: greater than before; for falling loads, give the number of the step.

        Raises:
            ValueError: after `close`, for a time that does not rise, for fields of another mesh, or
                with values that are NaN or infinite.
            OSError: naming the file, if there is no space on the disk; earlier steps stay readable,
                and the step may be written again.
        """
        if not self._open:
            raise ValueError(f"Writer of {str(self.path)!r} is closed: make a new one.")
        file, fields, tools = self._file, self.problem.output_fields(), self._find_tools()
        V: fem.FunctionSpace = self.problem.solid.V
        number = sum(not step.earlier for step in file.steps)
        with raised_together(self.comm):
            check("t", t, NUMBER, "give the time or load of the step, a finite number")
            done, brought = getattr(self.problem, "steps_done", (0, 0))
            step = new_step(done, float(t))
            steps = insert(file.steps, step, made=done > brought)
            for name, f in fields.items():
                _check_xml("output fields", name)
                if f.function_space.mesh is not V.mesh:
                    raise ValueError(
                        f"output field {name!r} is on another mesh than the displacement."
                    )
        found = {name: _values(V, f) for name, f in fields.items()}
        bad = np.array([np.sum(~np.isfinite(values)) for values, _ in found.values()])
        for name, wrong in zip(found, self.comm.allreduce(bad), strict=True):
            if wrong:
                raise ValueError(
                    f"output field {name!r}: {wrong} values are NaN or infinite, and the step is "
                    "not written; check what they come from."
                )
        step.grid.extend(self._grid_head)
        rows = []
        for name, (values, centre) in found.items():
            kind = KINDS.get(values.shape[1], "Matrix")
            about = {"Name": name, "AttributeType": kind, "Center": centre}
            element = ET.SubElement(step.grid, "Attribute", about)
            rows.append((element, f"{quote(name, safe='')}_{number:06d}", values))
        file.write(*rows)
        with raised_together(self.comm):
            if self._tools is not None:  # first: steps that the results lack are dropped
                self._tools.write_step(steps, step, tools)
        file.replace(steps)

    def close(self) -> None:
        """End the writing: other writers may use the files; collective."""
        self.__exit__(None)

    def _leave(self) -> None:
        self._open = False
        for file in (self._file, self._tools):
            if file is not None:
                file.close()

    def __enter__(self) -> Writer:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close; without a barrier after an exception, which may be that of one rank."""
        self._leave()
        if kind is None:
            self.comm.Barrier()

    def _write_mesh(self, V: fem.FunctionSpace) -> list[ET.Element]:
        """Write cells and points; return their references."""
        nodes, _, _ = plot.vtk_mesh(V)
        k = V.dofmap.dof_layout.num_dofs
        local = nodes.reshape(-1, k + 1)[:, 1:]  # the first column repeats the number of nodes
        cells = V.dofmap.index_map.local_to_global(local.ravel().astype(np.int32)).reshape(-1, k)
        x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
        total = V.mesh.topology.index_map(V.mesh.topology.dim).size_global
        if self._file.steps and self.comm.rank == 0:
            log.warning(
                "%s: each run has a mesh of its own, and on another number of ranks other numbers "
                "of nodes; ParaView reads the mesh of each step, meshio only the first one",
                self.path,
            )
        linear = V.ufl_element().degree == 1
        kind = V.mesh.topology.cell_name().capitalize() + ("" if linear else f"_{k}")
        head = ET.Element("Topology", TopologyType=kind, NumberOfElements=str(total))
        geometry = ET.Element("Geometry", GeometryType="XYZ")
        return self._file.write((head, "cells", cells), (geometry, "points", x))


def _values(V: fem.FunctionSpace, function: fem.Function) -> tuple[Floats, str]:
    """Padded values (n, c) at V's owned nodes or cells, and "Node" or "Cell"; collective."""
    degree, own = V.ufl_element().degree, function.function_space.ufl_element().degree
    shape, topology = function.ufl_shape, V.mesh.topology
    if own not in (0, degree):
        target = fem.Function(fem.functionspace(V.mesh, ("Lagrange", degree, shape)))
        target.interpolate(function)
        function = target
    dofmap = function.function_space.dofmap
    if own == 0:
        rows = dofmap.list[: topology.index_map(topology.dim).size_local, 0]
    else:
        rows = np.empty(len(V.tabulate_dof_coordinates()), dtype=np.int32)
        rows[V.dofmap.list] = dofmap.list
        rows = rows[: V.dofmap.index_map.size_local]
    values = function.x.array.reshape(-1, dofmap.index_map_bs)[rows]
    if shape == (2,):
        values = np.pad(values, ((0, 0), (0, 1)))
    elif shape in ((4,), (6,)):
        values = tensor_of(values).reshape(-1, 9)
    return values, "Node" if own else "Cell"


@dataclass(frozen=True)
class Step:
    """A grid of the XDMF file: all data of one step."""

    grid: ET.Element
    done: int  # load steps completed before
    time: float
    earlier: bool = False

    @property
    def files(self) -> set[str]:
        """Names of the files with its numbers."""
        return {str(item.text).partition(":")[0].strip() for item in self.grid.iter("DataItem")}


def new_step(done: int, time: float) -> Step:
    """A step whose grid has these data, for `_read`."""
    grid = ET.Element("Grid", GridType="Uniform", Name=f"t = {time!r}")
    ET.SubElement(grid, "Time", Value=repr(time))
    ET.SubElement(grid, "Information", Name=DONE, Value=str(done))
    return Step(grid, done, time)


class File:
    """The two files of some ranks; all methods but `close` are collective.

    Attributes:
        path: the XDMF file.
        data: the HDF5 file, not one of an earlier run.
        steps: in the file.
    """

    def __init__(
        self, comm: MPI.Comm, path: Path, notes: Mapping[str, Any], *, resume: bool
    ) -> None:
        """Reserve both files, and remove earlier ones except an XDMF file that is resumed.

        Raises:
            ValueError: on all ranks, if rank 0 cannot create or resume them, another `File` has
                them, or notes are neither text nor JSON.
        """
        self.comm, self.path, self._mode = comm, path, "w"
        with raised_together(comm):
            self._root, self._collection = _create_tree(notes)
        steps: list[Step] = []
        with raised_together(comm):
            if comm.rank == 0:
                steps = _read(path) if resume and path.exists() else []
                self._reserve(free_name(path, steps), resume)
        self.steps: list[Step] = comm.bcast(steps)
        self.data = free_name(path, self.steps)

    def _reserve(self, data: Path, resume: bool) -> None:
        """Register this file, remove replaced ones, and create its HDF5 file; on rank 0."""
        path = self.path
        if path.resolve() in _OPEN:
            raise ValueError(f"path is {str(path)!r}, open in another Writer: close it first.")
        try:
            if disk.is_checkpoint(data):
                raise ValueError(
                    f"path is {str(path)!r}: its numbers would go to {str(data)!r}, which is a "
                    "checkpoint; choose another name."
                )
            if not resume:
                path.unlink(missing_ok=True)
            data.write_bytes(b"")
        except OSError as error:
            raise ValueError(
                f"path is {str(path)!r}, which cannot be written ({error.strerror}); choose an "
                "existing, writable folder."
            ) from error
        _OPEN[path.resolve()] = self

    def close(self) -> None:
        """Release the files; not collective."""
        if _OPEN.get(self.path.resolve()) is self:
            del _OPEN[self.path.resolve()]

    def replace(self, steps: Sequence[Step]) -> None:
        """Replace the XDMF file by one with these steps, atomically; an OSError on all ranks."""
        self._collection[:] = [one.grid for one in steps]
        with raised_together(self.comm):
            if self.comm.rank == 0:
                ET.indent(self._root)
                draft = disk.draft_of(self.path)
                try:
                    draft.write_bytes(ET.tostring(self._root, "utf-8", xml_declaration=True))
                    disk.replace_by_draft(self.path)
                except OSError as error:
                    draft.unlink(missing_ok=True)
                    raise OSError(error.errno, error.strerror, str(self.path)) from error
        self.steps = list(steps)

    def write(self, *new: tuple[ET.Element, str, Floats | Ints | Longs]) -> list[ET.Element]:
        """Write rows (n, k) of this rank by keys, refer to them in elements, and return these.

        A full disk during a parallel write leaves a broken file and a deadlock, so that space is
        demanded first.
        """
        total = disk.space_for(len(new), self.comm.allreduce(sum(rows.nbytes for *_, rows in new)))
        with raised_together(self.comm):
            if self.comm.rank == 0:
                total += self.path.stat().st_size if self.path.exists() else 0  # its next version
                disk.demand_space(self.data, total)
        viewer = PETSc.Viewer()
        self._together(lambda: viewer.createHDF5(str(self.data), self._mode, comm=self.comm))
        self._mode = "a"
        try:
            for element, key, rows in new:
                element.append(self._write_rows(viewer, key, rows))
        finally:
            self._together(viewer.destroy)
        return [element for element, _, _ in new]

    def _write_rows(
        self, viewer: PETSc.Viewer, key: str, rows: Floats | Ints | Longs
    ) -> ET.Element:
        """Write numbers or nodes of cells; return the reference."""
        k, kind, flat = rows.shape[1], "Float", rows.ravel()
        written: Any
        if rows.dtype.kind == "f":
            flat = flat.astype(np.float64)
            written = PETSc.Vec().createWithArray(flat, bsize=k, comm=self.comm)
        else:
            kind, flat = "Int", flat.astype(PETSc.IntType)
            written = PETSc.IS().createGeneral(flat, comm=self.comm)
            written.setBlockSize(k)
        written.setName(key)
        self._together(lambda: written.view(viewer))
        n = int(written.getSize()) // k
        written.destroy()
        about = {"NumberType": kind, "Precision": str(flat.itemsize), "Format": "HDF"}
        item = ET.Element("DataItem", about, Dimensions=f"{n} {k}" if k > 1 else str(n))
        item.text = f"{self.data.name}:/{key}"
        return item

    def _together(self, action: Callable[[], Any]) -> None:
        """Call a collective action; an error on one rank is raised on all, naming the file."""
        failed = None
        try:
            action()
        except Exception as error:
            failed = OSError(f"{self.data} could not be written: {error}")
        raise_together(self.comm, failed)


def _create_tree(notes: Mapping[str, Any]) -> tuple[ET.Element, ET.Element]:
    root = ET.Element("Xdmf", Version="3.0")
    domain = ET.SubElement(root, "Domain")
    steps = ET.SubElement(domain, "Grid", Name="steps", GridType="Collection")
    steps.set("CollectionType", "Temporal")
    check("notes", notes, instance(Mapping, "give a dictionary, name -> text or JSON value"))
    for name, note in notes.items():
        _check_xml("notes", name)
        text = note
        if not isinstance(note, str):
            try:
                text = json.dumps(note, allow_nan=False)
            except (TypeError, ValueError) as error:
                wrong = f"notes[{name!r}] = {note!r} is no text and no JSON value."
                raise ValueError(wrong) from error
        _check_xml(f"notes[{name!r}]", text)
        ET.SubElement(domain, "Information", Name=name, Value=text)
    return root, steps


def _check_xml(what: str, text: Any) -> None:
    if not isinstance(text, str) or _NOT_XML.search(text):
        raise ValueError(f"{what}: {text!r} is no text that XML can hold.")


def _read(path: Path) -> list[Step]:
    """Steps of an earlier run, or a ValueError; on rank 0."""
    told = f"path is {str(path)!r}, which cannot be resumed, as"
    steps = []
    try:
        root = ET.parse(path).getroot()
        collection = root.find("Domain/Grid[@Name='steps']")
        if root.tag != "Xdmf" or collection is None:
            raise ValueError("it has no steps")
        for grid in collection:
            found = {i.get("Name"): i.get("Value") for i in grid.findall("Information")}
            time = float(grid.find("Time").get("Value"))  # type: ignore[union-attr, arg-type]
            steps.append(Step(grid, int(found[DONE] or ""), time, earlier=True))
    except (ET.ParseError, OSError, LookupError, ValueError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{told} no Writer of this version has written it ({error}): give another name."
        ) from error
    gone = {name for s in steps for name in s.files if not (path.parent / name).is_file()}
    if gone:
        names = ", ".join(sorted(gone))
        raise ValueError(f"{told} {names} with its numbers is gone: give another name.")
    return steps


def insert(steps: Sequence[Step], new: Step, *, made: bool) -> list[Step]:
    """Insert a step in order of time, and drop steps of an earlier run that it replaces.

    A load step `made` by this run replaces itself and all later ones, one restored from a
    checkpoint only itself; before the first load step, the new one replaces steps without load
    steps from its time on.

    Raises:
        ValueError: if times would not rise.
    """

    def is_replaced(one: Step) -> bool:
        if made:
            return one.done >= new.done
        if new.done:
            return (one.done, one.time) == (new.done, new.time)
        return not one.done and one.time >= new.time

    kept = [one for one in steps if not (one.earlier and is_replaced(one))]
    for one in kept:
        before = not one.earlier or one.done <= new.done
        if one.time == new.time or (before and one.time > new.time):
            raise ValueError(
                f"t is {new.time}, but the file has a step at {one.time}: times have to rise; "
                "where loads fall, give the number of the step, len(problem.history)."
            )
    return sorted([*kept, new], key=lambda one: one.time)


def free_name(path: Path, steps: Iterable[Step]) -> Path:
    """New name for the HDF5 file."""
    taken = {name for step in steps for name in step.files}
    names = chain([".h5"], (f".{number}.h5" for number in count(2)))
    return next(file for file in map(path.with_suffix, names) if file.name not in taken)


class _ToolFile(File):
    """The surfaces of rigid tools, of rank 0.

    Cut in the frames of the tools, in a box around the side, enlarged by its diagonal, and moved,
    until the side leaves the box.
    """

    written = 0  # steps, by this run, also those that the results lack
    boxes: Any = None  # (tools, 2, d) of the last cuts
    points: Sequence[Floats] = ()
    head: Sequence[ET.Element] = ()

    def write_step(self, steps: Sequence[Step], new: Step, tools: Tools) -> None:
        """Write the tools at a new step, and drop steps that the results lack."""
        number, self.written = self.written, self.written + 1
        sides = np.array([box for _, box in tools])
        inwards = np.array([[1.0], [-1.0]])
        if self.boxes is None or not (inwards * (sides - self.boxes) >= 0.0).all():
            diagonals = np.linalg.norm(np.diff(sides, axis=1), axis=2, keepdims=True)
            self.boxes = sides - inwards * diagonals
            cuts = [tool.cut(*box) for (tool, _), box in zip(tools, self.boxes, strict=True)]
            self.points = [x for x, _ in cuts]
            before = np.cumsum([0, *map(len, self.points)])
            cells = np.concatenate([c + n for (_, c), n in zip(cuts, before, strict=False)])
            of = np.repeat(np.arange(len(cuts), dtype=np.float64), [len(c) for _, c in cuts])
            about = {"TopologyType": "Triangle", "NumberOfElements": str(len(cells))}
            if cells.shape[1] == 2:
                about |= {"TopologyType": "Polyline", "NodesPerElement": "2"}
            topology = ET.Element("Topology", about)
            numbers = ET.Element("Attribute", Name="tool", AttributeType="Scalar", Center="Cell")
            self.head = self.write(
                (topology, f"cells_{number:06d}", cells),
                (numbers, f"tool_{number:06d}", of[:, None]),
            )
        pairs = zip(self.points, tools, strict=True)
        x = np.concatenate([tool.pose().to_space(points) for points, (tool, _) in pairs])
        x = np.pad(x, ((0, 0), (0, 3 - x.shape[1])))
        step = new_step(new.done, new.time)
        geometry = ET.Element("Geometry", GeometryType="XYZ")
        points = self.write((geometry, f"points_{number:06d}", x))
        step.grid.extend([*self.head, *points])
        own = {(one.done, one.time): one for one in [*self.steps, step]}
        self.replace([own[at] for one in steps if (at := (one.done, one.time)) in own])
