# SPDX-License-Identifier: MIT
"""The bodies: laws on cells, energy, residual and tangent in UFL, state, values at points.

What is compiled depends on the cell and the laws, not on the mesh or the numbers.
Knows nothing of contact.
"""
