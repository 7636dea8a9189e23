# SPDX-License-Identifier: MIT
"""Surfaces of a mesh, pairs of facets over all ranks, dual functions, D and M.

`paper` has D, M and N for users; the solver uses `operators`. No mechanics.
"""
