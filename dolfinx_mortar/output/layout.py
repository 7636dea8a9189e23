# SPDX-License-Identifier: MIT
"""From Functions to rows of numbers in the order of the file's nodes or cells."""

from collections.abc import Mapping

import numpy as np

from dolfinx import fem
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


class Layout:
    """Bring Functions into the numbering of the displacement space's nodes, or of the cells."""

    def __init__(self, V: fem.FunctionSpace) -> None:
        self.V = V
        self.element = V.ufl_element()
        self._rows: dict[str, tuple[fem.FunctionSpace, Ints]] = {}  # by name
        self._targets: dict[str, fem.Function] = {}  # for fields of another degree, by name

    def check(self, fields: Mapping[str, fem.Function]) -> None:
        """Raise a ValueError, without communication, for fields that cannot be written."""
        for name, function in fields.items():
            if function.function_space.mesh is not self.V.mesh:
                raise ValueError(f"output field {name!r} is on another mesh than the displacement.")

    def values(self, name: str, function: fem.Function) -> tuple[Floats, str]:
        """Return the owned values, padded, shape (n, components), and "Node" or "Cell"; collective.

        A Function of another degree than the displacement is interpolated.
        """
        degree = function.function_space.ufl_element().degree
        if degree != 0 and degree != self.element.degree:
            function = self._interpolate(name, function)
        rows = self._permutation(name, function.function_space)
        values = function.x.array.reshape(-1, function.function_space.dofmap.index_map_bs)[rows]
        return _pad(values, function.ufl_shape), "Cell" if degree == 0 else "Node"

    def _permutation(self, name: str, space: fem.FunctionSpace) -> Ints:
        """Return the nodes (or cells) of a space in the order of V's owned nodes (or owned cells).

        Two spaces of the same element may number their nodes differently.
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
