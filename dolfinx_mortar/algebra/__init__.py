# SPDX-License-Identifier: MIT
"""Matrices and reductions over ranks that PETSc and mpi4py do not offer.

Triplets on a fixed pattern, d x d blocks between nodes, congruence transformations, reductions of
small arrays, errors raised on all ranks; without finite elements.
"""
