# SPDX-License-Identifier: MIT
"""Solvers of bound-constrained QPs: one file each, named like the backend with underscores.

Each has ``solve(qp, linear, *, start, rtol)`` and returns a `QPSolution`; nothing has to
be registered. Knows nothing of meshes, and is judged by `bound_qp.check` alone.
"""
