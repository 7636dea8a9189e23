# SPDX-License-Identifier: MIT
"""Bodies and what holds them: connected parts, rigid motions, Dirichlet data, the axis of rings.

Knows nothing of contact sets, loads or steps.
"""
