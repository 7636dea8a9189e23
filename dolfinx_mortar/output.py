# SPDX-License-Identifier: MIT
"""Results for ParaView and meshio: one XDMF file over the steps, one grid per step.

dolfinx's own XDMF writer gives every function a grid of its own, of which meshio keeps the last
one only. Here each step is one grid with the mesh and all fields. The heavy numbers are written in
parallel to one HDF5 file next to the XDMF file; no field is gathered on one rank.

Points are the nodes of the displacement space, whatever its degree, so that node fields need no
interpolation.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from types import TracebackType
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import default_scalar_type, fem, plot
from dolfinx_mortar.arrays import Floats, Ints
from dolfinx_mortar.materials.tensor import COMPONENTS

TOPOLOGY = {  # XDMF names by (cell, nodes per cell); nodes in VTK order
    ("triangle", 3): "Triangle",
    ("triangle", 6): "Triangle_6",
    ("quadrilateral", 4): "Quadrilateral",
    ("quadrilateral", 9): "Quadrilateral_9",
    ("tetrahedron", 4): "Tetrahedron",
    ("tetrahedron", 10): "Tetrahedron_10",
    ("hexahedron", 8): "Hexahedron",
    ("hexahedron", 27): "Hexahedron_27",
}

KINDS = {1: "Scalar", 3: "Vector", 9: "Tensor"}  # XDMF attribute types by components


def _expansion(stored: tuple[str, ...]) -> Floats:
    """Return the matrix E, (components, 9), that makes full tensors of stored symmetric ones.

    >>> np.array([[1.0, 2.0, 3.0, 4.0]]) @ _expansion(("xx", "yy", "zz", "xy"))
    array([[1., 4., 0., 4., 2., 0., 0., 0., 3.]])
    """
    nine = [row + column for row in "xyz" for column in "xyz"]
    return np.array([[float(name in (s, s[::-1])) for name in nine] for s in stored])


STORED = {len(names): _expansion(names) for names in COMPONENTS.values()}  # by components


class HasSpace(Protocol):
    """The part of a solid that the writer reads."""

    V: fem.FunctionSpace  # vector Lagrange space of the displacement


class HasOutput(Protocol):
    """The part of a problem that the writer reads."""

    solid: HasSpace

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
    been written stays readable whatever happens next.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        problem: HasOutput,
        *,
        notes: dict[str, str] | None = None,
    ) -> None:
        """Create the files and write the mesh.

        Args:
            path: File to write, ending in .xdmf; the numbers go next to it, ending in .h5. Earlier
                files of these names are replaced; the folder must exist.
            problem: Problem with ``solid.V`` and ``output_fields()``.
            notes: Texts kept in the file, such as {"units": "mm, MPa"}.

        Raises:
            ValueError: If the suffix is another, the files cannot be written, or the cells are of
                a kind that XDMF has no name for (on all ranks).
        """
        V = problem.solid.V
        self.comm: MPI.Intracomm = V.mesh.comm
        self.path = Path(path)
        self.problem = problem
        cell = V.mesh.topology.cell_type.name, V.dofmap.dof_layout.num_dofs
        if cell not in TOPOLOGY:
            raise ValueError(f"problem: {cell[0]} cells with {cell[1]} nodes have no XDMF name.")
        _check_writable(self.comm, self.path)
        self._layout = _Layout(V)
        self._step = 0
        self._root, self._steps = _create_tree(notes or {})
        self._grid_head = self._write_mesh(V, TOPOLOGY[cell])

    def write(self, t: float) -> None:
        """Add the problem's current fields as the step at time (or load) t."""
        fields = self.problem.output_fields()
        grid = ET.Element("Grid", Name=f"step {self._step}", GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(float(t)))
        grid.extend(self._grid_head)
        viewer = self._open("a")
        for name, function in fields.items():
            values, centre = self._layout.values(name, function)
            key = f"{re.sub(r'[^A-Za-z0-9]+', '_', name)}_{self._step:06d}"
            kind = KINDS.get(values.shape[1], "Matrix")
            attribute = ET.SubElement(grid, "Attribute", Name=name, AttributeType=kind)
            attribute.set("Center", centre)
            attribute.append(self._write_values(viewer, key, values))
        viewer.destroy()
        self._steps.append(grid)
        self._step += 1
        self._replace_tree()

    def close(self) -> None:
        """End the writing; everything is on disk already, so this only lets go of the problem."""
        self.comm.Barrier()

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

    def _open(self, mode: str) -> PETSc.Viewer:
        return PETSc.Viewer().createHDF5(str(self.path.with_suffix(".h5")), mode, comm=self.comm)

    def _write_mesh(self, V: fem.FunctionSpace, topology: str) -> list[ET.Element]:
        """Write cells and points once; every step's grid refers to them."""
        viewer = self._open("w")
        nodes, _, _ = plot.vtk_mesh(V)
        k = V.dofmap.dof_layout.num_dofs
        local = nodes.reshape(-1, k + 1)[:, 1:]  # the first column repeats the number of nodes
        cells = V.dofmap.index_map.local_to_global(local.reshape(-1).astype(np.int32))
        indices = PETSc.IS().createGeneral(cells.astype(PETSc.IntType), comm=self.comm)
        indices.setBlockSize(k)
        indices.setName("cells")
        indices.view(viewer)
        head = ET.Element("Topology", TopologyType=topology)
        shape = V.mesh.topology.index_map(V.mesh.topology.dim).size_global, k
        head.set("NumberOfElements", str(shape[0]))
        head.append(self._item("cells", shape, "Int", np.dtype(PETSc.IntType).itemsize))
        indices.destroy()
        geometry = ET.Element("Geometry", GeometryType="XYZ")
        x = V.tabulate_dof_coordinates()[: V.dofmap.index_map.size_local]
        geometry.append(self._write_values(viewer, "points", x))
        viewer.destroy()
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
        vector.view(viewer)
        rows = vector.getSize() // components
        vector.destroy()
        return self._item(key, (rows, components) if components > 1 else (rows,), "Float", 8)

    def _item(self, key: str, shape: tuple[int, ...], kind: str, precision: int) -> ET.Element:
        item = ET.Element("DataItem", Dimensions=" ".join(map(str, shape)), NumberType=kind)
        item.set("Precision", str(precision))
        item.set("Format", "HDF")
        item.text = f"{self.path.with_suffix('.h5').name}:/{key}"
        return item

    def _replace_tree(self) -> None:
        """Rewrite the XDMF file so that a reader finds the old or the new one, never a half."""
        if self.comm.rank == 0:
            draft = self.path.with_suffix(".xdmf.part")
            with draft.open("wb") as file:
                ET.indent(self._root)
                ET.ElementTree(self._root).write(file, "utf-8", xml_declaration=True)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(self.path)
        self.comm.Barrier()


