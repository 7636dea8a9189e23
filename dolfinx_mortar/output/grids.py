# SPDX-License-Identifier: MIT
"""The steps in an XDMF file: their order, and which steps of an earlier run are replaced."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

from dolfinx_mortar.algebra.errors import raised_together

# Names of what a grid contains beside fields: number of load steps, digest of mesh and numbering
DONE, MESH = "load steps", "mesh"


@dataclass(frozen=True)
class Step:
    """A grid of the XDMF file: all data of one step."""

    grid: ET.Element
    done: int  # load steps completed before it was written
    time: float
    mesh: str  # digest of the mesh with its numbering of nodes
    earlier: bool = False  # written by an earlier run

    @property
    def files(self) -> set[str]:
        """Names of the files with its numbers."""
        return {str(item.text).partition(":")[0].strip() for item in self.grid.iter("DataItem")}

    def remember(self) -> None:
        """Store in the grid what `read_steps` needs."""
        for name, value in ((DONE, self.done), (MESH, self.mesh)):
            ET.SubElement(self.grid, "Information", Name=name, Value=str(value))


def read_steps(comm: MPI.Comm, path: Path) -> list[Step]:
    """Return the steps in the file of an earlier run, none without a file; collective.

    Raises:
        ValueError: on all ranks, if it is no file of a `Writer`, or its HDF5 files are missing.
    """
    steps: list[Step] = []
    with raised_together(comm):
        if comm.rank == 0 and path.exists():
            try:
                steps = _steps(ET.parse(path).getroot())
            except (ET.ParseError, OSError, ValueError, TypeError, AttributeError) as error:
                raise ValueError(
                    f"path is {str(path)!r}, which cannot be resumed, as no Writer of this version "
                    f"has written it ({error}): give another name."
                ) from error
            gone = {name for s in steps for name in s.files if not (path.parent / name).is_file()}
            if gone:
                raise ValueError(
                    f"path is {str(path)!r}, which cannot be resumed, as "
                    f"{', '.join(sorted(gone))} with its numbers is gone: give another name."
                )
    return list(comm.bcast(steps))


def _steps(root: ET.Element) -> list[Step]:
    """Return the steps of a document; an error if it has another structure than a Writer's."""
    collection = root.find("Domain/Grid[@Name='steps']")
    if root.tag != "Xdmf" or collection is None:
        raise ValueError("it has no steps")
    return [_step(grid) for grid in collection]


def _step(grid: ET.Element) -> Step:
    """Return the step of a grid; an error if something is missing."""
    found = {i.get("Name"): i.get("Value") for i in grid.findall("Information")}
    if not {DONE, MESH} <= set(found):
        raise ValueError("a grid has no number of load steps")
    time = float(grid.find("Time").get("Value"))  # type: ignore[union-attr, arg-type]
    return Step(grid, int(found[DONE] or ""), time, str(found[MESH]), earlier=True)


def insert(steps: Sequence[Step], new: Step, *, made: bool) -> list[Step]:
    """Return the steps in order of time with a new one, less those of an earlier run it replaces.

    A load step computed by this run replaces itself and all later ones. A state restored from a
    checkpoint replaces only itself, as a later checkpoint may follow. Before the first load step,
    steps without load steps are replaced from the new time on.

    Args:
        steps: in the file.
        new: the new one.
        made: whether its load step was computed by this run, not restored from a checkpoint.

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
