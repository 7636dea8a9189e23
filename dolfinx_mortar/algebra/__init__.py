# SPDX-License-Identifier: MIT
"""Sparse matrices, congruence transformations reductions over ranks; without finite elements."""
