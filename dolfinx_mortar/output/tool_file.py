# SPDX-License-Identifier: MIT
"""Rigid tools beside the results: a second XDMF file, with a grid for each step.

Their surfaces are no part of the mesh. They are found in the frames of the tools, where they do not
change, and their points are moved. All is done on rank 0, which needs of the mesh only the boxes
around the sides that meet the tools.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_mortar.algebra.errors import raised_together
from dolfinx_mortar.arrays import Floats, Longs
from dolfinx_mortar.output.files import (
    claim_files,
    create_tree,
    demand_space_for_step,
    release_files,
    replace_tree,
)
from dolfinx_mortar.output.grids import Step, free_name, read_steps
from dolfinx_mortar.output.numbers import Numbers

SELF = MPI.COMM_SELF


class ToolFile:
    """The file out.tools.xdmf beside out.xdmf, of rank 0."""

    def __init__(self, results: Path, notes: Mapping[str, Any], *, resume: bool) -> None:
        """Create it.

        Args:
            results: the file of the results.
            notes: as of a `Writer`.
            resume: whether to go on with an earlier file.
        """
        self.path = results.with_suffix(".tools.xdmf")
        self._root, self._collection = create_tree(notes)
        self._steps = read_steps(SELF, self.path) if resume else []
        self._numbers = Numbers(SELF, free_name(self.path, self._steps))
        claim_files(SELF, self.path, self._numbers.path, self, resume=resume)
        with self._numbers.viewer("w"):
            pass
        self._written = 0  # steps, by this run
        self._cuts: list[_Cut] = []
        self._cells: list[ET.Element] = []  # references to those of the last cuts

    def write(self, steps: Sequence[Step], new: Step, tools: Sequence[tuple[Any, Floats]]) -> None:
        """Write the tools at a new step, and keep only steps that the results have.

        Args:
            steps: of the results, with the new one.
            new: this one.
            tools: see `ContactProblem.output_tools`.
        """
        known = len(self._cuts) == len(tools) and all(
            cut.holds(box) for cut, (_, box) in zip(self._cuts, tools, strict=True)
        )
        if not known:
            self._cuts = [_Cut(tool, box) for tool, box in tools]
        pairs = zip(self._cuts, tools, strict=True)
        x = np.concatenate([tool.pose.to_space(cut.points) for cut, (tool, _) in pairs])
        x = np.pad(x, ((0, 0), (0, 3 - x.shape[1])))
        grid = ET.Element("Grid", GridType="Uniform")
        step = replace(new, grid=grid, mesh="tools")
        grid.set("Name", f"step {steps.index(new)}")
        ET.SubElement(grid, "Time", Value=repr(step.time))
        step.remember()
        size = x.nbytes + sum(cut.cells.nbytes for cut in self._cuts)
        demand_space_for_step(SELF, self.path, self._numbers.path, size, 3)
        with self._numbers.viewer("a") as viewer:
            if not known:
                self._cells = self._write_cells(viewer)
            geometry = ET.Element("Geometry", GeometryType="XYZ")
            geometry.append(self._numbers.write(viewer, f"points_{self._written:06d}", x))
        self._written += 1
        topology, of_cells = self._cells
        grid.extend([topology, geometry, of_cells])
        places = {(one.done, one.time) for one in steps} - {(new.done, new.time)}
        kept = [one for one in self._steps if (one.done, one.time) in places]
        self._steps = sorted([*kept, step], key=lambda one: one.time)
        self._collection[:] = [one.grid for one in self._steps]
        replace_tree(SELF, self.path, self._root)

    def _write_cells(self, viewer: Any) -> list[ET.Element]:
        """Write lines or triangles, and which tool each belongs to; return the references."""
        before = np.cumsum([0, *(len(cut.points) for cut in self._cuts)])
        cells = np.concatenate([cut.cells + n for cut, n in zip(self._cuts, before, strict=False)])
        of = np.repeat(np.arange(len(self._cuts)), [len(cut.cells) for cut in self._cuts])
        kind = {2: "Polyline", 3: "Triangle"}[cells.shape[1]]
        topology = ET.Element("Topology", TopologyType=kind, NumberOfElements=str(len(cells)))
        if kind == "Polyline":
            topology.set("NodesPerElement", "2")
        topology.append(self._numbers.write_cells(viewer, f"cells_{self._written:06d}", cells))
        about = {"Name": "tool", "AttributeType": "Scalar", "Center": "Cell"}
        attribute = ET.Element("Attribute", about)
        values = of[:, None].astype(np.float64)
        attribute.append(self._numbers.write(viewer, f"tool_{self._written:06d}", values))
        return [topology, attribute]

    def leave(self) -> None:
        """Make the files available to other writers."""
        release_files(self.path, self)


class _Cut:
    """The surface of a tool in its frame, as far as a side may get, and beyond.

    A box around the side is enlarged by its diagonal on all sides: what rolls along the side rolls
    no farther. When the side leaves this box, the surface is cut anew.
    """

    def __init__(self, tool: Any, box: Floats) -> None:
        beside = np.linalg.norm(box[1] - box[0])
        self.low, self.high = box[0] - beside, box[1] + beside
        found: tuple[Floats, Longs] = tool.cut(self.low, self.high)
        self.points, self.cells = found

    def holds(self, box: Floats) -> bool:
        """Whether a box (2, d) around the side is within."""
        return bool((self.low <= box[0]).all() and (box[1] <= self.high).all())


def create_tool_file(
    comm: MPI.Comm,
    problem: Any,
    results: Path,
    notes: Mapping[str, Any],
    *,
    resume: bool,
) -> ToolFile | None:
    """Return the file on rank 0, for a problem with tools; collective."""
    found = None
    if tools_of(problem):
        with raised_together(comm):
            if comm.rank == 0:
                found = ToolFile(results, notes, resume=resume)
    return found


def tools_of(problem: Any) -> Sequence[tuple[Any, Floats]]:
    """Return the tools of a problem; collective."""
    find = getattr(problem, "output_tools", None)
    return () if find is None else find()
