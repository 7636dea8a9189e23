# SPDX-License-Identifier: MIT
"""Facets in space: search, projection, clipping, quadrature points.

Arrays only: no dofs, no ranks, no PETSc.
"""
