# SPDX-License-Identifier: MIT
"""What would go wrong, named before the first step: mesh, sides, partners, free bodies."""