class _Layout:
    """Bring Functions into the numbering of the displacement space's nodes, or of the cells."""

    def __init__(self, V: fem.FunctionSpace) -> None:
        self.V = V
        self.element = V.ufl_element()
        self._rows: dict[str, tuple[fem.FunctionSpace, Ints]] = {}  # by name
        self._targets: dict[str, fem.Function] = {}  # for fields of another degree, by name

    def values(self, name: str, function: fem.Function) -> tuple[Floats, str]:
        """Return the owned values, padded, shape (n, components), and "Node" or "Cell"."""
        space = function.function_space
        if space.mesh is not self.V.mesh:
            raise ValueError(f"output field {name!r} lives on another mesh than the displacement.")
        degree = space.ufl_element().degree
        if degree != 0 and degree != self.element.degree:
            function = self._interpolate(name, function)
        rows = self._permutation(name, function.function_space)
        values = function.x.array.reshape(-1, function.function_space.dofmap.index_map_bs)[rows]
        return _pad(values, function.ufl_shape), "Cell" if degree == 0 else "Node"

    def _permutation(self, name: str, space: fem.FunctionSpace) -> Ints:
        """Local nodes (or cells) of a space in the order of V's owned nodes (or the owned cells).

        The numbering of a space is dolfinx's affair: two spaces of the same element need not agree.
        """
        known, rows = self._rows.get(name, (None, np.empty(0, dtype=np.int32)))
        if known is not space:
            cells, topology = space.dofmap.list, space.mesh.topology
            if space.ufl_element().degree == 0:
                rows = cells[: topology.index_map(topology.dim).size_local, 0]
            else:
                index_map = self.V.dofmap.index_map
                rows = np.empty(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
                rows[self.V.dofmap.list] = cells
                rows = rows[: index_map.size_local]
            self._rows[name] = space, rows
        return rows

    def _interpolate(self, name: str, function: fem.Function) -> fem.Function:
        if name not in self._targets:
            family, shape = ("Lagrange", self.element.degree), function.ufl_shape
            space = fem.functionspace(self.V.mesh, (*family, shape) if shape else family)
            self._targets[name] = fem.Function(space)
        self._targets[name].interpolate(function)
        return self._targets[name]


def _pad(values: Floats, shape: tuple[int, ...]) -> Floats:
    """Pad vectors to three and tensors to three by three components.

    >>> _pad(np.array([[1.0, 2.0]]), (2,)).tolist()
    [[1.0, 2.0, 0.0]]
    >>> _pad(np.array([[1.0, 2.0, 3.0, 4.0]]), (2, 2)).tolist()
    [[1.0, 2.0, 0.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0]]
    """
    n, components = values.shape
    if shape == (2,):
        return np.pad(values, ((0, 0), (0, 1)))
    if len(shape) == 1 and components in STORED:
        return values @ STORED[components]
    if len(shape) == 2 and shape[0] == shape[1] <= 3:
        if components < shape[0] ** 2:
            # a symmetric element stores the rows of the lower triangle
            row, column = np.tril_indices(shape[0])
            full = np.zeros((n, *shape))
            full[:, row, column] = full[:, column, row] = values
        else:
            full = values.reshape(n, *shape)
        margin = (0, 3 - shape[0])
        return np.pad(full, ((0, 0), margin, margin)).reshape(n, 9)
    return values


def _create_tree(notes: dict[str, str]) -> tuple[ET.Element, ET.Element]:
    """Return the XDMF document and its collection of steps."""
    root = ET.Element("Xdmf", Version="3.0")
    domain = ET.SubElement(root, "Domain")
    steps = ET.SubElement(domain, "Grid", Name="steps", GridType="Collection")
    steps.set("CollectionType", "Temporal")
    for name, text in notes.items():
        ET.SubElement(domain, "Information", Name=name, Value=text)
    return root, steps


def _check_writable(comm: MPI.Intracomm, path: Path) -> None:
    """Raise on all ranks unless rank 0 can create both files; remove what an earlier run left."""
    problem = ""
    if path.suffix != ".xdmf":
        problem = "must end in .xdmf"
    elif comm.rank == 0:
        try:
            path.unlink(missing_ok=True)
            with path.with_suffix(".h5").open("wb"):
                pass
        except OSError as error:
            problem = f"cannot be written ({error.strerror}); choose an existing, writable folder"
    problem = comm.bcast(problem)
    if problem:
        raise ValueError(f"path = {str(path)!r} {problem}.")
