# SPDX-License-Identifier: MIT
"""Bodies and their supports: connected parts, rigid motions, Dirichlet data, the axis of rings.

Knows nothing of contact sets, loads or steps.
"""
