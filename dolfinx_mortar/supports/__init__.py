# SPDX-License-Identifier: MIT
"""Bodies and supports: connected parts, rigid motions, Dirichlet data, axis of rotation."""
