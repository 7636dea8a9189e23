# SPDX-License-Identifier: MIT
"""Solvers of bound-constrained QPs: one file each, found by name.

A backend has ``solve(qp, linear, *, start, rtol, settled)`` and returns a `QPSolution`.
Knows nothing of meshes, and is judged by `bound_qp.check` alone.
"""
