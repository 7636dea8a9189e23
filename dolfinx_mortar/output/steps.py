# SPDX-License-Identifier: MIT
"""The steps in an XDMF file: their order, and which steps of an earlier run are replaced."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from dolfinx_mortar.algebra.errors import raised_together

# What a grid says beside its fields: load steps made when it was written, numbering of its mesh
DONE, MESH = "load steps", "mesh"


@dataclass(frozen=True)
class Step:
    """A grid with all that is written of one step."""

    grid: ET.Element
    done: int  # load steps that the problem had made
    time: float
    mesh: str  # tells meshes, and how their nodes are numbered, from others
    earlier: bool = False  # another run has written it

    @property
    def files(self) -> set[str]:
        """Names of the files with its numbers."""
        return {str(item.text).partition(":")[0].strip() for item in self.grid.iter("DataItem")}

    def remember(self) -> None:
        """Write into the grid what a later run has to know."""
        for name, value in ((DONE, self.done), (MESH, self.mesh)):
            ET.SubElement(self.grid, "Information", Name=name, Value=str(value))


def read_steps(comm: MPI.Comm, path: Path) -> list[Step]:
    """Return the steps that an earlier run has left in a file, none without a file; collective.

    Raises:
        ValueError: on all ranks, if it is no file of a `Writer`, or its numbers are gone.
    """
    steps: list[Step] = []
    with raised_together(comm):
        if comm.rank == 0 and path.exists():
            try:
                steps = _steps(ET.parse(path).getroot())
            except (ET.ParseError, OSError, ValueError, TypeError, AttributeError) as error:
                raise ValueError(
                    f"path = {str(path)!r} cannot be resumed, as no Writer of this version has "
                    f"written it ({error}): give another name."
                ) from error
            gone = {name for s in steps for name in s.files if not (path.parent / name).is_file()}
            if gone:
                raise ValueError(
                    f"path = {str(path)!r} cannot be resumed, as {', '.join(sorted(gone))} with "
                    "its numbers is gone: give another name."
                )
    return list(comm.bcast(steps))


def _steps(root: ET.Element) -> list[Step]:
    """Return the records of the grids; an error if they are not where a Writer has them."""
    collection = root.find("Domain/Grid[@Name='steps']")
    if root.tag != "Xdmf" or collection is None:
        raise ValueError("it has no steps")
    return [_step(grid) for grid in collection]


def _step(grid: ET.Element) -> Step:
    """Return the record of a grid; an error if something is missing."""
    said = {i.get("Name"): i.get("Value") for i in grid.findall("Information")}
    if not {DONE, MESH} <= set(said):
        raise ValueError("it does not say which load steps it has")
    time = float(grid.find("Time").get("Value"))  # type: ignore[union-attr, arg-type]
    return Step(grid, int(said[DONE] or ""), time, str(said[MESH]), earlier=True)


def insert(steps: Sequence[Step], new: Step, *, made: bool) -> list[Step]:
    """Return the steps with a new one in its place, and without those of an earlier run that go.

    A load step that is made anew takes away all that an earlier run has written of it and of later
    ones. What is written of a state that a checkpoint has brought takes away the same only, as
    another checkpoint may follow. Before the first load step none may have been read yet: what was
    written then goes, from this time on.

    Args:
        steps: in the file.
        new: another one.
        made: its load step has been made here, and does not come from a checkpoint.

    Raises:
        ValueError: if times would not rise.
    """
    place = new.done, new.time
    if made:
        gone = [s for s in steps if s.earlier and s.done >= new.done]
    elif new.done:
        gone = [s for s in steps if s.earlier and (s.done, s.time) == place]
    else:
        gone = [s for s in steps if s.earlier and not s.done and s.time >= new.time]
    kept = [step for step in steps if step not in gone]
    for step in kept:
        before = not step.earlier or step.done <= new.done
        if step.time == new.time or (before and step.time > new.time):
            raise ValueError(
                f"t is {new.time}, but the file has a step at {step.time}: times have to rise; "
                "where loads fall, give the number of the step, len(problem.history)."
            )
    return sorted([*kept, new], key=lambda step: step.time)


def free_name(path: Path, steps: Iterable[Step]) -> Path:
    """Return the HDF5 file for new numbers, one that no step refers to.

    >>> free_name(Path("out.xdmf"), [])
    PosixPath('out.h5')
    """
    taken = {name for step in steps for name in step.files}
    file, number = path.with_suffix(".h5"), 1
    while file.name in taken:
        number += 1
        file = path.with_suffix(f".{number}.h5")
    return file


def check_time(t: object) -> float:
    """Return a time as a number, or raise a ValueError."""
    try:
        time = float(t)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise ValueError(f"t is {t!r}: give the time or load of the step, a number.") from error
    if not math.isfinite(time):
        raise ValueError(f"t is {time}: give the time or load of the step, a finite number.")
    return time
