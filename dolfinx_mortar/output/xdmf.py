# SPDX-License-Identifier: MIT
"""An XDMF file with a grid for each step, and the HDF5 file with its numbers."""

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx_mortar.algebra.parallel import raise_together, raised_together
from dolfinx_mortar.common.arguments import check, instance
from dolfinx_mortar.common.arrays import Floats, Ints, Longs
from dolfinx_mortar.common.disk import (
    demand_space,
    draft_of,
    is_checkpoint,
    replace_by_draft,
    space_for,
)

# Open files of this program by path, on rank 0.
_OPEN: WeakValueDictionary[Path, "File"] = WeakValueDictionary()
# Characters forbidden in XML.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
DONE = "load steps"  # attribute of a grid: their number


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
            if is_checkpoint(data):
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
                draft = draft_of(self.path)
                try:
                    draft.write_bytes(ET.tostring(self._root, "utf-8", xml_declaration=True))
                    replace_by_draft(self.path)
                except OSError as error:
                    draft.unlink(missing_ok=True)
                    raise OSError(error.errno, error.strerror, str(self.path)) from error
        self.steps = list(steps)

    def write(self, *new: tuple[ET.Element, str, Floats | Ints | Longs]) -> list[ET.Element]:
        """Write rows (n, k) of this rank by keys, refer to them in elements, and return these.

        A full disk during a parallel write leaves a broken file and a deadlock, so that space is
        demanded first.
        """
        total = space_for(len(new), self.comm.allreduce(sum(rows.nbytes for *_, rows in new)))
        with raised_together(self.comm):
            if self.comm.rank == 0:
                total += self.path.stat().st_size if self.path.exists() else 0  # its next version
                demand_space(self.data, total)
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
        count = int(written.getSize()) // k
        written.destroy()
        about = {"NumberType": kind, "Precision": str(flat.itemsize), "Format": "HDF"}
        item = ET.Element("DataItem", about, Dimensions=f"{count} {k}" if k > 1 else str(count))
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
        check_xml("notes", name)
        text = note
        if not isinstance(note, str):
            try:
                text = json.dumps(note, allow_nan=False)
            except (TypeError, ValueError) as error:
                wrong = f"notes[{name!r}] = {note!r} is no text and no JSON value."
                raise ValueError(wrong) from error
        check_xml(f"notes[{name!r}]", text)
        ET.SubElement(domain, "Information", Name=name, Value=text)
    return root, steps


def check_xml(what: str, text: Any) -> None:
    """Raise a ValueError for what XML cannot hold."""
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
    """New name for the HDF5 file.

    >>> free_name(Path("out.xdmf"), [])
    PosixPath('out.h5')
    """
    taken = {name for step in steps for name in step.files}
    names = chain([".h5"], (f".{number}.h5" for number in count(2)))
    return next(file for file in map(path.with_suffix, names) if file.name not in taken)
