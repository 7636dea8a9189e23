# SPDX-License-Identifier: MIT
"""Bodies: laws on cells, energy, residual and tangent in UFL, state, values at points."""
