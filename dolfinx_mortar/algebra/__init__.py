# SPDX-License-Identifier: MIT
"""Matrices and reductions that PETSc and mpi4py do not offer in the form we need.

Triplets on a fixed pattern, d x d blocks between nodes, reductions of small arrays over the ranks.
Knows nothing of finite elements: rows, columns and values only.
"""
