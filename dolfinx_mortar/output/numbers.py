# SPDX-License-Identifier: MIT
"""The HDF5 file with the numbers of an XDMF file."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from dolfinx import default_scalar_type
from dolfinx_mortar.algebra.errors import raise_together
from dolfinx_mortar.arrays import Floats, Ints, Longs


class Numbers:
    """Write arrays of all ranks to a file, and say in XDMF where they are (all collective)."""

    def __init__(self, comm: MPI.Comm, path: Path) -> None:
        self.comm, self.path = comm, path

    @contextmanager
    def viewer(self, mode: str) -> Iterator[PETSc.Viewer]:
        """Open the HDF5 file within a ``with`` block."""
        viewer = PETSc.Viewer()
        self._together(lambda: viewer.createHDF5(str(self.path), mode, comm=self.comm))
        try:
            yield viewer
        finally:
            self._together(viewer.destroy)

    def write(self, viewer: PETSc.Viewer, key: str, values: Floats) -> ET.Element:
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

    def write_cells(self, viewer: PETSc.Viewer, key: str, cells: Ints | Longs) -> ET.Element:
        """Write the nodes (n, k) of the cells of this rank, and return the reference to them."""
        indices = PETSc.IS().createGeneral(cells.ravel().astype(PETSc.IntType), comm=self.comm)
        indices.setBlockSize(cells.shape[1])
        indices.setName(key)
        self._together(lambda: indices.view(viewer))
        shape = indices.getSize() // cells.shape[1], cells.shape[1]
        indices.destroy()
        return self._item(key, shape, "Int", np.dtype(PETSc.IntType).itemsize)

    def _together(self, action: Callable[[], Any]) -> None:
        """Do something collective; an error on one rank is raised on all, naming the file."""
        failed = None
        try:
            action()
        except Exception as error:
            failed = OSError(f"{self.path} could not be written: {error}")
        raise_together(self.comm, failed)

    def _item(self, key: str, shape: tuple[int, ...], kind: str, precision: int) -> ET.Element:
        about = {"NumberType": kind, "Precision": str(precision), "Format": "HDF"}
        item = ET.Element("DataItem", about, Dimensions=" ".join(map(str, shape)))
        item.text = f"{self.path.name}:/{key}"
        return item
