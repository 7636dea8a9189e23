# SPDX-License-Identifier: MIT
"""Surfaces of a mesh, pairs of facets over all ranks, dual functions, D and M. No mechanics."""
