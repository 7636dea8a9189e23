# SPDX-License-Identifier: MIT
"""Surfaces of a mesh, pairs of facets over all ranks, dual functions, D and M.

`paper` has D, M and N as the paper writes them; the solver uses `operators`.
No mechanics: no materials, forces or constraints.
"""
