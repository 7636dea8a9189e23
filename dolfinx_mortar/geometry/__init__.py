# SPDX-License-Identifier: MIT
"""Facets in space: search, projection, clipping, quadrature points.

Arrays of node coordinates in, index arrays and quadrature points out.
No dofs, no ranks, no PETSc.
"""
