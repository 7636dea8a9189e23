# SPDX-License-Identifier: MIT
"""The bodies: laws on cells, energy, residual and tangent in UFL, state, values at points."""
