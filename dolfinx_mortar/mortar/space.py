# SPDX-License-Identifier: MIT
"""Which spaces a surface can be made of: the gatekeeper of the mortar method."""

from petsc4py import PETSc

import numpy as np

import dolfinx
from dolfinx_mortar.geometry.elements import FACETS_OF


def _is_vector_p1(V: dolfinx.fem.FunctionSpace) -> bool:
    """Tell whether V is made of continuous vector Lagrange elements of degree 1."""
    if V.dofmap.index_map_bs != V.mesh.geometry.dim:
        return False
    element = V.ufl_element()
    if element.family_name not in ("P", "Q", "Lagrange") or element.reference_value_size < 2:
        return False
    return not element.discontinuous and V.element.basix_element.degree == 1


def check_space(V: dolfinx.fem.FunctionSpace) -> None:
    """Raise a ValueError, without communication, for spaces that are not supported.

    It needs no surface: a problem without interfaces can ask, too.

    Raises:
        ValueError: For a complex PETSc, cells of other types or dimensions, curved cells, parts of
            larger spaces, and other elements than vector Lagrange of degree 1.
    """
    if np.issubdtype(PETSc.ScalarType, np.complexfloating):
        raise ValueError("PETSc was built for complex numbers; use a build for real numbers.")
    cell, d = V.mesh.topology.cell_name(), V.mesh.geometry.dim
    if cell not in FACETS_OF or d != V.mesh.topology.dim:
        raise ValueError(
            f"V: cells of type {cell} in {d}D are not supported; use one of {sorted(FACETS_OF)}, "
            "the same for all bodies."
        )
    degree = V.mesh.geometry.cmap.degree
    if degree != 1:
        raise ValueError(
            f"V: the cells of the mesh are of degree {degree}; only straight ones are supported, "
            "make the mesh with degree 1 (in Gmsh: mesh.setOrder(1))."
        )
    if V.component():
        raise ValueError("V is a part of a larger space; use V.collapse()[0].")
    if not _is_vector_p1(V):
        raise ValueError(
            f"V: the element is {V.ufl_element()}; it has to be a continuous vector Lagrange "
            f'element of degree 1, functionspace(mesh, ("Lagrange", 1, ({d},))).'
        )
